"""Samples and commands as messages, at the other end of a topic."""

import math
from pathlib import Path

import genpy
import numpy as np
import pytest
from alike import assert_as_before
from geometry_msgs.msg import Twist, Vector3
from message_fields import message, message_of, plain
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import COMMANDS, Converter
from bullet_lab.ros.messages.gazebo_types import kobuki_msg
from bullet_lab.ros.messages.poses import InputError, first_step_at, pose_message, time_of
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, planar_pose
from bullet_lab.simulation.plugins.ray_sensors import RING_POINT
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
    RangeSample,
    RingsSample,
    ShapeContact,
    Stop,
    SwitchesSample,
    TransformSample,
    Trigger,
    VectorSample,
    VelocitySample,
    WheelDropEvent,
)


@pytest.mark.parametrize("step", [0, 999, 2**31])
def test_steps_are_milliseconds(step):
    assert time_of(step).to_nsec() == step * 1_000_000
    assert first_step_at(time_of(step)) == step


@pytest.mark.parametrize("time, step", [((1, 1), 1001), ((0, 999_999_999), 1000)])
def test_time_between_two_steps_is_the_later_one(time, step):
    assert first_step_at(genpy.Time(*time)) == step


def test_quaternions_have_a_w_that_is_not_negative():
    turned = pose_message(Pose(quaternion=(-0.6, 0.0, 0.0, -0.8))).orientation
    assert plain(turned) == [0.6, 0.0, 0.0, 0.8]


POSE = Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
FIRST, SECOND = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
VELOCITY = PlanarCommand(0.1, 0.2, 0.3)
RANGES = np.array([1.5, math.inf, -math.inf])
CAMERA = PinholeCamera(64, 48, 50.0, 51.0, 31.5, 23.5, (0.1, 0.2, 0.3, 0.4, 0.5))
# Its rows are not in one piece.
PICTURE = np.arange(36, dtype=np.uint8).reshape(2, 6, 3)[:, ::2]
CONTACT = ShapeContact(
    1,
    "a::b::c",
    "d::e::f",
    ((1.0, 0.0, 2.0), (3.0, 0.0, 4.0)),
    ((0.0, 1.0, 0.0), (0.0, 2.0, 0.5)),
    ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
    ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    (1e-3, 2e-3),
)
SAMPLES = [
    OdometrySample(1050, "odom", "base", POSE, VELOCITY, FIRST + SECOND, SECOND + FIRST),
    MotionSample(5, "world", "base", POSE, FIRST, SECOND, 0.25),
    JointSample(7, ("a", "b"), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0)),
    LaserSample(2001, "laser", -1.0, 1.5, 1.25, 0.2, 8.0, RANGES, np.zeros(3)),
    RangeSample(50, "sonar", True, 0.5, 0.25, 4.0, 1.5),
    RangeSample(50, "sonar", False, 0.5, 0.25, 4.0, 1.5),
    ImuSample(10, "imu", POSE.quaternion, FIRST, SECOND, 0.1, 0.2, 0.3),
    ImuSample(20, "f", (0, 0, 0, 1), FIRST, FIRST, (3.0, 2.0, 1.0), 0.5, 0.0),
    LoopSample(1500, 1.0, 0.75, 0.1, 0.25, 0.001, -7.0, (4.0, 3.0, 2.0, 1.0), True),
    FixSample(250, "earth", 1, 3, 45.0, 9.0, 105.0, FIRST),
    VectorSample(20, "earth", FIRST),
    BlockSample(20, "base", np.array([FIRST, SECOND]), RANGES[:2]),
    RingsSample(20, "base", np.array([[(1.0, 2.0, 3.0, 4.0, 513, 5.0)]], RING_POINT)),
    TransformSample(50, "odom", "base", POSE),
    ContactsSample(1, "world", (CONTACT, CONTACT)),
    # What is left of a command.
    VelocitySample(20, "", VELOCITY),
    # What a Kobuki says.
    BumperEvent(20, 2, True),
    CliffEvent(20, 1, True, 7),
    WheelDropEvent(20, 1, False),
    SwitchesSample(20, "base_link", 4, 2, 1),
    CameraInfoSample(5, "optical", CAMERA, baseline=0.2),
    ImageSample(1234, "optical", "rgb8", PICTURE),
    ImageSample(1234, "optical", "mono8", PICTURE[..., 0]),
    ImageSample(7, "optical", "32FC1", np.array([[1.5, math.nan], [0.4, 5.0]], np.float32)),
    ImageSample(7, "optical", "16UC1", np.array([[65000, 1]], np.uint16)),
]


def test_messages_say_what_samples_say():
    told = []
    for sample in SAMPLES:
        message = message_of(sample)
        told += [f"# {message._type}", *str(message).splitlines()]
    assert_as_before(told, Path(__file__).with_name("messages.txt"))


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


@pytest.mark.parametrize(
    "bad",
    [
        "position: {x: .nan}, orientation: {w: 1.0}",
        "position: {x: .inf}, orientation: {w: 1.0}",
        "orientation: {w: .nan}",
        "orientation: {w: 0.0}",
        "orientation: {w: 1.1}",
        "orientation: {z: 1.0e+308, w: 1.0e+308}",
    ],
)
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
