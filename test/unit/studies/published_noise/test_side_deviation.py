import numpy as np
import pytest

from bullet_lab.studies.published_noise.side_deviation import (
    SideError,
    corner_points,
    side_deviations,
    sides_between,
)
from bullet_lab.studies.squares import NO_SIDE

CORNERS = np.array([(0, 0), (2, 0), (2, -2), (0, -2), (0, 0)], dtype=float)
# Beside each side by 1, 2, 3 and 4 cm, and ahead of itself where that must not count.
POINTS = np.array(
    [(9, 9), (0.5, 0.01), (2.5, 0), (1.98, -1), (1, -2.03), (1.2, -1.99), (0.04, -1)]
)
SIDES = np.array([NO_SIDE, 0, 0, 1, 2, 2, 3])


def test_largest_deviation_on_each_side():
    found = side_deviations(POINTS[:, np.newaxis], SIDES[:, np.newaxis], CORNERS)
    np.testing.assert_allclose(found, [[0.01, 0.02, 0.03, 0.04]], atol=1e-12)


def test_deviations_of_many_paths_with_their_own_sides():
    paths = np.stack([POINTS, POINTS * [1, 1]], axis=1)
    paths[1, 1] = (0.5, -0.07)
    sides = np.stack([SIDES, SIDES], axis=1)
    sides[1, 1], sides[2, 1] = NO_SIDE, 0
    found = side_deviations(paths, sides, CORNERS)
    np.testing.assert_allclose(found[:, 0], [0.01, 0.0], atol=1e-12)
    np.testing.assert_allclose(found[0, 1:], found[1, 1:])


def test_deviations_do_not_depend_on_where_the_square_is():
    angle = 0.7
    turn = np.array([(np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))])
    moved = side_deviations(
        (POINTS @ turn + [3, 4])[:, np.newaxis], SIDES[:, np.newaxis], CORNERS @ turn + [3, 4]
    )
    np.testing.assert_allclose(moved, [[0.01, 0.02, 0.03, 0.04]], atol=1e-12)


def test_a_side_without_points_is_refused():
    with pytest.raises(SideError, match="side 4"):
        side_deviations(POINTS[:-1, np.newaxis], SIDES[:-1, np.newaxis], CORNERS)


def test_corners_in_one_place_are_refused():
    with pytest.raises(SideError, match="corners"):
        side_deviations(POINTS[:, np.newaxis], SIDES[:, np.newaxis], CORNERS[[0, 0, 2, 3, 4]])


def test_corners_of_a_drawn_path():
    drawn = np.array(
        [(0, 0), (0, 0), (1, 0.1), (2.03, 0), (2, 0), (2, -1), (2, -2), (0, -2), (0, -1), (0, -0.1)]
    )
    corners = corner_points(drawn, CORNERS, 0.2)
    assert corners.tolist() == [0, 4, 6, 7, 9]
    assert sides_between(corners, len(drawn)).tolist() == [0, 0, 0, 0, 0, 1, 1, 2, 3, 3]


def test_a_path_that_misses_a_corner_is_refused():
    with pytest.raises(SideError, match="corner 2"):
        corner_points([(0, 0), (2, 0), (0, -2), (0, 0)], CORNERS, 0.2)
