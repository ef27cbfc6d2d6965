"""What controllers and a Kobuki say and are told, as messages."""

import pytest
from message_fields import check, message_of
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

from bullet_lab.ros.messages.conversions import COMMANDS
from bullet_lab.ros.messages.gazebo_types import kobuki_msg
from bullet_lab.simulation.plugins.samples import (
    BumperEvent,
    CliffEvent,
    ImuSample,
    JointCommand,
    JointCommands,
    LoopSample,
    MotorPower,
    PlanarCommand,
    Stop,
    SwitchesSample,
    Trigger,
    VelocitySample,
    WheelDropEvent,
)


@pytest.mark.parametrize(
    ("message", "command"),
    [
        (Float64(0.5), JointCommand(0.5)),
        (Float64MultiArray(data=[1.0, -2.0]), JointCommands((1.0, -2.0))),
        (Bool(True), Stop(True)),
        (kobuki_msg.MotorPower(0), MotorPower(False)),
        (kobuki_msg.MotorPower(1), MotorPower(True)),
        (Empty(), Trigger()),
    ],
)
def test_commands(message, command):
    message_kind, command_of = COMMANDS[type(command)]
    assert message_kind is type(message)
    assert command_of(message) == command


def test_the_state_of_a_loop():
    sample = LoopSample(1500, 1.0, 0.75, 0.1, 0.25, 0.001, -7.0, (4.0, 3.0, 2.0, 1.0), True)
    message = message_of(sample)
    fields = """
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
    """
    check(message, fields)


def test_what_is_left_of_a_command():
    message = message_of(VelocitySample(20, "", PlanarCommand(vx=0.3, wz=-0.4)))
    fields = """
        _type: geometry_msgs/TwistStamped
        twist.linear: [0.3, 0.0, 0.0]
        twist.angular: [0.0, 0.0, -0.4]
    """
    check(message, fields)


@pytest.mark.parametrize(
    "sample, fields",
    [
        (BumperEvent(20, 2, True), "{_type: kobuki_msgs/BumperEvent, bumper: 2, state: 1}"),
        (CliffEvent(20, 1, True, 7), "{_type: kobuki_msgs/CliffEvent, sensor: 1, bottom: 7}"),
        (WheelDropEvent(20, 1, False), "{_type: kobuki_msgs/WheelDropEvent, wheel: 1, state: 0}"),
        (
            SwitchesSample(20, "base_link", 4, 2, 1),
            "{_type: kobuki_msgs/SensorState, header.stamp: 0.02, header.frame_id: base_link,"
            " bumper: 4, cliff: 2, wheel_drop: 1}",
        ),
        (
            ImuSample(20, "f", (0, 0, 0, 1), (0, 0, 0), (0, 0, 0), (3.0, 2.0, 1.0), 0.5, 0.0),
            "{orientation_covariance: [3.0, 0, 0, 0, 2.0, 0, 0, 0, 1.0]}",
        ),
    ],
)
def test_what_a_kobuki_says(sample, fields):
    check(message_of(sample), fields)
