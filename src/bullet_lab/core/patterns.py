"""Where things stand that are set out in a pattern."""

from __future__ import annotations

import math
from typing import List, Tuple

# x and y in m, yaw in rad.
Place = Tuple[float, float, float]


def line(count: int, spacing: float) -> List[Place]:
    """Return places along x from the origin on, `spacing` m apart, all with yaw 0."""
    return [(spacing * index, 0.0, 0.0) for index in range(count)]


def grid(count: int, spacing: float) -> List[Place]:
    """Return places row by row in a square grid that starts at the origin.

    The grid is as many places wide as the root of their number, rounded up; rows run along x
    and follow each other along y.
    """
    width = math.ceil(math.sqrt(count))
    return [(spacing * (index % width), spacing * (index // width), 0.0) for index in range(count)]


def circle(count: int, radius: float) -> List[Place]:
    """Return places evenly on a circle about the origin, from (radius, 0) on, facing outwards."""
    angles = [math.tau * index / count for index in range(count)]
    return [
        (radius * math.cos(a), radius * math.sin(a), math.remainder(a, math.tau)) for a in angles
    ]
