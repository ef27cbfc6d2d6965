import math

import pytest
from control_robots import TRANSMISSION, robot_urdf
from shared import cases

from bullet_lab.simulation.plugins.controllers import ControlParameters
from bullet_lab.simulation.plugins.controllers.joints import (
    EFFORT,
    VELOCITY,
    DescribedJoint,
    JointLimits,
    described_joints,
)

JOINT = '<joint name="arm"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>'
TYPE = "<type>transmission_interface/SimpleTransmission</type>"
MOTOR = '<actuator name="motor"/>'


def interfaces(urdf):
    return {name: joint.interface for name, joint in described_joints(urdf, "bot").items()}


@cases("""
prefix:
  - ""
  - hardware_interface/
""")
def test_interfaces_are_read_with_and_without_their_prefix(prefix):
    assert interfaces(robot_urdf(prefix + VELOCITY, prefix + EFFORT)) == {
        "left_wheel_joint": VELOCITY,
        "right_wheel_joint": VELOCITY,
        "turntable_joint": EFFORT,
    }


@cases("""
content, complaint:
  # In it, {0} is a type, {1} a joint with an interface and {2} an actuator.
  - ['{1}{2}', no <type>]
  - ['{0}{2}', no joints]
  - ['{0}{1}{1}{2}', 2 joints]
  - ['{0}<joint name="arm"/>{2}', no <hardwareInterface>]
  - ['{0}<joint name="arm"><hardwareInterface>MagicInterface</hardwareInterface></joint>{2}',
     "'MagicInterface'"]
  - ['{0}{1}', no <actuator>]
""")
def test_a_transmission_without_sense_is_named_and_the_rest_stays(caplog, content, complaint):
    good = TRANSMISSION.format(joint="wheel", interface=VELOCITY)
    content = content.format(TYPE, JOINT, MOTOR)
    odd = f'<transmission name="odd">{content}</transmission>'
    assert interfaces(f'<robot name="bot">{odd}{good}</robot>') == {"wheel": VELOCITY}
    assert len(caplog.messages) == 1
    assert "'odd'" in caplog.text
    assert complaint in caplog.text


def test_joints_have_limits_places_and_wheels():
    joints = described_joints(robot_urdf(), "bot")
    assert joints["turntable_joint"].limits == JointLimits(-2.0, 2.0, 4.0, math.inf, 3.0)
    wheel = joints["left_wheel_joint"]
    assert (wheel.radius, wheel.origin) == (0.06, (0.0, 0.15, 0.06))
    # Zero by default in URDF, and of no meaning where a joint turns for ever.
    assert (wheel.limits.lower, wheel.limits.upper) == (-math.inf, math.inf)


def test_parameters_change_limits():
    told = {
        "has_velocity_limits": True,
        "max_velocity": 0.5,
        "has_acceleration_limits": True,
        "max_acceleration": 3,
        "has_position_limits": False,
        "has_effort_limits": True,
    }
    limits = JointLimits(-1.0, 1.0, 2.0, math.inf, 7.0).changed_by(ControlParameters(told, ""))
    # Without a number for the effort, the URDF's stays.
    assert limits == JointLimits(-math.inf, math.inf, 0.5, 3.0, 7.0)


@cases("""
kind, position, target, way:
  - [continuous, 3.0, -3.0, 0.2831853]
  - [continuous, 40.0, 40.5, 0.5]
  # Over the end of the limits there is no way, short as it is.
  - [revolute, 2.0, -2.0, -4.0]
  - [prismatic, 2.0, -2.0, -4.0]
""")
def test_the_way_to_a_target(kind, position, target, way):
    joint = DescribedJoint("arm", kind, limits=JointLimits(-2.5, 2.5))
    assert joint.error(position, target) == pytest.approx(way)
