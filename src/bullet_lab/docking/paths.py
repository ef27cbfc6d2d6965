"""Safe paths: the risk of each place when the dock is not known well, and paths over the floor.

A grid in the odometry frame holds the share of the possible docks that a robot at each place would
touch. `bullet_lab.navigation.paths` finds the cheapest paths on it.
"""

from __future__ import annotations

import math
from typing import Any, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.geometry import QUIET_ZONE, clearance, extent_of_walls, wall_boxes
from bullet_lab.docking.types import TURNING_RADIUS, Point
from bullet_lab.navigation.paths import CostGrid, points_of

# Of the grid: edge of a cell, m, and most cells; beyond, the cells are larger.
CELL = 0.1
_MOST_CELLS = 40_000
# Cost of a metre of floor, beside 1: where all possible docks would be touched, and near them, m.
_TOUCH_COST = 300.0
_NEAR_COST = 3.0
_NEAR = 0.22
# Poses of the dock that a costmap is made of.
_SAMPLES = 120
# Share of the possible docks that a robot may touch.
_RISKY = 0.03
# A path is unsafe from its start if it leads nearer to a wall than the robot is, by so much, m.
_NEARER_WALL = 0.01
# Length of a drive that shows the size of a print, m, and how many there are at most.
_PROBE = 0.6
_MOST_PROBES = 6
# Least distance of the circle in which the robot turns from the walls' front edges, m.
_ROOM_TO_TURN = 0.17
# Angle from the axis at which the marker is viewed from aside: share of the angle at which the
# walls begin to hide it, and most, rad.
_ASIDE = 0.85
_FARTHEST_ASIDE = math.radians(35.0)

WALL_MARGIN = 0.04
"""Distance that is kept between robot and walls, m."""


class Costmap(CostGrid):
    """Risks on a grid of (rows, columns) cells, along x and y of the odometry frame.

    Args:
        robot: (x, y) in the odometry frame; where it stands is free.
        docks: (n, 3) possible poses of the dock in the odometry frame.
        boxes: walls in the dock's frame, see `wall_boxes`.
        obstacles: (m, 4) x, y, radius and probability of other things.
        radius: of the circle that the robot is to have for itself, m.
        reach: how far the map goes beyond robot and docks, m.

    Attributes:
        points: (rows, columns, 2) of the cells' middles, m.
        touch: (rows, columns) share of the docks that a robot there would touch.
    """

    def __init__(
        self,
        robot: Sequence[float],
        docks: ndarray,
        boxes: ndarray,
        obstacles: ndarray,
        radius: float,
        reach: float = 4.0,
    ):
        low = np.minimum(robot[:2], docks[:, :2].min(axis=0)) - reach
        high = np.maximum(robot[:2], docks[:, :2].max(axis=0)) + reach
        cell = max(CELL, math.sqrt(float(np.prod(high - low)) / _MOST_CELLS))
        shape = tuple((np.ceil((high - low) / cell).astype(int) + 1).tolist())
        x = low[0] + cell * np.arange(shape[0])
        y = low[1] + cell * np.arange(shape[1])
        self.points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        self.touch, near = self._risks(docks, boxes, obstacles, radius, cell)
        free = np.hypot(*(self.points - robot[:2]).transpose(2, 0, 1)) < 1.2 * cell
        self.touch[free] = 0.0
        super().__init__(low, cell, 1.0 + _TOUCH_COST * self.touch + _NEAR_COST * near, robot)

    def _risks(self, docks, boxes, obstacles, radius: float, cell: float):
        """Return the shares of docks that a robot in a cell would touch, and come near to."""
        shape = self.points.shape[:2]
        touch, near = np.zeros(shape), np.zeros(shape)
        flat = np.zeros((*shape, 3))
        flat[..., :2] = self.points

        def add(away: ndarray, weight: float, cells: Any = ...) -> None:
            touch[cells][away < radius] += weight
            near[cells][away < radius + _NEAR] += weight

        reach = extent_of_walls(boxes) + radius + _NEAR
        for dock in docks if len(boxes) else ():
            low = np.maximum((dock[:2] - reach - flat[0, 0, :2]) / cell, 0.0).astype(int).tolist()
            cells = tuple(slice(first, first + 3 + int(2.0 * reach / cell)) for first in low)
            away = clearance(se2.between(dock, flat[cells])[..., :2], boxes)
            add(away, 1.0 / len(docks), cells)
        for x, y, size, weight in obstacles:
            add(np.hypot(self.points[..., 0] - x, self.points[..., 1] - y) - size, weight)
        return touch, near

    def risk(self, points: ndarray) -> float:
        """Return the largest share of docks that a robot at any of (n, 2) points would touch."""
        return float(np.max(self.touch.ravel()[self._index(points)], initial=0.0))


