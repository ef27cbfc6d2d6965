"""Paths over a grid: Dijkstra's algorithm, straightened ways, and driving along them."""

from __future__ import annotations

import math
from itertools import accumulate
from typing import Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.drive import STANDSTILL, Command, approach, clip

Point = Tuple[float, float]
"""x and y, m."""

_DIAGONAL = math.sqrt(2.0)
# Half of a cell's neighbours: offset in rows and columns, and distance in cells.
_NEIGHBOURS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, _DIAGONAL), (1, -1, _DIAGONAL))
ACCELERATION = 0.5
"""Of the wheels' mean, m/s²."""

# Turns on the spot: rad/s for each rad that is left, slowest rad/s, and rad at which they are done.
_TURN_GAIN = 2.5
_SLOWEST_TURN = 0.06
_TURNED = math.radians(1.0)
# Distances along a line, m: to its end where it is done, and to the point ahead that is aimed at.
_ARRIVED = 0.05
_LOOKAHEAD = 0.35


class CostGrid:
    """The cheapest ways over a grid of (rows, columns) cells, along x and y, from one place.

    Args:
        low: x, y of the first cell's middle, m.
        cell: edge of a cell, m.
        rate: (rows, columns) costs of a metre in each cell; infinite where there is no way.
        start: x, y where all ways begin, m.

    Attributes:
        costs: (rows, columns) of the cheapest way to each cell; infinite without a way.
    """

    def __init__(self, low: ndarray, cell: float, rate: ndarray, start: Sequence[float]):
        self.cell, self._low, self._shape = cell, low, rate.shape
        self._start = (float(start[0]), float(start[1]))
        self._rate = rate.ravel()
        self.costs, self._before = self._dijkstra()

    def _dijkstra(self) -> tuple[ndarray, ndarray]:
        """Return the costs of all cells, and each one's predecessor on the way there, by index."""
        # Imported late: most jobs plan nothing, and it takes a tenth of a second.
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import dijkstra

        rows, columns = self._shape
        cells, edges = np.arange(rows * columns).reshape(self._shape), []
        for down, right, length in _NEIGHBOURS:
            first = cells[: rows - down, max(-right, 0) : columns - max(right, 0)].ravel()
            second = first + down * columns + right
            cost = 0.5 * length * (self.cell * self._rate[first] + self.cell * self._rate[second])
            edges.append((first, second, cost))
        first, second, costs = (np.concatenate(part) for part in zip(*edges))
        if not np.isfinite(self._rate).all():
            open_to = np.isfinite(costs)
            first, second, costs = first[open_to], second[open_to], costs[open_to]
        graph = coo_matrix((costs, (first, second)), (cells.size, cells.size)).tocsr()
        start = self._index(self._start)
        found = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
        return found[0].reshape(self._shape), found[1]

    def _index(self, points) -> ndarray:
        """Return the index of the cell nearest each of (..., 2 or more) points."""
        places = np.round((np.asarray(points)[..., :2] - self._low) / self.cell).astype(int)
        places = np.clip(places, 0, np.array(self._shape) - 1)
        return places[..., 0] * self._shape[1] + places[..., 1]

    def path(self, goal: Sequence[float]) -> list[Point] | None:
        """Return the way points from the start to a goal, both included; None without a way."""
        cells = np.round((np.asarray(goal[:2]) - self._low) / self.cell)
        if np.any(cells < 0) or np.any(cells >= self._shape):
            return None
        if not np.isfinite(self.costs.ravel()[self._index(goal)]):
            return None
        way = [(float(goal[0]), float(goal[1]))]
        cell = self._before[self._index(goal)]
        while cell >= 0:
            place = self._low + self.cell * np.array(divmod(cell, self._shape[1]))
            way.append(tuple(place.tolist()))
            cell = self._before[cell]
        way[-1] = self._start
        if len(way) == 1:
            way.append(self._start)
        return self._straighten(way[::-1])

    def _straighten(self, way: list[Point]) -> list[Point]:
        """Leave out points where the straight way costs hardly more."""
        costs = list(accumulate(map(self._straight_cost, way, way[1:]), initial=0.0))
        kept, here = [way[0]], 0
        while here < len(way) - 1:
            there = len(way) - 1
            while there > here + 1:
                dearest = 1.02 * (costs[there] - costs[here]) + 1e-6
                # Without a way straight on, both are infinite or no numbers.
                if self._straight_cost(way[here], way[there]) <= dearest < math.inf:
                    break
                there -= 1
            kept.append(way[there])
            here = there
        return kept

    def _straight_cost(self, first: Point, second: Point) -> float:
        length = math.dist(first, second)
        points = along(first, second, 0.5 * self.cell)
        return length * float(np.mean(self._rate[self._index(points)]))


