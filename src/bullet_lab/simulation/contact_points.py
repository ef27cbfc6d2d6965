"""Points where a link touches others, and what is exchanged there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

from bullet_lab.simulation.engine import pybullet
from bullet_lab.simulation.physics import Body
from bullet_lab.simulation.pose import Vector, add


@dataclass(frozen=True)
class ContactPoint:
    """One point of contact in the last step, in the world.

    Attributes:
        index: PyBullet's index of the link, or of the helper that carries what touches.
        other: unique id of the other body, and PyBullet's index of its link.
        place: on the link, in m.
        place_on_other: on the other link, in m.
        normal: unit vector from the other link to this one.
        depth: how deep they overlap, in m.
        force: on this link, friction included, in N.
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
    (_, first, second, first_link, second_link, on_first, on_second, normal, distance, pressure,
     friction, along, cross_friction, across) = point
    force = add(
        _times(pressure, normal), add(_times(friction, along), _times(cross_friction, across))
    )
    if own == (first, first_link):
        return ContactPoint(
            first_link, (second, second_link), on_first, on_second, normal, -distance, force
        )
    return ContactPoint(
        second_link,
        (first, first_link),
        on_second,
        on_first,
        _times(-1.0, normal),
        -distance,
        _times(-1.0, force),
    )


def _times(factor: float, vector: Vector) -> Vector:
    return (factor * vector[0], factor * vector[1], factor * vector[2])
