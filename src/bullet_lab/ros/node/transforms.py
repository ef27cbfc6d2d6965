"""Frames: their names in a fleet, by tf_prefix, and poses brought from one into another."""

from __future__ import annotations

import time
from typing import Tuple

import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped
from tf2_msgs.msg import TFMessage

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import InputError, pose_of
from bullet_lab.ros.node.lock_step import in_lock_step
from bullet_lab.ros.node.node import TF_PREFIX, Refusals

# s; over stamps from there on, which stand for "no time" in it, tf2 ends the process.
END_OF_TIME = 2**31 - 1
# Wall seconds for a transform that nobody has sent yet.
PATIENCE = 2.0
# Likewise in lock step for the thread that drives: time stands meanwhile.
LOCK_STEP_PATIENCE = 5.0
POLL_SECONDS = 0.02


class FrameError(LabError):
    """A pose cannot be brought into the wanted frame."""


class CarefulListener(tf2_ros.TransformListener):
    """Fills a buffer from /tf and /tf_static, but for stamps that tf2 cannot bear."""

    def __init__(self, buffer: tf2_ros.Buffer):
        self._refusals = Refusals()
        super().__init__(buffer)

    def callback(self, data: TFMessage) -> None:
        """Take transforms from /tf."""
        super().callback(self._usable("/tf", data))

    def static_callback(self, data: TFMessage) -> None:
        """Take transforms from /tf_static."""
        super().static_callback(self._usable("/tf_static", data))

    def _usable(self, topic: str, message: TFMessage) -> TFMessage:
        usable = [one for one in message.transforms if one.header.stamp.secs < END_OF_TIME]
        if len(usable) < len(message.transforms):
            self._refusals.refuse(topic, "a stamp at the end of ROS time")
            message.transforms = usable
        return message


class FrameFinder:
    """Brings poses from one frame into another, by the newest transforms of TF.

    With `wait`, a transform that nobody has sent yet is waited for: that is not for the thread
    that drives. It waits in lock step only, where time stands meanwhile.
    """

    def __init__(self):
        self._buffer = tf2_ros.Buffer()
        self._listener = CarefulListener(self._buffer)

    def clear(self) -> None:
        """Forget what was known: time was set back."""
        self._buffer.clear()

    def bring(self, pose: Pose, source: str, target: str, wait: bool = True) -> Pose:
        """Return a pose in another frame; leading slashes of their names, as of old, do not count.

        Raises:
            FrameError: no transform between the two.
            InputError: a frame without a name.
        """
        source, target = source.lstrip("/"), target.lstrip("/")
        if not source:
            raise InputError("it has no frame_id")
        if source == target:
            return pose
        return self.pose_in(target, source, wait) * pose

    def planar(
        self, message: PoseStamped, target: str, wait: bool = True
    ) -> Tuple[float, float, float]:
        """Return a message's pose in another frame as x (m), y (m) and yaw (rad).

        It raises LabError if that is not finite or no rotation, or as of `bring`.
        """
        pose = pose_of(message.pose.position, message.pose.orientation)
        placed = self.bring(pose, message.header.frame_id, target, wait)
        return placed.position[0], placed.position[1], placed.yaw

    def pose_in(self, target: str, source: str, wait: bool = True) -> Pose:
        """Return the pose of the frame `source` in another; errors as of `bring`."""
        if "\0" in source + target:
            raise InputError("a frame's name has a NUL")
        patience = PATIENCE if wait else LOCK_STEP_PATIENCE if in_lock_step() else 0.0
        deadline = time.monotonic() + patience
        while True:
            try:
                found = self._buffer.lookup_transform(target, source, rospy.Time(0)).transform
                return pose_of(found.translation, found.rotation)
            except tf2_ros.TransformException as error:
                if time.monotonic() >= deadline or rospy.is_shutdown():
                    line = f"no transform from '{source}' to '{target}': {error}"
                    raise FrameError(line) from None
            time.sleep(POLL_SECONDS)


def own_tf_prefix() -> str:
    """Return what stands before the frames of the node that asks, with its slash, or nothing."""
    found = rospy.search_param(TF_PREFIX)
    prefix = str(rospy.get_param(found)).strip("/") if found else ""
    return f"{prefix}/" if prefix else ""


def own_frame(frame: str) -> str:
    """Return the full name of a frame that the node that asks means.

    As with the tf library, its tf_prefix goes before names that do not begin with a slash; a
    name that has it already stays.
    """
    prefix = own_tf_prefix()
    if not frame or frame.startswith(("/", prefix)):
        return frame.lstrip("/")
    return prefix + frame
