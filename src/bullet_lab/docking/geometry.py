"""Geometry of a dock: its walls on the floor, its marker in an image, and from where it is seen.

In the dock's frame the marker's face is at x = 0, and a robot before it has x < 0 and yaw 0.
"""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.se2 import PlanarPose, columns
from bullet_lab.docking.database import Dock
from bullet_lab.docking.types import CameraMount
from bullet_lab.navigation.paths import Point

# Largest angle between the line of sight and the dock's axis, and px that the marker should be
# away from the image's edges.
_SLANT, _BORDER = math.radians(55.0), 40.0
# Size in the image at which it should be found, px.
_FOUND_SIZE = 18.0
# px that its corners have to be away from them where it is docked at.
_WHOLE = 6.0
QUIET_ZONE = 0.125
"""Width of a marker's white border, as part of its edge: the whole of it has to be seen."""


def wall_boxes(dock: Dock) -> ndarray:
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


def extent_of_walls(boxes: ndarray) -> float:
    """Return the distance (m) from the dock's origin beyond which there are no boxes (n, 4)."""
    return math.hypot(*np.abs(boxes.reshape(-1, 2, 2)).max(axis=(0, 2), initial=0.0))


def clearance(points, boxes: ndarray) -> ndarray:
    """Return the distance of (..., 2) points from the nearest of (n, 4) boxes, m; inf without any.

    >>> clearance([[-1.0, 0.0], [3.0, 4.0]], np.array([[-1.0, 0.0, -1.0, 0.0]]))
    array([0., 5.])
    """
    x, y = columns(points)
    squares = np.full(x.shape, np.inf)
    for x_min, x_max, y_min, y_max in boxes:
        dx = np.maximum(np.maximum(x_min - x, x - x_max), 0.0)
        dy = np.maximum(np.maximum(y_min - y, y - y_max), 0.0)
        squares = np.minimum(squares, dx * dx + dy * dy)
    return np.sqrt(squares)


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A camera as it was when it took an image, seen from the robot as it is now."""

    camera: PinholeCamera
    mount: CameraMount
    moved: PlanarPose = (0.0, 0.0, 0.0)  #: the robot then, in its present frame

    def optical(self, points: ndarray) -> ndarray:
        """Turn (..., 3) points of the robot's present frame into the optical frame, m."""
        cos, sin = math.cos(self.moved[2]), math.sin(self.moved[2])
        x, y = points[..., 0] - self.moved[0], points[..., 1] - self.moved[1]
        then, optical = points.astype(float), np.empty(points.shape)
        then[..., 0], then[..., 1] = cos * x + sin * y, cos * y - sin * x
        there = (then - (self.mount.x, self.mount.y, self.mount.z)) @ self.mount.rotation
        optical[..., 0], optical[..., 1] = -there[..., 1], -there[..., 2]
        optical[..., 2] = there[..., 0]
        return optical

    def pixels(self, optical: ndarray) -> ndarray:
        """Return (..., 2) pixels of (..., 3) points of the optical frame."""
        return self.camera.project(optical.reshape(-1, 3)).reshape(*optical.shape[:-1], 2)

    @property
    def origin(self) -> ndarray:
        """Place (3,) of the camera at the time of the image, in the robot's present frame, m."""
        x, y = self._turn(self.mount.x, self.mount.y)
        return np.array([self.moved[0] + x, self.moved[1] + y, self.mount.z])

    def _turn(self, x: float, y: float) -> Point:
        """Turn a direction of the robot then into its present frame."""
        cos, sin = math.cos(self.moved[2]), math.sin(self.moved[2])
        return cos * x - sin * y, sin * x + cos * y

    def line_of_sight(self, corners: ndarray, size: float) -> tuple[ndarray, float]:
        """Return the direction (3,) of a marker in the robot's frame, and its range in m.

        The direction is scaled to unit length on the floor. A slanted marker is narrower than it
        is tall, so the range comes from its height.
        """
        camera, (u, v) = self.camera, np.mean(corners, axis=0)
        ahead = np.array([1.0, (camera.cx - u) / camera.fx, (camera.cy - v) / camera.fy])
        *flat, rise = self.mount.rotation @ ahead
        x, y = self._turn(*flat)
        tall = 0.5 * (np.hypot(*(corners[3] - corners[0])) + np.hypot(*(corners[2] - corners[1])))
        depth = camera.fy * size / max(float(tall), 1.0)
        floor = math.hypot(x, y)
        return np.array([x, y, rise]) / floor, depth * floor


