"""Poses in other frames, by the transforms of TF."""

from __future__ import annotations

import time

import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped, TransformStamped

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import InputError, pose_of
from bullet_lab.ros.node.lock_step import in_lock_step
from bullet_lab.ros.node.node import Refusals

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


class CarefulBuffer(tf2_ros.Buffer):
    """A buffer that ignores transforms that would end the process."""

    def __init__(self):
        super().__init__()
        self._refusals = Refusals()

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


class FrameFinder:
    """Transforms poses from one frame to another by the newest transforms of TF.

    With `wait`, it waits for a missing transform. The thread that drives uses `wait=False`, which
    waits only in lock step, where simulated time stands still meanwhile.
    """

    def __init__(self):
        self._buffer = CarefulBuffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

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
    ) -> tuple[float, float, float]:
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