def along(first: Point, second: Point, spacing: float) -> ndarray:
    """Return (n, 2) points on a line, both ends included, no farther apart than `spacing`.

    >>> along((0.0, 0.0), (1.0, 0.0), 0.5)
    array([[0. , 0. ],
           [0.5, 0. ],
           [1. , 0. ]])
    """
    count = max(2, math.ceil(math.dist(first, second) / spacing) + 1)
    part = np.linspace(0.0, 1.0, count)[:, None]
    return (1.0 - part) * np.asarray(first) + part * np.asarray(second)


def points_of(way: Sequence[Point], spacing: float) -> tuple[ndarray, ndarray]:
    """Return points (n, 2) of a way, as `along`, and how far each one is from its start, m.

    >>> points_of([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)], 2.0)[1]
    array([0., 1., 1., 3.])
    """
    pieces = [along(*ends, spacing) for ends in zip(way, way[1:])]
    points = np.concatenate(pieces or [np.asarray(way, dtype=float)])
    return points, np.cumsum(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T))


class PathFollower:
    """Drives along straight lines, turning on the spot between them.

    `way` are points (m, m) in the frame of the poses, the first where the robot stands.
    """

    def __init__(self, way: Sequence[Point]):
        self._way: list[Point] = list(way)
        self._turning = True

    @property
    def left(self) -> tuple[Point, ...]:
        """The points still to be driven to."""
        return tuple(self._way[1:])

    def command(self, pose: PlanarPose, speed: float, turn_speed: float) -> Command:
        """Return the command for the present pose, within m/s and rad/s; zero when there."""
        while len(self._way) > 1:
            start, end = self._way[:2]
            direction = math.atan2(end[1] - start[1], end[0] - start[0])
            length, cos, sin = math.dist(start, end), math.cos(direction), math.sin(direction)
            done = cos * (pose[0] - start[0]) + sin * (pose[1] - start[1])
            if length - done > _ARRIVED:
                break
            self._way.pop(0)
            self._turning = True
        else:
            return STANDSTILL
        aim = min(done + _LOOKAHEAD, length)
        x, y = start[0] + aim * cos, start[1] + aim * sin
        off = wrap(math.atan2(y - pose[1], x - pose[0]) - pose[2])
        if self._turning or abs(off) > 0.6:
            self._turning = abs(off) > 0.06
            if self._turning:
                return turn_command(off, turn_speed, 0.0)
        braking = math.sqrt(0.6 * ACCELERATION * (length - done))
        speed = min(speed, braking)
        return speed * math.cos(off), clip(2.0 * off, 0.7 * turn_speed)


def turn_command(left: float, fastest: float, tolerance: float = _TURNED) -> Command:
    """Return the command that turns on the spot by what is left (rad); zero when done.

    >>> turn_command(-1.0, fastest=0.8)
    (0.0, -0.8)
    """
    if abs(left) <= tolerance:
        return STANDSTILL
    speed = approach(abs(left), fastest, _SLOWEST_TURN, _TURN_GAIN)
    return 0.0, math.copysign(speed, left)
