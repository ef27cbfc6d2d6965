"""Keeping what is out of all proportion away from the engine, where numbers would overflow."""

from __future__ import annotations

from typing import Iterable, Iterator, Tuple

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import (
    Box,
    Cylinder,
    Geometry,
    Mesh,
    Model,
    Plane,
    Sphere,
)

# In m, m/s and rad/s: no robot of a lab is so far away, or so fast.
FARTHEST = 1e6
FASTEST = 1e6
# In kg.
HEAVIEST = 1e12


class ProportionError(LabError):
    """Something is out of all proportion."""


def check_proportions(model: Model) -> None:
    """Refuse a model with a part that is absurdly far away, large or heavy.

    Raises:
        ProportionError: there is one; the message says which.
    """
    for what, values, limit in _measures(model):
        for value in values:
            # Not finite is out of proportion, too.
            if not abs(value) <= limit:
                raise ProportionError(
                    f"model '{model.name}': {what}: {value:g} is out of all proportion"
                )


def _measures(model: Model) -> Iterator[Tuple[str, Iterable[float], float]]:
    yield "pose", model.pose.position, FARTHEST
    for link in model.links:
        where = f"link '{link.name}'"
        yield f"{where}: pose", link.pose.position, FARTHEST
        if link.inertia is not None:
            yield f"{where}: mass", (link.inertia.mass,), HEAVIEST
            yield f"{where}: centre of mass", link.inertia.centre, FARTHEST
            moments = link.inertia.matrix.ravel().tolist()
            yield f"{where}: inertia", moments, HEAVIEST * FARTHEST
        for shape in (*link.visuals, *link.collisions):
            yield f"{where}: pose of a shape", shape.pose.position, FARTHEST
            yield f"{where}: size of a shape", _sizes(shape.geometry), FARTHEST
    for joint in model.joints:
        yield f"joint '{joint.name}': pose", joint.pose.position, FARTHEST


def _sizes(geometry: Geometry) -> Tuple[float, ...]:
    if isinstance(geometry, Box):
        return geometry.size
    if isinstance(geometry, Cylinder):
        return (geometry.radius, geometry.length)
    if isinstance(geometry, Sphere):
        return (geometry.radius,)
    if isinstance(geometry, Plane):
        return geometry.size
    if isinstance(geometry, Mesh):
        return geometry.scale
    return ()
