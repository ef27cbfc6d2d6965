"""Frames that are fixed to a link of a body: their pose, velocity and contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable

from bullet_lab.core.pose import Pose, Vector, add, cross
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.physics.bodies import Body, is_contact
from bullet_lab.simulation.world.description import Collision, Model

ORIGIN = Pose()


@dataclass(frozen=True)
class ContactPoint:
    """One contact point of a link in the last step, in the world.

    Attributes:
        own: the body's unique id, and PyBullet's index of the link, or of its helper link.
        other: the same of the link that it touches.
        place: on this link, in m.
        place_on_other: on the other link, in m.
        normal: from the other link to this one.
        depth: of the overlap, in m.
        force: on this link in N, with friction unless it is a wheel with a `Traction`.
    """

    own: tuple[int, int]
    other: tuple[int, int]
    place: Vector
    place_on_other: Vector
    normal: Vector
    depth: float
    force: Vector


class AttachedFrame:
    """A frame at a pose `offset` in a link of a body."""

    def __init__(self, body: Body, link: str, offset: Pose = ORIGIN):
        self.body, self.link = body, link
        self._index = body.link_index(link)
        # PyBullet gives the pose of a link's principal frame.
        principal = body.link_at(self._index).mass_properties()[2]
        self._in_principal = principal.inverse() * offset

    @classmethod
    def of(
        cls, model: Model, bodies: Iterable[Body], link: str, offset: Pose = ORIGIN
    ) -> AttachedFrame:
        """Return a frame at an offset in a link of a model, which may be merged into another.

        Raises KeyError if there is no such link.
        """
        carrier, pose = model.frames.get(link, (link, ORIGIN))
        for body in bodies:
            if any(one.name == carrier for one in body.links):
                return cls(body, carrier, pose * offset)
        raise KeyError(link)

    def pose(self) -> Pose:
        """Return the frame's pose in the world."""
        return self._principal_pose() * self._in_principal

    def velocity(self, before_friction: bool = False) -> tuple[Vector, Vector]:
        """Return linear (m/s, of the frame's origin) and angular (rad/s) velocity, in the world.

        `before_friction` means the velocity that a plugin sets, if there is one: see `Body`.
        """
        if before_friction and self.body.commanded_velocity is not None:
            linear, angular = self.body.commanded_velocity()
        elif self._index < 0:
            linear, angular = self.body.velocity()
        else:
            state = pybullet.getLinkState(self.body.unique_id, self._index, 1, 1, self.body.client)
            linear, angular = state[6:8]
        arm = self._principal_pose().rotate(self._in_principal.position)
        return add(linear, cross(angular, arm)), angular

    def centre_of_mass(self) -> Vector:
        """Return the position of the link's centre of mass in the world, in m."""
        return self._principal_pose().position

    def contact_points(self) -> list[ContactPoint]:
        """Return the contact points of the link."""
        body = self.body
        own = [(body.unique_id, index) for index in body.link_indices(self.link)]
        if not any(body.near_points(linkIndexA=index) for _, index in own):
            return []
        # The points of the whole world: if asked for one body, PyBullet turns points round so
        # that the body comes first, but not their friction.
        found = []
        for point in filter(is_contact, pybullet.getContactPoints(physicsClientId=body.client)):
            ends = ((point[1], point[3]), (point[2], point[4]))
            found += [_seen_from(point, end) for end in (0, 1) if ends[end] in own]
        return found

    def _principal_pose(self) -> Pose:
        return Pose(*self.body.link_place(self._index))


def _seen_from(point: tuple, end: int) -> ContactPoint:
    """Return one of PyBullet's points as its first link (0) or its second one (1) sees it."""
    own, other = 1 + end, 2 - end
    sign = -1.0 if end else 1.0
    pressure, friction, along, cross_friction, across = point[9:]
    slip = add(_times(friction, along), _times(cross_friction, across))
    return ContactPoint(
        own=(point[own], point[own + 2]),
        other=(point[other], point[other + 2]),
        place=point[own + 4],
        place_on_other=point[other + 4],
        normal=_times(sign, point[7]),
        depth=-point[8],
        force=_times(sign, add(_times(pressure, point[7]), slip)),
    )


def _times(factor: float, vector: Vector) -> Vector:
    return (factor * vector[0], factor * vector[1], factor * vector[2])


def shape_name(body: Body, index: int, place: Vector) -> str:
    """Return the name of the shape at a place (m, world) on a link: model::link::collision."""
    touched = body.link_at(index)
    link, shape = touched.link.name, touched.shapes[0]
    if len(touched.shapes) > 1:
        point = AttachedFrame(body, link).pose().inverse() * Pose(place)

        def distance(shape: Collision) -> float:
            return shape.geometry.distance((shape.pose.inverse() * point).position)

        shape = min(touched.shapes, key=distance)
    return f"{body.model}::{link}::{shape.name}"
