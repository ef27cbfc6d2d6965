"""Where two wheels say that a robot is."""

from __future__ import annotations

import math
from typing import Tuple


class DeadReckoning:
    """Integrates the rotation of two wheels to a planar pose, by exact arcs.

    Between two readings both wheels are taken to turn evenly, so that the middle of the axle
    moves on an arc of length s and angle φ; its chord is s·sin(φ/2)/(φ/2) long and points φ/2
    away from the old heading. What the wheels slip is not noticed.

    Args:
        separation: of the wheels' contacts with the floor, in m.
        radius: of the wheels, in m.
    """

    def __init__(self, separation: float, radius: float):
        self._separation = separation
        self._radius = radius
        self.restart(0.0, 0.0)

    def restart(self, left: float, right: float) -> None:
        """Be at the origin again, with the wheels at these angles (rad)."""
        self._x = self._y = self._yaw = 0.0
        self.resume(left, right)

    def resume(self, left: float, right: float) -> None:
        """Take new angles (rad) of the wheels for the present pose: nothing was driven."""
        self._left, self._right = left, right

    @property
    def pose(self) -> Tuple[float, float, float]:
        """Position x, y in m and yaw in rad within [-pi, pi], from where it was last restarted."""
        return self._x, self._y, self._yaw

    def advance(self, left: float, right: float) -> Tuple[float, float]:
        """Take the wheels' new angles (rad).

        Returns:
            The distance in m driven ahead and the angle in rad turned since the last angles.
        """
        left_way = (left - self._left) * self._radius
        right_way = (right - self._right) * self._radius
        self.resume(left, right)
        driven, turned = 0.5 * (left_way + right_way), (right_way - left_way) / self._separation
        half = 0.5 * turned
        chord = driven * math.sin(half) / half if half else driven
        self._x += chord * math.cos(self._yaw + half)
        self._y += chord * math.sin(self._yaw + half)
        self._yaw = math.remainder(self._yaw + turned, math.tau)
        return driven, turned
