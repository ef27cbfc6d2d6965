import math

import pytest

from bullet_lab.core.seeds import derived_seed
from bullet_lab.drive.square import DriverError, Square, SquareDriver, open_loop_side

SQUARE = Square(sides=2, side=0.2, turn_commands=3)


def test_open_loop_sends_the_commands_of_all_sides():
    driver = SquareDriver(SQUARE)
    commands = list(iter(driver.command, None))
    assert commands == 2 * list(open_loop_side(SQUARE))
    assert (driver.rate, driver.needs_pose, driver.sides_done) == (10.0, False, 2)
    assert driver.command() is None


def test_sides_are_counted_after_their_turn():
    driver = SquareDriver(SQUARE)
    done = []
    while driver.command() is not None:
        done.append(driver.sides_done)
    # Ten commands of a side and three of its turn.
    assert done == [0] * 13 + [1] * 13


def test_the_distance_is_that_of_the_sides():
    driver = SquareDriver(Square(sides=2, side=0.06, turn_commands=2))
    distances = []
    while driver.command() is not None:
        distances.append(driver.distance)
    side = [0.0, 0.02, 0.04, 0.06, 0.06]
    assert distances == pytest.approx(side + [0.06 + distance for distance in side])
    assert driver.distance == pytest.approx(0.12)


def test_closed_loop_drives_a_square_by_the_poses():
    """A robot that does exactly as it is told, at 20 Hz."""
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
    assert driver.distance == pytest.approx(2.0, abs=0.01)
    assert math.dist((x, y), corners[0]) < 0.01
    assert math.remainder(yaw - math.radians(20.0), math.tau) == pytest.approx(0.0, abs=0.01)


def test_an_unknown_mode_is_refused():
    with pytest.raises(DriverError, match="mode 'by_feel' is not one of open_loop, closed_loop"):
        SquareDriver(SQUARE, "by_feel")


def test_derived_seeds_are_the_same_each_time_and_differ_from_each_other():
    seeds = [derived_seed(seed, index) for seed in range(20) for index in range(50)]
    assert len(set(seeds)) == len(seeds)
    assert seeds == [derived_seed(seed, index) for seed in range(20) for index in range(50)]
    # As far as a parameter of type int goes.
    assert min(seeds) >= 0
    assert max(seeds) < 2**31
