"""Make the floor plan of a world: the boxes on it, from above."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Tuple

from bullet_lab.simulation.world.description import World

Point = Tuple[float, float]

_CORNERS = ((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))
# The footprint of a box that leans more than this (rad) is no rectangle.
_UPRIGHT = 1e-3


@dataclass(frozen=True)
class Footprint:
    """An upright box of the model `name` from above.

    `centre` is x, y in the world, `yaw` that of its sides (rad), `size` along its own x and y,
    `bottom` and `top` are the heights of its ends; all in m.
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
        """Return the distance of a point in m, 0 inside."""
        dx, dy = point[0] - self.centre[0], point[1] - self.centre[1]
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        beside = abs(cosine * dx + sine * dy) - 0.5 * self.size[0]
        before = abs(cosine * dy - sine * dx) - 0.5 * self.size[1]
        return math.hypot(max(beside, 0.0), max(before, 0.0))


def footprints(world: World, below: float = math.inf) -> Tuple[Footprint, ...]:
    """Return the upright boxes of static models, which a robot could hit.

    Args:
        world: the world; shapes other than boxes, and leaning boxes, are left out.
        below: m; boxes that begin above this height are left out.
    """
    found: List[Footprint] = []
    static = [model for model in world.models if model.static]
    shapes = [(m, k, shape) for m in static for k in m.links for shape in k.collisions]
    for model, link, shape in shapes:
        sides, pose = shape.geometry.floor_sides(), model.pose * link.pose * shape.pose
        is_upright = pose.rotate((0.0, 0.0, 1.0))[2] > math.cos(_UPRIGHT)
        if sides is not None and is_upright:
            x, y, z = pose.position
            bottom, top = (z + shape.geometry.bounds()[:, 2]).tolist()
            found.append(Footprint(model.name, (x, y), pose.yaw, sides, bottom, top))
    return tuple(one for one in found if one.bottom < below)
