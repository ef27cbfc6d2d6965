import pytest
from arm_robots import CONFIG, NAMES, Sent, spawn_arm, trajectory
from control_robots import control_of, run
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.controllers import ControlError
from bullet_lab.simulation.plugins.samples import GripperSample
from bullet_lab.simulation.world.urdf import read_urdf

BOX = """<robot name="box"><link name="box"><inertial><mass value="0.1"/>
  <inertia ixx="3e-5" ixy="0" ixz="0" iyy="3e-5" iyz="0" izz="3e-5"/></inertial>
  <collision><geometry><box size="0.04 0.04 0.04"/></geometry></collision></link></robot>"""
FINGERS = ("left_finger_joint", "right_finger_joint")


def gripper(world, kind="effort", box=True, change=lambda urdf: urdf, **parameters):
    """Put the arm, without weight, into a world with a box between its fingers.

    Return the gripper's controller, and a function that returns the fingers' positions.
    """
    world.set_gravity((0.0, 0.0, 0.0))
    if kind == "position":
        change = lambda urdf: urdf.replace("EffortJoint", "PositionJoint")  # noqa: E731
    manager = spawn_arm(world, change=change)
    if box:
        world.add(read_urdf(BOX, "box"), "box", Pose((0.0, 0.0, 1.55)))
    given = {**CONFIG["gripper_controller"], "type": f"{kind}_controllers/GripperActionController"}
    controller = run(manager, "grip", **{**given, **parameters})
    body = next(iter(world.models["arm"].bodies.values()))
    world.run_for(0.05)
    return controller, lambda: [body.joint_state(name).position for name in FINGERS]


@cases("kind: [effort, position]")
def test_a_gripper_reaches_its_goal_or_stalls_at_a_box(world, kind):
    controller, fingers = gripper(world, kind)
    goal = Sent(controller, GripperSample(0.02, 5.0), world, 0.5)
    assert goal.states == ["accepted", "succeeded"]
    assert (goal.result.reached, goal.result.stalled) == (True, False)
    goal = Sent(controller, GripperSample(0.05, 5.0), world, 0.2)
    assert goal.states == ["accepted"]
    world.run_for(0.8)
    assert goal.states == ["accepted", "aborted"]
    assert (goal.result.reached, goal.result.stalled) == (False, True)
    assert goal.result.position == pytest.approx(0.03, abs=2e-3)
    assert goal.result.effort == pytest.approx(5.0, abs=0.5)
    assert goal.told[-1].position == pytest.approx(0.03, abs=2e-3)
    # It holds the box where it is, between both fingers.
    world.run_for(1.0)
    assert fingers() == pytest.approx([0.03, 0.03], abs=2e-3)
    y = world.models["box"].pose().position[1]
    assert y == pytest.approx(0.0, abs=2e-3)


def test_an_arm_carries_a_box_in_its_gripper(world):
    controller, fingers = gripper(world, "position")
    kind = "position_controllers/JointTrajectoryController"
    arm = run(control_of(world.models["arm"]), "arm", type=kind, joints=list(NAMES))
    Sent(controller, GripperSample(0.05, 10.0), world, 0.5)
    world.set_gravity((0.0, 0.0, -9.8))
    arm.command(trajectory((1.0, (0.5, 0.5, 0.5, 0.5, 0.0, 0.0), 0.0), (2.0, 0.0, 0.0)))
    world.run_for(1.0)
    assert world.models["box"].pose().position[2] < 1.2
    world.run_for(1.5)
    assert world.models["box"].pose().position == pytest.approx((0.0, 0.0, 1.55), abs=3e-3)
    assert fingers() == pytest.approx([0.03, 0.03], abs=2e-3)


def test_a_goal_that_is_cancelled_or_invalid(world):
    controller, fingers = gripper(world, box=False, max_effort=5.0)
    assert Sent(controller, GripperSample(float("nan"), 1.0)).states == []
    goal = Sent(controller, GripperSample(0.05, 5.0), world, 0.05)
    controller.cancel(goal.goal)
    world.run_for(0.01)
    assert goal.states == ["accepted", "canceled"]
    here = fingers()[0]
    world.run_for(0.5)
    assert fingers()[0] == pytest.approx(here, abs=0.01)
    # Without an effort, it cannot move.
    goal = Sent(controller, GripperSample(0.05, 0.0), world, 0.5)
    assert goal.states == ["accepted", "aborted"]


def test_its_joint_must_be_known(world):
    with pytest.raises(ControlError, match="no joint 'tail' has a EffortJointInterface"):
        gripper(world, joint="tail")


@cases("""
tags, expected:
  - [<multiplier>-0.5</multiplier><offset>0.03</offset>, 0.02]
  - [<sensitiveness>0.04</sensitiveness>, 0.0]
  - [<hasPID/>, 0.02]
  - [<hasPID>false</hasPID>, 0.02]
""")
def test_a_joint_mimics_another_one(world, tags, expected):
    wanted = {"p": 500.0, "d": 10.0}
    controller, fingers = gripper(
        world, box=False, change=lambda urdf: urdf.replace("<hasPID>true</hasPID>", tags)
    )
    (mimic,) = [plugin for plugin in world.models["arm"].plugins if hasattr(plugin, "gains")]
    if tags == "<hasPID/>":
        assert mimic.gains == "/arm/gazebo_ros_control/pid_gains/right_finger_joint"
        with pytest.raises(ControlError, match="right_finger_joint/p is missing"):
            mimic.configure(None)
        mimic.configure(wanted)
    else:
        assert mimic.gains == ""
    Sent(controller, GripperSample(0.02, 5.0), world, 2.0)
    assert fingers() == pytest.approx([0.02, expected], abs=1e-3)


def test_a_mimicking_motor_does_not_lag_behind(world):
    controller, fingers = gripper(world, "position", box=False)
    Sent(controller, GripperSample(0.02, 5.0))
    apart = []
    for _ in range(50):
        world.run_for(0.001)
        left, right = fingers()
        apart.append(abs(left - right))
    # A lag of one step would be 0.2 mm at 0.2 m/s.
    assert max(apart) < 1e-4
    assert left > 0.0


def test_a_mimicked_joint_that_is_missing(world, caplog):
    spawn_arm(world, change=lambda urdf: urdf.replace("<joint>left_finger", "<joint>no_finger"))
    assert "<joint>: no movable joint 'no_finger_joint'" in caplog.text
