"""Poses of markers: both that the corners allow, and the choice from one image to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Mapping, Sequence

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.images import Lens, VisionError, cross, grid, homography, solve_symmetric
from bullet_lab.vision.marker_detector import (
    DetectedMarker,
    Detections,
    DetectorSettings,
    MarkerDetector,
)
from bullet_lab.vision.pose_fit import (
    MarkerPose,
    PoseEstimate,
    PoseFit,
    clearly_better,
    projected,
)

# Least area of a marker in the image, px².
_LEAST_AREA = 1.0
# Seconds after which a pose no longer helps to choose the next one.
_PATIENCE = 1.0
# A marker moves by less than this part of its distance from one image to the next.
_NEAR = 0.2
# Least difference of the cosines of tilt by which one pose is clearly more upright: 3 degrees.
_CLEARLY_UPRIGHT = 0.0014
# Up, in the optical frame of a level camera.
_UP = np.array([0.0, -1.0, 0.0])

# Top left, top right, bottom right, bottom left corner in the marker's frame, by half its edge.
SQUARE = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
# Tilts (n, 2) at which the likelihood is evaluated, up to so many standard deviations.
_REACH = 3.5
_TILTS = grid(*2 * [np.linspace(-_REACH, _REACH, 15)])
# The square of the tilt (rad) that hardly shows, in units of the corners' noise as a share of the
# marker's edge: foreshortening moves each corner by 0.4 of its deviation.
_FAINT = 1.5
# The mean squares are enlarged: they are off by 5 % at some tilts. They are by more if the corners'
# noise is a tenth of the edge, since the curvature is that at the estimate, not at the truth.
_MARGIN, _ROUGH = 1.05, 1.4
# Rotations are one pose if the trace of that between them is larger.
SAME = 3.0 - 1e-4
# The other pose does not matter if it is so many standard deviations away.
_FAR = 16.0


def estimate_pose(
    corners: ndarray,
    size: float,
    camera: PinholeCamera,
    pixel_sigma: float = 0.1,
    covariance: ndarray | None = None,
) -> PoseEstimate:
    """Return the poses of a marker from its corners.

    Each of the two is refined to the least squares of the reprojection error, weighted by the
    corners' covariance.

    Args:
        corners: (4, 2) u, v in px: top left, top right, bottom right, bottom left.
        size: edge of the black square, m.
        camera: geometry of the image; of a rectified one without distortion.
        pixel_sigma: standard deviation of each coordinate of a corner, px.
        covariance: (8, 8) of u0, v0, u1 ... in px², which is added to that; None: nothing.

    Raises:
        VisionError: the corners or the size are not those of a marker, or no pose fits.
    """
    corners = np.asarray(corners, dtype=float)
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise VisionError("a marker needs four finite corners")
    sigma = float(np.sqrt(np.trace(_total(pixel_sigma, covariance)) / 8.0))
    if not (0.0 < size < math.inf and 0.0 < sigma < math.inf):
        raise VisionError(
            f"marker size {size} m, deviation of its corners {sigma} px; both must be above 0"
        )
    # The area of a quadrilateral, from its diagonals.
    if 0.5 * abs(cross(corners[2] - corners[0], corners[3] - corners[1])) < _LEAST_AREA:
        raise VisionError(f"the corners of a marker span less than {_LEAST_AREA:g} px²")
    square = _SquareFit(*ideal_corners(corners, camera, pixel_sigma, covariance), size, camera)
    refined = [square.refined(*start) for start in square.starts()]
    fits = sorted((fit for fit in refined if fit is not None), key=lambda fit: fit[0])
    if not fits:
        raise VisionError("no pose fits the corners")
    best, other = fits[0][1], fits[-1][1]
    best, other = square.widened(best, other, sigma), square.widened(other, best, sigma)
    same = np.sum(best.rotation * other.rotation) > SAME
    return PoseEstimate(best, other, not (same or clearly_better(best, other, sigma)))


def ideal_corners(
    corners: ndarray, camera: PinholeCamera, pixel_sigma: float, covariance: ndarray | None
) -> tuple[ndarray, ndarray]:
    """Return corners (4, 2) as without distortion, px, and their covariance (8, 8), px².

    The arguments are those of `estimate_pose`.
    """
    lens = Lens(camera)
    ideal = lens.ideal(corners)
    _, by_seen = cv2.invert(lens.derivatives(ideal))
    return ideal, by_seen @ _total(pixel_sigma, covariance) @ by_seen.T


def _total(pixel_sigma: float, covariance: ndarray | None) -> ndarray:
    return pixel_sigma**2 * np.eye(8) + (0.0 if covariance is None else covariance)


class _SquareFit(PoseFit):
    """Fits the pose of a square marker to its corners.

    Args:
        corners: (4, 2) ideal px.
        covariance: (8, 8) of the corners, px².
        size: edge of the black square, m.
        camera: geometry of the image; its distortion does not matter.
    """

    def __init__(self, corners: ndarray, covariance: ndarray, size: float, camera: PinholeCamera):
        super().__init__(0.5 * size * SQUARE, corners, covariance[None], camera)

    def starts(self) -> list[tuple[ndarray, ndarray]]:
        """Return both poses, rotation and translation, by Collins and Bartoli (2014, IPPE).

        (OpenCV's IPPE_SQUARE uses rotation vectors and fails at half turns, which is how a level
        camera sees an upright marker.)
        """
        camera = self._camera
        rays = (self._corners - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        size = self._points[1, 0] - self._points[0, 0]
        from_plane = np.array([[1.0 / size, 0.0, 0.5], [0.0, -1.0 / size, 0.5], [0.0, 0.0, 1.0]])
        plane = homography(rays) @ from_plane
        plane = plane / plane[2, 2]
        middle = plane[:2, 2]
        # How the image moves with the plane about its middle.
        by_plane = plane[:2, :2] - np.outer(middle, plane[2, :2])
        # The least rotation that turns the line of sight to the middle.
        away = float(np.hypot(*middle))
        turn = math.atan(away) / max(away, 1e-12) * np.array([-middle[1], middle[0], 0.0])
        to_middle = cv2.Rodrigues(turn)[0]
        by_space = np.column_stack((np.eye(2), -middle)) @ to_middle
        scaled = cv2.invert(by_space[:, :2])[1] @ by_plane
        upper = scaled / cv2.SVDecomp(scaled)[0].max()
        rest = np.eye(2) - upper.T @ upper
        lower = np.sqrt(np.maximum(0.0, np.diag(rest)))
        if rest[0, 1] < 0.0:
            lower[1] = -lower[1]
        poses = []
        for sign in (1.0, -1.0):
            columns = np.vstack((upper, sign * lower))
            local = np.column_stack((columns, np.cross(columns[:, 0], columns[:, 1])))
            # The nearest rotation to a matrix that is nearly one.
            _, left, right = cv2.SVDecomp(to_middle @ local)
            rotation = left @ right
            poses.append((rotation, _translation(self._points @ rotation.T, rays)))
        return poses

    def widened(self, pose: MarkerPose, other: MarkerPose, sigma: float) -> MarkerPose:
        """Return a pose with the mean squares of its error as covariance.

        How a marker that faces the camera looks changes with the square of its tilt: equally likely
        tilts form no ellipse, and the estimate is not in their middle. Its curvature may vanish
        there. So the likelihood is summed over a grid of both tilts, up to half way to the other
        pose. For each tilt, place and roll are those of least squares (variable projection, Golub
        and Pereyra 1973, to first order).

        A marker that faces the camera exactly always seems tilted. If all angles are equally likely
        before, its covariance is too small by 15 to 30 %: it is right in the mean over the angles,
        not at each. Hence the prior: Student's t of both tilts, two degrees of freedom, as wide as
        the tilt that hardly shows. With it, the mean NEES (Bar-Shalom, Li and Kirubarajan 2001,
        5.4) over 6 is 0.8 to 1.1 at distances of 0.5 to 10 m, tilts to 60° and noise of 1 px.

        Args:
            pose: its covariance is the inverse of the curvature.
            other: the other pose that the corners allow, or the same.
            sigma: standard deviation of the corners, px.
        """
        turn = cv2.Rodrigues(other.rotation @ pose.rotation.T)[0].ravel()
        sight = pose.translation / pose.distance
        # Rows: place, roll about the line of sight, both tilts.
        frame = np.eye(6)
        frame[3:, 3:] = np.linalg.svd(sight[None])[2]
        across = frame[4:, 3:]
        away = across @ turn
        if away @ away > _FAR**2 * np.trace(across @ pose.covariance[3:, 3:] @ across.T):
            return pose
        _, _, jacobian = self.whitened(pose.rotation, pose.translation)
        basis, upper = np.linalg.qr(jacobian @ frame.T)
        faint = _FAINT * sigma * pose.distance / (self._camera.fx * np.ptp(self._points[:, 0]))
        of_tilts = np.linalg.inv(upper[4:, 4:].T @ upper[4:, 4:] + np.eye(2) / faint)
        scale = np.linalg.cholesky(of_tilts + np.outer(away, away) / (2.0 * _REACH) ** 2)
        tilts = _TILTS @ scale.T
        tilts = tilts[tilts @ away <= 0.5 * (away @ away)]
        moves = tilts @ frame[4:]
        residuals = self._turned_residuals(pose, moves[:, 3:]) @ self._whitening[0].T
        in_basis = residuals @ basis[:, :4]
        by_basis = np.linalg.inv(upper[:4, :4]).T @ frame[:4]
        moves -= in_basis @ by_basis
        squares = np.square(residuals).sum(axis=1) - np.square(in_basis).sum(axis=1)
        facing = across @ np.cross(sight, pose.rotation[:, 2])
        # The density of Student's t.
        likely = np.exp(-0.5 * (squares - squares.min()))
        likely /= np.square(np.square(tilts - facing).sum(axis=1) + faint)
        squares = by_basis.T @ by_basis + (moves.T * (likely / likely.sum())) @ moves
        squares *= _MARGIN + _ROUGH * faint
        return replace(pose, covariance=squares) if np.isfinite(squares).all() else pose

    def _turned_residuals(self, pose: MarkerPose, turns: ndarray) -> ndarray:
        """Return the residuals (n, 8), px, of a pose that is turned by (n, 3)."""
        turned = self._points @ pose.rotation.T
        angles = np.linalg.norm(turns, axis=1)[:, None, None]
        axes = turns[:, None] / np.maximum(angles, 1e-12)
        # Rodrigues' formula.
        sine, cosine = np.sin(angles), np.cos(angles)
        points = cosine * turned + sine * np.cross(axes, turned)
        points += (1.0 - cosine) * (axes * turned).sum(axis=2, keepdims=True) * axes
        points += pose.translation
        pixels, _ = projected(points.reshape(-1, 3), self._camera)
        return pixels.reshape(len(turns), 8) - self._corners.ravel()


def _translation(turned: ndarray, rays: ndarray) -> ndarray:
    """Return the translation (least squares) that puts turned points on their rays."""
    columns = np.concatenate((np.tile(np.eye(2), (4, 1)), -rays.reshape(8, 1)), axis=1)
    right = rays * turned[:, 2:] - turned[:, :2]
    return solve_symmetric(columns.T @ columns, columns.T @ right.ravel())


@dataclass(frozen=True, eq=False)
class ObservedMarker(DetectedMarker):
    """A detected marker, with both poses that it may have."""

    size: float  #: edge of its black square, m
    pose: PoseEstimate


class MarkerObserver:
    """Finds markers and where they are.

    Args:
        settings: of the detector.
        size: edge of the markers' black square, m.
        sizes: the edge by id, of markers with another one.
        pixel_sigma: standard deviation of a corner's coordinates beside that of the image's noise,
            px: of the print, or of an inexact lens model.
    """

    def __init__(
        self,
        settings: DetectorSettings | None = None,
        size: float = 0.2,
        sizes: Mapping[int, float] | None = None,
        pixel_sigma: float = 0.02,
    ):
        self._detector = MarkerDetector(settings)
        self._size, self._sizes, self._sigma = size, sizes or {}, pixel_sigma

    def observe(self, image: ndarray, camera: PinholeCamera | None) -> Detections:
        """Return the `ObservedMarker`s in an image; without a camera, `DetectedMarker`s.

        Args:
            image: (h, w) grey levels or (h, w, 3) BGR, uint8.
            camera: geometry of the image.

        Raises:
            VisionError: it is no image, or not of the camera's size.
        """
        if camera is None:
            return self._detector.detect(image)
        if image.shape[:2] != (camera.height, camera.width):
            size = f"{image.shape[1]} x {image.shape[0]} px"
            raise VisionError(f"the image has {size}; the camera {camera.width} x {camera.height}")
        found = self._detector.detect(image, camera)
        return replace(found, markers=[self._observed(one, camera) for one in found.markers])

    def _observed(self, marker: DetectedMarker, camera: PinholeCamera) -> ObservedMarker:
        size = self._sizes.get(marker.id, self._size)
        pose = estimate_pose(marker.corners, size, camera, self._sigma, marker.covariance)
        return ObservedMarker(**vars(marker), size=size, pose=pose)


class PoseMemory:
    """Chooses between the two poses of each marker, from one image to the next.

    If the image shows which is right, that one. If not: the one nearest to the last pose of that
    marker; else, if markers hang `upright` before a level camera, the more upright one if that is
    clear; else the one that fits better.
    """

    def __init__(self, upright: bool = True):
        self._upright = upright
        self._last: list[tuple[int | str, MarkerPose]] = []
        self._stamp = -math.inf

    def forget(self) -> None:
        """Forget the last poses."""
        self._last = []

    def choose(self, markers: Sequence[Any], stamp: float) -> list[MarkerPose]:
        """Return a pose for each marker or bundle of an image of a stamp in s."""
        if not 0.0 <= stamp - self._stamp <= _PATIENCE:
            self._last = []
        poses = [self._choose(marker) for marker in markers]
        if poses:
            self._last = [(m.id, pose) for m, pose in zip(markers, poses)]
            self._stamp = stamp
        return poses

    def _choose(self, marker: Any) -> MarkerPose:
        estimate, best = marker.pose, marker.pose.best
        if not estimate.ambiguous:
            return best
        # The last pose of this very marker; there may be others of the same id.
        same = [pose for number, pose in self._last if number == marker.id]
        distances = [float(np.linalg.norm(pose.translation - best.translation)) for pose in same]
        if same and min(distances) <= _NEAR * best.distance:
            return estimate.nearest_to(same[int(np.argmin(distances))].rotation)
        return estimate.upright(_UP, _CLEARLY_UPRIGHT) if self._upright else best
