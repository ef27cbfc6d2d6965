"""Geometry of a dock: walls as boxes on the floor, and the places that see its marker.

In the dock's frame the marker's face is at x = 0, and a robot before it has x < 0 and yaw 0.
"""

from __future__ import annotations

import copy
import itertools
import math

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.docking.database import Dock
from bullet_lab.docking.filter import Viewpoint, corner_points
from bullet_lab.docking.types import CameraMount

# Largest angle between the line of sight and the dock's axis, and px that the marker should be
# away from the image's edges.
_SLANT, _BORDER = math.radians(55.0), 40.0
# px that its corners have to be away from them where it is docked at.
_WHOLE = 6.0
QUIET_ZONE = 0.125
"""Width of a marker's white border, as part of its edge: the whole of it has to be seen."""


def wall_boxes(dock: Dock) -> np.ndarray:
    """Return the walls as (n, 4) boxes x_min, x_max, y_min, y_max in the dock's frame, m."""
    walls = dock.walls
    if walls is None:
        return np.empty((0, 4))
    inner, thick = 0.5 * walls.opening, walls.thickness
    outer = inner + thick
    return np.array(
        [
            [0.0, thick, -outer, outer],
            [-walls.depth, thick, inner, outer],
            [-walls.depth, thick, -outer, -inner],
        ]
    )


def clearance(points, boxes: np.ndarray) -> np.ndarray:
    """Return the distance of (..., 2) points from the nearest of (n, 4) boxes, m; inf without any.

    >>> clearance([[-1.0, 0.0], [3.0, 4.0]], np.array([[-1.0, 0.0, -1.0, 0.0]]))
    array([0., 5.])
    """
    x, y = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    nearest = np.full(x.shape, np.inf)
    for x_min, x_max, y_min, y_max in boxes:
        dx = np.maximum(np.maximum(x_min - x, x - x_max), 0.0)
        dy = np.maximum(np.maximum(y_min - y, y - y_max), 0.0)
        nearest = np.minimum(nearest, np.hypot(dx, dy))
    return nearest


def whole_in_image(
    dock: Dock, camera: PinholeCamera, mount: CameraMount, distances: np.ndarray
) -> np.ndarray:
    """Return at which distances (n,), m, the whole marker is in a camera's image.

    That is for a robot in the dock, wherever the dock's tolerances let it stand.
    """
    off, signs = dock.tolerance, np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    robots = signs * (off.distance, off.lateral, off.yaw) - np.multiply.outer(
        np.asarray(distances, dtype=float) + mount.x, np.array([[1.0, 0.0, 0.0]])
    )
    states = np.concatenate([se2.inverse(robots), np.zeros((*robots.shape[:-1], 2))], axis=-1)
    states[..., 3] = dock.marker.height
    view = Viewpoint(camera, mount)
    pixels = view.pixels(view.optical(corner_points(states, dock.marker.size)))
    edge = np.array([camera.width, camera.height]) - 1.0 - _WHOLE
    return np.all((pixels >= _WHOLE) & (pixels <= edge), axis=(1, 2, 3))


def misfit(dock: Dock, camera: PinholeCamera, mount: CameraMount, farthest: float) -> str:
    """Return why a camera, which finds the marker up to `farthest` m, cannot see it from the dock.

    Empty where it can.
    """
    wanted = dock.docked_distance
    if wanted <= farthest and whole_in_image(dock, camera, mount, [wanted])[0]:
        return ""
    trouble = f"docked_distance is {wanted:g} m, where the camera does not see the whole marker"
    distances = np.arange(1, 1 + int(1e3 * min(farthest, dock.staging_distance))) / 1e3
    possible = distances[whole_in_image(dock, camera, mount, distances)]
    if not len(possible):
        return f"{trouble}, as from no other distance"
    nearest = possible[np.argmin(np.abs(possible - wanted))]
    return f"{trouble}; the nearest distance possible is {nearest:g} m"


class MarkerVisibility:
    """Visibility of a dock's marker for a camera at a height above the floor.

    `height` and the range, `farthest`, are in m.
    """

    def __init__(self, dock: Dock, camera: PinholeCamera, height: float, farthest: float = 4.5):
        self._half = dock.marker.size * (0.5 + QUIET_ZONE)
        self._walls = dock.walls
        self.farthest = farthest
        beside = min(camera.cx, camera.width - 1.0 - camera.cx) - _BORDER
        above = min(camera.cy, camera.height - 1.0 - camera.cy) - 0.25 * _BORDER
        self._half_angle = math.atan(beside / camera.fx)
        rise = abs(dock.marker.height - height) + self._half
        self._nearest = max(rise * camera.fy / above, 2.0 * self._half)

    def up_to(self, farthest: float, half: float) -> MarkerVisibility:
        """Return the same up to another range, of something of half a width, both in m."""
        other = copy.copy(self)
        other.farthest, other._half = farthest, max(half, self._half)
        return other

    def unobstructed(self, x, y) -> np.ndarray:
        """Return whether nothing is between cameras at (x, y) m in the dock's frame and the marker.

        Range and slant count as well, the camera's heading does not. Shapes broadcast.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        before = -x
        good = (before > self._nearest) & (np.hypot(x, y) < self.farthest)
        good &= np.abs(y) < before * math.tan(_SLANT)
        if self._walls is None:
            return good
        inner, depth = 0.5 * self._walls.opening, self._walls.depth
        # Where the line from either edge of the marker passes the walls' front edges.
        along = np.minimum(depth / np.maximum(before, 1e-6), 1.0)
        at_opening = np.abs(y) * along + self._half * (1.0 - along)
        return good & (at_opening < inner)

    def visible(self, cameras: np.ndarray) -> np.ndarray:
        """Return whether (..., 3) cameras in the dock's frame should find the marker."""
        x, y, heading = cameras[..., 0], cameras[..., 1], cameras[..., 2]
        off = np.arctan2(-y, -x) - heading
        off = np.abs(np.arctan2(np.sin(off), np.cos(off)))
        return self.unobstructed(x, y) & (off < self.half_angle(np.hypot(x, y)))

    def in_reach(self, distance, reach) -> np.ndarray:
        """Return whether a marker is found at distances (m) in light that has `reach`.

        That is the share of the range of good light up to which it is. Shapes broadcast.
        """
        return np.asarray(distance) < np.asarray(reach) * self.farthest

    def found(self, cameras: np.ndarray, reach) -> np.ndarray:
        """Return whether (..., 3) cameras in the dock's frame should find the marker in a light."""
        distance = np.hypot(cameras[..., 0], cameras[..., 1])
        return self.visible(cameras) & self.in_reach(distance, reach)

    def half_angle(self, distance) -> np.ndarray:
        """Return how far off the image's middle (rad) a marker at a distance (m) is whole."""
        return self._half_angle - np.arctan2(self._half, np.maximum(distance, 0.1))
