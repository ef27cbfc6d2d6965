"""The costmap of a robot on a map: what the map shows, and what a laser sees besides."""

from __future__ import annotations

import math
from typing import Any, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Pose
from bullet_lab.navigation.occupancy import FREE, OCCUPIED, UNKNOWN, MapError, OccupancyMap
from bullet_lab.navigation.paths import CostGrid, Point, points_of

# Larger maps are planned on with larger cells.
MOST_CELLS = 160_000
# A cell is in the way if its middle is nearer to an occupied one's than the robot's radius and this
# share of a cell: the surface may be anywhere in the occupied cell.
SURE = 0.7
# Cost of a metre beside what is in the way and on unknown floor, above the 1 of free floor, and m
# in which the first falls to a third.
NEAR_COST, UNKNOWN_COST, DECAY = 5.0, 3.0, 0.2
# Cost of a metre on the way out if the robot begins nearer to something than it may be.
ESCAPE_COST = 20.0
# m up to which the laser marks and clears cells, as costmap_2d's defaults.
MARK_RANGE, CLEAR_RANGE = 2.5, 3.0
# Cells around what the map shows where the laser marks nothing: its noise would thicken walls.
EXPLAINED = 1.6
# m of a way ahead that are checked.
AHEAD = 2.5
# m by which a robot that begins too near to something may come nearer.
NEARER = 0.01


class RobotCostmap:
    """Where a round robot can be, on the cells of a map. All arrays have rows along x.

    Args:
        known: the map; if it has more than `MOST_CELLS`, cells are joined.
        radius: of the circle in which the robot turns, m.
        inflation: m from what is in the way beyond which floor costs nothing more.
        allow_unknown: whether ways may lead over unknown cells.

    Raises:
        MapError: the map has no cells.
    """

    def __init__(
        self,
        known: OccupancyMap,
        radius: float,
        inflation: float = 0.55,
        allow_unknown: bool = True,
    ):
        if not known.cells.size:
            raise MapError("the map has no cells")
        self.map = _with_fewer_cells(known)
        self._radius, self._inflation = radius, max(inflation, radius)
        self._cell, cells = self.map.resolution, self.map.cells.T
        self._low = np.array(self.map.origin[:2]) + 0.5 * self._cell
        self._unknown = cells == UNKNOWN
        self._allow_unknown = allow_unknown
        self._standing = cells == OCCUPIED
        self._static = _distances(self._standing) * self._cell
        self._least = radius + SURE * self._cell
        self.clear()

    def clear(self) -> None:
        """Forget what the laser has seen."""
        self._seen = np.zeros_like(self._standing)
        self._distance = self._static

    def see(self, sensor: Pose, angles: ndarray, ranges: ndarray, greatest: float) -> bool:
        """Take a scan; return whether it has changed the costmap.

        Args:
            sensor: pose in the map.
            angles: (n,) of the rays, rad.
            ranges: (n,) m; infinite without a hit; other rays are not used.
            greatest: that the laser can measure, m.
        """
        turn, place = sensor.rotation_matrix(), np.array(sensor.position)
        rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1) @ turn.T
        hit = np.isfinite(ranges) & (ranges > 0.0) & (ranges < greatest)
        clear = np.where(np.isposinf(ranges), greatest, np.where(hit, ranges, 0.0))
        steps = np.arange(0.0, min(CLEAR_RANGE, greatest), self._cell)
        free = steps[None, :] < (clear - 1.5 * self._cell)[:, None]
        points = place[:2] + steps[None, :, None] * rays[:, None, :2]
        seen = self._seen.copy()
        seen.ravel()[self._inside(points[free])] = False
        marked = hit & (ranges < MARK_RANGE)
        cells = self._inside(place[:2] + ranges[marked, None] * rays[marked, :2])
        cells = cells[self._static.ravel()[cells] > EXPLAINED * self._cell]
        seen.ravel()[cells] = True
        return self._remember(seen)

    def mark(self, points: ndarray) -> None:
        """Mark the cells of points (n, 2) as if the laser had seen something there."""
        seen = self._seen.copy()
        seen.ravel()[self._inside(points)] = True
        self._remember(seen)

    def _remember(self, seen: ndarray) -> bool:
        if np.array_equal(seen, self._seen):
            return False
        self._seen = seen
        self._distance = np.minimum(self._static, _distances(seen) * self._cell)
        return True

    def _cells(self, points: Sequence[Any]) -> ndarray:
        return np.round((np.asarray(points)[..., :2] - self._low) / self._cell).astype(int)

    def _inside(self, points: Sequence[Any]) -> ndarray:
        """Return the indices of the cells of points, without those off the map."""
        cells, shape = self._cells(points), self._standing.shape
        cells = cells[np.all((cells >= 0) & (cells < shape), axis=-1)]
        return cells[:, 0] * shape[1] + cells[:, 1]

    def clearance(self, points: Sequence[Any]) -> ndarray:
        """Return the distances (…) in m of points (…, 2) from the nearest occupied cell."""
        cells = self._cells(points).clip(0, np.array(self._standing.shape) - 1)
        return self._distance[tuple(np.moveaxis(cells, -1, 0))]

    def is_free(self, way: Sequence[Point], robot: Sequence[float]) -> bool:
        """Return whether a robot can drive to the next points of a way, as far as is known."""
        way = [(robot[0], robot[1]), *way]
        points, gone = points_of(way, self._cell)
        here = float(self.clearance(robot))
        least = min(self._radius, here - NEARER)
        return bool(np.all(self.clearance(points[gone <= AHEAD]) >= least))

    def _rates(self, robot: Sequence[float]) -> ndarray:
        """Return the costs of a metre in each cell, infinite where the robot cannot be."""
        beyond = self._distance - self._least
        rates = np.where(
            self._distance < self._inflation, 1.0 + NEAR_COST * np.exp(-beyond / DECAY), 1.0
        )
        rates[self._unknown] += UNKNOWN_COST if self._allow_unknown else math.inf
        rates[beyond < 0.0] = math.inf
        # A robot that is too near to something may drive away from it.
        spots = np.indices(self._standing.shape).transpose(1, 2, 0) * self._cell + self._low
        around = np.hypot(*(spots - np.asarray(robot[:2])).transpose(2, 0, 1))
        here = float(self.clearance(robot))
        way_out = (around < self._radius + 2.0 * self._cell) & (self._distance >= here - NEARER)
        rates[way_out & (beyond < 0.0)] = ESCAPE_COST
        rates[around < self._cell] = np.minimum(rates[around < self._cell], ESCAPE_COST)
        return rates

    def plan(self, robot: Sequence[float], goal: Sequence[float]) -> list[Point] | None:
        """Return the cheapest way, both ends included, as points to drive to; None without one."""
        return CostGrid(self._low, self._cell, self._rates(robot), robot).path(goal)

    def why_not(self, goal: Sequence[float]) -> str:
        """Return why there is no way to a goal, in words."""
        x, y = goal[:2]
        if not self._inside([goal]).size:
            return f"the goal ({x:.2f}, {y:.2f}) m is off the map"
        room = float(self.clearance(goal))
        if room < self._least:
            return (
                f"the goal ({x:.2f}, {y:.2f}) m is {room:.2f} m from something; "
                f"the robot needs {self._least:.2f} m"
            )
        return f"no way to ({x:.2f}, {y:.2f}) m is wide enough for a radius of {self._radius:.3g} m"

    def values(self) -> OccupancyMap:
        """Return the costs as costmap_2d publishes them: 100 in the way, 99 too near, down to 0."""
        near = np.exp(-(self._distance - self._least) / DECAY).clip(0.0, 1.0)
        costs = np.where(self._distance < self._inflation, np.floor(98.0 * near), 0.0)
        costs[self._distance < self._least] = 99.0
        costs[self._standing | self._seen] = 100.0
        costs[self._unknown & (costs == 0.0)] = UNKNOWN
        return OccupancyMap(costs.T.astype(np.int8), self._cell, self.map.origin)


