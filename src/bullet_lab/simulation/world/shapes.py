"""Describe the shapes of bodies, and read the triangles of mesh files.

Lengths are metres in the shape's frame, whose origin is in the middle of all but planes and meshes.
A new shape is a class here, and an entry in the tables of `tags`, `physics.physics`,
`rendering.drawables` and `ros.messages.conversions`.
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Vector, dot
from bullet_lab.simulation.world.meshes import (
    MeshError,
    MeshPart,
    file_version,
    read_parts,
    readable,
)

KNOWN_SUFFIXES = (".dae", ".stl", ".obj")
# Meshes that are kept in memory, since many models may share one.
CACHED_MESHES = 16
# PyBullet accepts so many corners in one call.
MOST_CORNERS = 131_072
# The directions in which corners of a large convex hull are searched.
DIRECTIONS = 4096


class Shape(ABC):
    """Base of all shapes; `tag` is its name in SDF."""

    tag: ClassVar[str]

    def measures(self) -> dict[str, tuple[float, ...]]:
        """Return the sizes of the shape by their names in SDF."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: v if isinstance(v, tuple) else (v,) for name, v in values.items()}

    @abstractmethod
    def bounds(self) -> ndarray:
        """Return the least and the greatest corner of the box around it in m, shape (2, 3).

        >>> Box((2.0, 1.0, 0.5)).bounds().tolist()
        [[-1.0, -0.5, -0.25], [1.0, 0.5, 0.25]]
        """

    def distance(self, point: Vector) -> float:
        """Return the distance of a point from its surface in m, inside or outside.

        For a mesh, it is that from the box around it.

        >>> Box((2.0, 2.0, 2.0)).distance((0.75, 0.0, 0.0))
        0.25
        >>> Cylinder(radius=1.0, length=2.0).distance((3.0, 4.0, 0.0))
        4.0
        """
        gaps = self._gaps(point)
        # The first term is 0 inside, the second outside.
        return abs(math.hypot(*(max(gap, 0.0) for gap in gaps)) + min(max(gaps), 0.0))

    def _gaps(self, point: Vector) -> Sequence[float]:
        """Return how far a point is beyond each of the shape's extents, m."""
        low, high = self.bounds()
        return np.maximum(low - point, point - high).tolist()


@dataclass(frozen=True)
class Box(Shape):
    """A box with its centre at the origin; `size` along x, y, z."""

    size: Vector
    tag = "box"

    def bounds(self) -> ndarray:
        return np.outer((-0.5, 0.5), self.size)

    def _gaps(self, point: Vector) -> Sequence[float]:
        return [abs(p) - 0.5 * size for p, size in zip(point, self.size)]


@dataclass(frozen=True)
class Cylinder(Shape):
    """A cylinder along z with its centre at the origin."""

    radius: float
    length: float
    tag = "cylinder"

    def bounds(self) -> ndarray:
        return np.outer((-1.0, 1.0), (self.radius, self.radius, 0.5 * self.length))

    def _gaps(self, point: Vector) -> Sequence[float]:
        x, y, z = point
        return math.hypot(x, y) - self.radius, abs(z) - 0.5 * self.length


@dataclass(frozen=True)
class Sphere(Shape):
    """A ball with its centre at the origin."""

    radius: float
    tag = "sphere"

    def bounds(self) -> ndarray:
        return np.outer((-1.0, 1.0), 3 * (self.radius,))

    def _gaps(self, point: Vector) -> Sequence[float]:
        return (math.hypot(*point) - self.radius,)


@dataclass(frozen=True)
class Plane(Shape):
    """A plane through the origin; it is infinite for contacts and is drawn with a `size`."""

    normal: Vector = (0.0, 0.0, 1.0)
    size: tuple[float, float] = (100.0, 100.0)
    tag = "plane"

    def bounds(self) -> ndarray:
        return np.outer((-math.inf, math.inf), np.ones(3))

    def _gaps(self, point: Vector) -> Sequence[float]:
        return (dot(point, self.normal) / math.hypot(*self.normal),)


