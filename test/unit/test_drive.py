"""Squares are driven by the clock and by odometry, and goals are reached."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from shared import cases

from bullet_lab.core.parameters import ParameterError, declarations, read_parameters
from bullet_lab.core.se2 import wrap
from bullet_lab.drive import (
    CLOSED_LOOP,
    STANDSTILL,
    TURN_EXCESS,
    DrivePhase,
    GoalDriver,
    GoalLimits,
    SlowestTurn,
    Square,
    SquareDriver,
    open_loop_side,
)
from bullet_lab.errors import LabError
from bullet_lab.noise.systematic import SystematicErrors, SystematicPath
from bullet_lab.simulation.plugins.mobile_base import SupportPatch

BLOCK = SupportPatch(1.0, 0.0102, 4.51, 7.5125e-3)
ICE = SupportPatch(0.0, 0.0102, 4.51, 7.5125e-3)
PERIOD = 0.05


def integrate(pose, command, patch=ICE):
    """Return the pose one odometry period later; its friction slows a robot down."""
    x, y, yaw = pose
    speed, _, turn = patch.slow_down(command[0], 0.0, command[1], BLOCK.mass * 9.8, 1e-3)
    heading = yaw + 0.5 * PERIOD * turn
    return (
        x + PERIOD * speed * math.cos(heading),
        y + PERIOD * speed * math.sin(heading),
        wrap(yaw + PERIOD * turn),
    )


def drive(square, patch, start=(0.0, 0.0, 0.0), odometry=lambda pose: pose):
    """Drive a square in closed loop; return the poses at its corners and all commands."""
    driver, pose, corners, commands = SquareDriver(square, CLOSED_LOOP), start, [start], []
    while True:
        command = driver.command(odometry(pose))
        if driver.sides_done == len(corners):
            corners.append(pose)
        if command is None:
            assert driver.sides_done == square.sides
            return corners, commands
        commands.append(command)
        assert len(commands) < 20_000
        pose = integrate(pose, command, patch)


def test_an_open_loop_side_is_that_of_listing_9_by_default():
    commands = list(open_loop_side(Square()))
    assert commands == [(0.2, 0.0)] * 100 + [(0.0, -0.5236)] * 34
    # The length and speed set the number of commands.
    assert Square(side=0.01, speed=1.0).side_commands == 1


@pytest.mark.parametrize(
    ("name", "patch", "turn_speed", "start"),
    [("block", BLOCK, -0.5236, (3.0, -1.0, 3.0)), ("ice", ICE, 0.5236, (0.0, 0.0, -1.57))],
)
def test_a_closed_loop_ends_within_its_tolerances_and_as_before(name, patch, turn_speed, start):
    corners, commands = drive(Square(turn_speed=turn_speed), patch, start)
    for before, after in zip(corners, corners[1:]):
        assert math.dist(before[:2], after[:2]) == pytest.approx(2.0, abs=0.003)
        quarter = math.copysign(0.5 * math.pi, turn_speed)
        assert abs(wrap(after[2] - before[2] - quarter)) < math.radians(0.3)
    assert math.dist(corners[0][:2], corners[-1][:2]) < 0.02
    check_as_before(name, corners, commands)


def check_as_before(name, corners, commands):
    """Compare corners and commands; of those, one of a run of the same counts for all."""
    runs = [(*command, len(list(same))) for command, same in itertools.groupby(commands)]
    found = lines_of((np.array(corners), np.array(runs)), name)
    assert_as_before(found, Path(__file__).with_name("driven") / f"{name}.txt")


def test_a_turn_ends_wherever_it_starts_even_without_friction():
    # A slow turn crosses the target in steps; it must not go to and fro for ever.
    for offset in range(50):
        drive(Square(sides=1, side=0.1), ICE, (0.0, 0.0, 0.0001 * offset))


def test_a_turn_that_went_far_too_far_is_turned_back():
    driver = SquareDriver(Square(sides=1), CLOSED_LOOP)
    driver.command((0.0, 0.0, 0.0))
    ahead, turn = driver.command((2.0, 0.0, -0.5 * math.pi - math.radians(0.25)))
    assert driver.sides_done == 0
    assert ahead == 0.0
    assert turn > 0.0
    # Past its goal for the second time, it is done.
    for beyond, turns in ((-0.1, True), (0.1, False)):
        command = driver.command((2.0, 0.0, -0.5 * math.pi - beyond))
        assert (command != STANDSTILL) == turns


@cases("ticks_per_metre: [50, 300, 1000]")
def test_a_turn_ends_though_the_ticks_of_encoders_step_over_the_tolerance(ticks_per_metre):
    errors = SystematicErrors(ticks_per_metre=ticks_per_metre)
    path = SystematicPath(errors)
    corners, _ = drive(Square(), ICE, odometry=lambda pose: path.update(*pose).pose)
    # Within two ticks of both wheels, in opposite directions.
    assert_turned(corners, 4.0 / (ticks_per_metre * errors.wheel_base) + TURN_EXCESS)


def test_errors_of_the_turns_do_not_add_up():
    corners, _ = drive(Square(sides=40, side=0.1), BLOCK)
    assert_turned(corners, math.radians(0.21))


def assert_turned(corners, within):
    """Each corner's heading is a quarter turn further to the right, within an angle in rad."""
    for number, (_, _, yaw) in enumerate(corners):
        assert abs(wrap(yaw + 0.5 * math.pi * number)) < within