_ACROSS, _UP = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]])


def corner_points(states: ndarray, sizes) -> ndarray:
    """Return the corners of markers in the robot's frame, m.

    For states (..., 5), or longer, and edges of the black square (...), m, they are (..., 4, 3):
    top left, top right, bottom right and bottom left, as one looks at it.

    >>> corner_points(np.array([2.0, 0.0, 0.0, 0.5, 0.0]), 0.2)
    array([[ 2. ,  0.1,  0.6],
           [ 2. , -0.1,  0.6],
           [ 2. , -0.1,  0.4],
           [ 2. ,  0.1,  0.4]])
    """
    # Copies, since numpy's functions round differently where they take columns of a larger array
    # to overlap with their result, which depends on where that happens to lie in memory.
    half = 0.5 * (np.asarray(sizes, dtype=float) * np.exp(states[..., 4].copy()))[..., None]
    across, up = half * _ACROSS, half * _UP
    x, y, yaw, height = (states[..., i, None] for i in range(4))
    yaw = yaw.copy()
    points = np.empty((*across.shape, 3))
    points[..., 0], points[..., 1] = x - np.sin(yaw) * across, y + np.cos(yaw) * across
    points[..., 2] = height + up
    return points


def extent_of(corners: ndarray) -> float:
    """Return the size of a marker in the image: its mean diagonal over the root of two, in px.

    >>> round(extent_of(np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0], [0.0, 30.0]])), 9)
    30.0
    """
    diagonals = np.hypot(*(corners[2] - corners[0])), np.hypot(*(corners[3] - corners[1]))
    return float(np.mean(diagonals)) / math.sqrt(2.0)


def whole_in_image(
    dock: Dock, camera: PinholeCamera, mount: CameraMount, distances: ndarray
) -> ndarray:
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


def reach_of(camera: PinholeCamera, dock: Dock) -> float:
    """Return from how far (m) a camera should find the marker of a dock."""
    return camera.fy * dock.marker.size / _FOUND_SIZE


def misfit(dock: Dock, camera: PinholeCamera, mount: CameraMount) -> str:
    """Return why a camera cannot see the marker from the dock; empty where it can."""
    wanted, farthest = dock.docked_distance, reach_of(camera, dock)
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
    """Visibility of a dock's marker for a camera at a height above the floor, up to `farthest`, m.

    `height` is in m as well.
    """

    def __init__(self, dock: Dock, camera: PinholeCamera, height: float):
        self._half = dock.marker.size * (0.5 + QUIET_ZONE)
        self._walls = dock.walls
        self.farthest = reach_of(camera, dock)
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

    def unobstructed(self, x, y) -> ndarray:
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

    def visible(self, cameras: ndarray) -> ndarray:
        """Return whether (..., 3) cameras in the dock's frame should find the marker."""
        x, y, heading = cameras[..., 0], cameras[..., 1], cameras[..., 2]
        off = np.arctan2(-y, -x) - heading
        off = np.abs(np.arctan2(np.sin(off), np.cos(off)))
        return self.unobstructed(x, y) & (off < self.half_angle(np.hypot(x, y)))

    def found(self, cameras: ndarray, reach: ndarray) -> ndarray:
        """Return whether (..., 3) cameras in the dock's frame should find the marker in a light.

        `reach` (...) is the share of the range of good light up to which it is found.
        """
        distance = np.hypot(cameras[..., 0], cameras[..., 1])
        return self.visible(cameras) & (distance < reach * self.farthest)

    def half_angle(self, distance) -> ndarray:
        """Return how far off the image's middle (rad) a marker at a distance (m) is whole."""
        return self._half_angle - np.arctan2(self._half, np.maximum(distance, 0.1))
