"""Forces from outside on links and joints, for a period of simulated time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from bullet_lab.core.pose import Vector, add, cross
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.simulation.models import Entity, ModelInstance
from bullet_lab.simulation.world.description import FrameState
from bullet_lab.simulation.world.tree import FARTHEST

# Greatest force (N) or torque (N m); beyond it, the engine's numbers overflow.
STRONGEST = 1e9


class ForceError(LabError):
    """A force that cannot be applied."""


@dataclass(frozen=True)
class Period:
    """The steps from `first` up to, but without, `end`."""

    first: int
    end: float

    @classmethod
    def after(cls, now: int, start: float, duration: float) -> Period:
        """Return the steps of a period of simulated time, from the step `now` on.

        A `start` (s) in the past means at once. A `duration` (s) of less than a step is one step;
        a negative one never ends.
        """
        first = max(now, math.ceil(round(start * STEPS_PER_SECOND, 6)))
        if duration < 0.0:
            return cls(first, math.inf)
        steps = round(duration * STEPS_PER_SECOND)
        return cls(first, first + (max(1, steps) if duration else 0))


@dataclass(frozen=True)
class Wrench:
    """A force in N at a link's centre of mass and a torque in N m, in the world's axes.

    `target` is the model and the link that it acts on; `numbers` are the values to check.
    """

    link: Entity
    force: Vector
    torque: Vector
    period: Period
    target = property(lambda self: (self.link.instance, self.link.frame.link))
    numbers = property(lambda self: self.force + self.torque)

    @classmethod
    def at_point(
        cls,
        frame: FrameState | None,
        link: Entity,
        force: Vector,
        torque: Vector,
        point: Vector,
        period: Period,
    ) -> Wrench:
        """Return the wrench of a force and torque at a point (m), given in a frame.

        As in Gazebo, the components are computed in the link's axes, and then act along the
        world's axes: the direction of the force is right only for a link that is not turned.
        Without a frame, they are in the world's axes, and the point is relative to the centre of
        mass.

        Raises:
            ForceError: the point is too far away.
        """
        if not max(map(abs, point)) <= FARTHEST:
            raise ForceError(f"force at {point} m: not within {FARTHEST:g} m")
        torque = add(torque, cross(point, force))
        if frame is not None:
            seen = link.frame.pose().inverse() * frame.pose
            force, torque = seen.rotate(force), seen.rotate(torque)
            torque = add(torque, cross(seen.position, force))
        return cls(link, force, torque, period)

    def apply(self) -> None:
        """Act in the coming step."""
        frame = self.link.frame
        frame.body.push(frame.link, self.force, self.torque, frame.centre_of_mass())


@dataclass(frozen=True)
class Effort:
    """A torque (N m) or a force (N) of a joint; `target` and `numbers` are as in `Wrench`."""

    instance: ModelInstance
    joint: str
    effort: float
    period: Period
    target = property(lambda self: (self.instance, self.joint))
    numbers = property(lambda self: (self.effort,))

    def apply(self) -> None:
        """Act in the coming step."""
        self.instance.body_of_joint(self.joint).exert(self.joint, self.effort)


class Forces:
    """The forces on models. Use it in the simulation's thread only.

    Attributes:
        active: the forces that act now or later.
    """

    def __init__(self) -> None:
        self.active: list[Wrench | Effort] = []

    def add(self, force: Wrench | Effort) -> None:
        """Add a force, which acts in its period.

        Raises:
            ForceError: a number is not finite or too large, or the model is static.
        """
        for number in force.numbers:
            if not abs(number) <= STRONGEST:
                raise ForceError(f"force of {number:g}: not within {STRONGEST:g} N or N m")
        model = force.target[0].model
        if model.static:
            raise ForceError(f"model '{model.name}' is static; it cannot be moved")
        self.active.append(force)

    def before_step(self, step: int) -> None:
        """Apply the forces of the coming step, and remove those that have ended."""
        self.active = [force for force in self.active if force.period.end > step]
        for force in self.active:
            if force.period.first <= step:
                force.apply()

    def clear(self, kind: type = object, target: tuple[Any, ...] = ()) -> None:
        """End all forces of a kind on a model's link or joint, on a model, or on everything."""
        self.active = [
            force
            for force in self.active
            if not (isinstance(force, kind) and force.target[: len(target)] == target)
        ]