def test_progress_is_along_the_side():
    driver = SquareDriver(Square(side=1.6), CLOSED_LOOP)
    driver.command((1.0, 1.0, 0.5 * math.pi))
    assert driver.command((1.3, 2.5, 0.0))[0] > 0.0
    assert driver.command((1.3, 2.6, 0.0))[0] == 0.0


@cases("turn_speed: [0.0, true, .nan]")
def test_no_turn_is_refused(turn_speed):
    with pytest.raises(ParameterError):
        read_parameters(Square, {"~turn_speed": turn_speed}.get)


@pytest.mark.parametrize("kind", [Square, GoalLimits])
def test_parameters_and_their_limits_are_as_before(kind):
    said = {name: (one.doc, one.allowed) for name, one in declarations(kind).items()}
    text = Path(__file__).with_name("driven") / f"{kind.__name__}.txt"
    assert_as_before(lines_of((kind(), said), ""), text)


def test_open_loop_sends_the_commands_of_all_sides_and_counts_them():
    square = Square(sides=2, side=0.06, turn_commands=2)
    driver, sent = SquareDriver(square), []
    for command in iter(driver.command, None):
        sent.append((command, driver.sides_done))
    commands, sides_done = zip(*sent)
    assert list(commands) == 2 * list(open_loop_side(square))
    # Three commands of a side and two of its turn.
    assert sides_done == (0,) * 5 + (1,) * 5
    assert (driver.rate, driver.needs_pose, driver.sides_done) == (10.0, False, 2)
    assert driver.command() is None


def test_an_unknown_mode_is_refused():
    with pytest.raises(LabError, match="mode 'by_feel' is not one of open_loop, closed_loop"):
        SquareDriver(Square(), "by_feel")


LIMITS = GoalLimits()
ORIGIN = (0.0, 0.0, 0.0)


def drive_to(goal, start=ORIGIN, limits=LIMITS, command=STANDSTILL):
    """Drive to a goal; return the last pose and all commands."""
    driver, pose, commands = GoalDriver(goal, limits, command), start, []
    while driver.phase is not DrivePhase.ARRIVED:
        commands.append(driver.command(pose, PERIOD))
        assert len(commands) < 20_000, f"never arrives at {goal}"
        pose = integrate(pose, commands[-1])
    return pose, commands


def assert_at(pose, goal, tolerance, yaw_tolerance):
    """A pose is within tolerances (m, rad) of a goal."""
    assert math.dist(pose[:2], goal[:2]) <= tolerance
    assert abs(wrap(pose[2] - goal[2])) <= yaw_tolerance


