"""Friction of wheels that Bullet cannot compute: by Coulomb's law, or by ODE's with `fdir1`.

The engine limits friction along two axes of the world (`docs/contact_model.md`), so it only
carries these wheels. Their friction is computed here, before each step of the physics, by one
step of the projected Jacobi iteration, which starts from the friction of the step before. First
the force is added that would stop the slip; then what exceeds the limit is taken back.

By Coulomb's law, friction ends up opposing the slip, or stopping it: the rule of greatest
dissipation (Moreau 1974, "On unilateral constraints, friction and plasticity"). ODE limits it
along `fdir1` and along the axle alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Iterable, Mapping, Optional, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Pose, Vector, add, cross, dot, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.physics.bodies import Body, is_contact
from bullet_lab.simulation.physics.surfaces import RoundWheel
from bullet_lab.simulation.world.description import Joint, Link

# Something along a wheel's rolling direction, and the same along its axle.
Pair = Tuple[float, float]
# Share of the stopping force that is added in a step.
STOPPING = 1.5
# Share of the stopping force that is kept for the next steps, as a spring would.
KEEPING = 0.2
# Weight of the newest load in the smoothed load: Bullet may carry a wheel in small pushes.
LOAD_SMOOTHING = 0.1
# Least load in N.
LEAST_LOAD = 1e-6
# Least coefficient of friction.
LEAST_COEFFICIENT = 1e-6
# Newton's method ends when the length is less than this, ...
NEARLY_ONE = 1.0 + 1e-5
# ... or after this many iterations.
ITERATIONS = 20
# A body that is pushed at its rim yields as if it had this part less of its mass.
YIELDING = 4.0
# Where fdir1 points into the floor, friction along it adds to the load, which adds to friction. It
# is not more than the inverse of this times what it would be without.
JAMMED = 0.1
# Least sine of the angle between an axle and the normal of a contact with the wheel's tread.
FLANK = 0.05
UP = np.array((0.0, 0.0, 1.0))


def limit_friction(wanted: Pair, gains: Pair, limits: Pair) -> tuple[float, float, float]:
    """Return the wanted friction within its limits, and the share of the wanted that is left.

    The share is that of the direction in which more is left.

    Args:
        wanted: the force W that would stop the slip, in N.
        gains: the change of the force with the slip, in N s/m.
        limits: half axes of the ellipse that the force must stay within, in N.

    The force F is the point of the ellipse that is nearest to W if distances are measured by
    Σ (F - W)²/gain. So the slip (W - F)/gain is normal to the ellipse in F; if the half axes are
    equal, F opposes that slip, whatever the gains:

    >>> limit_friction((3.0, 4.0), (1.0, 1.0), (10.0, 10.0))
    (3.0, 4.0, 1.0)
    >>> x, y, _ = limit_friction((-300.0, 20.0), (3.0, 1.0), (10.0, 10.0))
    >>> round((-300.0 - x) / 3.0 / x, 6) == round((20.0 - y) / y, 6), round(math.hypot(x, y), 9)
    (True, 10.0)
    """
    # In units of the limits, F = W / (1 + s·p), with the s that puts F onto the unit circle.
    # Newton's method finds it on 1/|F|, which is concave in s. It starts where each component
    # alone is within its limit.
    x, y = wanted[0] / limits[0], wanted[1] / limits[1]
    if x * x + y * y <= 1.0:
        return (*wanted, 1.0)
    p, q = gains[0] / (limits[0] * limits[0]), gains[1] / (limits[1] * limits[1])
    s = max(0.0, (abs(x) - 1.0) / p, (abs(y) - 1.0) / q)
    for _ in range(ITERATIONS):
        u, v = x / (1.0 + s * p), y / (1.0 + s * q)
        square = u * u + v * v
        length = math.sqrt(square)
        if length < NEARLY_ONE:
            break
        slope = u * u * p / (1.0 + s * p) + v * v * q / (1.0 + s * q)
        s += (length - 1.0) * square / slope
    return u / length * limits[0], v / length * limits[1], 1.0 / (1.0 + s * min(p, q))


def limit_directed(
    wanted: Pair, coefficients: Pair, load: float, cosine: float, sine: float
) -> tuple[float, float, float]:
    """Return the wanted friction within ODE's limits, and the share of the wanted that is left.

    Args:
        wanted: the force that would stop the slip, along the rolling direction and the axle (N).
        coefficients: `mu1` and `mu2`.
        load: that the floor carries, in N.
        cosine: of the angle from the rolling direction to `fdir1`, which turns with the wheel.
        sine: of the same angle; positive if `fdir1` points up.

    The constraint of ODE's contact along fdir1 has a force λ with |λ| ≤ mu1·N. It pushes with
    λ·cosine along the rolling direction, and carries λ·sine of the load, so N = load - λ·sine.
    The second direction is normal times fdir1, whose length is |cosine|, and so is its share of
    mu2·N. With fdir1 along the floor:

    >>> limit_directed((-20.0, 4.0), (1.0, 0.5), 10.0, 1.0, 0.0)
    (-10.0, 4.0, 1.0)
    """
    first, second = coefficients
    side = math.copysign(1.0, wanted[0] * cosine)
    limit = first * abs(cosine) * load / max(1.0 + side * first * sine, JAMMED)
    along = max(-limit, min(limit, wanted[0]))
    carried = load - along * sine / cosine if cosine else load
    limit = max(0.0, second * abs(cosine) * carried)
    across = max(-limit, min(limit, wanted[1]))
    left = max(have / want if want else 0.0 for have, want in zip((along, across), wanted))
    return along, across, left


@dataclass(frozen=True)
class Partner:
    """What a wheel touches.

    Attributes:
        coefficients: of friction between the two.
        link: body and index of the link that is touched; None if it does not move.
        share: the factor by which that link, as it yields, reduces the wheel's gains.
    """

    coefficients: Pair
    link: tuple[Body, int] | None = None
    share: float = 1.0


@dataclass(eq=False)
class WheelFriction:
    """The friction of one wheel.

    Attributes:
        index: PyBullet's index of the wheel's link.
        axle: in the principal frame of the link.
        direction: `fdir1` in the same frame; None for Coulomb's law.
        gains: the friction that stops a slip in one step, in N s/m.
        load: the smoothed force that carries the wheel, in N.
        kept: the force that the next step begins with, in N.
    """

    index: int
    axle: Vector
    direction: Vector | None
    gains: Pair = (0.0, 0.0)
    load: float = 0.0
    kept: Pair = (0.0, 0.0)

    def reset(self) -> None:
        """Have no load and no friction."""
        self.load = 0.0
        self.kept = (0.0, 0.0)

    def force(self, slip: Pair, coefficients: Pair, share: float, angle: Pair) -> Pair:
        """Return the friction in N at a slip in m/s, with this share of the gains.

        `angle` is cosine and sine of that from the rolling direction to `direction`.
        """
        gains = share * self.gains[0], share * self.gains[1]
        stop, stop2 = gains[0] * slip[0], gains[1] * slip[1]
        wanted = self.kept[0] - STOPPING * stop, self.kept[1] - STOPPING * stop2
        load = max(self.load, LEAST_LOAD)
        if self.direction is None:
            limits = coefficients[0] * load, coefficients[1] * load
            along, across, left = limit_friction(wanted, gains, limits)
        else:
            along, across, left = limit_directed(wanted, coefficients, load, *angle)
        passing = left * (STOPPING - KEEPING)
        self.kept = along + passing * stop, across + passing * stop2
        return along, across


class Traction:
    """Friction of wheels of a body, in place of the engine's.

    Args:
        body: that has the wheels.
        wheels: those that slip.
        others: all bodies in the world by their unique ids.
        coulomb: whether by Coulomb's law; if not, all wheels have a direction.

    Attributes:
        owners: the wheels by PyBullet's index of their links and of their helper links.
    """

    def __init__(
        self,
        body: Body,
        wheels: Sequence[RoundWheel],
        others: Mapping[int, Body],
        coulomb: bool,
    ):
        self._body = body
        self._described = tuple(wheels)
        self._others = others
        self._wheels: list[WheelFriction] = []
        self.owners: dict[int, WheelFriction] = {}
        for described in wheels:
            indices = body.link_indices(described.link)
            to_frame = body.link_at(indices[0]).mass_properties()[2].inverse()
            direction = None if coulomb else to_frame.rotate(described.direction)
            wheel = WheelFriction(indices[0], to_frame.rotate(described.axle), direction)
            self._wheels.append(wheel)
            self.owners.update(dict.fromkeys(indices, wheel))
        self.update_gains()
        for index in self.owners:
            pybullet.changeDynamics(
                body.unique_id, index, lateralFriction=0.0, physicsClientId=body.client
            )
        self._partners: dict[tuple[int, Body, int], Partner] = {}
        self._points_are_valid = False
        indices = [wheel.index for wheel in self._wheels]
        self._states = partial(pybullet.getLinkStates, body.unique_id, indices, 1, 0, body.client)

    def update_gains(self) -> None:
        """Compute the gains from the inertias of the body's links.

        The gains stop a slip in one step even if all wheels slip and each adds to the slip of
        the others. So the iteration cannot overshoot (Gershgorin's theorem).
        """
        joints = [link.joint for link in self._body.bullet_links if link.joint is not None]
        mobility = wheel_mobility(self._body.links, joints, self._described)
        gains = (STEPS_PER_SECOND / np.abs(mobility).sum(axis=1)).tolist()
        for wheel, along, across in zip(self._wheels, gains[::2], gains[1::2]):
            wheel.gains = (along, across)

    def reset(self) -> None:
        """Start without friction after the body was placed somewhere."""
        self._points_are_valid = False
        for wheel in self._wheels:
            wheel.reset()

    def before_step(self, _: int) -> None:
        """Apply the wheels' friction in the coming step."""
        if not self._points_are_valid:
            # The engine's contact points are still those of the place before.
            self._points_are_valid = True
            return
        touching = {wheel.index: [] for wheel in self._wheels}
        for point in self._body.near_points():
            if point[3] in self.owners and is_contact(point):
                touching[self.owners[point[3]].index].append(point)
        for wheel, state in zip(self._wheels, self._states()):
            points = touching[wheel.index]
            load = sum([point[9] for point in points])
            wheel.load += LOAD_SMOOTHING * (load - wheel.load)
            if not points:
                wheel.kept = (0.0, 0.0)
            else:
                weights = [point[9] / load if load else 1.0 / len(points) for point in points]
                self._apply_friction(wheel, state, zip(points, weights))

    def _apply_friction(
        self, wheel: WheelFriction, state: tuple, points: Iterable[tuple[tuple, float]]
    ) -> None:
        """Push the wheel, and what it touches, at PyBullet's points, which have weights.

        The slip of the wheel is the mean over the points, weighted by their coefficients; each
        point gets a part of the friction in the same ratio.
        """
        pose = Pose(quaternion=state[1])
        axle = pose.rotate(wheel.axle)
        angle = (1.0, 0.0)
        mu_along = 0.0
        mu_across = 0.0
        slip_along = 0.0
        slip_across = 0.0
        share = 1.0
        parts = []
        for point, weight in points:
            partner, place = self._partner(point), point[5]
            rolling, lateral = _directions(axle, point[7])
            slip = add(state[6], cross(state[7], subtract(place, state[0])))
            if partner.link is not None:
                slip = subtract(slip, _velocity_of(*partner.link, place))
            part_along = weight * partner.coefficients[0]
            part_across = weight * partner.coefficients[1]
            mu_along += part_along
            mu_across += part_across
            slip_along += part_along * dot(slip, rolling)
            slip_across += part_across * dot(slip, lateral)
            share = min(share, partner.share)
            parts.append((partner, place, rolling, lateral, part_along, part_across))
            if wheel.direction is not None:
                direction = pose.rotate(wheel.direction)
                angle = dot(direction, rolling), dot(direction, point[7])
        mu_along = max(mu_along, LEAST_COEFFICIENT)
        mu_across = max(mu_across, LEAST_COEFFICIENT)
        slips = slip_along / mu_along, slip_across / mu_across
        along, across = wheel.force(slips, (mu_along, mu_across), share, angle)
        for partner, place, rolling, lateral, part_along, part_across in parts:
            x = part_along / mu_along * along
            y = part_across / mu_across * across
            force = (
                x * rolling[0] + y * lateral[0],
                x * rolling[1] + y * lateral[1],
                x * rolling[2] + y * lateral[2],
            )
            self._body.push_at(wheel.index, force, place)
            if partner.link is not None:
                other, index = partner.link
                other.push_at(index, (-force[0], -force[1], -force[2]), place)

    def _partner(self, point: tuple) -> Partner:
        key = (point[3], self._others[point[2]], point[4])
        partner = self._partners.get(key)
        if partner is None:
            partner = self._partners[key] = self._new_partner(*key)
        return partner

    def _new_partner(self, index: int, other: Body, other_index: int) -> Partner:
        own, theirs = self._body.link_at(index).surface, other.link_at(other_index).surface
        # The axis of a wheel's surface with two coefficients is its axle.
        along = min(own.across * own.friction, theirs.friction)
        across = min(own.along * own.friction, theirs.friction)
        if not other.moves or other is self._body:
            return Partner((along, across))
        mass = sum(link.inertia.mass for link in other.links)
        yields = YIELDING * len(self._wheels) * max(self.owners[index].gains) / STEPS_PER_SECOND
        return Partner((along, across), (other, other_index), mass / (mass + yields))


def _directions(axle: Vector, normal: Vector) -> tuple[Vector, Vector]:
    """Return a wheel's rolling direction at a contact with this normal, and its lateral one."""
    x, y, z = cross(axle, normal)
    length = math.sqrt(x * x + y * y + z * z)
    if length < FLANK:
        # The wheel's flank touches: any direction will do.
        return _directions((axle[1], axle[2], axle[0]), normal)
    rolling = (x / length, y / length, z / length)
    return rolling, cross(normal, rolling)


def _velocity_of(body: Body, index: int, place: Vector) -> Vector:
    """Return the velocity (m/s) of a place on a link of a body."""
    if index < 0:
        centre, (linear, angular) = body.com_place()[0], body.velocity()
    else:
        state = pybullet.getLinkState(body.unique_id, index, 1, 0, body.client)
        centre, linear, angular = state[0], state[6], state[7]
    return add(linear, cross(angular, subtract(place, centre)))


# A degree of freedom: its axis, and a place on the axis; the place is None for a translation.
Freedom = Tuple[ndarray, Optional[ndarray]]


def wheel_mobility(
    links: Sequence[Link], joints: Sequence[Joint], wheels: Sequence[RoundWheel]
) -> ndarray:
    """Return how easily friction moves the points where wheels touch the floor.

    The matrix J M⁻¹ Jᵀ, of shape (2n, 2n) and in 1/kg, maps impulses along the rolling direction
    and the axle of each wheel to the changes of velocity there. The body, of inertia M, is free
    in space, and its joints are loose and at zero.
    """
    poses = {link.name: link.pose for link in links}
    freedoms, columns = _freedoms(links, joints)
    inertia = np.zeros((len(freedoms), len(freedoms)))
    for link in links:
        if link.inertia is not None:
            centre = np.array((link.pose * Pose(link.inertia.centre)).position)
            linear, angular = _jacobian(centre, freedoms, columns[link.name])
            turn = link.pose.rotation_matrix().T @ angular
            inertia += link.inertia.mass * linear.T @ linear + turn.T @ link.inertia.matrix @ turn
    rows = []
    for wheel in wheels:
        axle = np.array(poses[wheel.link].rotate(wheel.axle))
        rolling = np.cross(axle, UP) / np.linalg.norm(np.cross(axle, UP))
        own = columns[wheel.link]
        _, hub = freedoms[own[-1]]
        linear, _ = _jacobian(hub - wheel.radius * np.cross(rolling, axle), freedoms, own)
        rows += [rolling @ linear, axle @ linear]
    touches = np.array(rows)
    # Links without inertia of their own change nothing for those that carry them.
    return touches @ np.linalg.pinv(inertia, hermitian=True) @ touches.T


def _freedoms(
    links: Sequence[Link], joints: Sequence[Joint]
) -> tuple[list[Freedom], dict[str, list[int]]]:
    """Return the freedoms, those of the root first, and which of them move each link."""
    above = {joint.child: joint for joint in joints}
    freedoms = [(axis, at) for at in (None, np.zeros(3)) for axis in np.eye(3)]
    columns = {links[0].name: list(range(len(freedoms)))}
    for link in links[1:]:
        joint = above[link.name]
        place = np.array((link.pose * Pose(joint.anchor)).position)
        turn = link.pose.rotation_matrix()
        axes = {"ball": turn.T, "fixed": ()}.get(joint.kind, [turn @ joint.axis])
        first = len(freedoms)
        freedoms += [(axis, None if joint.kind == "prismatic" else place) for axis in axes]
        columns[link.name] = [*columns[joint.parent], *range(first, len(freedoms))]
    return freedoms, columns


def _jacobian(
    place: ndarray, freedoms: Sequence[Freedom], columns: Sequence[int]
) -> tuple[ndarray, ndarray]:
    """Return the linear and angular Jacobian of a place (m) that some of the freedoms move."""
    linear, angular = np.zeros((2, 3, len(freedoms)))
    for column in columns:
        axis, at = freedoms[column]
        linear[:, column] = axis if at is None else np.cross(axis, place - at)
        if at is not None:
            angular[:, column] = axis
    return linear, angular
