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


def path(*legs, start=(0.0, 0.0, 0.0)):
    poses = [np.array(start)]
    for step in (step for leg in legs for step in leg):
        poses.append(se2.compose(poses[-1], step))
    return Trajectory(np.arange(len(poses)) / 20, poses)


def test_a_square():
    square = analyse(path(*[SIDE, TURN] * 4))
    assert square.side_lengths_m == pytest.approx([1.9] * 4)
    assert square.turns_deg == pytest.approx([90.0] * 4)
    assert square.closure_error_m == pytest.approx(0.0, abs=1e-12)


def test_turning_direction_and_start_do_not_matter():
    left = [(dx, dy, -dyaw) for dx, dy, dyaw in TURN]
    square = analyse(path(*[SIDE, left] * 4, start=(3.0, -2.0, 2.9)))
    assert square.side_lengths_m == pytest.approx([1.9] * 4)
    assert square.turns_deg == pytest.approx([90.0] * 4)


def test_rests_do_not_count():
    square = analyse(
        path(REST, *[SIDE[:90], REST, SIDE[90:], REST, TURN[:30], REST, TURN[30:], REST] * 4)
    )
    assert square.side_lengths_m == pytest.approx([1.9] * 4)
    assert square.turns_deg == pytest.approx([90.0] * 4)


def test_a_rest_that_trembles_does_not_count():
    tremble = np.random.default_rng(1).normal(0.0, 1e-6, (60, 3)).tolist()
    square = analyse(path(tremble, *[SIDE, tremble, TURN, tremble] * 4))
    assert square.side_lengths_m == pytest.approx([1.9] * 4, abs=1e-4)
    assert square.turns_deg == pytest.approx([90.0] * 4, abs=1e-2)


def test_a_slow_end_belongs_to_its_segment():
    square = analyse(path(*[SIDE, SLOW_DRIVE, TURN, SLOW_TURN] * 4))
    assert square.side_lengths_m == pytest.approx([1.91] * 4)
    assert square.turns_deg == pytest.approx([92.0] * 4)


def test_stray_messages_at_a_corner_do_not_split():
    turn_then_drive = [TURN[0], SIDE[0]]
    square = analyse(path(*[SIDE, turn_then_drive, TURN, turn_then_drive[::-1]] * 4))
    assert square.side_lengths_m == pytest.approx([1.9] * 4, abs=0.02)
    assert square.turns_deg == pytest.approx([93.0] * 4, abs=1.6)


def test_a_message_with_both_gives_its_share_to_both():
    square = analyse(path(*[SIDE, MIXED, TURN] * 4))
    assert square.side_lengths_m == pytest.approx([1.904] * 4, abs=1e-4)
    assert square.turns_deg == pytest.approx([90.7] * 4)


def test_a_turning_message_with_some_drive_gives_its_share_to_the_side():
    turning = [(0.002, 0.0, -math.radians(1.5))]
    square = analyse(path(*[turning, SIDE, turning, TURN] * 4))
    assert square.side_lengths_m == pytest.approx([1.904] * 4, abs=1e-5)
    assert square.turns_deg == pytest.approx([93.0] * 3 + [91.5])


def test_a_wobbling_drive_is_one_side():
    wobble = [(0.0095, 0.0, sway) for sway in [0.12, -0.12, 0.0, 0.0] * 50]
    square = analyse(path(*[wobble, TURN] * 4))
    assert len(square.side_lengths_m) == 4
    assert square.turns_deg == pytest.approx([90.0] * 4, abs=7.0)


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
