import math
from dataclasses import replace

import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import wrap
from bullet_lab.drive.goal import STANDSTILL, DrivePhase, GoalDriver, GoalDriverError, GoalLimits
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

PERIOD = 0.05
LIMITS = GoalLimits()


def integrate(pose, command):
    """Return the pose of a frictionless robot one period later."""
    x, y, yaw = pose
    v, w = command
    return (
        x + PERIOD * v * math.cos(yaw + 0.5 * PERIOD * w),
        y + PERIOD * v * math.sin(yaw + 0.5 * PERIOD * w),
        wrap(yaw + PERIOD * w),
    )


def drive(goal, start=(0.0, 0.0, 0.0), limits=LIMITS, blur=lambda pose: pose):
    """Drive to a goal; return the last pose and all commands."""
    driver, pose, commands = GoalDriver(goal, limits), start, []
    while driver.phase is not DrivePhase.ARRIVED:
        commands.append(driver.command(blur(pose), PERIOD))
        assert len(commands) < 20_000, f"never arrives at {goal}"
        pose = integrate(pose, commands[-1])
    return pose, commands


def goals():
    for direction in range(0, 360, 45):
        angle = math.radians(direction)
        for distance in (0.06, 0.3, 2.0):
            for yaw in (-2.0, 0.0, 3.1):
                yield distance * math.cos(angle), distance * math.sin(angle), yaw


@pytest.mark.parametrize("goal", list(goals()))
def test_arrives_within_the_tolerances_whatever_the_goal(goal):
    pose, _ = drive(goal, start=(0.0, 0.0, 0.4))
    assert math.dist(pose[:2], goal[:2]) <= LIMITS.tolerance
    assert abs(wrap(pose[2] - goal[2])) <= LIMITS.yaw_tolerance


@pytest.mark.parametrize("tolerance", [0.01, 0.05, 0.3])
def test_arrives_within_other_tolerances(tolerance):
    limits = replace(LIMITS, tolerance=tolerance, yaw_tolerance=tolerance)
    pose, _ = drive((1.0, -0.7, 1.0), limits=limits)
    assert math.dist(pose[:2], (1.0, -0.7)) <= tolerance
    assert abs(wrap(pose[2] - 1.0)) <= tolerance


def test_keeps_within_the_limits_of_speed_and_acceleration():
    for goal in ((2.0, 0.5, 1.0), (-1.0, -0.2, -3.0)):
        _, commands = drive(goal)
        assert max(v for v, _ in commands) == pytest.approx(0.2, abs=1e-3)
        assert min(v for v, _ in commands) >= -1e-9
        assert max(abs(w) for _, w in commands) <= LIMITS.turn_speed
        before = STANDSTILL
        for v, w in commands[:-1]:
            assert abs(v - before[0]) <= LIMITS.acceleration * PERIOD + 1e-9
            assert abs(w - before[1]) <= LIMITS.turn_acceleration * PERIOD + 1e-9
            before = (v, w)
        assert commands[-1] == STANDSTILL
        # The last command but one is a crawl.
        assert abs(before[0]) < 0.05
        assert abs(before[1]) < 0.15


def test_the_heading_is_left_alone_where_nobody_wants_it():
    pose, _ = drive((1.0, 0.0, 3.0), limits=replace(LIMITS, heading=False))
    assert abs(pose[2]) < 0.1
    assert math.dist(pose[:2], (1.0, 0.0)) <= LIMITS.tolerance


def test_noisy_poses_do_not_keep_it_from_arriving():
    flip = [0.004]

    def blur(pose):
        flip[0] = -flip[0]
        return (pose[0] + flip[0], pose[1] - flip[0], pose[2] + 2.0 * flip[0])

    pose, _ = drive((1.0, 1.0, 0.0), blur=blur)
    assert math.dist(pose[:2], (1.0, 1.0)) <= LIMITS.tolerance + 0.006


def test_drives_on_where_a_turn_has_moved_it_off_the_goal():
    driver = GoalDriver((1.0, 0.0, 1.5))
    assert driver.command((0.98, 0.0, 0.0), PERIOD)[1] > 0.0
    assert driver.phase is DrivePhase.TURNING
    driver.command((0.96, 0.0, 0.3), PERIOD)
    assert driver.phase is DrivePhase.TURNING
    driver.command((0.90, 0.0, 0.3), PERIOD)
    assert driver.phase is DrivePhase.DRIVING


def test_another_goal_on_the_way_starts_from_the_present_speed():
    driver = GoalDriver((-5.0, 0.0, 0.0), command=(0.2, 0.0))
    v, w = driver.command((0.0, 0.0, 0.0), PERIOD)
    assert v == pytest.approx(0.2 - LIMITS.acceleration * PERIOD)
    driver.stopped()
    assert driver.command((0.0, 0.0, 0.0), PERIOD)[0] == 0.0


def test_what_is_left():
    driver = GoalDriver((3.0, 4.0, 3.0))
    assert driver.distance((0.0, 0.0, 0.0)) == 5.0
    assert driver.turn_left((0.0, 0.0, -3.0)) == pytest.approx(6.0 - math.tau)


@pytest.mark.parametrize("goal", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0, 0, math.nan)])
def test_goals_that_are_none(goal):
    with pytest.raises(GoalDriverError, match="not finite"):
        GoalDriver(goal)


@pytest.mark.parametrize("robot", ["block_robot", "camera_robot"])
@pytest.mark.parametrize("goal", [(0.6, 0.4, -1.0), (-0.3, 0.0, 0.0)])
def test_both_robots_of_the_course_stop_at_the_goal(robot, goal):
    with Simulation.of("package://bullet_lab/worlds/empty.world") as simulation:
        instance = simulation.spawn(f"package://bullet_lab/urdf/{robot}.urdf")
        simulation.run_for(0.2)
        driver = GoalDriver(goal)
        for _ in range(1000):
            pose = planar(instance.pose())
            v, w = driver.command(pose, PERIOD)
            instance.command("cmd_vel", PlanarCommand(vx=v, wz=w))
            if driver.phase is DrivePhase.ARRIVED:
                break
            simulation.run_for(PERIOD)
        assert driver.phase is DrivePhase.ARRIVED
        simulation.run_for(0.5)
        x, y, yaw = planar(instance.pose())
    assert math.dist((x, y), goal[:2]) <= LIMITS.tolerance
    # Coasting wheels turn on by a little.
    assert abs(wrap(yaw - goal[2])) <= LIMITS.yaw_tolerance + 0.03


def planar(pose: Pose):
    return (*pose.position[:2], pose.yaw)