def _distances(occupied: ndarray) -> ndarray:
    """Return each cell's distance from the nearest occupied one, in cells; inf without any."""
    # Imported late: most jobs have no map, and it takes a tenth of a second.
    from scipy.ndimage import distance_transform_edt

    if not occupied.any():
        return np.full(occupied.shape, math.inf)
    return distance_transform_edt(~occupied)


def _with_fewer_cells(known: OccupancyMap) -> OccupancyMap:
    """Return a map without unknown edges, of so large cells that there are `MOST_CELLS` at most.

    A joined cell is occupied if one of its cells is, else free if one is.
    """
    # Cells that are neither sure to be free nor occupied are unknown.
    cells = np.where(known.cells > 19, UNKNOWN, known.cells.clip(UNKNOWN, FREE))
    cells[known.cells >= 65] = OCCUPIED
    rows, columns = (np.flatnonzero((cells != UNKNOWN).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        rows, columns = (np.arange(count) for count in cells.shape)
    first = int(rows[0]), int(columns[0])
    cells = cells[first[0] : rows[-1] + 1, first[1] : columns[-1] + 1]
    join = max(1, math.ceil(math.sqrt(cells.size / MOST_CELLS)))
    padding = [(0, -count % join) for count in cells.shape]
    cells = np.pad(cells, padding, constant_values=UNKNOWN)
    blocks = cells.reshape(cells.shape[0] // join, join, cells.shape[1] // join, join)
    cells = blocks.max(axis=(1, 3)).astype(np.int8)
    size = known.resolution
    x, y = known.origin[0] + first[1] * size, known.origin[1] + first[0] * size
    return OccupancyMap(cells, join * size, (x, y, 0.0))
