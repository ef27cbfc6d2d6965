"""From the simulation's samples to ROS messages and back; the only place that does it.

A converter is made once for each output and keeps its message: rospy serialises in `publish`,
so the next sample may reuse it, which matters at a hundred times real time.
"""

from __future__ import annotations

from typing import Any, Dict, Type

from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.images import CameraInfoConverter, ImageConverter, PointsConverter
from bullet_lab.ros.messages.sensors import SENSOR_CONVERTERS
from bullet_lab.ros.messages.stamps import NANOSECONDS_PER_STEP, first_step_at, set_time, time_of
from bullet_lab.simulation.plugins.samples import (
    CameraInfoSample,
    ImageSample,
    JointSample,
    OdometrySample,
    PlanarCommand,
    PointsSample,
    TransformSample,
)

__all__ = [
    "INPUT_CONVERTERS",
    "NANOSECONDS_PER_STEP",
    "OUTPUT_CONVERTERS",
    "first_step_at",
    "pose_message",
    "set_pose",
    "set_time",
    "time_of",
]


def pose_message(pose: Pose) -> PoseMessage:
    """Return a pose as a message."""
    message = PoseMessage()
    set_pose(message, pose)
    return message


def set_pose(message: PoseMessage, pose: Pose) -> None:
    """Write a pose into a message."""
    message.position.x, message.position.y, message.position.z = pose.position
    turn = message.orientation
    turn.x, turn.y, turn.z, turn.w = pose.quaternion


class OdometryConverter:
    """OdometrySample to nav_msgs/Odometry."""

    message_kind = Odometry

    def __init__(self):
        self._message = Odometry()

    def convert(self, sample: OdometrySample) -> Odometry:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        message.child_frame_id = sample.child_frame
        set_pose(message.pose.pose, sample.pose)
        for axis, variance in enumerate(sample.pose_variances):
            message.pose.covariance[7 * axis] = variance
        for axis, variance in enumerate(sample.twist_variances):
            message.twist.covariance[7 * axis] = variance
        twist = message.twist.twist
        twist.linear.x, twist.linear.y = sample.velocity.vx, sample.velocity.vy
        twist.angular.z = sample.velocity.wz
        return message


class TransformConverter:
    """TransformSample to tf2_msgs/TFMessage."""

    message_kind = TFMessage

    def __init__(self):
        self._transform = TransformStamped()
        self._message = TFMessage([self._transform])

    def convert(self, sample: TransformSample) -> TFMessage:
        """Return the message, which the next call overwrites."""
        header, transform = self._transform.header, self._transform.transform
        set_time(header.stamp, sample.step)
        header.frame_id = sample.frame
        self._transform.child_frame_id = sample.child_frame
        place, turn = transform.translation, transform.rotation
        place.x, place.y, place.z = sample.pose.position
        turn.x, turn.y, turn.z, turn.w = sample.pose.quaternion
        return self._message


class JointConverter:
    """JointSample to sensor_msgs/JointState."""

    message_kind = JointState

    def __init__(self):
        self._message = JointState()

    def convert(self, sample: JointSample) -> JointState:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.name, message.position = sample.names, sample.positions
        message.velocity, message.effort = sample.velocities, sample.efforts
        return message


class TwistConverter:
    """geometry_msgs/Twist to PlanarCommand."""

    message_kind = Twist

    @staticmethod
    def convert(message: Twist) -> PlanarCommand:
        """Return the planar part of a twist."""
        return PlanarCommand(message.linear.x, message.linear.y, message.angular.z)


OUTPUT_CONVERTERS: Dict[type, Type[Any]] = {
    OdometrySample: OdometryConverter,
    TransformSample: TransformConverter,
    JointSample: JointConverter,
    ImageSample: ImageConverter,
    CameraInfoSample: CameraInfoConverter,
    PointsSample: PointsConverter,
    **SENSOR_CONVERTERS,
}
INPUT_CONVERTERS: Dict[type, Type[Any]] = {PlanarCommand: TwistConverter}
