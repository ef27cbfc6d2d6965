"""Tests of what a docking came to by the truth."""

import math

import pytest

from bullet_lab.docking.database import ERRORS, DockTolerance, docking_errors, judge
from bullet_lab.docking.types import DockingError

DOCK = (4.0, 0.0, 0.0)
TOLERANCE = DockTolerance(0.005, 0.003, math.radians(0.4))


@pytest.mark.parametrize(
    ("said", "errors", "contacts", "result"),
    [
        ("NONE", (0.0049, -0.0029, 0.39), 0, "docked"),
        ("NONE", (-0.0051, 0.0, 0.0), 0, "inaccurate"),
        ("NONE", (0.0, 0.0031, 0.0), 0, "inaccurate"),
        ("NONE", (0.0, 0.0, -0.41), 0, "inaccurate"),
        ("NONE", (math.nan, 0.0, 0.0), 0, "inaccurate"),
        ("NONE", (0.0, 0.0, 0.0), 1, "wall_contact"),
        ("TIMED_OUT", (0.0, 0.0, 0.0), 0, "timed_out"),
        ("TIMED_OUT", (0.0, 0.0, 0.0), 2, "wall_contact"),
    ],
)
def test_docked_is_who_says_so_stands_within_tolerance_and_touched_nothing(
    said, errors, contacts, result
):
    found = judge(DockingError[said], dict(zip(ERRORS, errors)), TOLERANCE, contacts)
    assert found == result


@pytest.mark.parametrize(
    ("robot", "distance", "lateral", "yaw"),
    [
        ((3.44, 0.0, 0.0), 0.0, 0.0, 0.0),
        ((3.43, 0.0, 0.0), 0.01, 0.0, 0.0),
        ((3.44, 0.02, 0.0), 0.0, 0.02, 0.0),
        ((3.44, 0.0, 0.1), 0.16 * (1.0 - math.cos(0.1)), 0.0, math.degrees(0.1)),
    ],
)
def test_errors_of_a_docked_robot(robot, distance, lateral, yaw):
    found = docking_errors(robot, DOCK, camera_ahead=0.16, docked_distance=0.4)
    assert found["distance_error_m"] == pytest.approx(distance, abs=1e-12)
    assert found["lateral_error_m"] == pytest.approx(lateral, abs=1e-12)
    assert found["yaw_error_deg"] == pytest.approx(yaw, abs=1e-12)


def test_errors_are_those_seen_from_the_dock_wherever_it_stands():
    dock = (1.0, 2.0, math.pi / 2)
    found = docking_errors((0.98, 1.43, math.pi / 2 + 0.01), dock, 0.16, 0.4)
    assert found["lateral_error_m"] == pytest.approx(0.02)
    assert found["distance_error_m"] == pytest.approx(0.01, abs=1e-4)
    assert found["yaw_error_deg"] == pytest.approx(math.degrees(0.01))