class PathPlanner:
    """Plans paths that are safe for all the likely poses of the dock."""

    def __init__(self, belief: DockBelief):
        self._belief, self._dock = belief, belief.dock
        self._boxes = wall_boxes(belief.dock)
        # Of the circle that the robot is to have for itself, m.
        self._radius = TURNING_RADIUS + WALL_MARGIN
        self._probes = 0

    def costmap(self) -> Costmap:
        """Return the costmap of the floor as it is believed to be now."""
        return Costmap(
            self._belief.pose[:2],
            self._belief.samples(_SAMPLES),
            self._boxes,
            self._obstacles(),
            self._radius,
        )

    def is_safe(self, way: Sequence[Point]) -> bool:
        """Return whether the next 1.5 m of a path are safe by the present belief."""
        points = self._ahead_of_robot([self._belief.pose[:2], *way], 0.0)
        if not len(points):
            return True
        docks, radius = self._belief.samples(_SAMPLES), TURNING_RADIUS
        flat = np.column_stack([points, np.zeros(len(points))])
        away = clearance(se2.between(docks[:, None], flat[None])[..., :2], self._boxes)
        # The robot's place is free even if its circle touches; nearer to a wall may not be.
        here = clearance(
            se2.between(docks, np.array([*self._belief.pose[:2], 0.0]))[..., :2], self._boxes
        )
        touched = (away < radius) & (away < here[:, None] - _NEARER_WALL)
        if float(np.max(np.mean(touched, axis=0), initial=0.0)) > 2.0 * _RISKY:
            return False
        return not any(
            weight > 0.3 and np.any(np.hypot(*(points - (x, y)).T) < size + radius)
            for x, y, size, weight in self._obstacles()
        )

    def _obstacles(self) -> ndarray:
        """Return the obstacles (n, 4) of `DockBelief.obstacles` that are not where the robot is.

        A print of unknown size could otherwise be a tiny one right before the camera.
        """
        rows = self._belief.obstacles()
        away = np.hypot(*(rows[:, :2] - self._belief.pose[:2]).T) - rows[:, 2]
        return rows[away > self._radius]

    def _ahead_of_robot(self, way, begin: float = 0.15) -> ndarray:
        """Return points of a path from `begin` (m) on; the robot occupies what is before."""
        points, travelled = points_of(way, 0.05)
        return points[(travelled > begin) & (travelled < 1.6)]

    def way_to_staging(self, estimate: GaussianPose) -> list[Point] | None:
        """Return a safe path to a point on the axis before the dock; None if there is none.

        The point is near enough to find the marker, or else at the database's distance.
        """
        staging, visibility = self._dock.staging_distance, self._belief.visibility
        way = None
        if visibility is not None:
            room = self._dock.depth + TURNING_RADIUS + _ROOM_TO_TURN
            near = min(staging, max(room, 0.9 * visibility.farthest + self._belief.mount.x))
            way = self._safe_way(estimate, (-near, 0.0, 0.0))
        return way or self._safe_way(estimate, (-staging, 0.0, 0.0))

    def way_aside(self, estimate: GaussianPose, to_the_left: bool) -> list[Point] | None:
        """Return a safe path to the same distance, but beside the axis; None if there is none.

        A flat marker looks narrower with the square of the viewing angle: on its axis, that shows
        little of its yaw.

        Args:
            estimate: of the dock.
            to_the_left: try this side of the axis first.
        """
        walls, before = self._dock.walls, float(np.hypot(*estimate.robot[:2]))
        angle = _FARTHEST_ASIDE
        if walls is not None:
            free = 0.5 * walls.opening - self._dock.marker.size * (0.5 + QUIET_ZONE)
            angle = min(angle, _ASIDE * math.atan2(free, walls.depth))
        for side in (angle, -angle) if to_the_left else (-angle, angle):
            way = self._safe_way(estimate, (-before * math.cos(side), before * math.sin(side), 0.0))
            if way is not None:
                return way
        return None

    def _safe_way(self, estimate: GaussianPose, there: PlanarPose) -> list[Point] | None:
        """Return a safe path to a pose in the dock's frame; None if there is none."""
        costmap = self.costmap()
        goal = se2.compose(self._belief.pose, se2.compose(estimate.mean, there))
        way = costmap.path(goal.tolist())
        safe = way is not None and costmap.risk(self._ahead_of_robot(way)) <= 2.0 * _RISKY
        return way if safe else None

    def choose_probe(self) -> float:
        """Return how far (m) to drive ahead or, negative, back; 0 if not safe or often enough.

        It shows how the size of what is seen changes.
        """
        if self._probes >= _MOST_PROBES:
            return 0.0
        pose, costmap = self._belief.pose, self.costmap()
        heading = np.array([math.cos(pose[2]), math.sin(pose[2])])
        for way in (-_PROBE, _PROBE):
            points = np.asarray(pose[:2]) + np.linspace(0.2, 1.0, 9)[:, None] * way * heading
            if costmap.risk(points) < _RISKY:
                self._probes += 1
                return way
        return 0.0
