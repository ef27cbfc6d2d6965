"""Next best view: where to look next for a marker that was not seen yet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, List, Optional

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.docking.costmap import Costmap
from bullet_lab.docking.geometry import MarkerVisibility
from bullet_lab.docking.types import Point

_HEADINGS = np.arange(36) * (math.tau / 36.0)
# Of cells; the finer one where the coarse one finds nothing, as between walls.
_STRIDES = (3, 1)
_NEAR_DOCK = 2.6
_LEAST_PROBABILITY = 0.02
_SAFE = 0.012
# A look itself takes about so long; it is what makes a sure look worth a longer way.
_LOOK_SECONDS = 3.0
# Places that are tried, from the best on.
_MOST_PLACES = 40
# Kept off the edge of the image, so that the marker is wholly in it after a turn.
_EDGE = math.radians(2.0)


@dataclass(frozen=True)
class NextView:
    """A place to look from, in the odometry frame."""

    way: List[Point]  #: points (m, m) to drive along; a single one for a turn on the spot
    heading: float  #: rad, to look at
    probability: float  #: that the marker is found from there


def detection_probabilities(
    points: np.ndarray,
    ahead: float,
    docks: np.ndarray,
    reach: np.ndarray,
    visibility: MarkerVisibility,
) -> np.ndarray:
    """Return the probability of finding the marker, (n, 36) for each point and heading.

    The robot is at `points` (n, 2), its camera `ahead` of its middle, m; `docks` are (m, 3), in
    light that has `reach` (m,).
    """
    to_dock = docks[None, :, :2] - points[:, None]
    distance = np.hypot(to_dock[..., 0], to_dock[..., 1])
    eyes = points[:, None] + to_dock * (ahead / np.maximum(distance, ahead))[..., None]
    flat = np.pad(eyes, ((0, 0), (0, 0), (0, 1)))
    x, y, _ = np.moveaxis(se2.between(docks[None], flat), -1, 0)
    found = visibility.unobstructed(x, y) & visibility.in_reach(np.hypot(x, y), reach)
    bearing = np.arctan2(to_dock[..., 1], to_dock[..., 0])
    aside = visibility.half_angle(distance) - _EDGE
    shares = [
        np.mean(found * (np.abs(wrap(bearing - heading)) < aside), axis=1) for heading in _HEADINGS
    ]
    return np.stack(shares, axis=1)


def next_best_view(
    robot: PlanarPose,
    costmap: Costmap,
    docks: np.ndarray,
    reach: np.ndarray,
    visibility: MarkerVisibility,
    ahead: float,
    speed: float,
    turn_speed: float,
    is_safe: Callable[[List[Point]], bool],
) -> Optional[NextView]:
    """Return where to look next: where most is to be found for the time that it takes.

    Args:
        robot: its pose in the odometry frame.
        costmap: of the floor about it.
        docks: (m, 3) thinkable poses of the dock in the odometry frame.
        reach: (m,) of the light there, as `MarkerVisibility.in_reach` takes it.
        visibility: of the marker; None is returned if no safe place has any.
        ahead: m, how far the camera is ahead of the robot's middle.
        speed: m/s.
        turn_speed: rad/s.
        is_safe: says of a way whether it will be driven; no other is returned.
    """
    for stride in _STRIDES:
        points = costmap.points[::stride, ::stride].reshape(-1, 2)
        costs = costmap.costs[::stride, ::stride].ravel()
        safe = costmap.touch[::stride, ::stride].ravel() < _SAFE
        if stride == 1:
            safe &= np.hypot(*(points - docks[:, :2].mean(axis=0)).T) < _NEAR_DOCK
        points = np.concatenate([[robot[:2]], points[safe]])
        costs = np.concatenate([[0.0], costs[safe]])[:, None]
        turns = np.abs(wrap(_HEADINGS - robot[2]))
        seconds = costs / speed + np.where(costs > 0.0, 2.0, turns[None] / turn_speed)
        found = detection_probabilities(points, ahead, docks, reach, visibility)
        view = _best_view(points, costmap, found, seconds, is_safe)
        if view is not None:
            return view
    return None


def _best_view(
    points: np.ndarray,
    costmap: Costmap,
    found: np.ndarray,
    seconds: np.ndarray,
    is_safe: Callable[[List[Point]], bool],
) -> Optional[NextView]:
    """Return the view of most worth; the robot is at the first point."""
    # Of headings that find as much, the one with the likely place in the middle is best.
    smooth = (np.roll(found, 1, axis=1) + found + np.roll(found, -1, axis=1)) / 3.0
    worth = (found + 0.05 * smooth) / (_LOOK_SECONDS + seconds)
    worth[found < _LEAST_PROBABILITY] = 0.0
    headings = np.argmax(worth, axis=1)
    # Each place once: the next best headings there are refused for the same way.
    for place in np.argsort(-worth.max(axis=1))[:_MOST_PLACES]:
        heading = headings[place]
        if worth[place, heading] <= 0.0:
            return None
        way = costmap.path(points[place]) if place else [tuple(points[0].tolist())]
        if way is not None and is_safe(way):
            return NextView(way, float(_HEADINGS[heading]), float(found[place, heading]))
    return None
