"""Two wheels, and robots on which they roll ideally but are not what the odometry believes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List

from bullet_lab.core.se2 import PlanarPose
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning


@dataclass(frozen=True)
class Wheels:
    """Two wheels: their diameters and the distance of their contacts, in m."""

    left: float
    right: float
    base: float

    def times(self, errors: SystematicErrors) -> Wheels:
        """Return wheels that are so much larger than these.

        >>> Wheels(0.5, 0.5, 1.0).times(SystematicErrors(scale_error=0.5, base_error=0.25))
        Wheels(left=0.75, right=0.75, base=1.25)
        """
        left, right = errors.diameters
        return Wheels(self.left * left, self.right * right, self.base * (1.0 + errors.base_error))


class IdealRobot:
    """A robot whose wheels roll without slipping and turn as they are told, at once.

    Args:
        wheels: that roll.
        believed: what its odometry takes them for, which also makes wheel speeds of commands.
    """

    def __init__(self, wheels: Wheels, believed: Wheels):
        self.believed = believed
        self._rolled = DeadReckoning(wheels.base, 0.5 * wheels.left, 0.5 * wheels.right)
        self._counted = DeadReckoning(believed.base, 0.5 * believed.left, 0.5 * believed.right)
        self._angles = (0.0, 0.0)
        self.odometry: List[PlanarPose] = [self._counted.pose]

    def pose(self) -> PlanarPose:
        """Return where it really is: (m, m, rad)."""
        return self._rolled.pose

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s), and report."""
        rim = 0.5 * self.believed.base * turning
        left, right = self._angles
        left += 2.0 * (ahead - rim) * seconds / self.believed.left
        right += 2.0 * (ahead + rim) * seconds / self.believed.right
        self._angles = (left, right)
        self._rolled.advance(left, right)
        self._counted.advance(left, right)
        self.odometry.append(self._counted.pose)

    def close(self) -> None:
        """There is nothing to give back."""
