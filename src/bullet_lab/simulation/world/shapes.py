"""Describe the shapes of bodies, with one class for each.

Lengths are metres in the shape's frame, whose origin is in the middle of all but planes and meshes.
A new shape is a class here, in SHAPES, and an entry in the tables of `physics.physics`,
`rendering.drawables` and `ros.messages.world`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Dict, Optional, Sequence, Tuple, Type

import numpy as np

from bullet_lab.core.pose import Vector
from bullet_lab.simulation.world.meshes import mesh_bounds
from bullet_lab.simulation.world.xml import TagReader


class ShapeTag(TagReader):
    """A tag that describes a shape, with its measures as attributes (URDF) or children (SDF).

    `file_key` is the key of a mesh's file.
    """

    file_key: ClassVar[str]

    @abstractmethod
    def file(self, uri: str) -> Path:
        """Return the file that a URI means; raise ResourceError."""


class Shape(ABC):
    """Base of all shapes.

    `tag` is its name in SDF and, if `in_urdf`, in URDF. If it `has_own_colours`, its default colour
    is white.
    """

    tag: ClassVar[str]
    in_urdf: ClassVar[bool] = True
    has_own_colours: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def read(cls, tag: ShapeTag) -> Any:
        """Return the shape that a tag describes; raise LabError."""

    def measures(self) -> Dict[str, Tuple[float, ...]]:
        """Return the sizes of the shape by their names in SDF."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: v if isinstance(v, tuple) else (v,) for name, v in values.items()}

    @abstractmethod
    def bounds(self) -> np.ndarray:
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

    def floor_sides(self) -> Optional[Tuple[float, float]]:
        """Return the sides (m) of its rectangular footprint; None if it is no rectangle."""
        return None

    def _gaps(self, point: Vector) -> Sequence[float]:
        """Return how far a point is beyond each of the shape's extents, m."""
        low, high = self.bounds()
        return np.maximum(low - point, point - high).tolist()


@dataclass(frozen=True)
class Box(Shape):
    """A box with its centre at the origin; `size` along x, y, z."""

    size: Vector
    tag = "box"

    @classmethod
    def read(cls, tag: ShapeTag) -> Box:
        return cls(tag.sizes("size", 3))

    def bounds(self) -> np.ndarray:
        return np.outer((-0.5, 0.5), self.size)

    def floor_sides(self) -> Tuple[float, float]:
        return self.size[:2]

    def _gaps(self, point: Vector) -> Sequence[float]:
        return [abs(p) - 0.5 * size for p, size in zip(point, self.size)]


@dataclass(frozen=True)
class Cylinder(Shape):
    """A cylinder along z with its centre at the origin."""

    radius: float
    length: float
    tag = "cylinder"

    @classmethod
    def read(cls, tag: ShapeTag) -> Cylinder:
        return cls(*tag.sizes("radius", 1), *tag.sizes("length", 1))

    def bounds(self) -> np.ndarray:
        return np.outer((-1.0, 1.0), (self.radius, self.radius, 0.5 * self.length))

    def _gaps(self, point: Vector) -> Sequence[float]:
        x, y, z = point
        return math.hypot(x, y) - self.radius, abs(z) - 0.5 * self.length


@dataclass(frozen=True)
class Sphere(Shape):
    """A ball with its centre at the origin."""

    radius: float
    tag = "sphere"

    @classmethod
    def read(cls, tag: ShapeTag) -> Sphere:
        return cls(*tag.sizes("radius", 1))

    def bounds(self) -> np.ndarray:
        return np.outer((-1.0, 1.0), 3 * (self.radius,))

    def _gaps(self, point: Vector) -> Sequence[float]:
        return (math.hypot(*point) - self.radius,)


@dataclass(frozen=True)
class Plane(Shape):
    """A plane through the origin; it is infinite for contacts and is drawn with a `size`."""

    normal: Vector = (0.0, 0.0, 1.0)
    size: Tuple[float, float] = (100.0, 100.0)
    tag = "plane"
    in_urdf = False

    @classmethod
    def read(cls, tag: ShapeTag) -> Plane:
        return cls(tag.direction("normal", "0 0 1"), tag.sizes("size", 2, "1 1"))

    def bounds(self) -> np.ndarray:
        return np.outer((-math.inf, math.inf), (1.0, 1.0, 1.0))

    def _gaps(self, point: Vector) -> Sequence[float]:
        along = sum(p * n for p, n in zip(point, self.normal))
        return (along / math.hypot(*self.normal),)


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
    # A default colour would darken the colours and pictures in the file.
    has_own_colours = True

    @classmethod
    def read(cls, tag: ShapeTag) -> Mesh:
        uri, scale, part = tag.text(tag.file_key), tag.scale("scale"), tag.text("submesh/name")
        return cls(tag.file(uri), uri, scale, part, tag.boolean("submesh/center", False))

    def measures(self) -> Dict[str, Tuple[float, ...]]:
        return {"scale": self.scale}

    def bounds(self) -> np.ndarray:
        return mesh_bounds(self)


SHAPES: Dict[str, Type[Shape]] = {kind.tag: kind for kind in (Box, Cylinder, Sphere, Plane, Mesh)}
