import pytest
from control_robots import control_of, run, spawn

from bullet_lab.simulation.plugins.controllers.joints import EFFORT, POSITION, VELOCITY
from bullet_lab.simulation.plugins.samples import JointCommand, Stop


def test_the_emergency_stop_holds_joints(world):
    tags = "<robotNamespace>/bot</robotNamespace><eStopTopic>e_stop</eStopTopic>"
    _, manager = spawn(world, turntable=POSITION, tags=tags)
    kind = "position_controllers/JointPositionController"
    controller = run(manager, "turn", type=kind, joint="turntable_joint")
    controller.command(JointCommand(1.0))
    (joint,) = controller.joints
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
