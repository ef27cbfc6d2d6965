"""Frames: their names in a fleet, by tf_prefix, and poses brought from one into another."""

from __future__ import annotations

import time
from typing import Tuple

import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped, TransformStamped

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import pose_of
from bullet_lab.ros.node.lock_step import in_lock_step
from bullet_lab.ros.node.node import TF_PREFIX

# Wall seconds for a transform that nobody has sent yet.
PATIENCE = 2.0
LOCK_STEP_PATIENCE = 5.0
POLL_SECONDS = 0.02


class FrameError(LabError):
    """A pose cannot be brought into the wanted frame."""


class FrameFinder:
    """Brings poses from one frame into another, by the newest transforms of TF.

    Its methods, but for `newest`, may wait for a transform: they are not for the thread that
    drives.
    """

    def __init__(self):
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    def clear(self) -> None:
        """Forget what was known: time was set back."""
        self._buffer.clear()

    def bring(self, pose: Pose, source: str, target: str) -> Pose:
        """Return a pose in another frame.

        Args:
            pose: in `source`.
            source: frame as a message names it; a leading slash, as of old, is passed over.
            target: likewise.

        Raises:
            FrameError: a frame without a name, or no transform between the two.
        """
        source, target = source.lstrip("/"), target.lstrip("/")
        if not source:
            raise FrameError("it has no frame_id")
        if source == target:
            return pose
        found = self._lookup(target, source).transform
        return pose_of(found.translation, found.rotation) * pose

    def planar(self, message: PoseStamped, target: str) -> Tuple[float, float, float]:
        """Return a message's pose in another frame as x (m), y (m) and yaw (rad).

        Raises:
            LabError: it is not finite or no rotation, or as of `bring`.
        """
        pose = pose_of(message.pose.position, message.pose.orientation)
        placed = self.bring(pose, message.header.frame_id, target)
        return placed.position[0], placed.position[1], placed.yaw

    def newest(self, target: str, source: str) -> TransformStamped:
        """Return the newest transform to `target` from `source`; raises FrameError.

        In lock step one that is on its way is waited for: time stands meanwhile.
        """
        try:
            return self._wait(target, source, LOCK_STEP_PATIENCE if in_lock_step() else 0.0)
        except tf2_ros.TransformException as error:
            raise FrameError(f"no transform to {target}: {_line(error)}") from None

    def _lookup(self, target: str, source: str) -> TransformStamped:
        try:
            return self._wait(target, source, PATIENCE)
        except tf2_ros.TransformException as error:
            line = f"no transform from '{source}' to '{target}': {_line(error)}"
            raise FrameError(line) from None

    def _wait(self, target: str, source: str, patience: float) -> TransformStamped:
        """Return the newest transform; raises tf2_ros.TransformException."""
        deadline = time.monotonic() + patience
        while True:
            try:
                return self._buffer.lookup_transform(target, source, rospy.Time(0))
            except tf2_ros.TransformException:
                if time.monotonic() >= deadline or rospy.is_shutdown():
                    raise
            time.sleep(POLL_SECONDS)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


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
