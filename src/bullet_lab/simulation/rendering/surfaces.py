"""Shapes as triangles with normals and, where they have a picture on them, its coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Optional, Tuple

import numpy as np

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering.textures import Image, load_textured
from bullet_lab.simulation.world.description import Box, Cylinder, Geometry, Mesh, Plane, Sphere
from bullet_lab.simulation.world.meshes import load_triangles

CYLINDER_SIDES = 48
SPHERE_RINGS = 16


@dataclass(frozen=True)
class Surface:
    """Triangles in metres: corner arrays of shape (n, 3, …), three corners each.

    Attributes:
        corners: (n, 3, 3) positions.
        normals: (n, 3, 3) unit normals at the corners.
        picture: (n, 3, 2) coordinates in the texture, from its lower left; None without one.
        image: on the surface; None without one.
    """

    corners: np.ndarray
    normals: np.ndarray
    picture: Optional[np.ndarray] = None
    image: Optional[Image] = None

    def moved(self, pose: Pose) -> Surface:
        """Return the same, seen from the frame that `pose` is given in."""
        turn = pose.rotation_matrix()
        corners = self.corners @ turn.T + np.asarray(pose.position)
        return replace(self, corners=corners, normals=self.normals @ turn.T)


def surfaces_of(geometry: Geometry) -> List[Surface]:
    """Return what is seen of a shape; raises LabError for an unusable mesh or texture."""
    if isinstance(geometry, Box):
        return [_box(geometry.size)]
    if isinstance(geometry, Cylinder):
        return [_cylinder(geometry.radius, geometry.length)]
    if isinstance(geometry, Sphere):
        return [_sphere(geometry.radius)]
    if isinstance(geometry, Plane):
        return [_plane(geometry.normal, geometry.size)]
    return _mesh(geometry)


def _box(size: Tuple[float, float, float]) -> Surface:
    half = 0.5 * np.asarray(size)
    corners, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = np.roll(np.eye(3), -axis, axis=0)[1:]
            normal = sign * np.eye(3)[axis]
            square = [normal + a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            if sign < 0.0:
                square.reverse()
            corners += _two_triangles(square)
            normals += [[normal] * 3] * 2
    return Surface(np.array(corners) * half, np.array(normals))


def _plane(normal: Tuple[float, float, float], size: Tuple[float, float]) -> Surface:
    z = np.asarray(normal) / np.linalg.norm(normal)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    a, b = 0.5 * size[0] * x, 0.5 * size[1] * y
    corners = np.array(_two_triangles([-a - b, a - b, a + b, b - a]))
    return Surface(corners, np.broadcast_to(z, corners.shape).copy())


def _cylinder(radius: float, length: float) -> Surface:
    angles = np.linspace(0.0, 2.0 * np.pi, CYLINDER_SIDES + 1)
    rim = np.column_stack((np.cos(angles), np.sin(angles), 0.0 * angles))
    up = np.array((0.0, 0.0, 0.5 * length))
    corners, normals = [], []
    for first, second in zip(rim[:-1], rim[1:]):
        a, b = radius * first, radius * second
        corners += _two_triangles([a - up, b - up, b + up, a + up])
        normals += _two_triangles([first, second, second, first])
        corners += [[up, a + up, b + up], [-up, b - up, a - up]]
        normals += [[(0.0, 0.0, 1.0)] * 3, [(0.0, 0.0, -1.0)] * 3]
    return Surface(np.array(corners), np.array(normals))


def _sphere(radius: float) -> Surface:
    tilts = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SPHERE_RINGS + 1)
    turns = np.linspace(0.0, 2.0 * np.pi, 2 * SPHERE_RINGS + 1)
    directions = np.stack(
        (
            np.outer(np.cos(tilts), np.cos(turns)),
            np.outer(np.cos(tilts), np.sin(turns)),
            np.outer(np.sin(tilts), np.ones_like(turns)),
        ),
        axis=-1,
    )
    normals = []
    for low, high in zip(directions[:-1], directions[1:]):
        for k in range(len(turns) - 1):
            normals += _two_triangles([low[k], low[k + 1], high[k + 1], high[k]])
    return Surface(radius * np.array(normals), np.array(normals))


def _mesh(mesh: Mesh) -> List[Surface]:
    textured = load_textured(mesh)
    if textured:
        return [Surface(c, _face_normals(c), p, image) for c, p, image in textured]
    triangles = load_triangles(mesh)
    corners = triangles.vertices[triangles.faces]
    if np.prod(mesh.scale) < 0.0:
        corners = corners[:, ::-1]
    return [Surface(corners, _face_normals(corners))]


def _face_normals(corners: np.ndarray) -> np.ndarray:
    """Return each triangle's normal at its three corners; a triangle without area gets up."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals[lengths == 0.0] = (0.0, 0.0, 1.0)
    normals /= np.where(lengths == 0.0, 1.0, lengths)[:, None]
    return np.repeat(normals[:, None, :], 3, axis=1)


def _two_triangles(square: list) -> list:
    a, b, c, d = square
    return [[a, b, c], [a, c, d]]
