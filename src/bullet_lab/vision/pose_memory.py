"""Which of a marker's two poses it is, by what was seen before and by how markers hang."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence

import numpy as np

from bullet_lab.vision.marker_observer import ObservedMarker
from bullet_lab.vision.marker_pose import MarkerPose, PoseEstimate

# Seconds after which a pose says nothing about the next one.
_PATIENCE = 1.0
# A marker moves by less than this part of its distance from one image to the next.
_NEAR = 0.2
# One pose is clearly more upright than the other from this cosine of the tilt on: 3 degrees.
_CLEARLY_UPRIGHT = 0.0014
# Up, in the optical frame of a level camera.
_UP = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True)
class _Seen:
    id: int
    pose: MarkerPose


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
        self._last: List[_Seen] = []
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
            self._last = [_Seen(m.id, pose) for m, pose in zip(markers, poses)]
            self._stamp = stamp
        return poses

    def _choose(self, marker: ObservedMarker) -> MarkerPose:
        estimate = marker.pose
        if not estimate.ambiguous:
            return estimate.best
        previous = self._previous(marker)
        if previous is not None:
            return estimate.nearest_to(previous.rotation)
        if self._upright:
            return _upright(estimate)
        return estimate.best

    def _previous(self, marker: ObservedMarker) -> Optional[MarkerPose]:
        """Return the last pose of this very marker; others may bear the same id."""
        place = marker.pose.best.translation
        same = [seen.pose for seen in self._last if seen.id == marker.id]
        distances = [float(np.linalg.norm(pose.translation - place)) for pose in same]
        if not same or min(distances) > _NEAR * marker.pose.best.distance:
            return None
        return same[int(np.argmin(distances))]


def _upright(estimate: PoseEstimate) -> MarkerPose:
    gain = float((estimate.alternative.rotation[:, 1] - estimate.best.rotation[:, 1]) @ _UP)
    return estimate.alternative if gain > _CLEARLY_UPRIGHT else estimate.best
