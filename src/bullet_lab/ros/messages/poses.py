"""Poses of messages that come from outside, read with care."""

from __future__ import annotations

import math
from typing import Any

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError

# A quaternion that is off by more than this is no rotation but a mistake, such as all zeros.
NORM_TOLERANCE = 1e-2


class InputError(LabError):
    """A message that docking cannot use."""


def pose_of(place: Any, turn: Any) -> Pose:
    """Return a pose of a position and a quaternion; raises InputError if they make none."""
    position = (place.x, place.y, place.z)
    quaternion = (turn.x, turn.y, turn.z, turn.w)
    if not all(map(math.isfinite, position + quaternion)):
        raise InputError("a pose that is not finite")
    norm = math.sqrt(sum(value * value for value in quaternion))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise InputError(f"an orientation of length {norm:.3g} is no unit quaternion")
    return Pose(position, tuple(value / norm for value in quaternion))
