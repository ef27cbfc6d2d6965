import pytest
from control_robots import control_of, run, spawn

from bullet_lab.simulation.plugins.controllers.joints import EFFORT, POSITION, VELOCITY
from bullet_lab.simulation.plugins.samples import JointCommand, Stop

GAINS = {POSITION: {"p": 0.02, "d": 0.005}, VELOCITY: {"p": 0.02}}
FREE = {"limit": '<limit effort="100" velocity="1000"/>', "kind": "continuous"}
KINDS = {
    POSITION: "position_controllers/JointPositionController",
    VELOCITY: "velocity_controllers/JointVelocityController",
    EFFORT: "effort_controllers/JointEffortController",
}


def turntable(world, interface, command, parameters=None, **robot):
    """A turntable that is told something; return its joint and its controller."""
    _, manager = spawn(world, parameters, turntable=interface, **robot)
    controller = run(manager, "turn", type=KINDS[interface], joint="turntable_joint")
    world.run_for(0.01)
    controller.command(JointCommand(command))
    return manager.joints["turntable_joint"], controller


def test_an_effort_is_limited_and_ends_at_the_greatest_speed(world):
    limit = '<limit effort="0.003" velocity="2"/>'
    joint, controller = turntable(world, EFFORT, 99.0, kind="continuous", limit=limit)
    world.run_for(0.1)
    assert joint.effort == 0.003
    world.run_for(0.9)
    assert joint.velocity == pytest.approx(2.0, abs=0.02)
    assert joint.effort == 0.0
    controller.command(JointCommand(-99.0))
    world.run_for(0.01)
    assert joint.effort == -0.003
    world.run_for(0.6)
    assert joint.velocity == pytest.approx(-2.0, abs=0.02)


def test_a_position_is_reached_at_the_greatest_speed_and_not_passed(world):
    joint, controller = turntable(world, POSITION, 1.0)
    world.run_for(0.1)
    assert joint.velocity == pytest.approx(4.0, rel=1e-3)
    world.run_for(0.2)
    assert joint.position == pytest.approx(1.0, abs=1e-4)
    controller.command(JointCommand(9.0))
    world.run_for(1.0)
    assert joint.position == pytest.approx(2.0, abs=1e-4)


def test_an_acceleration_is_limited_by_parameters(world):
    limits = {"has_acceleration_limits": True, "max_acceleration": 2.0}
    parameters = {"joint_limits": {"turntable_joint": limits}}
    joint, _ = turntable(world, VELOCITY, 1.5, parameters)
    world.run_for(0.5)
    assert joint.velocity == pytest.approx(1.0, abs=0.01)
    world.run_for(0.5)
    assert joint.velocity == pytest.approx(1.5, rel=1e-3)


def test_a_safety_controller_slows_down_before_the_end(world):
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="1" k_position="5"'
    limit = f'<limit lower="-2" upper="2" effort="3" velocity="4"/>{soft} k_velocity="1"/>'
    joint, _ = turntable(world, POSITION, 1.8, limit=limit)
    world.run_for(0.5)
    assert 0.8 < joint.position < 1.0
    world.run_for(2.0)
    assert joint.position == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("interface", "what"), [(POSITION, "position"), (VELOCITY, "velocity")])
def test_gains_make_a_joint_driven_by_effort(world, interface, what):
    gains = {"pid_gains": {"turntable_joint": GAINS[interface]}}
    joint, _ = turntable(world, interface, 1.0, {"gazebo_ros_control": gains}, **FREE)
    world.run_for(0.004)
    # Otherwise it is there by now.
    assert getattr(joint, what) < 0.5
    assert joint.effort != 0.0
    world.run_for(3.0)
    assert getattr(joint, what) == pytest.approx(1.0, abs=0.02)


def test_the_emergency_stop_holds_joints(world):
    tags = "<robotNamespace>/bot</robotNamespace><eStopTopic>e_stop</eStopTopic>"
    joint, controller = turntable(world, POSITION, 1.0, tags=tags)
    world.run_for(0.1)
    plugin = control_of(world.models["bot"])
    (entry,) = plugin.inputs
    assert entry.topic == "/bot/e_stop"
    entry.handle(Stop(True))
    world.run_for(0.01)
    held = joint.position
    assert held < 0.5
    controller.command(JointCommand(1.2))
    world.run_for(0.2)
    assert joint.position == pytest.approx(held, abs=1e-3)
    # As in Gazebo, its controllers are started anew.
    entry.handle(Stop(False))
    world.run_for(0.1)
    assert joint.position == pytest.approx(held, abs=0.01)


def test_a_transmission_on_no_joint_of_the_model_is_named_and_left_out(world, caplog):
    robot, _ = spawn(world)
    urdf = """<robot name="bot"><joint name="tail" type="continuous"/><transmission name="t">
      <type>transmission_interface/SimpleTransmission</type><actuator name="m"/>
      <joint name="tail"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
      </transmission></robot>"""
    assert control_of(robot).configure(urdf, {}).joints == {}
    assert "'tail' is no movable joint" in caplog.text


DRIVE = (
    "<robotNamespace>/bot</robotNamespace></plugin>"
    '<plugin name="{name}" filename="libgazebo_ros_diff_drive.so">'
    "<leftJoint>left_wheel_joint</leftJoint><rightJoint>right_wheel_joint</rightJoint>"
)
BOTH = "both drive left_wheel_joint, right_wheel_joint: each undoes what the other does"


@pytest.mark.parametrize(
    ("tags", "interface", "said"),
    [
        (DRIVE.format(name="wheels"), VELOCITY, [f"plugin 'wheels' and plugin 'control' {BOTH}"]),
        (DRIVE.format(name="wheels"), EFFORT, []),
        (
            DRIVE.format(name="a") + "</plugin>" + DRIVE.format(name="b").partition("</plugin>")[2],
            EFFORT,
            [f"plugin 'a' and plugin 'b' {BOTH}"],
        ),
    ],
)
def test_two_plugins_that_drive_the_same_joints_are_named(world, caplog, tags, interface, said):
    spawn(world, tags=tags, interface=interface)
    lines = [line.partition(": ")[2] for line in caplog.messages if "both drive" in line]
    assert lines == said
