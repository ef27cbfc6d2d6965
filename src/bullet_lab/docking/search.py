"""Search for a marker that was not seen yet: where to look next (next best view)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.se2 import wrap
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.geometry import MarkerVisibility
from bullet_lab.docking.marker_track import MarkerTrack
from bullet_lab.docking.paths import Costmap, PathPlanner
from bullet_lab.docking.types import Odometry, Point

_HEADINGS = np.arange(36) * (math.tau / 36.0)
# Strides over the costmap's cells. The finer one is used if the coarse one finds no view, as
# between walls, and only this near to the dock, m.
_STRIDES = (3, 1)
_NEAR_DOCK = 2.6
# Views with a smaller probability are not considered.
_LEAST_PROBABILITY = 0.02
# Most share of the possible docks that a robot at a view may touch.
_SAFE = 0.012
# Duration of a look, s: it makes a view of high probability worth a longer way.
_LOOK_SECONDS = 3.0
# Seconds that starting a drive takes.
_START_SECONDS = 2.0
# Most places that are tried, the best first.
_MOST_PLACES = 40
# Distance from the edge of the image, rad, so that the whole marker is in it after a turn.
_EDGE = math.radians(2.0)
# Poses of the dock that views are rated with.
_SAMPLES = 120
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


class NextView(NamedTuple):
    """A place to look from, in the odometry frame."""

    way: list[Point]  #: points (m, m) to drive along; a single one for a turn on the spot
    heading: float  #: rad, to look at


class MarkerSearch:
    """Searches for a dock's marker: rates views, and learns from those that found nothing.

    Args:
        belief: of the dock's pose; looks that find nothing change it.
        paths: plans the robot's paths.
    """

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
            particles.add_failed_look(expected, missed, counts)

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
            safe = costmap.touch[::stride, ::stride].ravel() < _SAFE
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
        self,
        points: ndarray,
        docks: ndarray,
        reach: ndarray,
        visibility: MarkerVisibility,
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
