"""Samples, commands and shapes as messages, at the other end of a topic."""

import functools
import math
from pathlib import Path

import cv2
import genpy
import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Twist, Vector3
from message_fields import check, message, message_of, plain
from nav_msgs.msg import Odometry
from shared import cases
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import (
    COMMANDS,
    Converter,
    Look,
    _marker,
    compressed_message,
    look_of,
    world_markers,
)
from bullet_lab.ros.messages.gazebo_types import kobuki_msg
from bullet_lab.ros.messages.poses import InputError, first_step_at, pose_message, time_of
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, planar_pose
from bullet_lab.simulation.plugins import samples
from bullet_lab.simulation.plugins.ray_sensors import RING_POINT
from bullet_lab.simulation.plugins.samples import (
    ContactsSample,
    ImageSample,
    JointCommand,
    JointCommands,
    MotorPower,
    PlanarCommand,
    PointsSample,
    RingsSample,
    ShapeContact,
    Stop,
    Trigger,
)
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Box, Material, Mesh, Plane, Texture, Visual
from bullet_lab.simulation.world.sdf import read_world_file


@cases("step: [0, 999, 2147483648]")
def test_steps_are_milliseconds(step):
    assert time_of(step).to_nsec() == step * 1_000_000
    assert first_step_at(time_of(step)) == step


@cases("time, step: [[[1, 1], 1001], [[0, 999999999], 1000]]")
def test_time_between_two_steps_is_the_later_one(time, step):
    assert first_step_at(genpy.Time(*time)) == step


def test_quaternions_have_a_w_that_is_not_negative():
    turned = pose_message(Pose(quaternion=(-0.6, 0.0, 0.0, -0.8))).orientation
    assert plain(turned) == [0.6, 0.0, 0.0, 0.8]


# Its rows are not in one piece.
PICTURE = np.arange(36, dtype=np.uint8).reshape(2, 6, 3)[:, ::2]
POINTS = np.arange(18, dtype=np.float32).reshape(2, 3, 3)


class SampleLoader(yaml.SafeLoader):
    """Samples and what they hold have tags with the names of their classes."""


@functools.partial(SampleLoader.add_multi_constructor, "!")
def _made(loader, kind, node):
    kinds = {**vars(samples), "Pose": Pose, "PinholeCamera": PinholeCamera}
    parts = loader.construct_sequence(node, deep=True)
    return np.array(parts) if kind == "array" else kinds[kind](*parts)


@functools.partial(SampleLoader.add_constructor, "tag:yaml.org,2002:seq")
def _tuple(loader, node):
    return tuple(loader.construct_sequence(node, deep=True))


SAMPLES = [
    *yaml.load(Path(__file__).with_name("samples.yaml").read_text(), SampleLoader),
    RingsSample(20, "base", np.array([[(1.0, 2.0, 3.0, 4.0, 513, 5.0)]], RING_POINT)),
    ImageSample(1234, "optical", "rgb8", PICTURE),
    ImageSample(1234, "optical", "mono8", PICTURE[..., 0]),
    ImageSample(7, "optical", "32FC1", np.array([[1.5, math.nan], [0.4, 5.0]], np.float32)),
    ImageSample(7, "optical", "16UC1", np.array([[65000, 1]], np.uint16)),
    # Of the second, a point is unknown.
    PointsSample(9, "optical", POINTS, PICTURE),
    PointsSample(9, "optical", np.where(POINTS < 3, math.nan, POINTS), PICTURE),
]


def test_messages_say_what_samples_say(as_before):
    told = []
    for sample in SAMPLES:
        message = message_of(sample)
        told += [f"# {message._type}", *str(message).splitlines()]
    as_before(told, "messages.txt")


def test_the_planar_pose():
    assert planar_pose(message_of(SAMPLES[0])) == pytest.approx((1.0, 2.0, 2.0 * math.asin(0.6)))


@pytest.mark.parametrize(
    "message, command",
    [
        (Float64(0.5), JointCommand(0.5)),
        (Float64MultiArray(data=[1.0, -2.0]), JointCommands((1.0, -2.0))),
        (Bool(True), Stop(True)),
        (kobuki_msg.MotorPower(0), MotorPower(False)),
        (kobuki_msg.MotorPower(1), MotorPower(True)),
        (Empty(), Trigger()),
        # Of a twist, its planar part.
        (Twist(Vector3(1.0, 2.0, 9.0), Vector3(9.0, 0.0, 3.0)), PlanarCommand(1.0, 2.0, 3.0)),
    ],
)
def test_commands(message, command):
    message_kind, command_of = COMMANDS[type(command)]
    assert message_kind is type(message)
    assert command_of(message) == command


def test_a_message_is_made_anew_for_each_sample():
    convert = Converter(ContactsSample).convert
    full = ContactsSample(1, "a", (ShapeContact(1, "a", "b", (), (), (), (), ()),))
    assert len(convert(full).states) == 1
    assert convert(ContactsSample(2, "b", ())).states == []


def odometry(pose="orientation: {w: 1.0}", frame="odom", child="base"):
    """Return odometry with a pose, or with the identity."""
    text = f"{{header: {{frame_id: {frame}}}, child_frame_id: {child}, pose: {{pose: {{{pose}}}}}}}"
    return message(Odometry, text)


@cases("""
bad:
  - "position: {x: .nan}, orientation: {w: 1.0}"
  - "position: {x: .inf}, orientation: {w: 1.0}"
  - "orientation: {w: .nan}"
  - "orientation: {w: 0.0}"
  - "orientation: {w: 1.1}"
  - "orientation: {z: 1.0e+308, w: 1.0e+308}"
""")
def test_poses_that_are_none_are_refused(bad):
    with pytest.raises(InputError):
        planar_pose(odometry(bad))


