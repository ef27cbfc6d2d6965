import numpy as np
import pytest
from arm_robots import NAMES, Sent, arm_controller, positions, spawn_arm, trajectory
from control_robots import listen, run
from shared import cases

from bullet_lab.simulation.plugins.controllers import ControlError
from bullet_lab.simulation.plugins.controllers.trajectories import (
    OFF_GOAL,
    Segment,
    spline,
)
from bullet_lab.simulation.plugins.samples import TrajectoryGoal

GOAL = np.array([1.0, -0.6, 0.9, 0.4, -0.5, 2.0])
NAN = float("nan")
DEFAULT = {"path": {}, "goal": {}, "seconds": 0.0}


def arc(part):
    """Positions and velocities at a part of an arc of 2 s that begins and ends slowly."""
    return tuple(GOAL * (3.0 * part**2 - 2.0 * part**3)), tuple(GOAL * 3.0 * part * (1 - part))


@cases("""
one, two, middle:
  - [[1.0, null, null], [3.0, null, null], [2.0, 1.0, 0.0]]
  - [[1.0, 0.0, 0.0], [3.0, null, null], [2.0, 1.0, 0.0]]
  - [[1.0, 0.0, 5.0], [3.0, 0.0, null], [2.0, 1.5, 0.0]]
  - [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.875, 0.0]]
  # Of t + t² + 0.5 t³ + 0.1 t⁴ - 0.03 t⁵.
  - [[0.0, 1.0, 2.0], [10.64, 11.8, 8.0], [2.57, 4.75, 5.6]]
""")
def test_a_spline_is_as_smooth_as_its_ends_are_known(one, two, middle):
    segment = Segment(4.0, 6.0, spline(one, two, 2.0), 0.0)
    assert segment.at(5.0) == pytest.approx(middle)
    assert segment.at(3.0) == pytest.approx((one[0], 0.0, 0.0))
    assert segment.at(7.0) == pytest.approx((two[0], 0.0, 0.0))


@cases("kind: [position, velocity, effort]")
def test_an_arm_follows_ten_points(world, kind):
    controller = arm_controller(world, kind)
    states = listen(controller.states)
    world.run_for(0.5)
    points = ((2.0 * part, *arc(part)) for part in np.linspace(0.1, 1.0, 10))
    goal = Sent(controller, trajectory(*points), world, 2.2)
    assert goal.states == ["accepted", "succeeded"]
    assert goal.result == (0, "")
    assert positions(controller) == pytest.approx(GOAL, abs=0.02)
    # 20 Hz and 25 Hz.
    assert len(goal.told) == pytest.approx(40, abs=1)
    assert len(states) == pytest.approx(67, abs=1)
    most = max(abs(error) for one in goal.told for error in one.error.positions)
    assert most < (0.1 if kind == "effort" else 2e-3)
    there, _ = arc(0.5 * goal.told[20].desired.seconds)
    assert goal.told[20].desired.positions == pytest.approx(there, abs=1e-3)
    assert goal.told[20].actual.positions == pytest.approx(there, abs=0.1)
    world.run_for(0.5)
    assert positions(controller) == pytest.approx(GOAL, abs=0.02)


JOINTS = {"all": NAMES, "five": NAMES[:5], "none": (), "tail": ("tail",), "twice": NAMES[:5] * 2}


