"""Contacts: which shapes touch, where, and with which forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterable, List, Mapping, Sequence, Tuple

from bullet_lab.core.pose import Pose, Vector, add
from bullet_lab.simulation.physics import is_contact, pybullet
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.world.description import Collision


@dataclass(frozen=True)
class ContactPoint:
    """One contact point of a link in the last step, in the world.

    Attributes:
        index: PyBullet's index of the link, or of its helper link that carries the shape.
        other: the other body's unique id and its link's index.
        place: on this link, in m.
        place_on_other: on the other link, in m.
        normal: from the other link to this one.
        depth: of the overlap, in m.
        force: on this link in N, with friction unless it is a wheel with a `Traction`.
    """

    index: int
    other: Tuple[int, int]
    place: Vector
    place_on_other: Vector
    normal: Vector
    depth: float
    force: Vector


def contact_points(body: Body, link: str) -> List[ContactPoint]:
    """Return the contact points of a link, by the link's name."""
    own = [(body.unique_id, index) for index in body.link_indices(link)]
    if not any(body.near_points(linkIndexA=index) for _, index in own):
        return []
    # The points of the whole world: if asked for one body, PyBullet turns points round so that
    # the body comes first, but not their friction.
    found = []
    for point in pybullet.getContactPoints(physicsClientId=body.client):
        if is_contact(point):
            first, second = (point[1], point[3]), (point[2], point[4])
            found += [_seen_from(point, end) for end in own if end in (first, second)]
    return found


def _seen_from(point: tuple, own: Tuple[int, int]) -> ContactPoint:
    """Return one of PyBullet's points as the link `own` (body and index) sees it."""
    first, second, first_link, second_link, on_first, on_second, normal, distance = point[1:9]
    pressure, friction, along, cross_friction, across = point[9:]
    slip = add(_times(friction, along), _times(cross_friction, across))
    force = add(_times(pressure, normal), slip)
    if own == (first, first_link):
        other = (second, second_link)
        return ContactPoint(first_link, other, on_first, on_second, normal, -distance, force)
    back, opposite = _times(-1.0, normal), _times(-1.0, force)
    other = (first, first_link)
    return ContactPoint(second_link, other, on_second, on_first, back, -distance, opposite)


def _times(factor: float, vector: Vector) -> Vector:
    return (factor * vector[0], factor * vector[1], factor * vector[2])


@dataclass(frozen=True)
class Contact:
    """Contact of two models.

    Attributes:
        force: the sum of all normal forces in N.
        position: of the point with the greatest force, in the world in m.
    """

    force: float
    position: Vector


def contacts_of(bodies: Iterable[Body], owners: Mapping[int, str], own: str) -> Dict[str, Contact]:
    """Return the contacts of the model `own` with others in the last step, by their names.

    `owners` names the models by the unique ids of their bodies.
    """
    sums: Dict[str, float] = {}
    strongest: Dict[str, Tuple[float, Vector]] = {}
    for body in bodies:
        for point in body.touching_points():
            other, place, force = owners[point[2]], point[5], point[9]
            sums[other] = sums.get(other, 0.0) + force
            if other not in strongest or force > strongest[other][0]:
                strongest[other] = (force, place)
    sums.pop(own, None)
    return {other: Contact(force, strongest[other][1]) for other, force in sums.items()}


def nearest_shape(collisions: Sequence[Collision], point: Vector) -> Collision:
    """Return the shape of a link whose surface is nearest to a point in the link's frame."""

    def distance(shape: Collision) -> float:
        return shape.geometry.distance((shape.pose.inverse() * Pose(point)).position)

    return min(collisions, key=distance)


def shape_name(model: str, body: Body, index: int, place: Vector) -> str:
    """Return the name of the shape at a place (m, world) on a link: model::link::collision."""
    touched = body.link_at(index)
    link, shapes = touched.link.name, touched.shapes
    if len(shapes) == 1:
        return f"{model}::{link}::{shapes[0].name}"
    point = AttachedFrame(body, link).pose().inverse() * Pose(place)
    return f"{model}::{link}::{nearest_shape(shapes, point.position).name}"
