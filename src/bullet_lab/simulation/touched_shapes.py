"""Which shape of a link is touched: PyBullet knows its own links only."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Callable, Mapping, Sequence, Tuple

import numpy as np

from bullet_lab.simulation.attached_frame import AttachedFrame
from bullet_lab.simulation.description import Box, Collision, Cylinder, Geometry, Mesh, Sphere
from bullet_lab.simulation.meshes import load_triangles
from bullet_lab.simulation.physics import Body
from bullet_lab.simulation.pose import Pose, Vector


def distance_from_surface(geometry: Geometry, point: Vector) -> float:
    """Return how far a point is from the surface of a shape, in m; inside or outside.

    A mesh is taken for the box around it, and a plane's distance is signed by no side.
    """
    x, y, z = point
    if isinstance(geometry, Sphere):
        return abs(math.hypot(x, y, z) - geometry.radius)
    if isinstance(geometry, Cylinder):
        return abs(_outside((math.hypot(x, y) - geometry.radius, abs(z) - 0.5 * geometry.length)))
    if isinstance(geometry, Box):
        return abs(_outside([abs(p) - 0.5 * size for p, size in zip(point, geometry.size)]))
    if isinstance(geometry, Mesh):
        low, high = _corners(geometry)
        return abs(_outside(np.maximum(low - point, point - high).tolist()))
    normal = geometry.normal
    return abs(sum(p * n for p, n in zip(point, normal))) / math.hypot(*normal)


def _outside(gaps: Sequence[float]) -> float:
    """Return the signed distance from a shape that is a product of intervals.

    Args:
        gaps: how far beyond the end of each interval the point is, negative within.
    """
    beyond = [max(gap, 0.0) for gap in gaps]
    return math.hypot(*beyond) + min(max(gaps), 0.0)


@lru_cache(maxsize=64)
def _corners(mesh: Mesh) -> Tuple[np.ndarray, np.ndarray]:
    """Return two opposite corners of the box around a mesh."""
    vertices = load_triangles(mesh).vertices
    return vertices.min(axis=0), vertices.max(axis=0)


def nearest_shape(collisions: Sequence[Collision], point: Vector) -> Collision:
    """Return the shape of a link whose surface is next to a point in the link's frame."""
    def distance(shape: Collision) -> float:
        inside = (shape.pose.inverse() * Pose(point)).position
        return distance_from_surface(shape.geometry, inside)

    return min(collisions, key=distance)


class TouchedShapes:
    """Names the shapes of all models as Gazebo does: model::link::collision.

    Args:
        instance_of: returns the instance that a body belongs to, by the body's unique id.
    """

    def __init__(self, instance_of: Callable[[int], Any]):
        self._instance_of = instance_of

    def name(self, unique_id: int, index: int, place: Vector) -> str:
        """Return the name of the shape at a place on a link's surface.

        Args:
            unique_id: of the body.
            index: PyBullet's index of the link.
            place: in the world, in m.
        """
        instance = self._instance_of(unique_id)
        body = _body_of(instance.bodies, unique_id)
        part = body.part_at(index)
        if len(part.shapes) == 1:
            (shape,) = part.shapes
        else:
            point = AttachedFrame(body, part.link.name).pose().inverse() * Pose(place)
            shape = nearest_shape(part.shapes, point.position)
        return f"{instance.name}::{part.link.name}::{shape.name}"


def _body_of(bodies: Mapping[str, Body], unique_id: int) -> Body:
    return next(body for body in bodies.values() if body.unique_id == unique_id)
