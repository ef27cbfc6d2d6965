"""The shapes of bodies: one class for each, with all that follows from its measures.

Lengths are metres, in the shape's own frame: its origin is in the middle of all but planes and
meshes. A new shape is a class here, in SHAPES, and an entry in the tables of what makes
something of its own of shapes: `physics.bodies`, `rendering.surfaces`,
`ros.messages.world_markers`.
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
    """What all shapes know.

    `tag` is its name in SDF and, if `in_urdf`, in URDF. One with colours of its own is white where
    nobody says a colour.
    """

    tag: ClassVar[str]
    in_urdf: ClassVar[bool] = True
    has_own_colours: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def read(cls, tag: ShapeTag) -> Any:
        """Return the shape that a tag describes; raises LabError."""

    def measures(self) -> Dict[str, Tuple[float, ...]]:
        """Return the numbers that make the shape, by their names in SDF."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: v if isinstance(v, tuple) else (v,) for name, v in values.items()}

    @abstractmethod
    def bounds(self) -> np.ndarray:
        """Return the least and the greatest corner of the box around it, shape (2, 3), in m.

        >>> Box((2.0, 1.0, 0.5)).bounds().tolist()
        [[-1.0, -0.5, -0.25], [1.0, 0.5, 0.25]]
        """

    def distance(self, point: Vector) -> float:
        """Return how far a point is from its surface, in m; inside or outside.

        A mesh is taken for the box around it.

        >>> Box((2.0, 2.0, 2.0)).distance((0.75, 0.0, 0.0))
        0.25
        >>> Cylinder(radius=1.0, length=2.0).distance((3.0, 4.0, 0.0))
        4.0
        """
        gaps = self._gaps(point)
        # Outside of a product of intervals, and inside.
        return abs(math.hypot(*(max(gap, 0.0) for gap in gaps)) + min(max(gaps), 0.0))

    def floor_sides(self) -> Optional[Tuple[float, float]]:
        """Return the sides (m) of the rectangle that it covers standing; None if it is none."""
        return None

    def _gaps(self, point: Vector) -> Sequence[float]:
        """Return how far beyond the intervals that it is a product of a point is, m."""
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
    """A plane through the origin; it collides without end and is drawn `size` wide."""

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

    `uri` is what the description said, for those who resolve it themselves (RViz); `path` is
    the file that it means here. With a `submesh`, only what a COLLADA file has in nodes of that
    name, or an .obj file in objects or groups, with its middle at the origin if it is `centred`.
    What asks for its triangles raises MeshError or XmlError for a file that is not usable.
    """

    path: Path
    uri: str
    scale: Vector = (1.0, 1.0, 1.0)
    submesh: str = ""
    centred: bool = False
    tag = "mesh"
    # It may bring colours and pictures, which nothing shall darken.
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
