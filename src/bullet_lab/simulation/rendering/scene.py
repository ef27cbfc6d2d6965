"""The lit copy of a simulation in an engine, kept where the models are."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Tuple

import numpy as np

from bullet_lab.simulation.attached_frame import AttachedFrame
from bullet_lab.simulation.description import Colour, Geometry, Visual, World
from bullet_lab.simulation.pose import Pose, Vector
from bullet_lab.simulation.rendering.casters import Caster, casters_of
from bullet_lab.simulation.rendering.choice import EGL
from bullet_lab.simulation.rendering.engine import RenderEngine
from bullet_lab.simulation.rendering.lighting import Lighting
from bullet_lab.simulation.rendering.painting import Painted, paint
from bullet_lab.simulation.rendering.prefilter import fitting
from bullet_lab.simulation.rendering.shading import STANDING, TUMBLING, TURNING, Part, Shader
from bullet_lab.simulation.rendering.shadows import Shadows, casting_lights
from bullet_lab.simulation.rendering.surfaces import Surface, surfaces_of
from bullet_lab.simulation.rendering.texture_map import TextureMap, common_map

# Shapes are known to the shadows by numbers.
_NUMBERS = itertools.count()

# Where copies of pictures wait that do not fit the present distance: far below all.
ELSEWHERE = Pose((0.0, 0.0, -1e5))


class _Copy:
    """A part of a link in the engine: one body for each fineness of its picture."""

    def __init__(self, engine: RenderEngine, painted: Painted, where: Callable[[], Pose]):
        self._engine = engine
        self._painted = painted
        self._where = where
        self._bodies = [engine.load(path) for path in painted.files]
        for body in self._bodies:
            engine.place(body, ELSEWHERE)
        self._shown: Optional[int] = None
        self._pose = ELSEWHERE

    def follow(self, eye: Vector, angle: float) -> None:
        """Show the part where it is now, for pixels of a camera that each see `angle` (rad)."""
        pose = self._where()
        level = 0
        if self._painted.levels:
            level = fitting(self._painted.levels, angle * self._distance(pose, eye))
        if level != self._shown:
            if self._shown is not None:
                self._engine.place(self._bodies[self._shown], ELSEWHERE)
            self._shown, self._pose = level, ELSEWHERE
        if pose != self._pose:
            self._engine.place(self._bodies[level], pose)
            self._pose = pose

    def remove(self) -> None:
        for body in self._bodies:
            self._engine.remove(body)

    def _distance(self, pose: Pose, eye: Vector) -> float:
        """Return the distance from the eye to the part's box."""
        local = np.array(pose.inverse().rotate(tuple(np.subtract(eye, pose.position))))
        least, greatest = self._painted.box
        return float(np.linalg.norm(local - np.clip(local, least, greatest)))


@dataclass(frozen=True)
class _Visual:
    """A shape of a link with its surfaces in the link's frame, and a number of its own."""

    surfaces: Tuple[Surface, ...]
    colour: Colour
    number: int
    geometry: Optional[Geometry]

    def casters(self, pose: Pose) -> List[Caster]:
        """Return what throws shadows, in the world, for a link at a pose."""
        if self.geometry is None:
            return []
        return casters_of(self.geometry, [s.moved(pose) for s in self.surfaces], self.number)


@dataclass(frozen=True)
class _Shape:
    """What is to be seen of one link, and where it is."""

    visuals: Tuple[_Visual, ...]
    where: Callable[[], Pose]
    motion: str
    _cast: Dict[Pose, List[Caster]] = field(default_factory=dict)

    @property
    def surfaces(self) -> Iterator[Tuple[Surface, _Visual]]:
        """The surfaces in the link's frame, and what they belong to."""
        return ((surface, visual) for visual in self.visuals for surface in visual.surfaces)

    def casters(self) -> List[Caster]:
        """Return what throws shadows, in the world; the same objects until it moves."""
        if self.motion != STANDING:
            return []
        pose = self.where()
        if pose not in self._cast:
            self._cast.clear()
            self._cast[pose] = [c for visual in self.visuals for c in visual.casters(pose)]
        return self._cast[pose]

    def shaded_by(self, shadows: Shadows) -> List[Tuple[int, Caster]]:
        """Return, by the number of the light, what may throw a shadow on it."""
        if self.motion != STANDING:
            return []
        pose = self.where()
        return [
            found
            for surface, visual in self.surfaces
            for found in shadows.reaching(surface.moved(pose).corners, visual.number)
        ]

    def pictures(self) -> List[Surface]:
        """The surfaces with pictures, in the world."""
        pose = self.where()
        return [s.moved(pose) for s, _ in self.surfaces if s.texture is not None]


@dataclass
class _Copies:
    """All that is seen of one model instance, and its copies in the engine."""

    instance: Any
    shapes: List[_Shape]
    parts: List[_Copy] = field(default_factory=list)
    painted: List[Pose] = field(default_factory=list)
    shadows: Optional[Shadows] = None
    shaded_by: List[Tuple[int, Caster]] = field(default_factory=list)

    def see(self, shadows: Optional[Shadows]) -> bool:
        """Take the shadows in the world; return whether those on this model are as before."""
        before, same = self.shaded_by, self.shadows is shadows
        if not same and shadows is not None:
            self.shadows = shadows
            self.shaded_by = [found for s in self.shapes for found in s.shaded_by(shadows)]
        return same or before == self.shaded_by

    def is_painted(self) -> bool:
        """Whether there are copies, lit where the shapes are now or may be anywhere."""
        return bool(self.painted) and all(
            shape.motion != STANDING or shape.where() == pose
            for shape, pose in zip(self.shapes, self.painted)
        )

    def remove(self) -> None:
        """Take the copies out."""
        for part in self.parts:
            part.remove()
        self.parts.clear()
        self.painted.clear()


