"""Images for the detectors, and the geometry of quadrilaterals in them.

numpy's BLAS may wake threads for a 6 × 6 system, which takes a thousand times as long as the sum
itself when the cores are busy. OpenCV does not, so its solvers are used here.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.errors import LabError


class VisionError(LabError):
    """An image, a camera or a setting that cannot be used."""


LEAST_EDGE = 16
"""Smallest width and height of an image, px."""

NEXT = [1, 2, 3, 0]
"""Index of the corner, or of the side, after each of a quadrilateral's four."""

PREVIOUS = [3, 0, 1, 2]
"""Index of the one before each."""

UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])

# Conversions by the number of channels; the first is that of an image without an encoding.
_TO_GREY = {
    3: {"bgr8": cv2.COLOR_BGR2GRAY, "rgb8": cv2.COLOR_RGB2GRAY},
    4: {"bgra8": cv2.COLOR_BGRA2GRAY, "rgba8": cv2.COLOR_RGBA2GRAY},
}
# px; reach of the differences that give the derivatives of the lens.
_STEP = 0.5
# Most iterations, and px at which they end, of the inverse of the distortion.
_PRECISION = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-6)


def grey(pixels: ndarray, encoding: str = "") -> ndarray:
    """Return an image as (h, w) uint8 grey levels.

    Args:
        pixels: (h, w) or (h, w, 3) or (h, w, 4) uint8.
        encoding: mono8, bgr8, rgb8, bgra8 or rgba8; empty: mono8, bgr8 or bgra8 by the shape.

    Raises:
        VisionError: it is not such an image, or smaller than 16 px.

    >>> int(grey(np.full((16, 20, 3), (0, 0, 255), dtype=np.uint8), "bgr8")[0, 0])
    76
    """
    pixels = np.asarray(pixels)
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or min(pixels.shape[:2]) < LEAST_EDGE:
        raise VisionError(
            f"no image: an array of shape {pixels.shape} and type {pixels.dtype}; it must be "
            f"uint8, (h, w), (h, w, 3) or (h, w, 4), and {LEAST_EDGE} px or more each way"
        )
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return np.ascontiguousarray(pixels.reshape(pixels.shape[:2]))
    conversions = _TO_GREY.get(pixels.shape[2], {})
    encoding = encoding or next(iter(conversions), "")
    if encoding not in conversions:
        raise VisionError(
            f"encoding '{encoding}' does not fit an image of {pixels.shape[2]} channels; "
            "rgb8 and bgr8 have 3, rgba8 and bgra8 have 4"
        )
    return cv2.cvtColor(pixels, conversions[encoding])


def grid(x: ndarray, y: ndarray) -> ndarray:
    """Return the points (n m, 2) whose coordinates are each of (n,) and (m,) values, row by row."""
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def sample(image: ndarray, points: ndarray) -> ndarray:
    """Return the bilinear values of a (h, w) image at points (..., 2) of u, v in px.

    Points outside get the value at the border; at NaN it is 0. (OpenCV's `remap` rounds
    positions to 1/32 px.)

    >>> sample(np.array([[0.0, 10.0], [20.0, 30.0]]), np.array([[0.5, 0.5], [0.0, 0.25]]))
    array([15.,  5.])
    """
    height, width = image.shape
    u = np.fmin(np.fmax(points[..., 0], 0.0), width - 1.001)
    v = np.fmin(np.fmax(points[..., 1], 0.0), height - 1.001)
    column, row = u.astype(np.intp), v.astype(np.intp)
    right, down = u - column, v - row
    index = row * width + column
    flat = image.ravel()
    upper = flat[index] + right * (flat[index + 1].astype(float) - flat[index])
    index += width
    lower = flat[index] + right * (flat[index + 1].astype(float) - flat[index])
    return upper + down * (lower - upper)


