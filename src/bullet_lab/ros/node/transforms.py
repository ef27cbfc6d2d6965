"""Frame names with tf_prefix, and transforms of poses from one frame to another."""

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

# s; tf2 ends the process if a stamp is as large: it means "no time" there.
END_OF_TIME = 2**31 - 1
# Wall seconds to wait for a missing transform.
PATIENCE = 2.0
# Likewise for the thread that drives, in lock step: simulated time does not advance meanwhile.
LOCK_STEP_PATIENCE = 5.0
# Wall seconds between two attempts.
POLL_SECONDS = 0.02


class FrameError(LabError):
    """There is no transform between two frames."""


class CarefulListener(tf2_ros.TransformListener):
    """Fills a buffer from /tf and /tf_static; ignores transforms that would end the process."""

    def __init__(self, buffer: tf2_ros.Buffer):
        self._refusals = Refusals()
        super().__init__(buffer)

    def callback(self, data: TFMessage) -> None:
        """Store the transforms of a message on /tf."""
        super().callback(self._usable("/tf", data))

    def static_callback(self, data: TFMessage) -> None:
        """Store the transforms of a message on /tf_static."""
        super().static_callback(self._usable("/tf_static", data))

    def _usable(self, topic: str, message: TFMessage) -> TFMessage:
        usable = [one for one in message.transforms if one.header.stamp.secs < END_OF_TIME]
        if len(usable) < len(message.transforms):
            self._refusals.refuse(topic, "a stamp at the end of ROS time")
            message.transforms = usable
        return message


class FrameFinder:
    """Transforms poses from one frame to another by the newest transforms of TF.

    With `wait`, a missing transform is waited for. The thread that drives uses `wait=False`: it
    waits in lock step only, where simulated time does not advance meanwhile.
    """

    def __init__(self):
        self._buffer = tf2_ros.Buffer()
        self._listener = CarefulListener(self._buffer)

    def clear(self) -> None:
        """Remove all transforms after a reset of time."""
        self._buffer.clear()

    def bring(self, pose: Pose, source: str, target: str, wait: bool = True) -> Pose:
        """Return a pose in another frame; leading slashes of frame names are ignored.

        Raises:
            FrameError: no transform between the two.
            InputError: an invalid frame name.
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

        Raises InputError for an invalid pose, and the errors of `bring`.
        """
        pose = pose_of(message.pose.position, message.pose.orientation)
        placed = self.bring(pose, message.header.frame_id, target, wait)
        return placed.position[0], placed.position[1], placed.yaw

    def pose_in(self, target: str, source: str, wait: bool = True) -> Pose:
        """Return the pose of the frame `source` in the frame `target`; errors as of `bring`."""
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
    """Return this node's tf_prefix with a slash at the end; empty without one."""
    found = rospy.search_param(TF_PREFIX)
    prefix = str(rospy.get_param(found)).strip("/") if found else ""
    return f"{prefix}/" if prefix else ""


def own_frame(frame: str) -> str:
    """Return a frame name with this node's tf_prefix.

    As in the tf library, a name with a leading slash has no prefix. A name that has the prefix
    already is returned unchanged.
    """
    prefix = own_tf_prefix()
    if not frame or frame.startswith(("/", prefix)):
        return frame.lstrip("/")
    return prefix + frame
