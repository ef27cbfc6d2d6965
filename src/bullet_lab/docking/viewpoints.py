"""Where to look next for a marker that was not seen yet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.angles import wrap
from bullet_lab.docking.floor_map import FloorMap, Point
from bullet_lab.docking.geometry import View
from bullet_lab.docking.types import PlanarPose

_HEADINGS = np.arange(36) * (math.tau / 36.0)
# Of cells; the finer one where the coarse one finds nothing, as between walls.
_STRIDES = (3, 1)
_NEAR_DOCK = 2.6
_LEAST_CHANCE = 0.02
_SAFE = 0.012
# A look itself takes about so long; it is what makes a sure look worth a longer way.
_LOOK_SECONDS = 3.0
# Kept off the edge of the image, so that the marker is wholly in it after a turn.
_EDGE = math.radians(2.0)


@dataclass(frozen=True)
class Outlook:
    """A place to look from, in the odometry frame.

    Attributes:
        way: points to drive along; a single one for a turn on the spot.
        heading: rad, to look at.
        chance: probability that the marker is to be seen from there.
    """

    way: List[Point]
    heading: float
    chance: float


def chances(points: np.ndarray, ahead: float, docks: np.ndarray, view: View) -> np.ndarray:
    """Return the probability of finding the marker, (n, 36) for each point and heading.

    Args:
        points: (n, 2) of the robot in the odometry frame.
        ahead: m, how far the camera is ahead of the robot's middle.
        docks: (m, 3) in the same frame.
        view: what the camera can do.
    """
    to_dock = docks[None, :, :2] - points[:, None]
    distance = np.hypot(to_dock[..., 0], to_dock[..., 1])
    eyes = points[:, None] + to_dock * (ahead / np.maximum(distance, ahead))[..., None]
    flat = np.concatenate([eyes, np.zeros((*eyes.shape[:2], 1))], axis=-1)
    seen = se2.between(docks[None], flat)
    found = view.open_sight(seen[..., 0], seen[..., 1]) * view.quality(
        np.hypot(seen[..., 0], seen[..., 1])
    )
    bearing = np.arctan2(to_dock[..., 1], to_dock[..., 0])
    reach = view.reach(distance) - _EDGE
    shares = [
        np.mean(found * (np.abs(wrap(bearing - heading)) < reach), axis=1) for heading in _HEADINGS
    ]
    return np.stack(shares, axis=1)


def next_outlook(
    robot: PlanarPose,
    floor: FloorMap,
    docks: np.ndarray,
    view: View,
    ahead: float,
    speed: float,
    turn_speed: float,
) -> Optional[Outlook]:
    """Return where to look next: where most is to be found for the time that it takes.

    None if the marker cannot be seen from any place that is safe to go to.
    """
    for stride in _STRIDES:
        found = _best_outlook(robot, floor, docks, view, ahead, speed, turn_speed, stride)
        if found is not None:
            return found
    return None


def _best_outlook(
    robot, floor: FloorMap, docks, view: View, ahead, speed, turn_speed, stride: int
) -> Optional[Outlook]:
    points = floor.points[::stride, ::stride].reshape(-1, 2)
    costs = floor.costs[::stride, ::stride].ravel()
    safe = floor.touch[::stride, ::stride].ravel() < _SAFE
    if stride == 1:
        away = np.hypot(*(points - docks[:, :2].mean(axis=0)).T)
        safe &= away < _NEAR_DOCK
    points = np.concatenate([[robot[:2]], points[safe]])
    costs = np.concatenate([[0.0], costs[safe]])
    found = chances(points, ahead, docks, view)
    turns = np.abs(wrap(_HEADINGS - robot[2]))
    seconds = costs[:, None] / speed + np.where(costs[:, None] > 0.0, 2.0, turns[None] / turn_speed)
    # Of headings that find as much, the one with the likely place in the middle is best.
    smooth = (np.roll(found, 1, axis=1) + found + np.roll(found, -1, axis=1)) / 3.0
    worth = (found + 0.05 * smooth) / (_LOOK_SECONDS + seconds)
    worth[found < _LEAST_CHANCE] = 0.0
    order = np.argsort(-worth, axis=None)
    for best in order[:40]:
        place, heading = np.unravel_index(best, worth.shape)
        if worth[place, heading] <= 0.0:
            return None
        way = [tuple(robot[:2])] if place == 0 else floor.path(points[place])
        if way is not None:
            return Outlook(way, float(_HEADINGS[heading]), float(found[place, heading]))
    return None
