"""From the simulation's samples to ROS messages and back; the only place that does it.

A converter is made once for each output and keeps its message: rospy serialises in `publish`,
so the next sample may reuse it, which matters at a hundred times real time.
"""

from __future__ import annotations

from typing import Any, ClassVar, Dict, List, Type

import numpy as np
from geometry_msgs.msg import TransformStamped, Twist, Vector3, Wrench
from nav_msgs.msg import Odometry
from sensor_msgs.msg import (
    CameraInfo,
    Image,
    Imu,
    JointState,
    LaserScan,
    PointCloud2,
    PointField,
    Range,
)
from tf2_msgs.msg import TFMessage

from bullet_lab.core.pose import Vector
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import set_pose, set_time
from bullet_lab.simulation.plugins.samples import (
    CameraInfoSample,
    ContactsSample,
    ImageSample,
    ImuSample,
    JointSample,
    LaserSample,
    MotionSample,
    OdometrySample,
    PlanarCommand,
    PointsSample,
    RangeSample,
    ShapeContact,
    TransformSample,
)


class Converter:
    """Turns samples of one kind into messages with a header.

    Attributes:
        message_kind: class of the messages.
    """

    message_kind: ClassVar[Type[Any]]

    def __init__(self) -> None:
        self._message = self.message_kind()

    def convert(self, sample: Any) -> Any:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        self._fill(message, sample)
        return message

    def _fill(self, message: Any, sample: Any) -> None:
        """Write into a message what is not in its header."""
        raise NotImplementedError


class OdometryConverter(Converter):
    """OdometrySample to nav_msgs/Odometry."""

    message_kind = Odometry

    def _fill(self, message: Odometry, sample: OdometrySample) -> None:
        message.child_frame_id = sample.child_frame
        set_pose(message.pose.pose, sample.pose)
        for axis, variance in enumerate(sample.pose_variances):
            message.pose.covariance[7 * axis] = variance
        for axis, variance in enumerate(sample.twist_variances):
            message.twist.covariance[7 * axis] = variance
        twist = message.twist.twist
        twist.linear.x, twist.linear.y = sample.velocity.vx, sample.velocity.vy
        twist.angular.z = sample.velocity.wz


class MotionConverter(Converter):
    """MotionSample to nav_msgs/Odometry."""

    message_kind = Odometry

    def _fill(self, message: Odometry, sample: MotionSample) -> None:
        message.child_frame_id = sample.child_frame
        set_pose(message.pose.pose, sample.pose)
        _set_vector(message.twist.twist.linear, sample.linear)
        _set_vector(message.twist.twist.angular, sample.angular)
        message.pose.covariance = message.twist.covariance = _diagonal(sample.variance, 6)


class TransformConverter(Converter):
    """TransformSample to tf2_msgs/TFMessage."""

    message_kind = TFMessage

    def __init__(self) -> None:
        # It has the header, and the message has nothing else.
        self._message = TransformStamped()
        self._list = TFMessage([self._message])

    def convert(self, sample: TransformSample) -> TFMessage:
        """Return the message, which the next call overwrites."""
        super().convert(sample)
        return self._list

    def _fill(self, message: TransformStamped, sample: TransformSample) -> None:
        message.child_frame_id = sample.child_frame
        _set_vector(message.transform.translation, sample.pose.position)
        turn = message.transform.rotation
        turn.x, turn.y, turn.z, turn.w = sample.pose.quaternion


class JointConverter(Converter):
    """JointSample to sensor_msgs/JointState."""

    message_kind = JointState

    def _fill(self, message: JointState, sample: JointSample) -> None:
        message.name, message.position = sample.names, sample.positions
        message.velocity, message.effort = sample.velocities, sample.efforts


class ImageConverter(Converter):
    """ImageSample to sensor_msgs/Image."""

    message_kind = Image

    def _fill(self, message: Image, sample: ImageSample) -> None:
        message.encoding = sample.encoding
        message.height, message.width = sample.pixels.shape[:2]
        message.step = sample.pixels.nbytes // message.height
        message.data = sample.pixels.tobytes()


class CameraInfoConverter(Converter):
    """CameraInfoSample to sensor_msgs/CameraInfo."""

    message_kind = CameraInfo

    def __init__(self) -> None:
        self._message = CameraInfo(distortion_model="plumb_bob")
        self._message.R = np.eye(3).ravel().tolist()

    def _fill(self, message: CameraInfo, sample: CameraInfoSample) -> None:
        camera = sample.camera
        message.width, message.height = camera.width, camera.height
        message.D = list(camera.distortion)
        message.K = camera.matrix.ravel().tolist()
        shift = 0.0 - camera.fx * sample.baseline
        message.P = [camera.fx, 0.0, camera.cx, shift, 0.0, camera.fy, camera.cy, 0.0]
        message.P += [0.0, 0.0, 1.0, 0.0]


