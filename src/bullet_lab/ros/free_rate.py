"""A rate by ROS time, for nodes that are in no lock step."""

from __future__ import annotations

import rospy


class FreeRate:
    """Stands beside LockStepRate: ticks by ROS time, which may be set back.

    Attributes:
        now: ROS time at the last tick.
    """

    def __init__(self, hz: float):
        self._hz = hz
        self._rate = rospy.Rate(hz)
        self.now = rospy.Time.now()

    def sleep(self) -> None:
        """Wait for the next tick; raises ROSInterruptException when ROS shuts down."""
        try:
            self._rate.sleep()
        except rospy.exceptions.ROSTimeMovedBackwardsException:
            self._rate = rospy.Rate(self._hz)
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")
        self.now = rospy.Time.now()
