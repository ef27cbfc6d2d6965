"""Which floor is safe when the dock is not known well, and ways over it.

A grid in the odometry frame says for each place what share of the thinkable docks would be
touched there. Dijkstra's algorithm finds the cheapest ways; they are straightened afterwards.
"""

from __future__ import annotations

import heapq
import math
from typing import List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.docking.geometry import clearance

Point = Tuple[float, float]

CELL = 0.1
_MOST_CELLS = 40_000
_TOUCH_COST, _NEAR_COST = 300.0, 3.0
_NEAR = 0.22
_DIAGONAL = math.sqrt(2.0)
_NEIGHBOURS = tuple(
    (i, j, _DIAGONAL if i and j else 1.0) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j
)


class FloorMap:
    """Risks on a grid.

    Args:
        robot: (x, y) in the odometry frame; where it stands is free.
        docks: (n, 3) thinkable poses of the dock in the odometry frame.
        boxes: walls in the dock's frame, see `wall_boxes`.
        obstacles: (m, 4) x, y, radius and probability of other things.
        radius: of the circle that the robot is to have for itself, m.
        reach: how far the map goes beyond robot and docks, m.
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
        self._rate = 1.0 + _TOUCH_COST * self.touch + _NEAR_COST * near
        self.costs, self._parents = self._spread()

    def _risks(self, docks, boxes, obstacles, radius: float):
        touch, near = np.zeros(self._shape), np.zeros(self._shape)
        share = 1.0 / len(docks)
        flat = np.zeros((*self._shape, 3))
        flat[..., :2] = self.points
        for dock in docks if len(boxes) else ():
            away = clearance(se2.between(dock, flat)[..., :2], boxes)
            touch += share * (away < radius)
            near += share * (away < radius + _NEAR)
        for x, y, size, weight in obstacles:
            away = np.hypot(self.points[..., 0] - x, self.points[..., 1] - y) - size
            touch += weight * (away < radius)
            near += weight * (away < radius + _NEAR)
        return touch, near

    def _spread(self):
        """Return the least cost to each cell, and the cell before it on the way there."""
        rows, columns = self._shape
        rate = (self.cell * self._rate).ravel().tolist()
        start = self._index(self._robot)
        costs = [math.inf] * (rows * columns)
        parents = [-1] * (rows * columns)
        costs[start] = 0.0
        queue = [(0.0, start)]
        while queue:
            cost, here = heapq.heappop(queue)
            if cost > costs[here]:
                continue
            row, column = divmod(here, columns)
            for i, j, length in _NEIGHBOURS:
                if 0 <= row + i < rows and 0 <= column + j < columns:
                    there = here + i * columns + j
                    new = cost + 0.5 * length * (rate[here] + rate[there])
                    if new < costs[there]:
                        costs[there], parents[there] = new, here
                        heapq.heappush(queue, (new, there))
        return np.array(costs).reshape(self._shape), parents

    def _index(self, point: Sequence[float]) -> int:
        row, column = np.round((np.asarray(point[:2]) - self._low) / self.cell).astype(int)
        row = min(max(int(row), 0), self._shape[0] - 1)
        column = min(max(int(column), 0), self._shape[1] - 1)
        return row * self._shape[1] + column

    def risk(self, points: np.ndarray) -> float:
        """Return the largest share of docks that a robot at any of (n, 2) points would touch."""
        cells = [self._index(point) for point in points]
        return float(np.max(self.touch.ravel()[cells], initial=0.0))

    def path(self, goal: Sequence[float]) -> Optional[List[Point]]:
        """Return way points from the robot to a goal, both included; None if it is off the map."""
        off = np.asarray(goal[:2]) - self._low
        if np.any(off < 0.0) or np.any(off > self.cell * (np.array(self._shape) - 1)):
            return None
        index = self._index(goal)
        way = [(float(goal[0]), float(goal[1]))]
        while self._parents[index] >= 0:
            index = self._parents[index]
            row, column = divmod(index, self._shape[1])
            way.append(tuple(self.points[row, column].tolist()))
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
            while there > here + 1:
                if self._straight_cost(way[here], way[there]) <= (
                    1.02 * (costs[there] - costs[here]) + 1e-6
                ):
                    break
                there -= 1
            kept.append(way[there])
            here = there
        return kept

    def _straight_cost(self, first: Point, second: Point) -> float:
        length = math.dist(first, second)
        points = along(first, second, 0.5 * self.cell)
        cells = [self._index(point) for point in points]
        return length * float(np.mean(self._rate.ravel()[cells]))


def along(first: Point, second: Point, spacing: float) -> np.ndarray:
    """Return (n, 2) points on a line, both ends included."""
    count = max(2, math.ceil(math.dist(first, second) / spacing) + 1)
    part = np.linspace(0.0, 1.0, count)[:, None]
    return (1.0 - part) * np.asarray(first) + part * np.asarray(second)


def sample_way(way: Sequence[Point], spacing: float) -> np.ndarray:
    """Return (n, 2) points along way points."""
    if len(way) == 1:
        return np.asarray(way, dtype=float)
    return np.concatenate([along(a, b, spacing) for a, b in zip(way, way[1:])])
