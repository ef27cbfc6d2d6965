"""What controllers say and are told, as messages."""

import pytest

pytest.importorskip("rospy")

from std_msgs.msg import Bool, Float64, Float64MultiArray

from bullet_lab.ros.messages.conversions import COMMANDS, Converter
from bullet_lab.simulation.plugins.samples import (
    JointCommand,
    JointCommands,
    LoopSample,
    PlanarCommand,
    Stop,
    VelocitySample,
)


@pytest.mark.parametrize(
    ("message", "command"),
    [
        (Float64(0.5), JointCommand(0.5)),
        (Float64MultiArray(data=[1.0, -2.0]), JointCommands((1.0, -2.0))),
        (Bool(True), Stop(True)),
    ],
)
def test_commands(message, command):
    message_kind, command_of = COMMANDS[type(command)]
    assert message_kind is type(message)
    assert command_of(message) == command


def test_the_state_of_a_loop():
    gains = (4.0, 3.0, 2.0, 1.0)
    sample = LoopSample(1500, 1.0, 0.75, 0.1, 0.25, 0.001, -7.0, gains, True)
    message = Converter(LoopSample).convert(sample)
    assert message._type == "control_msgs/JointControllerState"
    assert message.header.stamp.to_sec() == 1.5
    assert (message.set_point, message.process_value, message.error) == (1.0, 0.75, 0.25)
    assert (message.process_value_dot, message.time_step, message.command) == (0.1, 0.001, -7.0)
    assert (message.p, message.i, message.d, message.i_clamp) == gains
    assert message.antiwindup


def test_what_is_left_of_a_command():
    sample = VelocitySample(20, "", PlanarCommand(vx=0.3, wz=-0.4))
    message = Converter(VelocitySample).convert(sample)
    assert message._type == "geometry_msgs/TwistStamped"
    assert (message.twist.linear.x, message.twist.angular.z) == (0.3, -0.4)
