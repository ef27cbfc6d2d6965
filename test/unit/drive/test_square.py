import math

import pytest

from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.core.se2 import wrap
from bullet_lab.drive.square import (
    ClosedLoopSide,
    DriverError,
    Square,
    SquareDriver,
    approach,
    open_loop_side,
)
from bullet_lab.simulation.plugins.planar_move import PUBLISHED_RADIUS, SupportPatch

BLOCK = SupportPatch(1.0, PUBLISHED_RADIUS, 4.51, 7.5125e-3)
ICE = SupportPatch(0.0, PUBLISHED_RADIUS, 4.51, 7.5125e-3)
PERIOD = 0.05


def integrate(pose, command, patch):
    """Return the pose one odometry period later."""
    x, y, yaw = pose
    speed, _, turn = patch.slow_down(command[0], 0.0, command[1], BLOCK.mass * 9.8, 1e-3)
    return (
        x + PERIOD * speed * math.cos(yaw),
        y + PERIOD * speed * math.sin(yaw),
        wrap(yaw + PERIOD * turn),
    )


def drive(square, patch, start=(0.0, 0.0, 0.0)):
    """Drive a square in closed loop; return the poses at its corners and all commands."""
    pose, heading, corners, commands = start, start[2], [start], []
    for _ in range(square.sides):
        side = ClosedLoopSide(square, pose, heading)
        while True:
            command = side.command(pose)
            commands.append(command)
            if side.done:
                break
            assert len(commands) < 20_000
            pose = integrate(pose, command, patch)
        corners.append(pose)
        heading = side.next_heading
    return corners, commands


def test_an_open_loop_side_is_that_of_listing_9():
    commands = list(open_loop_side(Square()))
    assert commands == [(0.2, 0.0)] * 100 + [(0.0, -0.5236)] * 34


def test_the_length_and_speed_set_the_number_of_commands():
    assert Square(side=1.0).side_commands == 50
    assert Square(speed=0.4).side_commands == 50
    assert Square(side=0.01, speed=1.0).side_commands == 1
    other = Square(side=0.1, turn_speed=0.3, turn_commands=2)
    assert list(open_loop_side(other)) == [(0.2, 0.0)] * 5 + [(0.0, 0.3)] * 2


@pytest.mark.parametrize("patch", [BLOCK, ICE])
@pytest.mark.parametrize("turn_speed", [-0.5236, 0.5236])
@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (3.0, -1.0, 3.0), (0.0, 0.0, -1.57)])
def test_a_closed_loop_ends_within_its_tolerances(patch, turn_speed, start):
    corners, commands = drive(Square(turn_speed=turn_speed), patch, start)
    for before, after in zip(corners, corners[1:]):
        assert math.dist(before[:2], after[:2]) == pytest.approx(2.0, abs=0.003)
        quarter = math.copysign(0.5 * math.pi, turn_speed)
        assert abs(wrap(after[2] - before[2] - quarter)) < math.radians(0.3)
    assert math.dist(corners[0][:2], corners[-1][:2]) < 0.02
    # Each side ends at rest.
    assert commands[-1] == (0.0, 0.0)
    assert all(0.0 <= ahead <= 0.2 for ahead, _ in commands)
    assert all(abs(turn) <= 0.5236 for _, turn in commands)


def test_a_turn_ends_wherever_it_starts_even_without_friction():
    # A slow turn crosses the target in steps; it must not go to and fro for ever.
    for offset in range(50):
        drive(Square(sides=1, side=0.1), ICE, (0.0, 0.0, 0.0001 * offset))


def test_errors_of_the_turns_do_not_add_up():
    corners, _ = drive(Square(sides=40, side=0.1), BLOCK)
    for number, corner in enumerate(corners):
        assert abs(wrap(corner[2] + number * 0.5 * math.pi)) < math.radians(0.21)


def test_a_turn_that_went_far_too_far_is_turned_back():
    side = ClosedLoopSide(Square(), (0.0, 0.0, 0.0), 0.0)
    beyond = (2.0, 0.0, -0.5 * math.pi - 0.1)
    ahead, turn = side.command(beyond)
    assert not side.done
    assert ahead == 0.0
    assert turn > 0.0


def test_progress_is_along_the_side():
    side = ClosedLoopSide(Square(), (1.0, 1.0, 0.0), 0.5 * math.pi)
    assert side.progress((1.3, 2.5, 0.0)) == pytest.approx(1.5)


def test_approach():
    assert approach(1.0, 0.2, 0.02) == 0.2
    assert approach(0.05, 0.2, 0.02) == pytest.approx(0.1)
    assert approach(0.001, 0.2, 0.02) == 0.02
    assert approach(0.001, 0.01, 0.02) == 0.01


@pytest.mark.parametrize(
    "values",
    [
        {"sides": 0},
        {"side": 0.0},
        {"side": math.nan},
        {"side": math.inf},
        {"speed": -0.2},
        {"speed": math.inf},
        {"turn_speed": 0.0},
        {"turn_speed": math.nan},
    ],
)
def test_squares_that_cannot_be_driven(values):
    given = {f"~{name}": value for name, value in values.items()}
    with pytest.raises(ParameterError):
        read_parameters(Square, given.get)


SHORT = Square(sides=2, side=0.2, turn_commands=3)


def test_open_loop_sends_the_commands_of_all_sides():
    driver = SquareDriver(SHORT)
    commands = list(iter(driver.command, None))
    assert commands == 2 * list(open_loop_side(SHORT))
    assert (driver.rate, driver.needs_pose, driver.sides_done) == (10.0, False, 2)
    assert driver.command() is None


def test_sides_are_counted_after_their_turn():
    driver = SquareDriver(SHORT)
    done = []
    while driver.command() is not None:
        done.append(driver.sides_done)
    # Ten commands of a side and three of its turn.
    assert done == [0] * 13 + [1] * 13


def test_closed_loop_drives_a_square_by_the_poses():
    """A robot that follows commands exactly, at 20 Hz."""
    driver = SquareDriver(Square(sides=4, side=0.5), "closed_loop")
    x, y, yaw = 3.0, -1.0, math.radians(20.0)
    corners = [(x, y)]
    for _ in range(3000):
        command = driver.command((x, y, yaw))
        if command is None:
            break
        ahead, turn = command
        x, y = x + ahead * math.cos(yaw) / driver.rate, y + ahead * math.sin(yaw) / driver.rate
        yaw += turn / driver.rate
        if len(corners) == driver.sides_done:
            corners.append((x, y))
    assert command is None
    assert driver.sides_done == 4
    assert math.dist((x, y), corners[0]) < 0.01
    assert math.remainder(yaw - math.radians(20.0), math.tau) == pytest.approx(0.0, abs=0.01)


def test_an_unknown_mode_is_refused():
    with pytest.raises(DriverError, match="mode 'by_feel' is not one of open_loop, closed_loop"):
        SquareDriver(SHORT, "by_feel")
