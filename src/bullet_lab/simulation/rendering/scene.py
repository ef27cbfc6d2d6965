"""The lit copy of a simulation in an engine, kept where the models are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping, Optional

import numpy as np

from bullet_lab.simulation.attached_frame import AttachedFrame
from bullet_lab.simulation.description import World
from bullet_lab.simulation.pose import Pose, Vector
from bullet_lab.simulation.rendering.engine import RenderEngine
from bullet_lab.simulation.rendering.lighting import Lighting
from bullet_lab.simulation.rendering.painting import (
    STANDING,
    TUMBLING,
    TURNING,
    Painted,
    paint_link,
)
from bullet_lab.simulation.rendering.prefilter import fitting

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


@dataclass
class _Copies:
    """Copies of all that is seen of one model instance."""

    instance: Any
    parts: List[_Copy] = field(default_factory=list)


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
        for name in gone:
            self._remove(name)
        for name, instance in self._models.items():
            if name not in self._copies:
                self._add(name, instance)
            for part in self._copies[name].parts:
                part.follow(eye, angle)

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

    def _add(self, name: str, instance: Any) -> None:
        copies = _Copies(instance)
        self._copies[name] = copies
        for root, body in instance.bodies.items():
            for link in body.links:
                motion = STANDING if instance.model.static else TURNING
                if link.name != root and not instance.model.static:
                    motion = TUMBLING
                place = AttachedFrame(body, link.name).pose
                painted = paint_link(self.engine, link.visuals, place(), self.lighting, motion)
                copies.parts.extend(_Copy(self.engine, part, place) for part in painted)

    def _remove(self, name: str) -> None:
        for part in self._copies.pop(name).parts:
            part.remove()
