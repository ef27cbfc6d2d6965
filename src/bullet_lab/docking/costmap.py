"""Costmap: which floor is safe when the dock is not known well, and paths over it.

A grid in the odometry frame holds the share of the possible docks that a robot at each place would
touch. Dijkstra's algorithm finds the cheapest paths, which are straightened afterwards.
"""

from __future__ import annotations

import math
from typing import List, Optional, Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from bullet_lab.core import se2
from bullet_lab.docking.geometry import clearance
from bullet_lab.docking.types import Point

CELL = 0.1
_MOST_CELLS = 40_000
_TOUCH_COST, _NEAR_COST = 300.0, 3.0
_NEAR = 0.22
_DIAGONAL = math.sqrt(2.0)
# Half of a cell's neighbours: offset in rows and columns, and distance in cells.
_NEIGHBOURS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, _DIAGONAL), (1, -1, _DIAGONAL))


class Costmap:
    """Risks on a grid of (rows, columns) cells, along x and y of the odometry frame.

    Args:
        robot: (x, y) in the odometry frame; where it stands is free.
        docks: (n, 3) possible poses of the dock in the odometry frame.
        boxes: walls in the dock's frame, see `wall_boxes`.
        obstacles: (m, 4) x, y, radius and probability of other things.
        radius: of the circle that the robot is to have for itself, m.
        reach: how far the map goes beyond robot and docks, m.

    Attributes:
        cell: edge of a cell, m.
        points: (rows, columns, 2) of the cells' middles, m.
        touch: (rows, columns) share of the docks that a robot there would touch.
        costs: (rows, columns) of the cheapest way there; a metre of free floor costs 1.
    """

    def __init__(
        self,
        robot: Sequence[float],
        docks: np.ndarray,
        boxes: np.ndarray,
        obstacles: np.ndarray,
        radius: float,
        reach: float = 4.0,
    ):
        self._robot = (float(robot[0]), float(robot[1]))
        low = np.minimum(robot[:2], docks[:, :2].min(axis=0)) - reach
        high = np.maximum(robot[:2], docks[:, :2].max(axis=0)) + reach
        cell = max(CELL, math.sqrt(float(np.prod(high - low)) / _MOST_CELLS))
        self.cell, self._low = cell, low
        self._shape = tuple((np.ceil((high - low) / cell).astype(int) + 1).tolist())
        x = low[0] + cell * np.arange(self._shape[0])
        y = low[1] + cell * np.arange(self._shape[1])
        self.points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        self.touch, near = self._risks(docks, boxes, obstacles, radius)
        free = np.hypot(*(self.points - self._robot).transpose(2, 0, 1)) < 1.2 * cell
        self.touch[free] = 0.0
        self._rate = (1.0 + _TOUCH_COST * self.touch + _NEAR_COST * near).ravel()
        self.costs = self._dijkstra()

    def _risks(self, docks, boxes, obstacles, radius: float):
        """Return the shares of docks that a robot in a cell would touch, and come near to."""
        touch, near = np.zeros(self._shape), np.zeros(self._shape)
        flat = np.zeros((*self._shape, 3))
        flat[..., :2] = self.points

        def add(away: np.ndarray, weight: float) -> None:
            touch[away < radius] += weight
            near[away < radius + _NEAR] += weight

        for dock in docks if len(boxes) else ():
            add(clearance(se2.between(dock, flat)[..., :2], boxes), 1.0 / len(docks))
        for x, y, size, weight in obstacles:
            add(np.hypot(self.points[..., 0] - x, self.points[..., 1] - y) - size, weight)
        return touch, near

    def _dijkstra(self) -> np.ndarray:
        rows, columns = self._shape
        cells, edges = np.arange(rows * columns).reshape(self._shape), []
        for down, right, length in _NEIGHBOURS:
            first = cells[: rows - down, max(-right, 0) : columns - max(right, 0)].ravel()
            second = first + down * columns + right
            edges.append((first, second, self._edge_cost(first, second, length)))
        first, second, costs = (np.concatenate(part) for part in zip(*edges))
        graph = coo_matrix((costs, (first, second)), (cells.size, cells.size)).tocsr()
        start = self._index(self._robot)
        return dijkstra(graph, directed=False, indices=start).reshape(self._shape)

    def _edge_cost(self, first, second, length: float):
        """Return the cost between neighbouring cells, so many cells apart."""
        return 0.5 * length * (self.cell * self._rate[first] + self.cell * self._rate[second])

    def _predecessor(self, cell: int) -> int:
        """Return the neighbour that the cheapest way to a cell comes over; -1 for the first."""
        rows, columns = self._shape
        row, column = divmod(cell, columns)
        costs, found = self.costs.ravel(), []
        for down, right, length in _NEIGHBOURS:
            for i, j in ((down, right), (-down, -right)):
                if 0 <= row + i < rows and 0 <= column + j < columns:
                    other = cell + i * columns + j
                    if costs[other] + self._edge_cost(other, cell, length) == costs[cell]:
                        found.append((costs[other], other))
        # Ties are frequent on free floor; cost and index decide.
        return min(found, default=(0.0, -1))[1]

    def _index(self, points) -> np.ndarray:
        """Return the index of the cell nearest each of (..., 2 or more) points."""
        places = np.round((np.asarray(points)[..., :2] - self._low) / self.cell).astype(int)
        places = np.clip(places, 0, np.array(self._shape) - 1)
        return places[..., 0] * self._shape[1] + places[..., 1]

    def risk(self, points: np.ndarray) -> float:
        """Return the largest share of docks that a robot at any of (n, 2) points would touch."""
        return float(np.max(self.touch.ravel()[self._index(points)], initial=0.0))

    def path(self, goal: Sequence[float]) -> Optional[List[Point]]:
        """Return way points from the robot to a goal, both included; None if it is off the map."""
        off = np.asarray(goal[:2]) - self._low
        if np.any(off < 0.0) or np.any(off > self.cell * (np.array(self._shape) - 1)):
            return None
        way = [(float(goal[0]), float(goal[1]))]
        cell = self._predecessor(int(self._index(goal)))
        while cell >= 0:
            way.append(tuple(self.points[divmod(cell, self._shape[1])].tolist()))
            cell = self._predecessor(cell)
        way[-1] = self._robot
        if len(way) == 1:
            way.append(self._robot)
        return self._straighten(way[::-1])

    def _straighten(self, way: List[Point]) -> List[Point]:
        """Leave out points where the straight way costs hardly more."""
        costs = [0.0]
        for first, second in zip(way, way[1:]):
            costs.append(costs[-1] + self._straight_cost(first, second))
        kept, here = [way[0]], 0
        while here < len(way) - 1:
            there = len(way) - 1
            while there > here + 1 and self._straight_cost(way[here], way[there]) > (
                1.02 * (costs[there] - costs[here]) + 1e-6
            ):
                there -= 1
            kept.append(way[there])
            here = there
        return kept

    def _straight_cost(self, first: Point, second: Point) -> float:
        length = math.dist(first, second)
        points = along(first, second, 0.5 * self.cell)
        return length * float(np.mean(self._rate[self._index(points)]))


def along(first: Point, second: Point, spacing: float) -> np.ndarray:
    """Return (n, 2) points on a line, both ends included, no farther apart than `spacing`.

    >>> along((0.0, 0.0), (1.0, 0.0), 0.5)
    array([[0. , 0. ],
           [0.5, 0. ],
           [1. , 0. ]])
    """
    count = max(2, math.ceil(math.dist(first, second) / spacing) + 1)
    part = np.linspace(0.0, 1.0, count)[:, None]
    return (1.0 - part) * np.asarray(first) + part * np.asarray(second)
