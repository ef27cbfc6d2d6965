"""Who touches whom, where, with which shapes, and what is exchanged there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterable, List, Mapping, Sequence, Tuple

from bullet_lab.core.pose import Pose, Vector, add
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.physics.engine import pybullet
from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.world.description import Collision


@dataclass(frozen=True)
class ContactPoint:
    """One point of contact in the last step, in the world.

    `index` is PyBullet's of the link, or of the helper that carries what touches; `other` the
    other body's unique id and link's index. Places and depth are in m, the normal points from the
    other link to this one, and `force` is that on this link in N, friction included but that of
    wheels with a `Traction` of their own.
    """

    index: int
    other: Tuple[int, int]
    place: Vector
    place_on_other: Vector
    normal: Vector
    depth: float
    force: Vector


def contact_points(body: Body, link: str) -> List[ContactPoint]:
    """Return the points where a link touches something, by its name."""
    own = [(body.unique_id, index) for index in body.link_indices(link)]
    if not any(body.near_points(linkIndexA=index) for _, index in own):
        return []
    # All of the world's: asked for one body, PyBullet turns points round to have it first, but
    # not their friction.
    everything = pybullet.getContactPoints(physicsClientId=body.client)
    return [_seen_from(point, end) for point in everything for end in own if _concerns(point, end)]


def _concerns(point: tuple, own: Tuple[int, int]) -> bool:
    _, first, second, first_link, second_link, *_ = point
    distance, force = point[8:10]
    # Bullet lists what is merely near, too; what comes apart overlaps without a force.
    touching = force > 0.0 or distance < 0.0
    return touching and own in ((first, first_link), (second, second_link))


def _seen_from(point: tuple, own: Tuple[int, int]) -> ContactPoint:
    """Return one of PyBullet's points as the link sees it."""
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
    """What two models do to each other.

    `force` is the sum of all normal forces in N, `position` (m, world) of what presses most.
    """

    force: float
    position: Vector


def touching_points(body: Body) -> List[tuple]:
    """Return PyBullet's points where a body touches something; the body itself comes first."""
    # Bullet lists what is merely near, too; what comes apart overlaps without a force.
    return [point for point in body.near_points() if point[9] > 0.0 or point[8] < 0.0]


def contacts_of(bodies: Iterable[Body], owners: Mapping[int, str], own: str) -> Dict[str, Contact]:
    """Return the contacts of the model `own` with others in the last step, by their names.

    `owners` names the models by the unique ids of their bodies.
    """
    sums: Dict[str, float] = {}
    strongest: Dict[str, Tuple[float, Vector]] = {}
    for body in bodies:
        for _, _, second, _, _, place, _, _, _, force, *_ in touching_points(body):
            other = owners[second]
            sums[other] = sums.get(other, 0.0) + force
            if other not in strongest or force > strongest[other][0]:
                strongest[other] = (force, place)
    sums.pop(own, None)
    return {other: Contact(force, strongest[other][1]) for other, force in sums.items()}


def nearest_shape(collisions: Sequence[Collision], point: Vector) -> Collision:
    """Return the shape of a link whose surface is next to a point in the link's frame."""

    def distance(shape: Collision) -> float:
        return shape.geometry.distance((shape.pose.inverse() * Pose(point)).position)

    return min(collisions, key=distance)


def shape_name(model: str, body: Body, index: int, place: Vector) -> str:
    """Return the name of the shape at a place (m, world) on a link: model::link::collision."""
    part = body.part_at(index)
    if len(part.shapes) == 1:
        (shape,) = part.shapes
    else:
        point = AttachedFrame(body, part.link.name).pose().inverse() * Pose(place)
        shape = nearest_shape(part.shapes, point.position)
    return f"{model}::{part.link.name}::{shape.name}"
