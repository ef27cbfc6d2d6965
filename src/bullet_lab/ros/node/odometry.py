"""Checks of nav_msgs/Odometry, and the newest pose for nodes that drive."""

from __future__ import annotations

import math
import threading
import time
from typing import Optional, Tuple

import rospy
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry

from bullet_lab.core.se2 import yaw_from_quaternion
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import NORM_TOLERANCE
from bullet_lab.ros.node.lock_step import in_lock_step
from bullet_lab.ros.node.node import NodeError, Refusals
from bullet_lab.ros.node.publishers import subscriber

# m; larger than all coordinates on Earth in any grid. Squares of smaller numbers stay finite.
FARTHEST = 1e8
# Seconds of ROS time after which odometry is out of date.
STALE_SECONDS = 0.5
# Wall seconds to wait for odometry.
ODOMETRY_TIMEOUT = 5.0
# Wall seconds between two checks for a shutdown.
POLL_SECONDS = 0.2


class OdometryError(LabError):
    """An odometry message is invalid."""


def planar_pose(message: Odometry) -> Tuple[float, float, float]:
    """Return x (m), y (m) and yaw (rad) of an odometry message.

    Raises:
        OdometryError: not finite, farther than `FARTHEST` from the origin, or an orientation that
            is no unit quaternion.
    """
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    x, y = position.x, position.y
    quaternion = (orientation.x, orientation.y, orientation.z, orientation.w)
    if not all(map(math.isfinite, (x, y, *quaternion))):
        raise OdometryError("a pose that is not finite")
    if max(abs(x), abs(y)) > FARTHEST:
        raise OdometryError(f"position ({x:.3g}, {y:.3g}) m exceeds {FARTHEST:.0e} m")
    norm = math.sqrt(sum(value * value for value in quaternion))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise OdometryError(f"an orientation of length {norm:.3g} is no unit quaternion")
    return x, y, yaw_from_quaternion(*quaternion)


def check_numbers(message: Odometry) -> None:
    """Raise OdometryError if a number that `planar_pose` does not check is not finite."""
    twist = message.twist.twist
    motion = (*_vector(twist.linear), *_vector(twist.angular))
    covariances = (*message.pose.covariance, *message.twist.covariance)
    if not all(map(math.isfinite, (message.pose.pose.position.z, *motion, *covariances))):
        raise OdometryError("a height, twist or covariance that is not finite")


def _vector(value: Vector3) -> Tuple[float, float, float]:
    return value.x, value.y, value.z


class FrameGuard:
    """Checks that all odometry messages have the frames of the first one."""

    def __init__(self):
        self._frames: Optional[Tuple[str, str]] = None

    def check(self, message: Odometry) -> None:
        """Raise OdometryError if the frames of a message differ from those of the first."""
        frames = (message.header.frame_id, message.child_frame_id)
        if self._frames is None:
            self._frames = frames
        if frames != self._frames:
            raise OdometryError(
                "frames {} -> {} where {} -> {} came before".format(*frames, *self._frames)
            )


class NewestOdometry:
    """The newest valid pose on an odometry topic.

    Args:
        topic: its name.
        subscribed: whether to subscribe to it; otherwise the caller passes the messages to
            `take`. (In rospy, a node cannot subscribe to a topic both with AnyMsg and with a type.)
    """

    def __init__(self, topic: str, subscribed: bool = True):
        self._topic = topic
        self._new = threading.Condition()
        self._pose: Optional[Tuple[float, float, float]] = None
        self._stamp = rospy.Time(0)
        self._period: Optional[rospy.Duration] = None
        self._received = rospy.Time(0)
        self._refusals = Refusals()
        self._subscriber = subscriber(topic, Odometry, self.take) if subscribed else None

    def newest(
        self, now: Optional[rospy.Time], patience: float = ODOMETRY_TIMEOUT
    ) -> Tuple[float, float, float]:
        """Return the newest pose (m, m, rad), not older than `STALE_SECONDS`.

        In lock step, wait for all messages up to `now`. Raises NodeError if none comes for
        `patience` wall seconds.
        """
        deadline = time.monotonic() + patience
        with self._new:
            while not self._is_new(now):
                if rospy.is_shutdown():
                    raise rospy.ROSInterruptException("shutdown")
                if time.monotonic() >= deadline:
                    raise NodeError(f"no odometry on {self._topic} for {patience:g} s")
                self._new.wait(POLL_SECONDS)
            return self._pose

    def is_stale(self) -> bool:
        """Return whether the newest pose is out of date; in lock step it never is."""
        if in_lock_step():
            return False
        return rospy.Time.now() - self._received > rospy.Duration(STALE_SECONDS)

    def _is_new(self, now: Optional[rospy.Time]) -> bool:
        if self._pose is None:
            return False
        if now is None or not in_lock_step():
            return not self.is_stale()
        return self._period is None or self._stamp + self._period > now

    def take(self, message: Odometry) -> None:
        """Store the pose of a message; an invalid message is refused and counted."""
        try:
            pose = planar_pose(message)
        except OdometryError as error:
            self._refusals.refuse(self._topic, str(error))
            return
        with self._new:
            if self._pose is not None and message.header.stamp > self._stamp:
                self._period = message.header.stamp - self._stamp
            self._pose, self._stamp = pose, message.header.stamp
            self._received = rospy.Time.now()
            self._new.notify_all()
