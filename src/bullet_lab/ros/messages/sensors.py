"""From what sensors measure to ROS messages."""

from __future__ import annotations

from typing import Any, Dict, List, Type

from geometry_msgs.msg import Vector3, Wrench
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, LaserScan, Range

from bullet_lab.core.pose import Vector
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.stamps import set_time
from bullet_lab.simulation.plugins.samples import (
    ContactsSample,
    ImuSample,
    LaserSample,
    MotionSample,
    RangeSample,
    ShapeContact,
)


class LaserConverter:
    """LaserSample to sensor_msgs/LaserScan; `time_increment` is 0, as all rays are of one time."""

    message_kind = LaserScan

    def __init__(self):
        self._message = LaserScan()

    def convert(self, sample: LaserSample) -> LaserScan:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        message.angle_min, message.angle_max = sample.angle_min, sample.angle_max
        message.angle_increment = sample.angle_increment
        message.scan_time = sample.period
        message.range_min, message.range_max = sample.range_min, sample.range_max
        # Lists are written four times as fast as arrays.
        message.ranges = sample.ranges.tolist()
        message.intensities = sample.intensities.tolist()
        return message


class RangeConverter:
    """RangeSample to sensor_msgs/Range."""

    message_kind = Range

    def __init__(self):
        self._message = Range()

    def convert(self, sample: RangeSample) -> Range:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        message.radiation_type = Range.INFRARED if sample.infrared else Range.ULTRASOUND
        message.field_of_view = sample.field_of_view
        message.min_range, message.max_range = sample.range_min, sample.range_max
        message.range = sample.range
        return message


class ImuConverter:
    """ImuSample to sensor_msgs/Imu."""

    message_kind = Imu

    def __init__(self):
        self._message = Imu()

    def convert(self, sample: ImuSample) -> Imu:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        turn = message.orientation
        turn.x, turn.y, turn.z, turn.w = sample.orientation
        _set_vector(message.angular_velocity, sample.angular_velocity)
        _set_vector(message.linear_acceleration, sample.specific_force)
        message.orientation_covariance = _diagonal(sample.orientation_variance, 3)
        message.angular_velocity_covariance = _diagonal(sample.angular_velocity_variance, 3)
        message.linear_acceleration_covariance = _diagonal(sample.specific_force_variance, 3)
        return message


class MotionConverter:
    """MotionSample to nav_msgs/Odometry."""

    message_kind = Odometry

    def __init__(self):
        self._message = Odometry()

    def convert(self, sample: MotionSample) -> Odometry:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id, message.child_frame_id = sample.frame, sample.child_frame
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = sample.pose.position
        turn.x, turn.y, turn.z, turn.w = sample.pose.quaternion
        _set_vector(message.twist.twist.linear, sample.linear)
        _set_vector(message.twist.twist.angular, sample.angular)
        message.pose.covariance = message.twist.covariance = _diagonal(sample.variance, 6)
        return message


class ContactsConverter:
    """ContactsSample to gazebo_msgs/ContactsState."""

    message_kind = msg.ContactsState

    def __init__(self):
        self._message = msg.ContactsState()

    def convert(self, sample: ContactsSample) -> msg.ContactsState:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        message.states = [_contact_message(contact) for contact in sample.contacts]
        return message


def _contact_message(contact: ShapeContact) -> msg.ContactState:
    return msg.ContactState(
        info=f"{len(contact.positions)} points",
        collision1_name=contact.first,
        collision2_name=contact.second,
        wrenches=[
            Wrench(Vector3(*force), Vector3(*torque))
            for force, torque in zip(contact.forces, contact.torques)
        ],
        total_wrench=Wrench(_sum(contact.forces), _sum(contact.torques)),
        contact_positions=[Vector3(*position) for position in contact.positions],
        contact_normals=[Vector3(*normal) for normal in contact.normals],
        depths=list(contact.depths),
    )


def _sum(vectors: tuple) -> Vector3:
    return Vector3(*(sum(values) for values in zip(*vectors)))


def _set_vector(message: Vector3, vector: Vector) -> None:
    message.x, message.y, message.z = vector


def _diagonal(value: float, size: int) -> List[float]:
    """Return a square matrix, row by row, with one value along its diagonal."""
    matrix = [0.0] * (size * size)
    matrix[:: size + 1] = [value] * size
    return matrix


SENSOR_CONVERTERS: Dict[type, Type[Any]] = {
    LaserSample: LaserConverter,
    RangeSample: RangeConverter,
    ImuSample: ImuConverter,
    MotionSample: MotionConverter,
    ContactsSample: ContactsConverter,
}