class Scene:
    """What is to be seen in a world.

    Args:
        world: for its light and background.
        models: all models that there are, by name; read anew at each `update`.
        engine: draws it. Several scenes may share one: the one that draws next throws out the
            copies of the one before.
    """

    def __init__(self, world: World, models: Mapping[str, Any], engine: RenderEngine):
        self.lighting = Lighting(world)
        self.engine = engine
        self._models = models
        self._copies: Dict[str, _Copies] = {}
        self._map: Optional[TextureMap] = None
        self._world = world
        self._shadows: Optional[Shadows] = None

    def update(self, eye: Vector, angle: float) -> None:
        """Bring the copies to where the models are.

        Args:
            eye: where they are seen from.
            angle: that a pixel covers, in rad.

        Raises:
            LabError: a mesh or a texture is not usable.
        """
        self._take_engine()
        gone = [n for n, c in self._copies.items() if self._models.get(n) is not c.instance]
        new = [name for name in self._models if name not in self._copies or name in gone]
        for name in gone:
            self._remove(name)
        for name in new:
            self._copies[name] = _Copies(self._models[name], _shapes_of(self._models[name]))
        if gone or not all(c.is_painted() for c in self._copies.values() if c.shapes):
            self._paint()
        for copies in self._copies.values():
            for part in copies.parts:
                part.follow(eye, angle)

    @property
    def texture_map(self) -> Optional[TextureMap]:
        """What EGL finds the places in pictures with; None for the shapes' own coordinates."""
        return self._map

    def close(self) -> None:
        """Take everything out of the engine."""
        if self.engine.owner is self:
            self.clear()
            self.engine.owner = None

    def clear(self) -> None:
        """Take all copies out; the next update makes them again."""
        for name in list(self._copies):
            self._remove(name)

    def _take_engine(self) -> None:
        owner = self.engine.owner
        if owner is not self:
            if isinstance(owner, Scene):
                owner.clear()
            self.engine.owner = self

    def _paint(self) -> None:
        """Make the copies that are missing; all of them, if the way of drawing changes."""
        found = self._common_map()
        same, self._map = _equal(found, self._map), found
        shadows = self._cast()
        for copies in self._copies.values():
            if not (copies.see(shadows) and same and copies.is_painted()):
                copies.remove()
        shader = Shader(self.lighting, self.engine.renderer == EGL, self._map, shadows)
        for copies in self._copies.values():
            if copies.painted:
                continue
            for shape in copies.shapes:
                pose = shape.where()
                copies.painted.append(pose)
                lit: List[Part] = []
                for surface, of in shape.surfaces:
                    lit.extend(shader.parts(surface, of.colour, pose, shape.motion, of.number))
                painted = paint(self.engine, lit, pose)
                copies.parts.extend(_Copy(self.engine, one, shape.where) for one in painted)

    def _cast(self) -> Optional[Shadows]:
        """Return the shadows in the world, the same until something is added, moved or gone."""
        if casting_lights(self._world):
            shapes = (shape for copies in self._copies.values() for shape in copies.shapes)
            casters = [caster for shape in shapes for caster in shape.casters()]
            if self._shadows is None or self._shadows.casters != casters:
                self._shadows = Shadows(self._world, casters)
        return self._shadows

    def _common_map(self) -> Optional[TextureMap]:
        if self.engine.renderer != EGL:
            return None
        pictures: List[Surface] = []
        for copies in self._copies.values():
            for shape in copies.shapes:
                found = shape.pictures()
                if found and shape.motion != STANDING:
                    return None
                pictures.extend(found)
        return common_map(pictures)

    def _remove(self, name: str) -> None:
        self._copies.pop(name).remove()


def _shapes_of(instance: Any) -> List[_Shape]:
    """Return what is seen of a model; raises LabError for an unusable mesh or texture."""
    shapes = []
    for root, body in instance.bodies.items():
        for link in body.links:
            motion = STANDING if instance.model.static else TURNING
            if link.name != root and not instance.model.static:
                motion = TUMBLING
            visuals = tuple(map(_visual_of, link.visuals))
            if visuals:
                shapes.append(_Shape(visuals, AttachedFrame(body, link.name).pose, motion))
    return shapes


def _visual_of(visual: Visual) -> _Visual:
    surfaces = tuple(surface.moved(visual.pose) for surface in surfaces_of(visual.geometry))
    geometry = visual.geometry if visual.casts_shadows else None
    return _Visual(surfaces, visual.colour, next(_NUMBERS), geometry)


def _equal(one: Optional[TextureMap], other: Optional[TextureMap]) -> bool:
    if one is None or other is None:
        return one is other
    return bool(np.array_equal(one.matrix, other.matrix))
