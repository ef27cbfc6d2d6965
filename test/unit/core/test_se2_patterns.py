import math

import pytest

from bullet_lab.core.se2 import circle, grid, line


def test_a_line():
    assert line(3, 0.5) == [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)]


def test_a_grid_fills_row_by_row():
    places = [(x, y) for x, y, _ in grid(5, 2.0)]
    assert places == [(0.0, 0.0), (2.0, 0.0), (4.0, 0.0), (0.0, 2.0), (2.0, 2.0)]
    assert grid(1, 2.0) == [(0.0, 0.0, 0.0)]


def test_a_circle_is_even_and_faces_outwards():
    places = circle(8, 3.0)
    assert places[0] == (3.0, 0.0, 0.0)
    for x, y, yaw in places:
        assert (3.0 * math.cos(yaw), 3.0 * math.sin(yaw)) == pytest.approx((x, y))
    gaps = [math.dist(a[:2], b[:2]) for a, b in zip(places, places[1:] + places[:1])]
    assert gaps == pytest.approx(8 * [gaps[0]])
