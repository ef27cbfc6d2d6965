"""The floor plan of a world: what stands on it, seen from above."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Tuple

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import Model, World

Point = Tuple[float, float]

_CORNERS = ((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))
# A box that leans more than this (rad) has no rectangle as its plan.
_UPRIGHT = 1e-3


@dataclass(frozen=True)
class Footprint:
    """A standing box from above.

    Attributes:
        name: of its model.
        centre: x, y in the world, in metres.
        yaw: of its sides, in radians.
        size: along its own x and y, in metres.
        bottom: height of its lowest point, in metres.
        top: height of its highest point, in metres.
    """

    name: str
    centre: Point
    yaw: float
    size: Tuple[float, float]
    bottom: float
    top: float

    def corners(self) -> Tuple[Point, ...]:
        """Return the four corners, counter-clockwise."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        sides = [(sx * self.size[0], sy * self.size[1]) for sx, sy in _CORNERS]
        return tuple(
            (self.centre[0] + cosine * x - sine * y, self.centre[1] + sine * x + cosine * y)
            for x, y in sides
        )

    def distance(self, point: Point) -> float:
        """Return how far a point is from it in m, 0 inside."""
        dx, dy = point[0] - self.centre[0], point[1] - self.centre[1]
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        beside = abs(cosine * dx + sine * dy) - 0.5 * self.size[0]
        before = abs(cosine * dy - sine * dx) - 0.5 * self.size[1]
        return math.hypot(max(beside, 0.0), max(before, 0.0))


def footprints(world: World, below: float = math.inf) -> Tuple[Footprint, ...]:
    """Return the boxes in a world that something could run into.

    Args:
        world: its static models count; their shapes other than boxes, and leaning boxes, do not.
        below: m; what begins above this height is left out.
    """
    found = (one for model in world.models if model.static for one in _of_model(model))
    return tuple(one for one in found if one.bottom < below)


def _of_model(model: Model) -> Iterator[Footprint]:
    for link in model.links:
        for collision in link.collisions:
            sides = collision.geometry.floor_sides()
            pose = model.pose * link.pose * collision.pose
            if sides is not None and _is_upright(pose):
                x, y, z = pose.position
                bottom, top = (z + collision.geometry.bounds()[:, 2]).tolist()
                yield Footprint(model.name, (x, y), pose.yaw, sides, bottom, top)


def _is_upright(pose: Pose) -> bool:
    return pose.rotate((0.0, 0.0, 1.0))[2] > math.cos(_UPRIGHT)
