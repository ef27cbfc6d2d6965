"""Reading nav_msgs/Odometry with care, shared by the nodes that listen to it."""

from __future__ import annotations

import math
from typing import Optional, Tuple

from nav_msgs.msg import Odometry

from bullet_lab.errors import LabError
from bullet_lab.numerics.angles import yaw_from_quaternion

# A quaternion that is off by more than this is no rotation but a mistake, such as all zeros.
NORM_TOLERANCE = 1e-2


class OdometryError(LabError):
    """An odometry message that cannot be used."""


def planar_pose(message: Odometry) -> Tuple[float, float, float]:
    """Return x (m), y (m) and yaw (rad) of an odometry message.

    Raises:
        OdometryError: not finite, or an orientation that is no unit quaternion.
    """
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    quaternion = (turn.x, turn.y, turn.z, turn.w)
    if not all(map(math.isfinite, (place.x, place.y, *quaternion))):
        raise OdometryError("a pose that is not finite")
    norm = math.sqrt(sum(value * value for value in quaternion))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise OdometryError(f"an orientation of length {norm:.3g} is no unit quaternion")
    return place.x, place.y, yaw_from_quaternion(*quaternion)


class FrameGuard:
    """Holds a stream of odometry to the frames of its first message."""

    def __init__(self):
        self._frames: Optional[Tuple[str, str]] = None

    def check(self, message: Odometry) -> None:
        """Raise OdometryError if the frames of a message are not those of the first."""
        frames = (message.header.frame_id, message.child_frame_id)
        if self._frames is None:
            self._frames = frames
        if frames != self._frames:
            raise OdometryError(
                "frames {} -> {} where {} -> {} came before".format(*frames, *self._frames)
            )
