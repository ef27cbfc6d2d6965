"""Tests of the costmap: the costs of its ways, and which ways it gives."""

import math
from itertools import product

import docking_standin as standin
import numpy as np
from shared import cases

from bullet_lab.docking.geometry import wall_boxes
from bullet_lab.docking.paths import Costmap

BOXES = wall_boxes(standin.make_dock(standin.Stand((0.0, 0.0, 0.0))))
NOTHING = np.empty((0, 4))


def costmap(robot=(0.0, 0.0), boxes=BOXES, obstacles=NOTHING):
    docks = np.array([4.0, 0.0, 0.0]) + np.linspace(-0.2, 0.2, 9)[:, None] * [1.0, -1.0, 0.5]
    return Costmap(robot, docks, boxes, obstacles, reach=2.0)


def cheapest(rate, start):
    """Costs (rows, columns) of the cheapest ways: each cell from its neighbours, until all stay."""
    rate = np.pad(rate, 1, constant_values=math.inf)
    costs = np.full(rate.shape, math.inf)
    costs[start[0] + 1, start[1] + 1] = 0.0
    before = None
    while not np.array_equal(costs, before):
        before = costs
        for by in set(product((-1, 0, 1), repeat=2)) - {(0, 0)}:
            length = math.sqrt(np.dot(by, by))
            neighbour, its_rate = (np.roll(values, by, axis=(0, 1)) for values in (costs, rate))
            costs = np.minimum(costs, neighbour + 0.5 * length * (its_rate + rate))
    return costs[1:-1, 1:-1]


@cases("robot: [[0.0, 0.0], [-0.7, 1.3]]")
def test_costs_are_those_of_the_cheapest_ways(robot):
    made = costmap(robot, obstacles=np.array([[1.0, 0.5, 0.3, 0.4]]))
    start = divmod(int(made._index(robot)), made.costs.shape[1])
    costs = cheapest(made.cell * made._rate.reshape(made.costs.shape), start)
    np.testing.assert_array_equal(made.costs, costs)


# The last one has as many cells as there may be.
@cases("robot, cell: [[[0.0, 0.0], 0.1], [[9.0, 3.0], 0.1], [[29.8, 19.8], 0.13416407864998736]]")
def test_the_map_reaches_2_m_beyond_robot_and_docks(robot, cell):
    made = costmap(robot)
    np.testing.assert_allclose(made.cell, cell)
    around = np.array([robot, (3.8, -0.2), (4.2, 0.2)])
    np.testing.assert_allclose(made.points[0, 0], around.min(axis=0) - 2.0)
    beyond = made.points[-1, -1] - (around.max(axis=0) + 2.0)
    assert ((beyond >= -1e-9) & (beyond < 1.01 * made.cell)).all()


def test_a_way_goes_round_what_may_be_there():
    made = costmap(boxes=NOTHING, obstacles=np.array([[1.0, 0.0, 0.2, 1.0]]))
    way = np.array(made.path((2.0, 0.0)))
    assert len(way) > 2
    assert made.risk(np.array([[1.0, 0.0]])) == 1.0
    assert made.risk(way) < 0.03