class Lens:
    """The distortion of a camera: pixels of its image, and ideal ones.

    Ideal pixels are those that a camera without distortion would see: straight edges are straight
    only there.

    Args:
        camera: the camera; None, or one without distortion: ideal pixels are those of the image.
    """

    def __init__(self, camera: PinholeCamera | None):
        self._camera = camera if camera is not None and any(camera.distortion) else None

    def ideal(self, points: ndarray) -> ndarray:
        """Return the ideal pixels (..., 2) of pixels of the image."""
        camera = self._camera
        if camera is None:
            return points
        flat, distortion = points.reshape(-1, 1, 2), np.array(camera.distortion)
        given = flat, camera.matrix, distortion, None, camera.matrix, _PRECISION
        return cv2.undistortPointsIter(*given).reshape(points.shape)

    def seen(self, points: ndarray) -> ndarray:
        """Return the pixels (..., 2) of the image at ideal ones."""
        camera = self._camera
        if camera is None:
            return points
        rays = (points.reshape(-1, 2) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return camera.project(np.column_stack((rays, np.ones(len(rays))))).reshape(points.shape)

    def derivatives(self, points: ndarray) -> ndarray:
        """Return the derivatives (2 n, 2 n) of `seen` at (n, 2) ideal pixels."""
        if self._camera is None:
            return np.eye(points.size)
        steps = _STEP * np.eye(2)[:, None]
        by_axis = self.seen(points + steps) - self.seen(points - steps)
        count = len(points)
        each, found = np.arange(count), np.zeros((count, 2, count, 2))
        found[each, :, each] = by_axis.transpose(1, 2, 0)
        return found.reshape(points.size, points.size)


class Picture(Lens):
    """Grey levels of an image, addressed by ideal pixels.

    Args:
        levels: (h, w) grey levels.
        camera: as of `Lens`.
    """

    def __init__(self, levels: ndarray, camera: PinholeCamera | None = None):
        super().__init__(camera)
        self.levels = levels

    def at(self, points: ndarray) -> ndarray:
        """Return the bilinear grey levels at ideal pixels (..., 2)."""
        return sample(self.levels, self.seen(points))


def solve_symmetric(matrix: ndarray, right: ndarray) -> ndarray:
    """Return x (n,) of matrix · x = right for a positive definite (n, n) matrix; NaN if not.

    >>> solve_symmetric(np.diag([2.0, 4.0]), np.array([2.0, 2.0]))
    array([1. , 0.5])
    """
    solved, x = cv2.solve(matrix, right, flags=cv2.DECOMP_CHOLESKY)
    return x.ravel() if solved else np.full(len(right), np.nan)


def cross(first: ndarray, second: ndarray) -> ndarray:
    """Return the cross products (...) of vectors (..., 2)."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def lengths_of(vectors: ndarray) -> ndarray:
    """Return the lengths (...) of vectors (..., 2)."""
    return np.hypot(vectors[..., 0], vectors[..., 1])


def right_of(vectors: ndarray) -> ndarray:
    """Return vectors (..., 2) turned by a quarter: on a clockwise outline, they point outward."""
    return np.stack((vectors[..., 1], -vectors[..., 0]), axis=-1)


def mean_side(quads: ndarray) -> ndarray:
    """Return the mean length (...) of the sides of (..., 4, 2) corners.

    >>> float(mean_side(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]])))
    2.0
    """
    return 0.25 * lengths_of(quads[..., NEXT, :] - quads).sum(axis=-1)


def homography(corners: ndarray) -> ndarray:
    """Return the (..., 3, 3) map from the unit square, clockwise from (0, 0), to (..., 4, 2).

    >>> corners = np.array([[2.0, 1.0], [4.0, 1.0], [4.0, 3.0], [2.0, 3.0]])
    >>> homography(corners) @ [0.5, 0.5, 1.0]
    array([3., 2., 1.])
    """
    first, second, third, fourth = (corners[..., k, :] for k in range(4))
    right, left = second - third, fourth - third
    rest = first - second - left
    determinant = cross(right, left)
    to_image = np.ones((*corners.shape[:-2], 3, 3))
    to_image[..., 2, 0] = by_x = cross(rest, left) / determinant
    to_image[..., 2, 1] = by_y = cross(right, rest) / determinant
    to_image[..., :2, 0] = second - first + by_x[..., None] * second
    to_image[..., :2, 1] = fourth - first + by_y[..., None] * fourth
    to_image[..., :2, 2] = first
    return to_image


def mapped(places: ndarray, to_image: ndarray) -> ndarray:
    """Return the points (n, 2) to which a homography (3, 3) maps (n, 2) places."""
    there = places @ to_image[:, :2].T + to_image[:, 2]
    return there[:, :2] / there[:, 2:]


def unmapped(points: ndarray, to_image: ndarray) -> tuple[ndarray, ndarray]:
    """Return the places (2, n) that a homography maps to points (2, n), and derivatives (2, 2, n).

    >>> corners = np.array([[2.0, 1.0], [4.0, 1.0], [4.0, 3.0], [2.0, 3.0]])
    >>> unmapped(np.array([[3.0], [2.0]]), homography(corners))[0].ravel().tolist()
    [0.5, 0.5]
    """
    back = cv2.invert(to_image)[1][:, :, None]
    there = back[:, 0] * points[0] + back[:, 1] * points[1] + back[:, 2]
    inverse = 1.0 / there[2]
    places = there[:2] * inverse
    return places, (back[:2, :2] - places[:, None] * back[2, :2]) * inverse


def intersections(points: ndarray, normals: ndarray) -> ndarray:
    """Return (..., 4, 2) corners: the k-th is where line k - 1 meets line k.

    Args:
        points: (..., 4, 2), one on each line.
        normals: (..., 4, 2), one of each line.

    >>> points = np.array([[1.0, 1.0], [3.0, 1.0], [1.0, 2.0], [1.0, 1.0]])
    >>> intersections(points, np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])).tolist()
    [[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]]
    """
    offsets = (points * normals).sum(axis=-1)[..., None]
    before, offsets_before = normals[..., PREVIOUS, :], offsets[..., PREVIOUS, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = offsets_before * normals - before * offsets
        return across[..., ::-1] / cross(before, normals)[..., None] * (1.0, -1.0)
