"""Friction of wheels that steer by slipping: Coulomb's law, along and across each wheel.

The engine limits friction along two axes of the world, each for itself or by what they move
(`docs/contact_model.md`), so it only carries these wheels here. Their friction is one step of
Jacobi's projected iteration before each step of the physics, started from that of the step
before: what would stop the slip is added to it, and what is beyond the limit is taken back by the
rule of greatest dissipation (Moreau 1974, "On unilateral constraints, friction and plasticity").
So friction ends up opposing the slip, or stopping it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Dict, List, Mapping, Optional, Protocol, Sequence, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.bodies import Part
from bullet_lab.simulation.physics.engine import pybullet
from bullet_lab.simulation.physics.skidding import SkiddingWheel, wheel_mobility
from bullet_lab.simulation.world.description import Link

# Something along a wheel's way, and across it.
Both = Tuple[float, float]
# Of what would stop a slip: the part that acts in a step, and the part of it that is kept for the
# next ones, as a spring keeps it.
STOPPING = 1.5
KEEPING = 0.2
# What part of a step's load counts; Bullet may carry a wheel in small pushes.
LOAD_SMOOTHING = 0.1
# No load (N) and no coefficient is smaller.
SLIGHT = SLICK = 1e-6
# Of Newton's method: how near 1 is near enough, and how many iterations at most.
NEARLY = 1.0 + 1e-5
ITERATIONS = 20
# A body that gives way to a push at its rim gives way so much more than its mass says.
YIELDING = 4.0
# Sine of the angle between an axle and the normal of what the wheel's flank touches, at most.
FLANK = 0.05


def limited(wanted: Both, gains: Both, most: Both) -> Tuple[float, float, float]:
    """Return friction within its limits, along and across, and what part is left of the one wanted.

    The part is that of the direction in which more is left.

    Args:
        wanted: the force W that would stop the slip, in N.
        gains: by how much the force changes with the slip, in N s/m.
        most: half axes of the ellipse that the force stays within, in N.

    The force F is that within the ellipse which is next to W where distances are measured by
    Σ (F - W)²/gain. So what is taken back, over the gains, is a slip to which the ellipse is
    normal in F; if its axes are equal, F opposes it, whatever the gains:

    >>> limited((3.0, 4.0), (1.0, 1.0), (10.0, 10.0))
    (3.0, 4.0, 1.0)
    >>> x, y, _ = limited((-300.0, 20.0), (3.0, 1.0), (10.0, 10.0))
    >>> round((-300.0 - x) / 3.0 / x, 6) == round((20.0 - y) / y, 6), round(math.hypot(x, y), 9)
    (True, 10.0)
    """
    # In units of the limits: F = W / (1 + s·p), with the s that puts F onto the unit circle. By
    # Newton's method on 1/|F|, which is concave in s, from where each part alone is within it.
    x, y = wanted[0] / most[0], wanted[1] / most[1]
    if x * x + y * y <= 1.0:
        return (*wanted, 1.0)
    p, q = gains[0] / (most[0] * most[0]), gains[1] / (most[1] * most[1])
    s = max(0.0, (abs(x) - 1.0) / p, (abs(y) - 1.0) / q)
    for _ in range(ITERATIONS):
        u, v = x / (1.0 + s * p), y / (1.0 + s * q)
        square = u * u + v * v
        length = math.sqrt(square)
        if length < NEARLY:
            break
        slope = u * u * p / (1.0 + s * p) + v * v * q / (1.0 + s * q)
        s += (length - 1.0) * square / slope
    return u / length * most[0], v / length * most[1], 1.0 / (1.0 + s * min(p, q))


class Body(Protocol):
    """What is needed here of `physics.Body`."""

    unique_id: int
    client: int
    links: Tuple[Link, ...]
    parts: Tuple[Part, ...]
    com_place: Callable[[], Tuple[Vector, Any]]
    near_points: Callable[[], Sequence[tuple]]
    velocity: Callable[[], Tuple[Vector, Vector]]
    link_indices: Callable[[str], Tuple[int, ...]]
    part_at: Callable[[int], Part]


@dataclass(frozen=True)
class Contact:
    """What a wheel touches: the coefficients of the two, along and across.

    `other` is the other link, if it gives way; then gains are smaller by a factor, `share`.
    """

    coefficients: Both
    other: Optional[Tuple[Body, int]] = None
    share: float = 1.0


class Wheel:
    """A wheel in the engine.

    Attributes:
        index: PyBullet's of its link.
        axle: in the principal frame of its link.
        gains: by how much friction along and across stops a slip in one step, in N s/m.
        load: what carries it, in N.
    """

    gains: Both

    def __init__(self, index: int, axle: Vector):
        self.index, self.axle = index, axle
        self.let_go()

    def let_go(self) -> None:
        """Have no friction."""
        self.load = 0.0
        self._kept = (0.0, 0.0)

    def carry(self, load: float, touching: bool) -> None:
        """Take over the force (N) that carried the wheel in the last step."""
        self.load += LOAD_SMOOTHING * (load - self.load)
        if not touching:
            self._kept = (0.0, 0.0)

    def rub(self, slip: Both, coefficients: Both, share: float) -> Both:
        """Return the friction (N) that a slip (m/s) makes, each along and across.

        `share` is the part of the gains that counts.
        """
        gain, gain2 = share * self.gains[0], share * self.gains[1]
        stop, stop2 = gain * slip[0], gain2 * slip[1]
        wanted = self._kept[0] - STOPPING * stop, self._kept[1] - STOPPING * stop2
        load = max(self.load, SLIGHT)
        most = coefficients[0] * load, coefficients[1] * load
        along, across, left = limited(wanted, (gain, gain2), most)
        passing = left * (STOPPING - KEEPING)
        self._kept = along + passing * stop, across + passing * stop2
        return along, across


class Traction:
    """Friction of the wheels of a body that steer it by slipping, in place of the engine's.

    Args:
        body: which has the wheels.
        wheels: of it.
        others: all bodies in the world by their unique ids.
    """

    def __init__(self, body: Body, wheels: Sequence[SkiddingWheel], others: Mapping[int, Body]):
        self._body, self._others, self._told = body, others, tuple(wheels)
        self._wheels = [
            Wheel(body.link_indices(w.link)[0], _principal_axle(body, w)) for w in wheels
        ]
        self.tune()
        # By PyBullet's index of a wheel's link or of a helper.
        self._owners = {
            index: wheel
            for wheel, told in zip(self._wheels, wheels)
            for index in body.link_indices(told.link)
        }
        for index in self._owners:
            self._call(pybullet.changeDynamics, body, index, lateralFriction=0.0)
        self._contacts: Dict[Tuple[int, int, int], Contact] = {}
        self._known = False
        indices = [wheel.index for wheel in self._wheels]
        self._states = partial(pybullet.getLinkStates, body.unique_id, indices, 1, 0, body.client)

    def tune(self) -> None:
        """Take over the inertias of the body's links.

        The gains stop a slip in a step, if it is one of all wheels at once and each makes the
        others' smaller. So the iteration cannot overshoot (Gershgorin's theorem).
        """
        joints = [part.joint for part in self._body.parts if part.joint is not None]
        mobility = wheel_mobility(self._body.links, joints, self._told)
        gains = (STEPS_PER_SECOND / np.abs(mobility).sum(axis=1)).tolist()
        for wheel, along, across in zip(self._wheels, gains[::2], gains[1::2]):
            wheel.gains = (along, across)

    def forget_others(self) -> None:
        """Learn anew what other bodies are like, where one was taken away."""
        self._contacts.clear()

    def forget(self) -> None:
        """Begin anew where the body was put somewhere."""
        self._known = False
        for wheel in self._wheels:
            wheel.let_go()

    def rubs(self, index: int) -> bool:
        """Return whether the friction of the link with PyBullet's index is made here."""
        return index in self._owners

    def before_step(self, _: int) -> None:
        """Let the wheels rub in the coming step."""
        if not self._known:
            # What they touch there is not.
            self._known = True
            return
        touching: Dict[int, List[tuple]] = {wheel.index: [] for wheel in self._wheels}
        for point in self._body.near_points():
            # What is merely near does not rub; what comes apart overlaps without a force.
            if point[3] in self._owners and (point[9] > 0.0 or point[8] < 0.0):
                touching[self._owners[point[3]].index].append(point)
        for wheel, state in zip(self._wheels, self._states()):
            points = touching[wheel.index]
            load = sum([point[9] for point in points])
            wheel.carry(load, bool(points))
            if points:
                weights = [point[9] / load if load else 1.0 / len(points) for point in points]
                self._rub(wheel, state, list(zip(weights, points)))

    def _rub(self, wheel: Wheel, state: tuple, points: Sequence[Tuple[float, tuple]]) -> None:
        axle = Pose(quaternion=state[1]).rotate(wheel.axle)
        # Friction is shared out among the points by what each can hold.
        one = other = along = across = 0.0
        gives, touches = 1.0, []
        for share, point in points:
            contact, place = self._contact(point), point[5]
            way, side = _tangents(axle, point[7])
            slip = add(state[6], cross(state[7], subtract(place, state[0])))
            if contact.other is not None:
                slip = subtract(slip, _velocity_of(*contact.other, place))
            mu, mu2 = share * contact.coefficients[0], share * contact.coefficients[1]
            one, other = one + mu, other + mu2
            along += mu * _dot(slip, way)
            across += mu2 * _dot(slip, side)
            gives = min(gives, contact.share)
            touches.append((mu, mu2, contact, place, way, side))
        one, other = max(one, SLICK), max(other, SLICK)
        along, across = wheel.rub((along / one, across / other), (one, other), gives)
        for mu, mu2, contact, place, way, side in touches:
            x, y = mu / one * along, mu2 / other * across
            force = (x * way[0] + y * side[0], x * way[1] + y * side[1], x * way[2] + y * side[2])
            self._push(self._body, wheel.index, force, place)
            if contact.other is not None:
                self._push(*contact.other, (-force[0], -force[1], -force[2]), place)

    def _contact(self, point: tuple) -> Contact:
        key = (point[3], point[2], point[4])
        if key not in self._contacts:
            self._contacts[key] = self._new_contact(*key)
        return self._contacts[key]

    def _new_contact(self, index: int, unique_id: int, other_index: int) -> Contact:
        other = self._others[unique_id]
        surface, theirs = self._body.part_at(index).surface, other.part_at(other_index).surface
        # A wheel that rubs more in one direction has the axle for its axis.
        shares = (surface.across, surface.along)
        coefficients = tuple(min(share * surface.friction, theirs.friction) for share in shares)
        if other.parts[0].link.inertia is None or other is self._body:
            return Contact(coefficients)
        mass = sum(link.inertia.mass for link in other.links if link.inertia is not None)
        gives = YIELDING * len(self._wheels) * max(self._owners[index].gains) / STEPS_PER_SECOND
        return Contact(coefficients, (other, other_index), mass / (mass + gives))

    def _push(self, body: Body, index: int, force: Vector, place: Vector) -> None:
        self._call(pybullet.applyExternalForce, body, index, force, place, pybullet.WORLD_FRAME)

    def _call(self, function: Callable[..., Any], body: Body, *arguments: Any, **more: Any) -> None:
        function(body.unique_id, *arguments, physicsClientId=body.client, **more)


def _principal_axle(body: Body, wheel: SkiddingWheel) -> Vector:
    frame = body.part_at(body.link_indices(wheel.link)[0]).mass_properties()[2]
    return frame.inverse().rotate(wheel.axle)


def _tangents(axle: Vector, normal: Vector) -> Tuple[Vector, Vector]:
    """Return the way that a wheel rolls where it touches something, and the way it does not."""
    x, y, z = cross(axle, normal)
    length = math.sqrt(x * x + y * y + z * z)
    if length < FLANK:
        # Any direction will do.
        return _tangents((axle[1], axle[2], axle[0]), normal)
    way = (x / length, y / length, z / length)
    return way, cross(normal, way)


def _velocity_of(body: Body, index: int, place: Vector) -> Vector:
    """Return the velocity (m/s) of a place on a link of a body."""
    if index < 0:
        centre, (linear, angular) = body.com_place()[0], body.velocity()
    else:
        state = pybullet.getLinkState(body.unique_id, index, 1, 0, body.client)
        centre, linear, angular = state[0], state[6], state[7]
    return add(linear, cross(angular, subtract(place, centre)))


def _dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
