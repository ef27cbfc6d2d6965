"""The newest pose on an odometry topic, for those who drive by it."""

from __future__ import annotations

import threading
import time
from typing import Optional, Tuple

import rospy
from nav_msgs.msg import Odometry

from bullet_lab.ros.node import NodeError, Refusals
from bullet_lab.ros.odometry import OdometryError, planar_pose

# Seconds of ROS time without odometry after which it is out of date.
STALE_SECONDS = 0.5
# Wall seconds to wait for odometry before giving up.
ODOMETRY_TIMEOUT = 5.0
# Wall seconds between two looks whether Ctrl-C was pressed meanwhile.
POLL_SECONDS = 0.2


class NewestOdometry:
    """The newest usable pose on an odometry topic."""

    def __init__(self, topic: str):
        self._topic = topic
        self._new = threading.Condition()
        self._pose: Optional[Tuple[float, float, float]] = None
        self._stamp = rospy.Time(0)
        self._period: Optional[rospy.Duration] = None
        self._received = rospy.Time(0)
        self._refusals = Refusals()
        self._subscriber = rospy.Subscriber(topic, Odometry, self._receive, tcp_nodelay=True)

    def newest(self, now: Optional[rospy.Time]) -> Tuple[float, float, float]:
        """Return the newest pose (m, m, rad).

        Args:
            now: in lock step, the simulated time: what was sent up to then is awaited.

        Raises:
            NodeError: no odometry comes.
        """
        deadline = time.monotonic() + ODOMETRY_TIMEOUT
        with self._new:
            while not self._is_new(now):
                self._new.wait(POLL_SECONDS)
                if rospy.is_shutdown():
                    raise rospy.ROSInterruptException("shutdown")
                if time.monotonic() > deadline:
                    raise NodeError(f"no odometry on {self._topic} for {ODOMETRY_TIMEOUT:g} s")
            return self._pose

    def is_stale(self) -> bool:
        """Return whether the newest pose came long ago, in ROS time."""
        return rospy.Time.now() - self._received > rospy.Duration(STALE_SECONDS)

    def _is_new(self, now: Optional[rospy.Time]) -> bool:
        if self._pose is None:
            return False
        if now is None:
            return not self.is_stale()
        return self._period is None or self._stamp > now - self._period

    def _receive(self, message: Odometry) -> None:
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
