"""Tests of the costmap: costs against a plain Dijkstra, and which ways it gives."""

import heapq
import math

import docking_standin as standin
import numpy as np
import pytest

from bullet_lab.docking.geometry import wall_boxes
from bullet_lab.docking.paths import Costmap

BOXES = wall_boxes(standin.make_dock(standin.Stand((0.0, 0.0, 0.0))))
NOTHING = np.empty((0, 4))


def costmap(robot=(0.0, 0.0), boxes=BOXES, obstacles=NOTHING):
    docks = np.array([4.0, 0.0, 0.0]) + np.linspace(-0.2, 0.2, 9)[:, None] * [1.0, -1.0, 0.5]
    return Costmap(robot, docks, boxes, obstacles, 0.32, reach=2.0)


def plain_dijkstra(rate, start):
    """Costs (rows, columns) of the cheapest ways."""
    costs = np.full(rate.shape, math.inf)
    costs[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        cost, (row, column) = heapq.heappop(queue)
        if cost > costs[row, column]:
            continue
        for i, j in ((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j):
            there = row + i, column + j
            if 0 <= there[0] < rate.shape[0] and 0 <= there[1] < rate.shape[1]:
                length = math.sqrt(2.0) if i and j else 1.0
                new = cost + 0.5 * length * (rate[row, column] + rate[there])
                if new < costs[there]:
                    costs[there] = new
                    heapq.heappush(queue, (new, there))
    return costs


@pytest.mark.parametrize("robot", [(0.0, 0.0), (-0.7, 1.3)])
def test_costs_are_those_of_a_plain_dijkstra(robot):
    made = costmap(robot, obstacles=np.array([[1.0, 0.5, 0.3, 0.4]]))
    columns = made.costs.shape[1]
    start = divmod(int(made._index(robot)), columns)
    costs = plain_dijkstra(made.cell * made._rate.reshape(made.costs.shape), start)
    np.testing.assert_array_equal(made.costs, costs)


@pytest.mark.parametrize("robot", [(0.0, 0.0), (9.0, 3.0)])
def test_the_map_reaches_2_m_beyond_robot_and_docks(robot):
    made = costmap(robot)
    around = np.array([robot, (3.8, -0.2), (4.2, 0.2)])
    np.testing.assert_allclose(made.points[0, 0], around.min(axis=0) - 2.0)
    beyond = made.points[-1, -1] - (around.max(axis=0) + 2.0)
    assert ((beyond >= -1e-9) & (beyond < 1.01 * made.cell)).all()


def test_on_free_floor_the_way_is_straight():
    made = costmap(boxes=np.empty((0, 4)))
    assert made.path((1.234, 0.5)) == [(0.0, 0.0), (1.234, 0.5)]


def test_a_way_goes_round_what_may_be_there():
    goal = (2.0, 0.0)
    in_the_way = np.array([[1.0, 0.0, 0.2, 1.0]])
    made = costmap(boxes=np.empty((0, 4)), obstacles=in_the_way)
    way = np.array(made.path(goal))
    assert len(way) > 2
    assert made.risk(np.array([[1.0, 0.0]])) == 1.0
    assert made.risk(way) < 0.03


def test_off_the_map_there_is_no_way():
    assert costmap().path((100.0, 0.0)) is None