# As PCL's PointXYZRGB lies in memory, and Gazebo's messages.
POINT = np.dtype(
    {
        "names": ["x", "y", "z", "rgb"],
        "formats": ["<f4", "<f4", "<f4", "<u4"],
        "offsets": [0, 4, 8, 16],
        "itemsize": 32,
    }
)


class PointsConverter(Converter):
    """PointsSample to sensor_msgs/PointCloud2, a row of points for each row of pixels.

    The colour is 0x00rrggbb, declared as a float, as PCL has it.
    """

    message_kind = PointCloud2

    def __init__(self) -> None:
        self._message = PointCloud2(is_bigendian=False, point_step=POINT.itemsize)
        self._message.fields = [
            PointField(name, POINT.fields[name][1], PointField.FLOAT32, 1) for name in POINT.names
        ]
        self._points = np.zeros((0, 0), POINT)

    def _fill(self, message: PointCloud2, sample: PointsSample) -> None:
        message.height, message.width = sample.points.shape[:2]
        message.row_step = message.width * message.point_step
        message.is_dense = bool(np.isfinite(sample.points[..., 2]).all())
        message.data = self._packed(sample).tobytes()

    def _packed(self, sample: PointsSample) -> np.ndarray:
        points, colours = self._points, sample.colours.astype(np.uint32)
        if points.shape != sample.points.shape[:2]:
            points = self._points = np.zeros(sample.points.shape[:2], POINT)
        for axis, name in enumerate("xyz"):
            points[name] = sample.points[..., axis]
        points["rgb"] = colours[..., 0] << 16 | colours[..., 1] << 8 | colours[..., 2]
        return points


class LaserConverter(Converter):
    """LaserSample to sensor_msgs/LaserScan; `time_increment` is 0, as all rays are of one time."""

    message_kind = LaserScan

    def _fill(self, message: LaserScan, sample: LaserSample) -> None:
        message.angle_min, message.angle_max = sample.angle_min, sample.angle_max
        message.angle_increment = sample.angle_increment
        message.scan_time = sample.period
        message.range_min, message.range_max = sample.range_min, sample.range_max
        # Lists are written four times as fast as arrays.
        message.ranges = sample.ranges.tolist()
        message.intensities = sample.intensities.tolist()


class RangeConverter(Converter):
    """RangeSample to sensor_msgs/Range."""

    message_kind = Range

    def _fill(self, message: Range, sample: RangeSample) -> None:
        message.radiation_type = Range.INFRARED if sample.infrared else Range.ULTRASOUND
        message.field_of_view = sample.field_of_view
        message.min_range, message.max_range = sample.range_min, sample.range_max
        message.range = sample.range


class ImuConverter(Converter):
    """ImuSample to sensor_msgs/Imu."""

    message_kind = Imu

    def _fill(self, message: Imu, sample: ImuSample) -> None:
        turn = message.orientation
        turn.x, turn.y, turn.z, turn.w = sample.orientation
        _set_vector(message.angular_velocity, sample.angular_velocity)
        _set_vector(message.linear_acceleration, sample.specific_force)
        message.orientation_covariance = _diagonal(sample.orientation_variance, 3)
        message.angular_velocity_covariance = _diagonal(sample.angular_velocity_variance, 3)
        message.linear_acceleration_covariance = _diagonal(sample.specific_force_variance, 3)


class ContactsConverter(Converter):
    """ContactsSample to gazebo_msgs/ContactsState."""

    message_kind = msg.ContactsState

    def _fill(self, message: msg.ContactsState, sample: ContactsSample) -> None:
        message.states = [_contact_message(contact) for contact in sample.contacts]


class TwistConverter:
    """geometry_msgs/Twist to PlanarCommand."""

    message_kind = Twist

    @staticmethod
    def convert(message: Twist) -> PlanarCommand:
        """Return the planar part of a twist."""
        return PlanarCommand(message.linear.x, message.linear.y, message.angular.z)


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


OUTPUT_CONVERTERS: Dict[type, Type[Any]] = {
    OdometrySample: OdometryConverter,
    TransformSample: TransformConverter,
    JointSample: JointConverter,
    ImageSample: ImageConverter,
    CameraInfoSample: CameraInfoConverter,
    PointsSample: PointsConverter,
    LaserSample: LaserConverter,
    RangeSample: RangeConverter,
    ImuSample: ImuConverter,
    MotionSample: MotionConverter,
    ContactsSample: ContactsConverter,
}
INPUT_CONVERTERS: Dict[type, Type[Any]] = {PlanarCommand: TwistConverter}
