"""Forces from outside: on links and on joints, for a while of simulated time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, List, Tuple, Union

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.simulation.models import Entity, ModelInstance
from bullet_lab.simulation.world.description import FrameState
from bullet_lab.simulation.world.inertia import FARTHEST

# Beyond this, in N or N m, numbers overflow rather than bodies move.
STRONGEST = 1e9


class ForceError(LabError):
    """A force that cannot be applied."""


@dataclass(frozen=True)
class Period:
    """Steps from `first` on, up to but without `end`."""

    first: int
    end: float

    @classmethod
    def after(cls, now: int, start: float, duration: float) -> Period:
        """Return the steps of a period of simulated time, not before the step `now`.

        A past `start` (s) means at once, a `duration` (s) of less than a step one step, and a
        negative one for ever.
        """
        first = max(now, math.ceil(round(start * STEPS_PER_SECOND, 6)))
        if duration < 0.0:
            return cls(first, math.inf)
        steps = round(duration * STEPS_PER_SECOND)
        return cls(first, first + (max(1, steps) if duration else 0))


@dataclass(frozen=True)
class Wrench:
    """A force in N at the origin of a link's frame, a torque in N m, in the world's axes.

    `target` is the model and the link that it acts on, `numbers` how strong it is.
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
        given_in: FrameState,
        link: Entity,
        force: Vector,
        torque: Vector,
        point: Vector,
        period: Period,
    ) -> Wrench:
        """Make a wrench from one that is given in a frame, at a point of that frame.

        It is turned into the world's axes now, and keeps its directions there.

        Raises:
            ForceError: a number that is not finite or absurd.
        """
        _check(force + torque)
        if not max(map(abs, point)) <= FARTHEST:
            raise ForceError(f"a force at {point} m is not within {FARTHEST:g} m")
        turn = Pose(quaternion=given_in.pose.quaternion)
        push, twist = turn.rotate(force), turn.rotate(torque)
        at = (given_in.pose * Pose(point)).position
        arm = subtract(at, link.frame.pose().position)
        return cls(link, push, add(twist, cross(arm, push)), period)

    def apply(self) -> None:
        """Push and turn in the coming step."""
        frame = self.link.frame
        frame.body.push(frame.link, self.force, self.torque, frame.pose().position)


@dataclass(frozen=True)
class Effort:
    """A torque in N m or a force in N of a joint; `target` and `numbers` as those of `Wrench`."""

    instance: ModelInstance
    joint: str
    effort: float
    period: Period
    target = property(lambda self: (self.instance, self.joint))
    numbers = property(lambda self: (self.effort,))

    def apply(self) -> None:
        """Turn or push in the coming step."""
        self.instance.body_of_joint(self.joint).exert(self.joint, self.effort)


def _check(numbers: Tuple[float, ...]) -> None:
    for number in numbers:
        if not abs(number) <= STRONGEST:
            raise ForceError(f"a force of {number:g} is not within {STRONGEST:g} N or N m")


class Forces:
    """All forces that act or wait for their time. Belongs to the simulation's thread."""

    def __init__(self) -> None:
        self._forces: List[Union[Wrench, Effort]] = []

    @property
    def active(self) -> bool:
        """Whether there is anything to do before a step."""
        return bool(self._forces)

    def add(self, force: Union[Wrench, Effort]) -> None:
        """Let a force act in its period.

        Raises:
            ForceError: a number that is not finite or absurd, or the model never moves.
        """
        _check(force.numbers)
        model = force.target[0].model
        if model.static:
            raise ForceError(f"model '{model.name}' is static: nothing moves it")
        self._forces.append(force)

    def before_step(self, step: int) -> None:
        """Apply what acts during the coming step."""
        ended = False
        for force in self._forces:
            if force.period.end <= step:
                ended = True
            elif force.period.first <= step:
                force.apply()
        if ended:
            self._forces = [force for force in self._forces if force.period.end > step]

    def clear(self, kind: type = object, target: Tuple[Any, ...] = ()) -> None:
        """End all forces of a kind on a model's link or joint, on a model, or anywhere."""
        self._forces = [
            force
            for force in self._forces
            if not (isinstance(force, kind) and force.target[: len(target)] == target)
        ]