@dataclass(frozen=True)
class Mesh(Shape):
    """A triangle mesh file (.dae, .stl or .obj).

    `uri` is that of the description, which RViz resolves itself; `path` is the file. With a
    `submesh`, only the nodes of that name in a COLLADA file, or the objects or groups in an .obj
    file, are used, with their middle at the origin if it is `centred`. Functions that read its
    triangles raise MeshError or XmlError for an unusable file.
    """

    path: Path
    uri: str
    scale: Vector = (1.0, 1.0, 1.0)
    submesh: str = ""
    centred: bool = False
    tag = "mesh"

    def measures(self) -> dict[str, tuple[float, ...]]:
        return {"scale": self.scale}

    def bounds(self) -> ndarray:
        vertices = load_triangles(self).vertices
        return np.array((vertices.min(axis=0), vertices.max(axis=0)))


def load_triangles(mesh: Mesh) -> MeshPart:
    """Read a mesh, with the transforms of its file and the scale of the description applied.

    All of it is one part, without normals and looks.

    The transforms matter: Blender writes the size into the `<matrix>` of a COLLADA node. So does
    the `<unit>` of a COLLADA file. As in Gazebo, its `<up_axis>` does not.

    Raises:
        MeshError: unknown kind of file, too large, malformed, empty, or with coordinates that
            are not finite.
        XmlError: a COLLADA file that is missing, not well-formed or has a document type.
    """
    return _load(mesh, file_version(mesh))


@functools.lru_cache(maxsize=CACHED_MESHES)
def _load(mesh: Mesh, _version: tuple[int, int] | None) -> MeshPart:
    path = mesh.path
    if path.suffix.lower() not in KNOWN_SUFFIXES:
        raise MeshError(f"{path}: unknown kind of mesh; use {', '.join(KNOWN_SUFFIXES)}")
    arrays, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=int)], 0
    with readable(path):
        for part in read_parts(path, mesh.submesh):
            if part.vertices.shape[1:] != (3,):
                raise MeshError(f"{path}: a corner needs three coordinates")
            arrays.append(part.vertices)
            faces.append(part.faces + count)
            count += len(part.vertices)
    vertices = np.concatenate(arrays)
    vertices = (vertices - middle_of([vertices], mesh)) * np.asarray(mesh.scale)
    triangles = MeshPart(vertices, np.concatenate(faces), None, None, None)
    if len(triangles.faces) == 0 or not np.isfinite(vertices).all():
        raise MeshError(f"{path}: no triangles with finite corners")
    if triangles.faces.min() < 0 or triangles.faces.max() >= count:
        raise MeshError(f"{path}: a triangle has an unknown corner")
    # Callers share these arrays.
    triangles.vertices.setflags(write=False)
    triangles.faces.setflags(write=False)
    return triangles


def middle_of(parts: Sequence[ndarray], mesh: Mesh) -> ndarray:
    """Return the point, among the points (…, 3) of an unscaled mesh, that becomes its origin."""
    if not (mesh.submesh and mesh.centred and any(map(len, parts))):
        return np.zeros(3)
    points = np.concatenate([part.reshape(-1, 3) for part in parts])
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def hull_corners(mesh: Mesh) -> ndarray:
    """Return at most MOST_CORNERS corners (n, 3) with the same convex hull as a mesh.

    Bullet itself drops corners inside the hull. Of a larger mesh, the farthest corner in each of
    many directions is kept: the hull is the same to a thousandth of its size. Raises as
    `load_triangles`.
    """
    corners = np.unique(load_triangles(mesh).vertices, axis=0)
    if len(corners) <= MOST_CORNERS:
        return corners
    spans = np.ptp(corners, axis=0)
    normalised = (corners / np.where(spans > 0.0, spans, 1.0)).T
    # Evenly spread unit vectors: a Fibonacci sphere.
    number = np.arange(DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * number / DIRECTIONS, number * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - height * height)
    directions = np.column_stack((level * np.cos(turn), level * np.sin(turn), height))
    blocks = np.array_split(directions, DIRECTIONS // 32)
    return corners[np.unique([np.argmax(block @ normalised, axis=1) for block in blocks])]


def triangle_corners(mesh: Mesh) -> list[ndarray]:
    """Return a mesh in pieces for PyBullet: corners (n, 3), three for each triangle."""
    corners = load_triangles(mesh).corners.reshape(-1, 3)
    piece = MOST_CORNERS // 3 * 3
    return [corners[start : start + piece] for start in range(0, len(corners), piece)]


