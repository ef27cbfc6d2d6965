import math

import numpy as np
import pytest

from bullet_lab.core import se2
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports.squares import analyse

SIDE = [(0.0095, 0.0, 0.0)] * 200
TURN = [(0.0, 0.0, -math.radians(1.5))] * 60
REST = [(0.0, 0.0, 0.0)] * 15
SLOW_DRIVE = [(0.0005, 0.0, 0.0)] * 20
SLOW_TURN = [(0.0, 0.0, -math.radians(0.1))] * 20
MIXED = [(0.004, 0.0, -math.radians(0.7))]
TREMBLE = np.random.default_rng(1).normal(0.0, 1e-6, (60, 3)).tolist()
WOBBLE = [(0.0095, 0.0, sway) for sway in [0.12, -0.12, 0.0, 0.0] * 50]
STRAY = [TURN[0], SIDE[0]]


def path(*legs, start=(0.0, 0.0, 0.0)):
    poses = [np.array(start)]
    for step in (step for leg in legs for step in leg):
        poses.append(se2.compose(poses[-1], step))
    return Trajectory(np.arange(len(poses)) / 20, poses)


@pytest.mark.parametrize(
    "lap, side, turn",
    [
        ([SIDE, TURN], (1.9, 1e-9), (90.0, 1e-9)),
        ([SIDE[:90], REST, SIDE[90:], REST, TURN[:30], REST, TURN[30:]], (1.9, 1e-9), (90.0, 1e-9)),
        ([TREMBLE, SIDE, TREMBLE, TURN], (1.9, 1e-4), (90.0, 1e-2)),
        # A slow end belongs to its segment.
        ([SIDE, SLOW_DRIVE, TURN, SLOW_TURN], (1.91, 1e-6), (92.0, 1e-4)),
        # Stray messages at a corner do not split.
        ([SIDE, STRAY, TURN, STRAY[::-1]], (1.9, 0.02), (93.0, 1.6)),
        # A message with both gives its share to both.
        ([SIDE, MIXED, TURN], (1.904, 1e-4), (90.7, 1e-4)),
        ([WOBBLE, TURN], (1.9, 0.2), (90.0, 7.0)),
    ],
)
def test_a_square(lap, side, turn):
    square = analyse(path(*lap * 4, start=(3.0, -2.0, 2.9)))
    assert square.side_lengths_m == pytest.approx([side[0]] * 4, abs=side[1])
    assert square.turns_deg == pytest.approx([turn[0]] * 4, abs=turn[1])


def test_the_turning_direction_does_not_matter():
    left = [(dx, dy, -dyaw) for dx, dy, dyaw in TURN]
    square = analyse(path(*[SIDE, left] * 4))
    assert square.turns_deg == pytest.approx([90.0] * 4)
    assert square.closure_error_m == pytest.approx(0.0, abs=1e-12)


def test_a_turning_message_with_some_drive_gives_its_share_to_the_side():
    turning = [(0.002, 0.0, -math.radians(1.5))]
    square = analyse(path(*[turning, SIDE, turning, TURN] * 4))
    assert square.side_lengths_m == pytest.approx([1.904] * 4, abs=1e-5)
    assert square.turns_deg == pytest.approx([93.0] * 3 + [91.5])


def test_a_path_that_stops_half_way_has_what_it_has():
    square = analyse(path(SIDE, TURN, SIDE[:100]))
    assert square.side_lengths_m == pytest.approx([1.9, 0.95])
    assert square.turns_deg == pytest.approx([90.0])
    assert square.closure_error_m == pytest.approx(math.hypot(1.9, 0.95))
    assert analyse(path(TURN, SIDE)).turns_deg == []


@pytest.mark.parametrize("legs", [[], [REST], [TURN], [SIDE[:3], TURN[:2]], [SIDE[:1]]])
def test_no_side_gives_empty_lists(legs):
    square = analyse(path(*legs))
    assert square.side_lengths_m == []
    assert square.turns_deg == []


def test_a_curve_has_no_sides():
    square = analyse(path([(0.01, 0.0, 0.01)] * 600))
    assert (square.side_lengths_m, square.turns_deg) == ([], [])
    assert square.closure_error_m > 0.1
