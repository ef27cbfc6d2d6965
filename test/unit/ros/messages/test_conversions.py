"""Samples and commands as messages, at the other end of a topic."""

import math

import genpy
import numpy as np
import pytest
from geometry_msgs.msg import Twist, Vector3
from message_fields import check, message, message_of, plain
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import COMMANDS, Converter
from bullet_lab.ros.messages.gazebo_types import kobuki_msg
from bullet_lab.ros.messages.poses import InputError, first_step_at, pose_message, time_of
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, planar_pose
from bullet_lab.simulation.plugins.point_lasers import RING_POINT
from bullet_lab.simulation.plugins.samples import (
    BlockSample,
    BumperEvent,
    CliffEvent,
    ContactsSample,
    FixSample,
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
# Samples, and fields of their messages.
SAMPLES = [
    (
        OdometrySample(1050, "odom", "base", POSE, VELOCITY, FIRST + SECOND, SECOND + FIRST),
        """
        header.stamp: 1.05
        header.frame_id: odom
        child_frame_id: base
        pose.pose: [[1.0, 2.0, 3.0], [0.0, 0.0, 0.6, 0.8]]
        twist.twist: [[0.1, 0.2, 0.0], [0.0, 0.0, 0.3]]
        """,
    ),
    (
        MotionSample(5, "world", "base", POSE, FIRST, SECOND, 0.25),
        """
        header.stamp: 0.005
        header.frame_id: world
        child_frame_id: base
        pose.pose: [[1.0, 2.0, 3.0], [0.0, 0.0, 0.6, 0.8]]
        twist.twist: [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
        """,
    ),
    (
        JointSample(7, ("a", "b"), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0)),
        """
        header.stamp: 0.007
        name: [a, b]
        position: [1.0, 2.0]
        velocity: [3.0, 4.0]
        effort: [5.0, 6.0]
        """,
    ),
    (
        LaserSample(2001, "laser", -1.0, 1.5, 1.25, 0.2, 8.0, RANGES, np.zeros(3)),
        """
        header.stamp: 2.001
        header.frame_id: laser
        angle_min: -1.0
        angle_max: 1.5
        angle_increment: 1.25
        time_increment: 0.0
        scan_time: 0.0
        range_min: 0.2
        range_max: 8.0
        ranges: [1.5, .inf, -.inf]
        intensities: [0.0, 0.0, 0.0]
        """,
    ),
    (
        RangeSample(50, "sonar", True, 0.5, 0.25, 4.0, 1.5),
        f"""
        header.stamp: 0.05
        header.frame_id: sonar
        radiation_type: {Range.INFRARED}
        field_of_view: 0.5
        min_range: 0.25
        max_range: 4.0
        range: 1.5
        """,
    ),
    (
        RangeSample(50, "sonar", False, 0.5, 0.25, 4.0, 1.5),
        f"radiation_type: {Range.ULTRASOUND}",
    ),
    (
        ImuSample(10, "imu", POSE.quaternion, FIRST, SECOND, 0.1, 0.2, 0.3),
        """
        header.stamp: 0.01
        header.frame_id: imu
        orientation: [0.0, 0.0, 0.6, 0.8]
        angular_velocity: [1.0, 2.0, 3.0]
        linear_acceleration: [4.0, 5.0, 6.0]
        orientation_covariance: [0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1]
        angular_velocity_covariance: [0.2, 0, 0, 0, 0.2, 0, 0, 0, 0.2]
        linear_acceleration_covariance: [0.3, 0, 0, 0, 0.3, 0, 0, 0, 0.3]
        """,
    ),
    (
        LoopSample(1500, 1.0, 0.75, 0.1, 0.25, 0.001, -7.0, (4.0, 3.0, 2.0, 1.0), True),
        """
        _type: control_msgs/JointControllerState
        header.stamp: 1.5
        set_point: 1.0
        process_value: 0.75
        process_value_dot: 0.1
        error: 0.25
        time_step: 0.001
        command: -7.0
        p: 4.0
        i: 3.0
        d: 2.0
        i_clamp: 1.0
        antiwindup: true
        """,
    ),
    (
        FixSample(250, "earth", 1, 3, 45.0, 9.0, 105.0, FIRST),
        """
        header.stamp: 0.25
        header.frame_id: earth
        status: [1, 3]
        latitude: 45.0
        longitude: 9.0
        altitude: 105.0
        position_covariance: [1.0, 0, 0, 0, 2.0, 0, 0, 0, 3.0]
        position_covariance_type: 2
        """,
    ),
    (VectorSample(20, "earth", FIRST), "{header.frame_id: earth, vector: [1.0, 2.0, 3.0]}"),
    (
        BlockSample(20, "base", np.array([FIRST, SECOND]), RANGES[:2]),
        """
        header.frame_id: base
        points: [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
        channels: [["", [1.5, .inf]]]
        """,
    ),
    (
        RingsSample(20, "base", np.array([[(1.0, 2.0, 3.0, 4.0, 513, 5.0)]], RING_POINT)),
        """
        header.frame_id: base
        height: 1
        width: 1
        fields: [[x, 0, 7, 1], [y, 4, 7, 1], [z, 8, 7, 1], [intensity, 12, 7, 1], [ring, 16, 4, 1],
          [time, 18, 7, 1]]
        is_bigendian: false
        point_step: 22
        row_step: 22
        data: !!binary AACAPwAAAEAAAEBAAACAQAECAACgQA==
        is_dense: true
        """,
    ),
    # What is left of a command.
    (
        VelocitySample(20, "", VELOCITY),
        "{_type: geometry_msgs/TwistStamped, twist: [[0.1, 0.2, 0.0], [0.0, 0.0, 0.3]]}",
    ),
    # What a Kobuki says.
    (BumperEvent(20, 2, True), "{_type: kobuki_msgs/BumperEvent, bumper: 2, state: 1}"),
    (CliffEvent(20, 1, True, 7), "{_type: kobuki_msgs/CliffEvent, sensor: 1, bottom: 7}"),
    (WheelDropEvent(20, 1, False), "{_type: kobuki_msgs/WheelDropEvent, wheel: 1, state: 0}"),
    (
        SwitchesSample(20, "base_link", 4, 2, 1),
        """
        _type: kobuki_msgs/SensorState
        header.stamp: 0.02
        header.frame_id: base_link
        bumper: 4
        cliff: 2
        wheel_drop: 1
        """,
    ),
    (
        ImuSample(20, "f", (0, 0, 0, 1), FIRST, FIRST, (3.0, 2.0, 1.0), 0.5, 0.0),
        "{orientation_covariance: [3.0, 0, 0, 0, 2.0, 0, 0, 0, 1.0]}",
    ),
]