def test_quaternions_may_be_rounded():
    rounded = odometry("orientation: {z: 0.7071, w: 0.7071}")
    assert planar_pose(rounded)[2] == pytest.approx(0.5 * math.pi)


def test_frames_are_those_of_the_first_message():
    guard = FrameGuard()
    guard.check(odometry())
    guard.check(odometry("position: {x: 1.0}, orientation: {w: 1.0}"))
    for bad in ({"frame": "map"}, {"child": "wheel"}, {"frame": "''"}):
        with pytest.raises(OdometryError):
            guard.check(odometry(**bad))
    guard.check(odometry())


COLOURED = np.full((8, 12, 3), [200, 100, 50], np.uint8)


@pytest.mark.parametrize(
    "encoding, format, pixels, said, shown",
    [
        ("rgb8", "png", COLOURED, "rgb8; png compressed bgr8", COLOURED[..., ::-1]),
        ("bgr8", "png", COLOURED, "bgr8; png compressed bgr8", COLOURED),
        ("mono8", "png", COLOURED[..., 0], "mono8; png compressed ", COLOURED[..., 0]),
        ("rgb8", "jpeg", COLOURED, "rgb8; jpeg compressed bgr8", COLOURED[..., ::-1]),
    ],
)
def test_pictures_are_compressed_as_image_transport_does(encoding, format, pixels, said, shown):
    settings = {"format": format, "jpeg_quality": 90, "jpeg_progressive": False}
    settings.update(jpeg_optimize=True, png_level=3)
    message = compressed_message(ImageSample(1500, "eye", encoding, pixels), settings)
    check(message, "{header.stamp: 1.5, header.frame_id: eye}")
    assert message.format == said
    decoded = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded.shape == shown.shape
    assert np.abs(decoded.astype(int) - shown).max() <= (3 if format == "jpeg" else 0)


WORLD = """<sdf version="1.6"><world name="shapes">
  <model name="things"><static>true</static><pose>1 2 0 0 0 1.5707963267948966</pose>
    <link name="l"><pose>0 0 1 0 0 0</pose>
      <visual name="box"><pose>3 0 0 0 0 0</pose>
        <geometry><box><size>1 2 3</size></box></geometry>
        <material><diffuse>0.1 0.2 0.3 0.4</diffuse></material></visual>
      <visual name="can"><geometry>
        <cylinder><radius>0.5</radius><length>2</length></cylinder></geometry></visual>
      <visual name="ball"><geometry><sphere><radius>0.25</radius></sphere></geometry></visual>
      <visual name="floor"><geometry>
        <plane><normal>0 0 1</normal><size>500 4</size></plane></geometry></visual>
      <visual name="beacon"><geometry><mesh>
        <uri>package://bullet_lab/meshes/beacon.dae</uri><scale>1 2 3</scale>
        </mesh></geometry></visual>
      <collision name="unseen"><geometry><box><size>9 9 9</size></box></geometry></collision>
    </link></model>
</world></sdf>"""


def test_each_visible_shape_is_a_marker_of_its_own(tmp_path, as_before):
    path = tmp_path / "shapes.world"
    path.write_text(WORLD)
    with Simulation(read_world_file(path)) as simulation:
        markers = world_markers(simulation.models["things"], "map")
    told = [line for marker in markers for line in str(marker).splitlines()]
    as_before(told, "markers.txt")
    # A plane is drawn below its surface.
    assert markers[3].pose.position.z + 0.5 * markers[3].scale.z < 1.0


def test_meshes_keep_what_they_bring_in_rviz(tmp_path):
    """RViz takes no colour at all for "as the mesh is"."""
    path, green = tmp_path / "m.dae", (0.0, 1.0, 0.0, 1.0)
    path.write_text("<COLLADA><instance_material/></COLLADA>")
    covered = Visual(Mesh(path, ""), colour=green, material=Material(covers=True))
    plain = Visual(Mesh(tmp_path / "m.stl", ""), colour=green)
    found = [_marker(v) for v in (Visual(Mesh(path, "")), covered, plain)]
    assert [m.mesh_use_embedded_materials for m in found] == [True, False, False]
    assert [(m.color.g, m.color.a) for m in found] == [(0, 0), (1, 1), (1, 1)]


def test_what_markers_have_no_field_for_stands_in_their_text(tmp_path):
    texture = Texture(tmp_path / "wood.png", (2.0, 0.5), (0.1, 0.2), 0.3, False, True, True)
    material = Material(emissive=(0.1, 0.0, 0.0, 1.0), texture=texture, lit=False)
    for shape in (Box((1.0, 2.0, 3.0)), Plane(size=(500.0, 4.0))):
        marker = _marker(Visual(shape, material=material))
        assert look_of(marker.text) == Look(material, isinstance(shape, Plane))
    # A picture on it is as large as it was.
    assert plain(marker.scale)[:2] == [500.0, 4.0]
    assert _marker(Visual(Box((1.0, 1.0, 1.0)))).text == ""


NO_LOOKS = """a label
[1]
"x"
{"texture": 3}
{"texture": {}}
{"texture": {"path": "a", "scale": [0, 1]}}
{"texture": {"path": "a", "rotation": "b"}}
{"emissive": [1, 2, NaN, 1]}"""


@pytest.mark.parametrize("text", [*NO_LOOKS.splitlines(), "[" * 100000])
def test_a_text_that_makes_no_sense_is_no_look(text):
    assert look_of(text) == Look()
