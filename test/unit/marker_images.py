"""Images of markers, computed exactly: each pixel is the mean of what it sees."""

import dataclasses
import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.dictionaries import dictionary_named

CAMERA = PinholeCamera(640, 480, 502.3, 502.3, 319.5, 239.5)
BENT = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.002, 0.02))
TAGS = "apriltag_36h10"
# Of large images fewer samples will do, as they have longer edges.
_MOST_SAMPLES = 1.0e6
# From the top left clockwise, in the frame of a plane.
_CORNERS = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


@dataclass
class Layer:
    """A flat thing: cells of grey levels, square, `width` m wide, of which `centre` is (x, y)."""

    cells: np.ndarray
    width: float
    centre: tuple = (0.0, 0.0)

    def paint(self, x, y, values):
        """Paint points of the plane (x right, y up, m)."""
        n = len(self.cells)
        column = np.floor((x - self.centre[0]) / self.width * n + n / 2.0).astype(int)
        row = np.floor((self.centre[1] - y) / self.width * n + n / 2.0).astype(int)
        inside = (column >= 0) & (column < n) & (row >= 0) & (row < n)
        values[inside] = self.cells[row[inside], column[inside]]


def marker(number=0, tags=TAGS, size=0.2, black=20.0, white=220.0, quiet=1, centre=(0.0, 0.0)):
    """A marker in its quiet zone; `size` is the edge of the black square in m."""
    pattern = dictionary_named(tags).pattern(number).astype(float)
    cells = np.pad(pattern, quiet, constant_values=1.0) * (white - black) + black
    return Layer(cells, size * len(cells) / len(pattern), centre)


def corner_points(size, centre=(0.0, 0.0)):
    """The (4, 3) corners in the frame of the plane: top left, top right, bottom right, left."""
    return size / 2.0 * _CORNERS + (*centre, 0.0)


@dataclass
class View:
    """Pose of a plane in the optical frame.

    Facing the camera at `distance` ahead and turned about its upright axis (`yaw`, degrees),
    then nodding (`pitch`) and rolled about its normal; moved by `shift` m (right, down).
    """

    distance: float
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    shift: tuple = (0.0, 0.0)
    rotation: np.ndarray = field(init=False)
    translation: np.ndarray = field(init=False)

    def __post_init__(self):
        turns = np.radians(np.diag([self.pitch, self.yaw, self.roll]))
        pitch, yaw, roll = (cv2.Rodrigues(turn)[0] for turn in turns)
        self.rotation = np.diag([1.0, -1.0, -1.0]) @ yaw @ pitch @ roll
        self.translation = np.array([*self.shift, self.distance])

    def to_camera(self, points):
        """Points (n, 3) of the plane's frame in the optical frame."""
        return np.asarray(points) @ self.rotation.T + self.translation


def image_of(layers, view, camera=CAMERA, background=120.0, samples=6, blur=0.0, noise=0.0, seed=0):
    """The image (uint8) of layers that lie on one plane, later ones over earlier ones."""
    values = np.full((camera.height, camera.width), float(background))
    left, top, right, bottom = _bounds(layers, view, camera)
    if right > left and bottom > top:
        each_way = math.sqrt(_MOST_SAMPLES / ((right - left) * (bottom - top)))
        samples = max(2, min(samples, int(each_way)))
        shape = (bottom - top, samples, right - left, samples)
        # Each place is moved at random within its share of the pixel: on a regular grid an edge
        # along a row or column would be seen at a multiple of a share.
        row, column = np.indices((shape[0] * samples, shape[2] * samples), dtype=float)
        chance = np.random.default_rng(0)
        u = left + (column + chance.random(row.shape)) / samples - 0.5
        v = top + (row + chance.random(row.shape)) / samples - 0.5
        x, y = _on_plane(np.column_stack((u.ravel(), v.ravel())), view, camera).T
        fine = np.full(x.shape, float(background))
        for layer in layers:
            layer.paint(x, y, fine)
        values[top:bottom, left:right] = fine.reshape(shape).mean(axis=(1, 3))
    if blur:
        values = cv2.GaussianBlur(values, (0, 0), blur)
    if noise:
        return noisy(values, noise, np.random.default_rng(seed))
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def noisy(values, sigma, chance):
    """An image of values with noise, whole numbers from 0 to 255."""
    values = values + chance.normal(0.0, sigma, values.shape)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def true_corners(view, size=0.2, camera=CAMERA, centre=(0.0, 0.0)):
    """Where the corners of a marker are seen, (4, 2) px."""
    return camera.project(view.to_camera(corner_points(size, centre)))


def off_by(found, view, *of, **marker_and_camera):
    """The largest distance between a corner that was found and the true one, px."""
    off = found.corners - true_corners(view, *of, **marker_and_camera)
    return float(np.linalg.norm(off, axis=1).max())


def angle_between(first, second):
    """Angle between two rotations, rad."""
    return math.acos(np.clip((np.trace(first.T @ second) - 1.0) / 2.0, -1.0, 1.0))


def normalised_square(error, covariance):
    """The square of an error by its covariance."""
    return error @ np.linalg.solve(covariance, error)


def _bounds(layers, view, camera):
    """The part of the image that layers are in: left, top, right, bottom."""
    corners = np.vstack([corner_points(layer.width, layer.centre) for layer in layers])
    seen = camera.project(view.to_camera(corners))
    if np.isnan(seen).any():
        return 0, 0, camera.width, camera.height
    ends = np.stack((np.floor(seen.min(axis=0)) - 2, np.ceil(seen.max(axis=0)) + 3))
    return np.clip(ends, 0, (camera.width, camera.height)).astype(int).ravel()


def _on_plane(pixels, view, camera):
    """Where the rays of pixels meet the plane, (x, y) in its frame."""
    rays = np.column_stack((camera.slopes(pixels), np.ones(len(pixels))))
    normal = view.rotation[:, 2]
    scale = (normal @ view.translation) / (rays @ normal)
    return ((rays * scale[:, None] - view.translation) @ view.rotation)[:, :2]