@pytest.mark.parametrize("sample, fields", SAMPLES)
def test_messages_say_what_samples_say(sample, fields):
    check(message_of(sample), fields)


def test_covariances_and_the_planar_pose():
    odometry, motion = (message_of(sample) for sample, _ in SAMPLES[:2])
    assert planar_pose(odometry) == pytest.approx((1.0, 2.0, 2.0 * math.asin(0.6)))
    expected = ((odometry, FIRST + SECOND, SECOND + FIRST), (motion, [0.25] * 6, [0.25] * 6))
    for made, of_pose, of_twist in expected:
        assert made.pose.covariance == tuple(np.diag(of_pose).flat)
        assert made.twist.covariance == tuple(np.diag(of_twist).flat)


def test_transform_says_what_the_sample_says():
    (transform,) = message_of(TransformSample(50, "odom", "base", POSE)).transforms
    check(transform, "{header.stamp: 0.05, header.frame_id: odom, child_frame_id: base}")
    assert plain(transform.transform) == [list(POSE.position), list(POSE.quaternion)]


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


def test_contacts():
    contact = ShapeContact(
        1,
        "a::b::c",
        "d::e::f",
        ((1.0, 0.0, 2.0), (3.0, 0.0, 4.0)),
        ((0.0, 1.0, 0.0), (0.0, 2.0, 0.5)),
        ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
        ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
        (1e-3, 2e-3),
    )
    message = message_of(ContactsSample(1, "world", (contact, contact)))
    check(message, "{header.stamp: 0.001, header.frame_id: world}")
    state, other = message.states
    assert (state.wrenches, state.depths) == (other.wrenches, other.depths)
    assert other.info == "Debug:  i:(1/2)  my geom:a::b::c  other geom:d::e::f  time:0.001000000"
    fields = """
        collision1_name: a::b::c
        collision2_name: d::e::f
        wrenches: [[[1.0, 0.0, 2.0], [0.0, 1.0, 0.0]], [[3.0, 0.0, 4.0], [0.0, 2.0, 0.5]]]
        total_wrench: [[4.0, 0.0, 6.0], [0.0, 3.0, 0.5]]
        contact_positions: [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]
        contact_normals: [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
        depths: [0.001, 0.002]
    """
    check(state, fields)


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
