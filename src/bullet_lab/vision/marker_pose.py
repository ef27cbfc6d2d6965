"""Poses of markers: both that the corners allow, and the choice from one image to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Mapping, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.images import VisionError
from bullet_lab.vision.marker_detector import (
    DetectedMarker,
    Detections,
    DetectorSettings,
    MarkerDetector,
)
from bullet_lab.vision.pose_fit import MarkerPose, SquareFit

# The better of two poses is right if the other one's error is larger by this factor, and by so many
# standard deviations of the corners.
_CLEAR_RATIO = 2.0
_CLEAR_SIGMAS = 3.0
# Least area of a marker in the image, px².
_LEAST_AREA = 1.0
# Seconds after which a pose is no hint for the next one.
_PATIENCE = 1.0
# A marker moves by less than this part of its distance from one image to the next.
_NEAR = 0.2
# Least difference of the cosines of tilt by which one pose is clearly more upright: 3 degrees.
_CLEARLY_UPRIGHT = 0.0014
# Up, in the optical frame of a level camera.
_UP = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The two poses of a flat marker that its corners allow."""

    best: MarkerPose  #: the one that fits better
    alternative: MarkerPose  #: the other one; the same as `best` where there is but one
    ambiguous: bool  #: the corners do not show which is right

    def nearest_to(self, rotation: ndarray) -> MarkerPose:
        """Return the pose that is turned least from a (3, 3) rotation, such as the last."""
        both = self.best, self.alternative
        return max(both, key=lambda pose: float(np.sum(pose.rotation * rotation)))

    def upright(self, up: ndarray, least: float = 0.0) -> MarkerPose:
        """Return the pose whose y axis is nearer to a direction (3,) of the optical frame.

        A marker on an upright wall has its y axis up: (0, -1, 0) for a level camera. The one that
        fits worse is returned only if the cosine of its angle is larger by more than `least`.
        """
        gain = (self.alternative.rotation[:, 1] - self.best.rotation[:, 1]) @ np.asarray(up)
        return self.alternative if gain > least else self.best


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
    total = pixel_sigma**2 * np.eye(8) + (0.0 if covariance is None else covariance)
    sigma = float(np.sqrt(np.trace(total) / 8.0))
    if not (np.isfinite(size) and size > 0.0 and np.isfinite(sigma) and sigma > 0.0):
        raise VisionError(
            f"marker size {size} m, deviation of its corners {sigma} px; both must be above 0"
        )
    # The area of a quadrilateral, from its diagonals.
    (ax, ay), (bx, by) = corners[2] - corners[0], corners[3] - corners[1]
    if 0.5 * abs(float(ax * by - ay * bx)) < _LEAST_AREA:
        raise VisionError(f"the corners of a marker span less than {_LEAST_AREA:g} px²")
    square = SquareFit(corners, size, camera, total)
    refined = [square.refined(*start) for start in square.starts()]
    fits = sorted((fit for fit in refined if fit is not None), key=lambda fit: fit[0])
    if not fits:
        raise VisionError("no pose fits the corners")
    best, other = fits[0][1], fits[-1][1]
    best, other = square.widened(best, other), square.widened(other, best)
    same = fits[0] is fits[-1] or np.sum(best.rotation * other.rotation) > 3.0 - 1e-4
    clear = other.error > _CLEAR_RATIO * best.error
    clear = clear and other.error - best.error > 0.5 * _CLEAR_SIGMAS * sigma
    return PoseEstimate(best, other, not (same or clear))


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

    Raises:
        VisionError: a setting is not allowed.
    """

    def __init__(
        self,
        settings: DetectorSettings | None = None,
        size: float = 0.2,
        sizes: Mapping[int, float] | None = None,
        pixel_sigma: float = 0.02,
    ):
        self.detector = MarkerDetector(settings)
        self._size = size
        self._sizes = dict(sizes or {})
        self._sigma = pixel_sigma
        for value in (size, *self._sizes.values()):
            if not math.isfinite(value) or value <= 0.0:
                raise VisionError(f"marker size is {value} m; it must be above 0")
        if not math.isfinite(pixel_sigma) or pixel_sigma < 0.0:
            raise VisionError(f"pixel_sigma is {pixel_sigma} px; it must be 0 or more")

    def observe(self, image: ndarray, camera: PinholeCamera) -> Detections:
        """Return the `ObservedMarker`s in an image, (h, w) grey levels or (h, w, 3) BGR, uint8.

        Raises:
            VisionError: it is no image, or not of the camera's size.
        """
        if image.shape[:2] != (camera.height, camera.width):
            size = f"{image.shape[1]} x {image.shape[0]} px"
            raise VisionError(f"the image has {size}; the camera {camera.width} x {camera.height}")
        detections = self.detector.detect(image, camera)
        return Detections([self.locate(m, camera) for m in detections.markers], detections.report)

    def locate(self, marker: DetectedMarker, camera: PinholeCamera) -> ObservedMarker:
        """Return a detected marker with its poses."""
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
        self._last: list[tuple[int, MarkerPose]] = []
        self._stamp = -np.inf

    def forget(self) -> None:
        """Forget the last poses."""
        self._last = []

    def choose(self, markers: Sequence[ObservedMarker], stamp: float) -> list[MarkerPose]:
        """Return a pose for each marker of an image of a stamp in s."""
        if not 0.0 <= stamp - self._stamp <= _PATIENCE:
            self._last = []
        poses = [self._choose(marker) for marker in markers]
        if poses:
            self._last = [(m.id, pose) for m, pose in zip(markers, poses)]
            self._stamp = stamp
        return poses

    def _choose(self, marker: ObservedMarker) -> MarkerPose:
        estimate, best = marker.pose, marker.pose.best
        if not estimate.ambiguous:
            return best
        # The last pose of this very marker; there may be others of the same id.
        same = [pose for number, pose in self._last if number == marker.id]
        distances = [float(np.linalg.norm(pose.translation - best.translation)) for pose in same]
        if same and min(distances) <= _NEAR * best.distance:
            return estimate.nearest_to(same[int(np.argmin(distances))].rotation)
        return estimate.upright(_UP, _CLEARLY_UPRIGHT) if self._upright else best
