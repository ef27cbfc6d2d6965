"""Markers with their poses, from an image and its camera, and from what was seen before."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Mapping, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.images import VisionError
from bullet_lab.vision.marker_detector import (
    DetectedMarker,
    DetectionReport,
    DetectorSettings,
    MarkerDetector,
)
from bullet_lab.vision.marker_pose import MarkerPose, PoseEstimate, estimate_pose


@dataclass(frozen=True, eq=False)
class ObservedMarker:
    """A marker that was found.

    Attributes:
        id: which of the dictionary.
        size: edge of its black square, m.
        corners: (4, 2) px; top left, top right, bottom right, bottom left.
        bit_errors: bits that were corrected.
        side: mean length of its sides, px.
        pose: both poses that it may have.
    """

    id: int
    size: float
    corners: np.ndarray
    bit_errors: int
    side: float
    pose: PoseEstimate


@dataclass(frozen=True)
class Observation:
    """All markers of an image, the largest first, and what happened on the way."""

    markers: List[ObservedMarker]
    report: DetectionReport


class MarkerObserver:
    """Finds markers and where they are.

    Args:
        settings: what to look for.
        size: edge of the markers' black square, m.
        sizes: of those ids that have another.
        pixel_sigma: standard deviation of a corner's coordinates, px; scales the covariance.

    Raises:
        VisionError: a setting is not allowed.
    """

    def __init__(
        self,
        settings: Optional[DetectorSettings] = None,
        size: float = 0.2,
        sizes: Optional[Mapping[int, float]] = None,
        pixel_sigma: float = 0.1,
    ):
        self.detector = MarkerDetector(settings)
        self._size = size
        self._sizes = dict(sizes or {})
        self._sigma = pixel_sigma
        for value in (size, pixel_sigma, *self._sizes.values()):
            if not math.isfinite(value) or value <= 0.0:
                raise VisionError(f"a size of {value}: it must be above 0")

    def size_of(self, marker: int) -> float:
        """Return the edge of a marker's black square, m."""
        return self._sizes.get(marker, self._size)

    def observe(self, image: np.ndarray, camera: PinholeCamera) -> Observation:
        """Return the markers in an image.

        Args:
            image: (h, w) grey levels or (h, w, 3) BGR, uint8.
            camera: its geometry.

        Raises:
            VisionError: the image is none, or not of the camera's size.
        """
        if image.shape[:2] != (camera.height, camera.width):
            seen = f"{image.shape[1]} x {image.shape[0]}"
            raise VisionError(
                f"an image of {seen} px of a camera of {camera.width} x {camera.height}"
            )
        detections = self.detector.detect(image, camera)
        return Observation([self.locate(m, camera) for m in detections.markers], detections.report)

    def locate(self, marker: DetectedMarker, camera: PinholeCamera) -> ObservedMarker:
        """Return a detected marker with its poses."""
        size = self.size_of(marker.id)
        pose = estimate_pose(marker.corners, size, camera, self._sigma)
        return ObservedMarker(marker.id, size, marker.corners, marker.bit_errors, marker.side, pose)


# Seconds after which a pose says nothing about the next one.
_PATIENCE = 1.0
# A marker moves by less than this part of its distance from one image to the next.
_NEAR = 0.2
# One pose is clearly more upright than the other from this cosine of the tilt on: 3 degrees.
_CLEARLY_UPRIGHT = 0.0014
# Up, in the optical frame of a level camera.
_UP = np.array([0.0, -1.0, 0.0])


class PoseMemory:
    """Chooses between the two poses of each marker, from one image to the next.

    Where the image tells them apart, it decides. Where it does not: the one nearest the last
    pose of that marker; else the more upright one, where that is clear; else the one that fits
    better.

    Args:
        upright: whether markers hang upright before a level camera.
    """

    def __init__(self, upright: bool = True):
        self._upright = upright
        self._last: List[Tuple[int, MarkerPose]] = []
        self._stamp = -np.inf

    def forget(self) -> None:
        """Forget what was seen."""
        self._last = []

    def choose(self, markers: Sequence[ObservedMarker], stamp: float) -> List[MarkerPose]:
        """Return a pose for each marker of an image of a stamp in s."""
        if not 0.0 <= stamp - self._stamp <= _PATIENCE:
            self._last = []
        poses = [self._choose(marker) for marker in markers]
        if poses:
            self._last = [(m.id, pose) for m, pose in zip(markers, poses)]
            self._stamp = stamp
        return poses

    def _choose(self, marker: ObservedMarker) -> MarkerPose:
        estimate = marker.pose
        if not estimate.ambiguous:
            return estimate.best
        previous = self._previous(marker)
        if previous is not None:
            return estimate.nearest_to(previous.rotation)
        return estimate.upright(_UP, _CLEARLY_UPRIGHT) if self._upright else estimate.best

    def _previous(self, marker: ObservedMarker) -> Optional[MarkerPose]:
        """Return the last pose of this very marker; others may bear the same id."""
        place = marker.pose.best.translation
        same = [pose for number, pose in self._last if number == marker.id]
        distances = [float(np.linalg.norm(pose.translation - place)) for pose in same]
        if not same or min(distances) > _NEAR * marker.pose.best.distance:
            return None
        return same[int(np.argmin(distances))]
