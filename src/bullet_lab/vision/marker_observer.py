"""Markers with their poses, from an image and its camera: detector and pose in one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Mapping, Optional

import numpy as np

from bullet_lab.numerics.pinhole import PinholeCamera
from bullet_lab.vision.errors import VisionError
from bullet_lab.vision.marker_detector import (
    DetectedMarker,
    DetectionReport,
    DetectorSettings,
    MarkerDetector,
)
from bullet_lab.vision.marker_pose import PoseEstimate, estimate_pose


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