@cases("""
points, joints, since, code, text:
  # Points, of which joints, from when on, the code and what is said.
  - [[[1.0, 0.5]], five, 0, -2, needed are shoulder_pan_joint]
  - [[], none, 0, -2, it names no joints]
  - [[[1.0, 0.5]], tail, 0, -2, it names tail]
  - [[[1.0, 0.5]], twice, 0, -2, needed are]
  - [[[1.0, [0.5]]], all, 0, -1, point 1 of 1 has 1/0/0 positions]
  - [[[1.0, []]], all, 0, -1, 0/0/0 positions/velocities/accelerations for 6]
  - [[[1.0, 0.5, .nan]], all, 0, -1, point 1 of 1 is not finite]
  - [[[1.0, 0.5], [1.0, 0.6]], all, 0, -1, 'point 2 of 2: 1 s comes after 1 s']
  - [[[0.0, 0.5]], all, 0, -1, 'all points are past: the last stamp']
  - [[[0.1, 0.5]], all, 1.0e-9, -3, was 0.410 s ago]
""")
def test_invalid_goals_are_rejected(world, points, joints, since, code, text):
    controller = arm_controller(world)
    world.run_for(0.5)
    content = trajectory(*points, joints=JOINTS[joints], start=since)
    goal = Sent(controller, content, world, 0.01)
    assert goal.states == ["rejected"]
    assert goal.result[0] == code
    assert text in goal.result[1] == goal.text
    assert positions(controller) == pytest.approx([0.0] * 6, abs=1e-3)


@cases("""
point, tolerances, code, text:
  # 3 rad/s are allowed.
  - [[0.3, 1.8], {}, -4, '''shoulder_pan_joint'': path error in position is 0.1']
  - [[0.3, 1.8], {path: {shoulder_lift_joint: [0.5, 0.9]}}, -4, velocity is 6; allowed are 0.9]
  # The limits are 3.1 rad.
  - [[2.0, 3.3, 0.0], {}, -4, path error in position is 0.1]
  - [[2.0, [3.3, 0, 0, 0, 0, 0], 0.0], {path: {shoulder_pan_joint: [-1, 0]}, seconds: 0.2}, -5,
     '''shoulder_pan_joint'': goal error in position is 0.2; allowed are 0.02']
""")
def test_a_violated_tolerance_is_named(world, point, tolerances, code, text):
    controller = arm_controller(world)
    content = TrajectoryGoal(trajectory(point), **{**DEFAULT, **tolerances})
    goal = Sent(controller, content, world, 2.15)
    assert (goal.states == ["accepted"]) == (code == OFF_GOAL)
    world.run_for(0.1)
    assert goal.states == ["accepted", "aborted"]
    assert goal.result[0] == code
    assert text in goal.result[1]


def test_a_new_goal_and_a_topic_preempt(world):
    controller = arm_controller(world)
    first = Sent(controller, trajectory((1.0, 0.5)), world, 0.5)
    second = Sent(controller, trajectory((1.0, -0.5)), world, 0.01)
    assert (first.states, second.states) == (["accepted", "canceled"], ["accepted"])
    controller.command(trajectory((0.5, 0.2)))
    world.run_for(0.7)
    assert second.states == ["accepted", "canceled"]
    assert positions(controller) == pytest.approx([0.2] * 6, abs=1e-3)


@cases("seconds: [0.0, 0.2]")
def test_a_cancelled_goal_stops_the_arm(world, seconds):
    controller = arm_controller(world, stop_trajectory_duration=seconds)
    goal = Sent(controller, trajectory((1.0, 1.0)), world, 0.5)
    controller.cancel(Sent(controller, trajectory((1.0, NAN))).goal)
    controller.cancel(goal.goal)
    world.run_for(0.5)
    assert goal.states == ["accepted", "canceled"]
    # From 1 rad/s at 0.5 rad.
    assert positions(controller) == pytest.approx([0.5 + 0.6 * seconds] * 6, abs=0.02)
    assert [joint.velocity for joint in controller.joints] == pytest.approx([0.0] * 6, abs=1e-3)


def test_an_empty_trajectory_holds_the_joints(world):
    controller = arm_controller(world)
    controller.command(trajectory((1.0, 1.0)))
    world.run_for(0.5)
    controller.command(trajectory()._replace(joints=()))
    world.run_for(0.5)
    assert max(positions(controller)) < 0.7
    goal = Sent(controller, trajectory(), world, 0.3)
    assert goal.states == ["accepted", "succeeded"]


