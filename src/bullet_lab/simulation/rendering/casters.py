"""What throws shadows: shapes that stand still, as convex bodies in the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator, List, Optional, Sequence

import numpy as np

from bullet_lab.simulation.description import Box, Cylinder, Geometry, Light, Plane, Sphere
from bullet_lab.simulation.rendering.surfaces import Surface

# A part of a mesh throws its hull's shadow, or those of its triangles if it is not convex and
# has no more.
MOST_TRIANGLES = 64
# Corners of a mesh that are no farther apart than this, in m, are one.
WELD = 1e-6
# Rounds of the search for a plane between a light and a body.
ROUNDS = 200

_SIDES = np.array(((0, 1), (1, 2), (2, 0)))


@dataclass(frozen=True, eq=False)
class Caster:
    """A convex body that throws shadows.

    Attributes:
        points: (n, 3) in the world; the body is their hull.
        edges: (m, 2) indices of points; all edges of the hull are among them.
        shape: number of the shape that it is part of and throws no shadow on; None if it may.
    """

    points: np.ndarray
    edges: np.ndarray
    shape: Optional[int]

    def holds(self, place: np.ndarray) -> bool:
        """Whether a place is inside, by the algorithm of Frank and Wolfe."""
        points = self.points - place
        if (points.min(axis=0) >= 0.0).any() or (points.max(axis=0) <= 0.0).any():
            return False
        nearest = points.mean(axis=0)
        for _ in range(ROUNDS):
            ahead = points[np.argmin(points @ nearest)]
            if ahead @ nearest > 0.0:
                return False
            side = ahead - nearest
            nearest = nearest + side * np.clip(-(nearest @ side) / (side @ side), 0.0, 1.0)
        return True


def casters_of(geometry: Geometry, surfaces: Sequence[Surface], shape: int) -> List[Caster]:
    """Return the convex bodies of a shape.

    Args:
        geometry: of the shape; a plane throws no shadow.
        surfaces: what is seen of it, in the world.
        shape: its number.
    """
    if isinstance(geometry, Plane):
        return []
    corners = np.concatenate([surface.corners for surface in surfaces])
    if isinstance(geometry, (Box, Cylinder, Sphere)):
        return [_body(corners, shape)]
    found: List[Caster] = []
    for part in _connected(corners):
        if len(part) > MOST_TRIANGLES or _is_convex(part):
            found.append(_body(part, shape))
        else:
            found += [Caster(triangle, _SIDES, None) for triangle in part]
    return found


def _is_convex(corners: np.ndarray) -> bool:
    """Whether triangles (n, 3, 3) enclose a body, and all corners lie on one side of each."""
    _, index = _welded(corners)
    edges = np.concatenate([index[:, side] for side in _SIDES])
    _, used = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(1e-12, np.linalg.norm(normals, axis=1, keepdims=True))
    beyond = corners.reshape(-1, 3) @ normals.T - np.sum(normals * corners[:, 0], axis=1)
    sides = (beyond < WELD).all(axis=0) | (beyond > -WELD).all(axis=0)
    return bool(sides.all() and (used == 2).all())


def _body(corners: np.ndarray, shape: int) -> Caster:
    points, index = _welded(corners)
    edges = np.concatenate([index[:, side] for side in _SIDES])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    return Caster(points, edges[edges[:, 0] != edges[:, 1]], shape)


def _welded(corners: np.ndarray) -> tuple:
    """Return the distinct points and (n, 3) indices into them."""
    flat = corners.reshape(-1, 3)
    _, first, index = np.unique(
        np.round(flat / WELD), axis=0, return_index=True, return_inverse=True
    )
    return flat[first], index.reshape(-1, 3)


def _connected(corners: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the triangles that hang together by common corners."""
    points, index = _welded(corners)
    label = np.arange(len(points))
    while True:
        least = label[index].min(axis=1)
        lower = label.copy()
        np.minimum.at(lower, index.ravel(), np.repeat(least, 3))
        # Labels of labels: long strips take few rounds.
        lower = lower[lower]
        if np.array_equal(lower, label):
            break
        label = lower
    part = label[index[:, 0]]
    for value in np.unique(part):
        yield corners[part == value]


class Bounds:
    """Which bodies may stand between a light and something, by boxes or balls around them."""

    def __init__(self, light: Light, bodies: Sequence[np.ndarray]):
        """Take a light, and the points (n, 3) of each body."""
        self._light = light
        self._place = np.asarray(light.pose.position)
        self._axes = _axes_along(np.asarray(light.pose.rotate(light.direction)))
        low = np.array([points.min(axis=0) for points in bodies]).reshape(-1, 3)
        high = np.array([points.max(axis=0) for points in bodies]).reshape(-1, 3)
        self._middles = 0.5 * (low + high)
        self._radii = 0.5 * np.linalg.norm(high - low, axis=1)
        extents = np.array([self._extent(points) for points in bodies]).reshape(-1, 2, 3)
        self._low, self._high = extents[:, 0], extents[:, 1]

    def between(self, points: np.ndarray) -> np.ndarray:
        """Return numbers of bodies that may shade the hull of points (n, 3) in the world."""
        if self._light.kind == "directional":
            low, high = self._extent(points)
            across = (self._low[:, :2] < high[:2]) & (self._high[:, :2] > low[:2])
            return np.flatnonzero(across.all(axis=1) & (self._low[:, 2] < high[2]))
        return np.flatnonzero(self._in_the_way(points))

    def _extent(self, points: np.ndarray) -> np.ndarray:
        seen = points @ self._axes.T
        return np.stack((seen.min(axis=0), seen.max(axis=0)))

    def _in_the_way(self, points: np.ndarray) -> np.ndarray:
        low, high = points.min(axis=0), points.max(axis=0)
        radius = 0.5 * np.linalg.norm(high - low)
        away = 0.5 * (low + high) - self._place
        distance = np.linalg.norm(away)
        reach = self._light.attenuation.range
        if distance - radius > reach:
            return np.zeros(len(self._radii), dtype=bool)
        aways = self._middles - self._place
        distances = np.linalg.norm(aways, axis=1)
        wide = _half_angle(self._radii, distances) + _half_angle(radius, distance)
        cosines = aways @ away / np.maximum(1e-12, distances * distance)
        nearer = distances - self._radii < min(reach, distance + radius)
        return nearer & (np.arccos(np.clip(cosines, -1.0, 1.0)) <= wide)


def _half_angle(radius: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Return the angle from the middle of a ball to its rim; all around from within."""
    ratio = np.asarray(radius) / np.maximum(1e-12, distance)
    return np.where(ratio >= 1.0, np.pi, np.arcsin(np.minimum(1.0, ratio)))


def _axes_along(along: np.ndarray) -> np.ndarray:
    """Return orthogonal unit axes (3, 3), by rows; the last one goes along."""
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(along, first), along))