@cases("distance, tolerances: [[0.06, [0.05, 0.03]], [2.0, [0.01, 0.01]], [2.0, [0.3, 0.3]]]")
@cases("direction: [0, 45, 90, 135, 180, 225, 270, 315]")
def test_arrives_within_the_tolerances_whatever_the_goal(direction, distance, tolerances):
    angle = math.radians(direction)
    limits = replace(LIMITS, tolerance=tolerances[0], yaw_tolerance=tolerances[1])
    for yaw in (-2.0, 3.1):
        goal = (distance * math.cos(angle), distance * math.sin(angle), yaw)
        pose, _ = drive_to(goal, (0.0, 0.0, 0.4), limits)
        assert_at(pose, goal, *tolerances)


@cases("""
name, goal, limits, command:
  - [ahead, [2.0, 0.5, 1.0], {}, [0.0, 0.0]]
  - [behind, [-1.0, -0.2, -3.0], {}, [0.0, 0.0]]
  - [nearly beside, [0.246, 0.435, 0.5], {tolerance: 0.02, yaw_tolerance: 0.01}, [0.0, 0.0]]
  - [slowly, [0.4, -0.1, 0.3], {acceleration: 0.02, turn_acceleration: 0.1, gain: 3.0}, [0.0, 0.0]]
  - [the heading is left alone, [1.0, 0.0, 3.0], {heading: false}, [0.0, 0.0]]
  # Another goal on the way.
  - [already moving, [-5.0, 0.0, 0.0], {speed: 0.3, turn_gain: 1.5}, [0.2, 0.1]]
""")
def test_goals_are_driven_to_as_before(name, goal, limits, command):
    pose, commands = drive_to(goal, limits=replace(LIMITS, **limits), command=command)
    check_as_before(name.replace(" ", "_"), [pose], commands)


def test_drives_on_where_a_turn_has_moved_it_off_the_goal():
    driver = GoalDriver((1.0, 0.0, 1.5))
    assert driver.command((0.98, 0.0, 0.0), PERIOD)[1] > 0.0
    assert driver.phase is DrivePhase.TURNING
    for x, phase in ((0.96, DrivePhase.TURNING), (0.90, DrivePhase.DRIVING)):
        driver.command((x, 0.0, 0.3), PERIOD)
        assert driver.phase is phase


@cases("goal: [[.nan, 0.0, 0.0], [0.0, 0.0, .inf]]")
def test_goals_that_are_none(goal):
    with pytest.raises(LabError, match="not finite"):
        GoalDriver(goal)


def test_a_robot_that_friction_holds_is_turned_faster():
    slowest = SlowestTurn()
    held = [slowest.now(0.05) for _ in range(7)]
    assert held == pytest.approx([0.1] * 5 + [0.11, 0.121])
    assert [slowest.now(left) for left in (0.04, 0.0394)] == [slowest.speed] * 2


def test_keeps_within_the_limits_of_speed_and_acceleration():
    for goal in ((2.0, 0.5, 1.0), (-1.0, -0.2, -3.0)):
        _, commands = drive_to(goal)
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
    pose, _ = drive_to((1.0, 0.0, 3.0), limits=replace(LIMITS, heading=False))
    assert_at(pose, (1.0, 0.0, 0.0), LIMITS.tolerance, 0.1)


def test_turns_on_the_spot_from_60_degrees_on_until_6_are_left():
    driver = GoalDriver((1.0, 0.0, 0.0), GoalLimits(acceleration=0.01, turn_acceleration=0.1))
    for degrees, ahead in ((59.5, 1), (60.5, 0), (6.5, 0), (5.5, 1), (6.5, 1), (59.5, 1)):
        off = math.radians(degrees)
        # So that it can brake.
        turn = min(0.8, 2.0 * off) if ahead else min(math.sqrt(0.2 * off), 2.0 * off)
        command = driver.command((0.0, 0.0, -off), 100.0)
        assert command == pytest.approx((math.sqrt(0.02) * ahead * math.cos(off), turn))


def test_another_goal_on_the_way_starts_from_the_present_speed():
    driver = GoalDriver((-5.0, 0.0, 0.0), command=(0.2, 0.0))
    v, _ = driver.command(ORIGIN, PERIOD)
    assert v == pytest.approx(0.2 - LIMITS.acceleration * PERIOD)
    driver.moving = STANDSTILL
    assert driver.command(ORIGIN, PERIOD)[0] == 0.0