def test_some_joints_alone_if_that_is_allowed(world):
    controller = arm_controller(world, allow_partial_joints_goal=True)
    controller.command(trajectory((1.0, 1.0)))
    world.run_for(0.2)
    goal = Sent(controller, trajectory((0.3, (-0.2, 0.3)), joints=(NAMES[2], NAMES[0])), world, 0.4)
    # The others are under way.
    assert goal.states == ["accepted"]
    world.run_for(0.5)
    assert goal.states == ["accepted", "succeeded"]
    assert positions(controller) == pytest.approx([0.3, 1.0, -0.2, 1.0, 1.0, 1.0], abs=2e-3)


def test_a_later_start_keeps_the_trajectory_until_then(world):
    controller = arm_controller(world)
    controller.command(trajectory((1.0, 1.0)))
    world.run_for(0.19)
    later = trajectory((0.1, 0.2), (0.4, 0.0), start=0.5)
    tolerances = {**DEFAULT, "path": {NAMES[0]: (1e-6, 0.0)}}
    goal = Sent(controller, TrajectoryGoal(later, **tolerances), world, 0.1)
    assert positions(controller) == pytest.approx([0.29] * 6, abs=0.01)
    world.run_for(0.2)
    assert positions(controller) == pytest.approx([0.49] * 6, abs=0.01)
    # Its tolerance holds from its start on.
    assert goal.states == ["accepted"]
    world.run_for(0.105)
    # It still goes on.
    assert goal.states == ["accepted", "aborted"]
    assert positions(controller) == pytest.approx([0.2] * 6, abs=0.02)
    # All points but the last are past.
    controller.command(trajectory((0.2, 9.0), (0.3, 9.0), (0.5, 0.4), start=0.25))
    world.run_for(0.2)
    assert positions(controller) == pytest.approx([0.4] * 6, abs=0.01)


def test_a_continuous_joint_takes_the_short_way(world):
    controller = arm_controller(world)
    joint = controller.joints[5]
    for target, reached in ((3.0, 3.0), (-3.0, 2 * np.pi - 3.0), (3.0, 3.0)):
        goal = Sent(controller, trajectory((1.5, (0.0,) * 5 + (target,))), world, 1.6)
        assert goal.states[-1] == "succeeded"
        assert joint.position == pytest.approx(reached, abs=2e-3)


def test_a_query_of_the_trajectory(world):
    controller = arm_controller(world)
    controller.command(trajectory((1.0, 1.0), (2.0, 2.0)))
    world.run_for(0.1)
    names, point = controller.query(1.51)
    assert names == NAMES
    assert point.positions == pytest.approx((1.5,) * 6, abs=2e-3)
    assert point.velocities == pytest.approx((1.0,) * 6, abs=2e-3)
    with pytest.raises(ControlError, match=r"no trajectory at 0\.000 s"):
        controller.query(0.0)


def test_a_controller_that_is_stopped_ends_its_goal(world):
    manager, kind = spawn_arm(world), "position_controllers/JointTrajectoryController"
    controller = run(manager, "a", type=kind, joints=list(NAMES))
    active = Sent(controller, trajectory((1.0, 1.0)), world, 0.1)
    waiting = Sent(controller, trajectory((1.0, 0.5)))
    manager.switch([], ["a"])
    assert (active.states, waiting.states) == (["accepted", "canceled"], ["rejected"])
    assert Sent(controller, trajectory((1.0, 0.5))).text == "controller 'a' is not running"
    with pytest.raises(ControlError, match="not running"):
        controller.command(trajectory((1.0, 0.5)))
    manager.switch(["a"], [])
    active = Sent(controller, trajectory((1.0, 1.0)), world, 0.5)
    world.reset_simulation()
    states = listen(controller.states)
    assert active.states == ["accepted", "canceled"]
    world.run_for(0.5)
    assert positions(controller) == pytest.approx([0.0] * 6, abs=1e-3)
    assert len(states) == pytest.approx(25, abs=1)


def test_gains_are_required_for_efforts(world):
    with pytest.raises(ControlError, match="arm_controller/gains/shoulder_pan_joint/p is missing"):
        arm_controller(world, "effort", gains={})
