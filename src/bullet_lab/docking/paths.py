"""Safe paths when the dock is not known well, and where to look for its marker next.

A grid in the odometry frame holds the share of the possible docks that a robot at each place would
touch. `bullet_lab.navigation.paths` finds the cheapest paths on it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.geometry import (
    QUIET_ZONE,
    MarkerVisibility,
    clearance,
    extent_of_walls,
    wall_boxes,
)
from bullet_lab.docking.marker_track import MarkerTrack
from bullet_lab.docking.types import TURNING_RADIUS, Odometry
from bullet_lab.navigation.paths import CostGrid, Point, points_of

# Of the grid: edge of a cell, m, and most cells; beyond, the cells are larger.
CELL = 0.1
_MOST_CELLS = 40_000
# Cost of a metre of floor, beside 1: where all possible docks would be touched, and near them, m.
_TOUCH_COST = 300.0
_NEAR_COST = 3.0
_NEAR = 0.22
# Poses of the dock that a costmap is made of, and that views are rated with.
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

_HEADINGS = np.arange(36) * (math.tau / 36.0)
# Strides over the costmap's cells. The finer one is used if the coarse one finds no view, as
# between walls, and only this near to the dock, m.
_STRIDES = (3, 1)
_NEAR_DOCK = 2.6
# Views with a smaller probability are not considered.
_LEAST_PROBABILITY = 0.02
# Most share of the possible docks that a robot at a view may touch.
_SAFE_VIEW = 0.012
# Duration of a look, s: it makes a view of high probability worth a longer way.
_LOOK_SECONDS = 3.0
# Seconds that starting a drive takes.
_START_SECONDS = 2.0
# Most places that are tried, the best first.
_MOST_PLACES = 40
# Distance from the edge of the image, rad, so that the whole marker is in it after a turn.
_EDGE = math.radians(2.0)
# Looks for a larger print of the marker, where the marker itself is too small to be found from
# outside of the walls: how many, and the range of the first one, m.
_MOST_FAR_LOOKS = 14
_FAR = 4.5
# Once something was seen, each range is this part of the one before, but not less, m.
_NEARER = 0.87
_NEAREST = 2.6
# Probability that a look misses a marker that it should find.
_MISSED = 0.25
# Half the width of the largest print, as a share of the walls' opening, and the probability that a
# look misses it.
_WIDEST_PRINT = 0.42
_FAR_MISSED = 0.3

WALL_MARGIN = 0.04
"""Distance that is kept between robot and walls, m."""

ROOM = TURNING_RADIUS + WALL_MARGIN
"""Radius of the circle that the robot is to have for itself, m."""


class Costmap(CostGrid):
    """Risks on a grid of (rows, columns) cells, along x and y of the odometry frame.

    Args:
        robot: (x, y) in the odometry frame; where it stands is free.
        docks: (n, 3) possible poses of the dock in the odometry frame.
        boxes: walls in the dock's frame, see `wall_boxes`.
        obstacles: (m, 4) x, y, radius and probability of other things.
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
        reach: float = 4.0,
    ):
        low = np.minimum(robot[:2], docks[:, :2].min(axis=0)) - reach
        high = np.maximum(robot[:2], docks[:, :2].max(axis=0)) + reach
        cell = max(CELL, math.sqrt(float(np.prod(high - low)) / _MOST_CELLS))
        shape = tuple((np.ceil((high - low) / cell).astype(int) + 1).tolist())
        x = low[0] + cell * np.arange(shape[0])
        y = low[1] + cell * np.arange(shape[1])
        self.points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        self.touch, near = self._risks(docks, boxes, obstacles, cell)
        free = np.hypot(*(self.points - robot[:2]).transpose(2, 0, 1)) < 1.2 * cell
        self.touch[free] = 0.0
        super().__init__(low, cell, 1.0 + _TOUCH_COST * self.touch + _NEAR_COST * near, robot)

    def _risks(self, docks, boxes, obstacles, cell: float):
        """Return the shares of docks that a robot in a cell would touch, and come near to."""
        shape = self.points.shape[:2]
        touch, near = np.zeros(shape), np.zeros(shape)
        flat = np.zeros((*shape, 3))
        flat[..., :2] = self.points

        def add(away: ndarray, weight: float, cells: Any = ...) -> None:
            touch[cells][away < ROOM] += weight
            near[cells][away < ROOM + _NEAR] += weight

        reach = extent_of_walls(boxes) + ROOM + _NEAR
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
        self._probes = 0

    def costmap(self) -> Costmap:
        """Return the costmap of the floor as it is believed to be now."""
        docks = self._belief.samples(_SAMPLES)
        return Costmap(self._belief.pose[:2], docks, self._boxes, self._obstacles())

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
        return rows[away > ROOM]

    def _ahead_of_robot(self, way, begin: float = 0.15) -> ndarray:
        """Return points of a path from `begin` (m) on; the robot occupies what is before."""
        points, travelled = points_of(way, 0.05)
        return points[(travelled > begin) & (travelled < 1.6)]

    def way_to_staging(self, estimate: GaussianPose) -> list[Point] | None:
        """Return a safe path to a point on the axis before the dock; None if there is none.

        The point is near enough to find the marker, or else at the database's distance.
        """
        staging, visibility = self._dock.staging_distance, self._belief.visibility
        way, walls = None, self._dock.walls
        if visibility is not None:
            room = (0.0 if walls is None else walls.depth) + TURNING_RADIUS + _ROOM_TO_TURN
            near = min(staging, max(room, 0.9 * visibility.farthest + self._belief.mount.x))
            way = self._safe_way(estimate, (-near, 0.0, 0.0))
        return way or self._safe_way(estimate, (-staging, 0.0, 0.0))

    def way_aside(self, estimate: GaussianPose, to_the_left: bool) -> list[Point] | None:
        """Return a safe path to the same distance, but beside the axis; None if there is none.

        A flat marker looks narrower with the square of the viewing angle: on its axis, that shows
        little of its yaw. The left side of the axis is tried first, or the right one.
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


class NextView(NamedTuple):
    """A place to look from, in the odometry frame."""

    way: list[Point]  #: points (m, m) to drive along; a single one for a turn on the spot
    heading: float  #: rad, to look at


class MarkerSearch:
    """Searches for a dock's marker: rates views, and learns from those that found nothing."""

    def __init__(self, belief: DockBelief, paths: PathPlanner):
        self._belief, self._paths = belief, paths
        self._ahead = belief.mount.x
        self._far_looks, self._far_range = 0, _FAR
        self._far_visibility: MarkerVisibility | None = None
        # Result of `chance_to_see`, which is asked for several times, and the odometry then.
        self._chance: tuple[Odometry | None, float] = (None, 0.0)
        # The copy that narrowed the belief last, and in how many images it was then.
        self._cue: tuple[MarkerTrack | None, int] = (None, 0)

    def chance_to_see(self) -> float:
        """Return the probability that an image taken now would show the marker, or its copy."""
        odometry, particles = self._belief.odometry.last, self._belief.particles
        if self._chance[0] is not odometry:
            visibility = self._far_visibility or self._belief.visibility
            visible = visibility.visible(self._cameras(particles.poses))
            self._chance = odometry, float(particles.weights @ visible)
        return self._chance[1]

    def expects_marker(self) -> bool:
        """Return whether an image taken now should show the marker that was seen before."""
        estimate = self._belief.estimate()
        if estimate is None:
            return False
        return bool(self._belief.visibility.visible(self._cameras(estimate.mean)))

    def _cameras(self, docks: ndarray) -> ndarray:
        """Return the camera's poses (..., 3) against docks (..., 3) in the robot's frame."""
        return se2.between(docks, (self._ahead, 0.0, 0.0))

    def add_failed_look(self) -> None:
        """Learn from a look that found nothing."""
        looks = [(self._belief.visibility, _MISSED, True)]
        if self._far_visibility is not None and not self._belief.copies_seen():
            looks.append((self._far_visibility, _FAR_MISSED, False))
        particles = self._belief.particles
        for visibility, missed, counts in looks:
            expected = visibility.found(self._cameras(particles.poses), particles.reach)
            particles.learn(1.0 - (1.0 - missed) * expected, counts)

    def use_cue(self) -> bool:
        """Narrow the belief by a copy on the dock's back wall, and return whether there is one.

        A copy where only the dock can be is on its wall: the dock fills that place.
        """
        found = self._belief.copy
        if found is None:
            return False
        used, frames = self._cue
        if used is not found or found.frames > 1.3 * frames:
            self._cue = found, found.frames
            walls = self._belief.dock.walls
            margin = 0.1 if walls is None else 0.5 * (walls.opening - found.likeliest_size())
            self._belief.concentrate(found.likeliest(), max(margin, 0.03))
        return True

    def next_view(self) -> NextView | None:
        """Return where to look next; None if nothing can be seen from a safe place.

        If the marker is too far to be found, look for a larger print, whose size shows on the way.
        The walls hide a larger print on the back wall sooner than the marker. Once something was
        seen, each look is from nearer than the one before.
        """
        view = self._best_view(self._belief.visibility)
        walls = self._belief.dock.walls
        half = 0.0 if walls is None else _WIDEST_PRINT * walls.opening
        while view is None and self._far_looks < _MOST_FAR_LOOKS:
            self._far_looks += 1
            if self._belief.copies_seen():
                self._far_range = max(_NEARER * self._far_range, _NEAREST)
            self._far_visibility = self._belief.visibility.up_to(self._far_range, half)
            view = self._best_view(self._far_visibility)
            if view is None:
                self._far_range = _FAR
        return view

    def _best_view(self, visibility: MarkerVisibility) -> NextView | None:
        """Return the view that finds most for the time it takes, or None; see `next_view`."""
        costmap, robot, settings = self._paths.costmap(), self._belief.pose, self._belief.settings
        docks, reach = self._belief.particles.samples(_SAMPLES)
        docks = se2.compose(robot, docks)
        for stride in _STRIDES:
            points = costmap.points[::stride, ::stride].reshape(-1, 2)
            costs = costmap.costs[::stride, ::stride].ravel()
            safe = costmap.touch[::stride, ::stride].ravel() < _SAFE_VIEW
            if stride == 1:
                safe &= np.hypot(*(points - docks[:, :2].mean(axis=0)).T) < _NEAR_DOCK
            points = np.concatenate([[robot[:2]], points[safe]])
            costs = np.concatenate([[0.0], costs[safe]])[:, None]
            turning = np.abs(wrap(_HEADINGS - robot[2])) / settings.turn_speed
            seconds = costs / settings.drive_speed
            seconds = seconds + np.where(costs > 0.0, _START_SECONDS, turning[None])
            found = self._probabilities(points, docks, reach, visibility)
            view = self._first_safe(points, costmap, _worth(found, seconds))
            if view is not None:
                return view
        return None

    def _probabilities(
        self, points: ndarray, docks: ndarray, reach: ndarray, visibility: MarkerVisibility
    ) -> ndarray:
        """Return the probability of finding the marker, (n, 36) for each point and heading.

        The robot is at `points` (n, 2); `docks` are (m, 3), in light that has `reach` (m,).
        """
        to_dock = docks[None, :, :2] - points[:, None]
        distance = np.hypot(to_dock[..., 0], to_dock[..., 1])
        ahead = self._ahead / np.maximum(distance, self._ahead)
        eyes = points[:, None] + to_dock * ahead[..., None]
        flat = np.pad(eyes, ((0, 0), (0, 0), (0, 1)))
        x, y, _ = se2.columns(se2.between(docks[None], flat))
        found = visibility.unobstructed(x, y) & (np.hypot(x, y) < reach * visibility.farthest)
        shares, some = np.zeros((len(points), len(_HEADINGS))), found.any(axis=1)
        found, (x, y) = found[some], se2.columns(to_dock[some])
        bearing, aside = np.arctan2(y, x), visibility.half_angle(distance[some]) - _EDGE
        for index, heading in enumerate(_HEADINGS):
            off = np.abs(bearing - heading)
            ahead = np.minimum(off, np.abs(math.tau - off)) < aside
            shares[some, index] = np.mean(found & ahead, axis=1)
        return shares

    def _first_safe(self, points: ndarray, costmap: Costmap, worth: ndarray) -> NextView | None:
        """Return the best view with a safe path; the robot is at the first point."""
        headings = np.argmax(worth, axis=1)
        # Each place once: the next best headings there are refused for the same path.
        for place in np.argsort(-worth.max(axis=1))[:_MOST_PLACES]:
            heading = headings[place]
            if worth[place, heading] <= 0.0:
                return None
            way = costmap.path(points[place]) if place else [tuple(points[0].tolist())]
            if way is not None and self._paths.is_safe(way):
                return NextView(way, float(_HEADINGS[heading]))
        return None


def _worth(found: ndarray, seconds: ndarray) -> ndarray:
    """Return the probability per time of views (n, 36), 0 where the probability is small."""
    # Of headings with the same probability, the one with the likely place in the middle is best.
    smooth = (np.roll(found, 1, axis=1) + found + np.roll(found, -1, axis=1)) / 3.0
    worth = (found + 0.05 * smooth) / (_LOOK_SECONDS + seconds)
    worth[found < _LEAST_PROBABILITY] = 0.0
    return worth
