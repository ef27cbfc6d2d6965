"""Conversions of samples to messages, of messages to commands, and of shapes to markers.

Markers show the world's shapes in RViz as Gazebo's window would.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any, Callable, Iterable, Mapping, NamedTuple

import cv2
import numpy as np
from geometry_msgs.msg import (
    Point32,
    TransformStamped,
    Twist,
    TwistStamped,
    Vector3,
    Vector3Stamped,
    Wrench,
)
from nav_msgs.msg import Odometry
from sensor_msgs.msg import (
    CameraInfo,
    ChannelFloat32,
    CompressedImage,
    Image,
    Imu,
    JointState,
    LaserScan,
    NavSatFix,
    PointCloud,
    PointCloud2,
    PointField,
    Range,
)
from std_msgs.msg import Bool, ColorRGBA, Empty, Float64, Float64MultiArray, Header
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.actions import fill_trajectory_state, trajectory_of
from bullet_lab.ros.messages.gazebo_types import (
    JointControllerState,
    arm_msg,
    kobuki_msg,
    msg,
)
from bullet_lab.ros.messages.poses import (
    pose_message,
    set_pose,
    set_quaternion,
    set_time,
    set_vector,
    time_of,
)
from bullet_lab.simulation.plugins.samples import (
    BlockSample,
    BumperEvent,
    CameraInfoSample,
    CliffEvent,
    ContactsSample,
    FixSample,
    ImageSample,
    ImuSample,
    JointCommand,
    JointCommands,
    JointSample,
    LaserSample,
    LoopSample,
    MotionSample,
    MotorPower,
    OdometrySample,
    PlanarCommand,
    PointsSample,
    RangeSample,
    RingsSample,
    ShapeContact,
    Stop,
    SwitchesSample,
    SwitchEvent,
    Trajectory,
    TrajectorySample,
    TransformSample,
    Trigger,
    Variance,
    VectorSample,
    VelocitySample,
    WheelDropEvent,
)
from bullet_lab.simulation.simulation import ModelInstance
from bullet_lab.simulation.world.description import BLACK, Material, Texture, Visual
from bullet_lab.simulation.world.mesh_parts import has_own_looks
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Sphere

# The memory layout of PCL's PointXYZRGB, as in Gazebo's messages; the colour is 0x00rrggbb.
POINT = np.dtype(
    {
        "names": ["x", "y", "z", "rgb"],
        "formats": ["<f4", "<f4", "<f4", "<u4"],
        "offsets": [0, 4, 8, 16],
        "itemsize": 32,
    }
)
# As in PCL, a colour is declared as a float.
DATATYPES = {"<f4": PointField.FLOAT32, "<u4": PointField.FLOAT32, "<u2": PointField.UINT16}
# OpenCV's parameters of each format, with their names in image_transport.
COMPRESSIONS = {
    "jpeg": {
        cv2.IMWRITE_JPEG_QUALITY: "jpeg_quality",
        cv2.IMWRITE_JPEG_PROGRESSIVE: "jpeg_progressive",
        cv2.IMWRITE_JPEG_OPTIMIZE: "jpeg_optimize",
    },
    "png": {cv2.IMWRITE_PNG_COMPRESSION: "png_level"},
}
# m; a plane is a slab just below the floor, or it would flicker with RViz's grid.
SLAB_THICKNESS = 0.01
SLAB_DEPTH = 0.005
# m; longest side of a plane without texture.
LARGEST_PLANE = 20.0
# Type and scale of the marker of each shape.
MARKERS: dict[type, Callable[[Any], tuple[int, tuple[float, ...]]]] = {
    Box: lambda box: (Marker.CUBE, box.size),
    Cylinder: lambda c: (Marker.CYLINDER, (2.0 * c.radius, 2.0 * c.radius, c.length)),
    Sphere: lambda sphere: (Marker.SPHERE, (2.0 * sphere.radius,) * 3),
    Plane: lambda plane: (
        Marker.CUBE,
        (*(min(side, LARGEST_PLANE) for side in plane.size), SLAB_THICKNESS),
    ),
    Mesh: lambda mesh: (Marker.MESH_RESOURCE, mesh.scale),
}


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


def _set_planar_twist(twist: Twist, sample: OdometrySample | VelocitySample) -> None:
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
    if kind == "jpeg" and pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    if sample.encoding.startswith("rgb"):
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    options: list[int] = []
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
    shift = (0.0 - camera.fx * sample.baseline, 0.0, 0.0)
    message.P = np.column_stack((camera.matrix, shift)).ravel().tolist()
    for name, value in sample.calibration.items():
        setattr(message, name, value)


def _points(message: PointCloud2, sample: PointsSample) -> None:
    points, colours = np.zeros(sample.points.shape[:2], POINT), sample.colours
    for axis, name in enumerate("xyz"):
        points[name] = sample.points[..., axis]
    red, green, blue = (colours[..., channel].astype(np.uint32) for channel in range(3))
    points["rgb"] = red << 16 | green << 8 | blue
    _set_records(message, points)


def _set_records(message: PointCloud2, records: np.ndarray) -> None:
    kind = records.dtype
    message.height, message.width = records.shape
    message.point_step, message.row_step = kind.itemsize, kind.itemsize * message.width
    message.is_dense = bool(np.isfinite(records["z"]).all())
    message.fields = [
        PointField(name, kind.fields[name][1], DATATYPES[kind[name].str], 1) for name in kind.names
    ]
    message.data = records.tobytes()


def _block(message: PointCloud, sample: BlockSample) -> None:
    message.points = [Point32(*point) for point in sample.points.tolist()]
    message.channels = [ChannelFloat32(values=sample.intensities.tolist())]


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


def _fix(message: NavSatFix, sample: FixSample) -> None:
    message.status.status, message.status.service = sample.status, sample.service
    message.latitude, message.longitude = sample.latitude, sample.longitude
    message.altitude = sample.altitude
    message.position_covariance = _diagonal(sample.variances, 3)
    message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN


def _vector(message: Vector3Stamped, sample: VectorSample) -> None:
    set_vector(message.vector, sample.vector)


def _contacts(message: msg.ContactsState, sample: ContactsSample) -> None:
    count = len(sample.contacts)
    message.states = [
        _contact(contact, f"i:({number}/{count})") for number, contact in enumerate(sample.contacts)
    ]


def _contact(contact: ShapeContact, number: str) -> msg.ContactState:
    pushes = zip(contact.forces, contact.torques)
    time = f"time:{time_of(contact.step).to_sec():.9f}"
    return msg.ContactState(
        # As in Gazebo; no other field has the time.
        info=f"Debug:  {number}  my geom:{contact.first}  other geom:{contact.second}  {time}",
        collision1_name=contact.first,
        collision2_name=contact.second,
        wrenches=[Wrench(Vector3(*force), Vector3(*torque)) for force, torque in pushes],
        total_wrench=Wrench(_sum(contact.forces), _sum(contact.torques)),
        contact_positions=[Vector3(*position) for position in contact.positions],
        contact_normals=[Vector3(*normal) for normal in contact.normals],
        depths=list(contact.depths),
    )


def _event(message: Any, event: SwitchEvent) -> None:
    # The fields have other names in each type of event, but the same order.
    for name, value in zip(message.__slots__, (event.number, int(event.on), event.reading)):
        setattr(message, name, value)


def _switches(message: kobuki_msg.SensorState, sample: SwitchesSample) -> None:
    message.bumper, message.cliff = sample.bumpers, sample.cliffs
    message.wheel_drop = sample.wheel_drops


def _sum(vectors: tuple) -> Vector3:
    return Vector3(*(sum(values) for values in zip(*vectors)))


def _diagonal(value: Variance, size: int) -> list[float]:
    """Return a diagonal matrix, row by row, with one value along the diagonal or several."""
    matrix = [0.0] * (size * size)
    matrix[:: size + 1] = value if isinstance(value, tuple) else [value] * size
    return matrix


# The message for each kind of samples, and the function that fills it.
MESSAGES: dict[type, tuple[type, Callable[[Any, Any], None]]] = {
    OdometrySample: (Odometry, _odometry),
    TransformSample: (TFMessage, _transform),
    JointSample: (JointState, _joints),
    ImageSample: (Image, _image),
    CameraInfoSample: (CameraInfo, _camera_info),
    PointsSample: (PointCloud2, _points),
    BlockSample: (PointCloud, _block),
    RingsSample: (PointCloud2, lambda message, sample: _set_records(message, sample.records)),
    LaserSample: (LaserScan, _scan),
    RangeSample: (Range, _range),
    ImuSample: (Imu, _imu),
    FixSample: (NavSatFix, _fix),
    VectorSample: (Vector3Stamped, _vector),
    MotionSample: (Odometry, _motion),
    LoopSample: (JointControllerState, _loop),
    VelocitySample: (TwistStamped, _velocity),
    ContactsSample: (msg.ContactsState, _contacts),
    BumperEvent: (kobuki_msg.BumperEvent, _event),
    CliffEvent: (kobuki_msg.CliffEvent, _event),
    WheelDropEvent: (kobuki_msg.WheelDropEvent, _event),
    SwitchesSample: (kobuki_msg.SensorState, _switches),
}
if arm_msg is not None:
    MESSAGES[TrajectorySample] = (arm_msg.JointTrajectoryControllerState, fill_trajectory_state)


class Converter:
    """Converts samples of one kind to messages of the class `message_kind`.

    All samples share one message, which saves time at a hundred times real time: rospy serialises
    it in `publish`.
    """

    def __init__(self, sample_kind: type):
        self.message_kind, self._fill = MESSAGES[sample_kind]
        self._message = self._stamped = self.message_kind()
        if self.message_kind is TFMessage:
            # The transform has the header.
            self._stamped = TransformStamped()
            self._message.transforms.append(self._stamped)

    def convert(self, sample: Any) -> Any:
        """Return a sample as a message, which the next call overwrites."""
        # Events of a Kobuki have no header.
        header = getattr(self._stamped, "header", None)
        if header is not None:
            set_time(header.stamp, sample.step)
            header.frame_id = sample.frame
        self._fill(self._stamped, sample)
        return self._message


# The message for each kind of commands, and the function that reads it.
COMMANDS: dict[type, tuple[type, Callable[[Any], Any]]] = {
    PlanarCommand: (Twist, lambda m: PlanarCommand(m.linear.x, m.linear.y, m.angular.z)),
    JointCommand: (Float64, lambda message: JointCommand(message.data)),
    JointCommands: (Float64MultiArray, lambda message: JointCommands(tuple(message.data))),
    Stop: (Bool, lambda message: Stop(message.data)),
    MotorPower: (kobuki_msg.MotorPower, lambda message: MotorPower(message.state != 0)),
    Trigger: (Empty, lambda _: Trigger()),
    Trajectory: (JointTrajectory, trajectory_of),
}


def world_markers(instance: ModelInstance, frame: str) -> list[Marker]:
    """Return the visible shapes of a model as markers; their namespace is the model's name.

    A marker has no fields for textures and emissive colours. They are in its text as JSON; RViz
    displays the text of text markers only.
    """
    markers: list[Marker] = []
    for link in instance.model.links:
        pose = instance.frame(link.name).pose() if link.visuals else Pose()
        for visual in link.visuals:
            placed = pose * visual.pose
            if isinstance(visual.geometry, Plane):
                placed = placed * Pose((0.0, 0.0, -SLAB_DEPTH - 0.5 * SLAB_THICKNESS))
            marker = _marker(visual)
            marker.header.frame_id = frame
            marker.ns = instance.name
            marker.id = len(markers)
            marker.pose = pose_message(placed)
            markers.append(marker)
    return markers


def deleted_markers(model: str, numbers: Iterable[int], frame: str) -> list[Marker]:
    """Return markers that delete those of a model with these numbers."""
    header = Header(frame_id=frame)
    return [Marker(header=header, action=Marker.DELETE, ns=model, id=one) for one in numbers]


def _marker(visual: Visual) -> Marker:
    shape = visual.geometry
    kind, size = MARKERS[type(shape)](shape)
    marker = Marker(action=Marker.ADD, frame_locked=True, type=kind, scale=Vector3(*size))
    marker.color = ColorRGBA(*visual.colour)
    marker.text = _look_text(visual)
    if isinstance(shape, Plane) and visual.material.texture is not None:
        # The full size, which the texture depends on.
        marker.scale = Vector3(*shape.size, SLAB_THICKNESS)
    if isinstance(shape, Mesh):
        # RViz resolves package:// itself.
        in_package = shape.uri.startswith("package://")
        marker.mesh_resource = shape.uri if in_package else shape.path.absolute().as_uri()
        if not visual.material.covers and has_own_looks(shape):
            # Without a colour of the marker, a mesh has its own colours.
            marker.mesh_use_embedded_materials, marker.color = True, ColorRGBA()
    return marker


class Look(NamedTuple):
    """The appearance of a shape besides its colour, and whether its slab is a plane."""

    material: Material = Material()
    is_plane: bool = False


def _look_text(visual: Visual) -> str:
    """Return the text of a visual's marker for `look_of`; empty if it has only a colour."""
    material = visual.material
    look: dict[str, Any] = {}
    if material.texture is not None:
        look = {"texture": asdict(material.texture), "plane": isinstance(visual.geometry, Plane)}
    if material.emissive != BLACK:
        look["emissive"] = material.emissive
    if not material.lit:
        look["lit"] = False
    return json.dumps(look, default=str) if look else ""


def look_of(text: str) -> Look:
    """Return the look in the text of a shape's marker; the default look if there is none.

    >>> look_of('{"texture": {"path": "/wood.png"}, "lit": false}').material.texture.path.name
    'wood.png'
    >>> look_of("a label") == Look()
    True
    """
    try:
        look = json.loads(text) if text else {}
        texture = _texture(**look["texture"]) if "texture" in look else None
        emissive = _numbers(look.get("emissive", BLACK), 4)
        lit = bool(look.get("lit", True))
        return Look(Material(None, emissive, texture, lit), bool(look.get("plane")))
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        return Look()


def _texture(path: Any, **values: Any) -> Texture:
    texture = Texture(Path(path), **values)
    scale, scroll = _numbers(texture.scale, 2), _numbers(texture.scroll, 2)
    if not all(scale):
        raise ValueError(scale)
    flags = (bool(flag) for flag in (texture.repeats, texture.blends, texture.sharp))
    return Texture(texture.path, scale, scroll, *_numbers([texture.rotation], 1), *flags)


def _numbers(values: Iterable[Any], count: int) -> tuple[Any, ...]:
    found = tuple(map(float, values))
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ValueError(found)
    return found
