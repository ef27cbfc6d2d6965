"""The transforms of TF, by the library tf2."""

from __future__ import annotations

import rospy
import tf2_ros
from geometry_msgs.msg import Transform, TransformStamped

from bullet_lab.ros.node.node import Refusals

# s; tf2 ends the process if a stamp is as large: it means "no time" there.
END_OF_TIME = 2**31 - 1


class CarefulBuffer(tf2_ros.Buffer):
    """The transforms of /tf and /tf_static, but for those that would end the process."""

    def __init__(self):
        super().__init__()
        self._refusals = Refusals()
        self._listener = tf2_ros.TransformListener(self)

    def newest(self, target: str, source: str) -> Transform:
        """Return the newest transform from one frame to another; raises LookupError."""
        try:
            return self.lookup_transform(target, source, rospy.Time(0)).transform
        except tf2_ros.TransformException as error:
            raise LookupError(str(error)) from None

    def set_transform(self, transform: TransformStamped, authority: str) -> None:
        """Store a transform of /tf."""
        if self._is_usable("/tf", transform):
            super().set_transform(transform, authority)

    def set_transform_static(self, transform: TransformStamped, authority: str) -> None:
        """Store a transform of /tf_static."""
        if self._is_usable("/tf_static", transform):
            super().set_transform_static(transform, authority)

    def _is_usable(self, topic: str, transform: TransformStamped) -> bool:
        is_usable = transform.header.stamp.secs < END_OF_TIME
        if not is_usable:
            self._refusals.refuse(topic, "a stamp at the end of ROS time")
        return is_usable
