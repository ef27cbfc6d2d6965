"""Occupancy grids, their files in the format of map_server, and a robot's costmap on one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Sequence, Tuple

import cv2
import numpy as np
import yaml
from numpy import ndarray

from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.errors import LabError
from bullet_lab.navigation.paths import CostGrid, Point, points_of

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Values of cells."""

# Grey levels of the three in an image, as map_saver writes them.
_FREE_LEVEL, _OCCUPIED_LEVEL, _UNKNOWN_LEVEL = 254, 0, 205
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196

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

# What a file raises that is no map.
_UNREADABLE = (
    TypeError,
    ValueError,
    ArithmeticError,
    AttributeError,
    RecursionError,
    yaml.YAMLError,
)


class MapError(LabError):
    """A map cannot be read or used."""


@dataclass(frozen=True)
class OccupancyMap:
    """A grid of the floor, with rows along y and columns along x."""

    cells: ndarray  #: int8: 0 free to 100 occupied, -1 unknown
    resolution: float  #: edge of a cell, m
    origin: PlanarPose = (0.0, 0.0, 0.0)  #: of the first cell's lower left corner: m, m, rad

    def extent(self) -> Tuple[float, float, float, float]:
        """Return left, right, bottom and top in m, as of matplotlib's `imshow`."""
        (rows, columns), (x, y, _) = self.cells.shape, self.origin
        return x, x + columns * self.resolution, y, y + rows * self.resolution

    def sorted_into(self, free: int, occupied: int, unknown: int) -> ndarray:
        """Return values for the cells that are surely free, those that are occupied, and others."""
        is_free = (self.cells >= 0) & (self.cells <= 19)
        return np.where(is_free, free, np.where(self.cells >= 65, occupied, unknown))

    def levels(self) -> ndarray:
        """Return the grey levels of an image, (rows from above, columns) uint8."""
        levels = self.sorted_into(_FREE_LEVEL, _OCCUPIED_LEVEL, _UNKNOWN_LEVEL)
        return levels[::-1].astype(np.uint8)

    def pgm(self) -> bytes:
        """Return the content of the image file."""
        rows, columns = self.cells.shape
        return f"P5\n{columns} {rows}\n255\n".encode() + self.levels().tobytes()

    def yaml(self, image: str) -> str:
        """Return the content of the YAML file beside an image of that name."""
        x, y, yaw = self.origin
        return (
            f"image: {image}\nresolution: {self.resolution:.6f}\n"
            f"origin: [{x:.6f}, {y:.6f}, {yaw:.6f}]\nnegate: 0\n"
            f"occupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {FREE_THRESHOLD}\n"
        )


def read_map(path: Path) -> OccupancyMap:
    """Read the YAML file of a map and its image; raises MapError."""
    if path.suffix not in (".yaml", ".yml"):
        raise MapError(f"the map is '{path}'; it must be a YAML file, such as that of the job map")
    try:
        content = yaml.safe_load(path.read_text())
        image = path.parent / str(content["image"])
        resolution, origin = float(content["resolution"]), tuple(map(float, content["origin"]))
        negate = bool(int(content.get("negate", 0)))
        occupied = float(content.get("occupied_thresh", OCCUPIED_THRESHOLD))
        free = float(content.get("free_thresh", FREE_THRESHOLD))
        mode = str(content.get("mode", "trinary"))
    except OSError as error:
        raise MapError(f"cannot read {path}: {error.strerror}") from error
    except KeyError as error:
        raise MapError(f"{path}: {error.args[0]} is missing") from error
    except _UNREADABLE as error:
        raise MapError(f"{path} is no map: {error}".split("\n")[0]) from error
    is_finite = all(map(math.isfinite, (resolution, *origin, occupied, free)))
    if len(origin) != 3 or not is_finite or resolution <= 0.0 or mode != "trinary":
        allowed = "a resolution > 0, an origin of 3 finite numbers, the mode trinary"
        raise MapError(f"{path}: needs {allowed}")
    levels = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    if levels is None or levels.dtype != np.uint8:
        raise MapError(f"{path}: cannot read the image {image}; it must be one of 8 bits, as PGM")
    # As in map_server, the mean of all channels counts.
    grey = np.atleast_3d(levels).mean(axis=2)
    share = (grey if negate else 255.0 - grey) / 255.0
    values = np.where(share > occupied, OCCUPIED, np.where(share < free, FREE, UNKNOWN))
    return OccupancyMap(values.astype(np.int8)[::-1], resolution, origin)


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

    def see(self, sensor: Pose, angles: ndarray, ranges: ndarray, greatest: float) -> None:
        """Take a scan.

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
        marked = hit & (ranges < MARK_RANGE)
        cells = self._inside(place[:2] + ranges[marked, None] * rays[marked, :2])
        cells = cells[self._static.ravel()[cells] > EXPLAINED * self._cell]
        self._remember(cells, self._inside(points[free]))

    def mark(self, points: ndarray) -> None:
        """Mark the cells of points (n, 2) as if the laser had seen something there."""
        self._remember(self._inside(points))

    def _remember(self, marked: ndarray, cleared: ndarray | None = None) -> None:
        """Mark cells by their indices, after others are cleared."""
        seen = self._seen.copy()
        if cleared is not None:
            seen.ravel()[cleared] = False
        seen.ravel()[marked] = True
        if not np.array_equal(seen, self._seen):
            self._seen = seen
            self._distance = np.minimum(self._static, _distances(seen) * self._cell)

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
        way = "way" if self._allow_unknown else "way over known floor"
        place, radius = f"({x:.2f}, {y:.2f}) m", f"{self._radius:.3g} m"
        return f"no {way} to {place} is wide enough for a radius of {radius}"

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
    cells = known.sorted_into(FREE, OCCUPIED, UNKNOWN).astype(np.int8)
    left, low, width, height = cv2.boundingRect((cells != UNKNOWN).astype(np.uint8))
    if width:
        cells = cells[low : low + height, left : left + width]
    join = max(1, math.ceil(math.sqrt(cells.size / MOST_CELLS)))
    for axis, count in enumerate(cells.shape):
        cells = np.maximum.reduceat(cells, np.arange(0, count, join), axis)
    size = known.resolution
    x, y = known.origin[0] + left * size, known.origin[1] + low * size
    return OccupancyMap(cells, join * size, (x, y, 0.0))
