"""Conversions of the simulation's samples to messages, and of messages to commands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Dict, List, Mapping, Type, Union

import cv2
import numpy as np
from geometry_msgs.msg import TransformStamped, Twist, TwistStamped, Vector3, Wrench
from nav_msgs.msg import Odometry
from sensor_msgs.msg import (
    CameraInfo,
    CompressedImage,
    Image,
    Imu,
    JointState,
    LaserScan,
    PointCloud2,
    PointField,
    Range,
)
from std_msgs.msg import Bool, Float64, Float64MultiArray
from tf2_msgs.msg import TFMessage

from bullet_lab.ros.messages.gazebo_types import JointControllerState, msg
from bullet_lab.ros.messages.poses import set_pose, set_quaternion, set_time, set_vector
from bullet_lab.simulation.plugins.samples import (
    CameraInfoSample,
    ContactsSample,
    ImageSample,
    ImuSample,
    JointCommand,
    JointCommands,
    JointSample,
    LaserSample,
    LoopSample,
    MotionSample,
    OdometrySample,
    PlanarCommand,
    PointsSample,
    RangeSample,
    ShapeContact,
    Stop,
    TransformSample,
    VelocitySample,
)

# The memory layout of PCL's PointXYZRGB, as in Gazebo's messages; the colour is 0x00rrggbb.
POINT = np.dtype(
    {
        "names": ["x", "y", "z", "rgb"],
        "formats": ["<f4", "<f4", "<f4", "<u4"],
        "offsets": [0, 4, 8, 16],
        "itemsize": 32,
    }
)
# OpenCV's parameters of each format, with their names in image_transport.
COMPRESSIONS = {
    "jpeg": {
        cv2.IMWRITE_JPEG_QUALITY: "jpeg_quality",
        cv2.IMWRITE_JPEG_PROGRESSIVE: "jpeg_progressive",
        cv2.IMWRITE_JPEG_OPTIMIZE: "jpeg_optimize",
    },
    "png": {cv2.IMWRITE_PNG_COMPRESSION: "png_level"},
}


class Converter:
    """Converts samples of one kind to messages of the class `message_kind`, with a header.

    All samples share one message, which saves time at a hundred times real time: rospy serialises
    it in `publish`.
    """

    def __init__(self, message_kind: Type[Any], fill: Callable[[Any, Any], None]):
        self.message_kind = message_kind
        self._message = self._stamped = message_kind()
        self._fill = fill
        if message_kind is TFMessage:
            # The transform has the header.
            self._stamped = TransformStamped()
            self._message.transforms.append(self._stamped)

    def convert(self, sample: Any) -> Any:
        """Return a sample as a message, which the next call overwrites."""
        header = self._stamped.header
        set_time(header.stamp, sample.step)
        header.frame_id = sample.frame
        self._fill(self._stamped, sample)
        return self._message


def _odometry(message: Odometry, sample: OdometrySample) -> None:
    message.child_frame_id = sample.child_frame
    set_pose(message.pose.pose, sample.pose)
    for axis, variance in enumerate(sample.pose_variances):
        message.pose.covariance[7 * axis] = variance
    for axis, variance in enumerate(sample.twist_variances):
        message.twist.covariance[7 * axis] = variance
    _set_planar_twist(message.twist.twist, sample)


def _velocity(message: TwistStamped, sample: VelocitySample) -> None:
    _set_planar_twist(message.twist, sample)


def _set_planar_twist(twist: Twist, sample: Union[OdometrySample, VelocitySample]) -> None:
    twist.linear.x, twist.linear.y = sample.velocity.vx, sample.velocity.vy
    twist.angular.z = sample.velocity.wz


def _motion(message: Odometry, sample: MotionSample) -> None:
    message.child_frame_id = sample.child_frame
    set_pose(message.pose.pose, sample.pose)
    set_vector(message.twist.twist.linear, sample.linear)
    set_vector(message.twist.twist.angular, sample.angular)
    message.pose.covariance = message.twist.covariance = _diagonal(sample.variance, 6)


def _transform(message: TransformStamped, sample: TransformSample) -> None:
    message.child_frame_id = sample.child_frame
    set_vector(message.transform.translation, sample.pose.position)
    set_quaternion(message.transform.rotation, sample.pose.quaternion)


def _joints(message: JointState, sample: JointSample) -> None:
    message.name, message.position = sample.names, sample.positions
    message.velocity, message.effort = sample.velocities, sample.efforts


def _loop(message: JointControllerState, sample: LoopSample) -> None:
    message.set_point, message.process_value = sample.target, sample.value
    message.process_value_dot, message.error = sample.slope, sample.error
    message.time_step, message.command = sample.seconds, sample.command
    message.p, message.i, message.d, message.i_clamp = sample.gains
    message.antiwindup = sample.antiwindup


def _image(message: Image, sample: ImageSample) -> None:
    message.encoding = sample.encoding
    message.height, message.width = sample.pixels.shape[:2]
    message.step = sample.pixels.nbytes // message.height
    message.data = sample.pixels.tobytes()


def compressed_message(sample: ImageSample, settings: Mapping[str, Any]) -> CompressedImage:
    """Return an image as compressed_image_transport publishes it with the same settings."""
    kind, pixels = settings["format"], sample.pixels
    if sample.encoding == "rgb8":
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    options: List[int] = []
    for key, name in COMPRESSIONS[kind].items():
        options += [key, int(settings[name])]
    message = CompressedImage(format=f"{sample.encoding}; {kind} compressed ")
    message.format += "" if pixels.ndim == 2 else "bgr8"
    set_time(message.header.stamp, sample.step)
    message.header.frame_id = sample.frame
    message.data = cv2.imencode(f".{kind}", pixels, options)[1].tobytes()
    return message


def _camera_info(message: CameraInfo, sample: CameraInfoSample) -> None:
    camera = sample.camera
    message.width, message.height = camera.width, camera.height
    message.distortion_model, message.D = "plumb_bob", list(camera.distortion)
    message.R = np.eye(3).ravel().tolist()
    message.K = camera.matrix.ravel().tolist()
    shift = 0.0 - camera.fx * sample.baseline
    message.P = [camera.fx, 0.0, camera.cx, shift, 0.0, camera.fy, camera.cy, 0.0]
    message.P += [0.0, 0.0, 1.0, 0.0]
    for name, value in sample.calibration.items():
        setattr(message, name, value)


def _points(message: PointCloud2, sample: PointsSample) -> None:
    message.height, message.width = shape = sample.points.shape[:2]
    message.point_step, message.row_step = POINT.itemsize, shape[1] * POINT.itemsize
    message.is_dense = bool(np.isfinite(sample.points[..., 2]).all())
    # As in PCL, the colour is declared as a float.
    message.fields = [
        PointField(name, POINT.fields[name][1], PointField.FLOAT32, 1) for name in POINT.names
    ]
    message.data = bytearray(shape[0] * message.row_step)
    points, colours = np.frombuffer(message.data, POINT).reshape(shape), sample.colours
    for axis, name in enumerate("xyz"):
        points[name] = sample.points[..., axis]
    red, green, blue = (colours[..., channel].astype(np.uint32) for channel in range(3))
    points["rgb"] = red << 16 | green << 8 | blue


def _scan(message: LaserScan, sample: LaserSample) -> None:
    # As in Gazebo, `time_increment` and `scan_time` are 0: all rays have the same time.
    message.angle_min, message.angle_max = sample.angle_min, sample.angle_max
    message.angle_increment = sample.angle_increment
    message.range_min, message.range_max = sample.range_min, sample.range_max
    # Lists are serialised four times as fast as arrays.
    message.ranges = sample.ranges.tolist()
    message.intensities = sample.intensities.tolist()


def _range(message: Range, sample: RangeSample) -> None:
    message.radiation_type = Range.INFRARED if sample.infrared else Range.ULTRASOUND
    message.field_of_view, message.range = sample.field_of_view, sample.range
    message.min_range, message.max_range = sample.range_min, sample.range_max


def _imu(message: Imu, sample: ImuSample) -> None:
    set_quaternion(message.orientation, sample.orientation)
    set_vector(message.angular_velocity, sample.angular_velocity)
    set_vector(message.linear_acceleration, sample.specific_force)
    message.orientation_covariance = _diagonal(sample.orientation_variance, 3)
    message.angular_velocity_covariance = _diagonal(sample.angular_velocity_variance, 3)
    message.linear_acceleration_covariance = _diagonal(sample.specific_force_variance, 3)


def _contacts(message: msg.ContactsState, sample: ContactsSample) -> None:
    message.states = [_contact(contact) for contact in sample.contacts]


def _contact(contact: ShapeContact) -> msg.ContactState:
    pushes = zip(contact.forces, contact.torques)
    return msg.ContactState(
        info=f"{len(contact.positions)} points",
        collision1_name=contact.first,
        collision2_name=contact.second,
        wrenches=[Wrench(Vector3(*force), Vector3(*torque)) for force, torque in pushes],
        total_wrench=Wrench(_sum(contact.forces), _sum(contact.torques)),
        contact_positions=[Vector3(*position) for position in contact.positions],
        contact_normals=[Vector3(*normal) for normal in contact.normals],
        depths=list(contact.depths),
    )


def _sum(vectors: tuple) -> Vector3:
    return Vector3(*(sum(values) for values in zip(*vectors)))


def _diagonal(value: float, size: int) -> List[float]:
    """Return a diagonal matrix, row by row, with the same value along the diagonal."""
    matrix = [0.0] * (size * size)
    matrix[:: size + 1] = [value] * size
    return matrix


# Functions that make the converter for a kind of samples.
OUTPUT_CONVERTERS: Dict[type, Callable[[], Converter]] = {
    OdometrySample: partial(Converter, Odometry, _odometry),
    TransformSample: partial(Converter, TFMessage, _transform),
    JointSample: partial(Converter, JointState, _joints),
    ImageSample: partial(Converter, Image, _image),
    CameraInfoSample: partial(Converter, CameraInfo, _camera_info),
    PointsSample: partial(Converter, PointCloud2, _points),
    LaserSample: partial(Converter, LaserScan, _scan),
    RangeSample: partial(Converter, Range, _range),
    ImuSample: partial(Converter, Imu, _imu),
    MotionSample: partial(Converter, Odometry, _motion),
    LoopSample: partial(Converter, JointControllerState, _loop),
    VelocitySample: partial(Converter, TwistStamped, _velocity),
    ContactsSample: partial(Converter, msg.ContactsState, _contacts),
}


@dataclass(frozen=True)
class CommandConverter:
    """Converts messages of the class `message_kind` to commands, by `convert`."""

    message_kind: Type[Any]
    convert: Callable[[Any], Any]


def _planar(message: Twist) -> PlanarCommand:
    return PlanarCommand(message.linear.x, message.linear.y, message.angular.z)


INPUT_CONVERTERS: Dict[type, CommandConverter] = {
    PlanarCommand: CommandConverter(Twist, _planar),
    JointCommand: CommandConverter(Float64, lambda message: JointCommand(message.data)),
    JointCommands: CommandConverter(
        Float64MultiArray, lambda message: JointCommands(tuple(message.data))
    ),
    Stop: CommandConverter(Bool, lambda message: Stop(message.data)),
}
