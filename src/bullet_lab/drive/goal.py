"""Driving to a goal: the P-controller of the course, for robots that steer.

The speed is proportional to the remaining distance and the turn rate to the remaining angle, both
within limits, as in the course's drive_to_goal. A robot with two wheels cannot move sideways: if
the goal is beside or behind it, it turns on the spot first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Tuple

from bullet_lab.core.parameters import boolean, number
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.drive.square import SLOWEST_DRIVE, SLOWEST_TURN, approach
from bullet_lab.errors import LabError

Command = Tuple[float, float]
STANDSTILL: Command = (0.0, 0.0)

# The drive ends at this share of the tolerance, and resumes beyond the whole of it. So a turn on
# the spot, or the next noisy pose, does not make the robot drive back and forth.
ARRIVAL = 0.5
# Angles (rad) to the goal at which a turn on the spot begins and ends.
TURN_BEYOND = math.radians(60.0)
TURN_UNTIL = math.radians(6.0)
# Smaller tolerances are not reached at 20 Hz with the slowest speeds that overcome friction.
LEAST_TOLERANCE = 0.01


class GoalDriverError(LabError):
    """A goal is invalid."""


class DrivePhase(Enum):
    """A phase of the drive to a goal."""

    DRIVING = "driving"
    TURNING = "turning to the goal's heading"
    ARRIVED = "arrived"


@dataclass(frozen=True)
class GoalLimits:
    """Speeds and tolerances of a drive to a goal; the defaults are the course's."""

    speed: float = number(0.2, "at most, m/s", above=0.0)
    turn_speed: float = number(0.8, "at most, rad/s", above=0.0)
    acceleration: float = number(0.4, "at most, m/s²", above=0.0)
    turn_acceleration: float = number(2.0, "at most, rad/s²", above=0.0)
    gain: float = number(1.0, "m/s for each m to the goal", above=0.0)
    turn_gain: float = number(2.0, "rad/s for each rad", above=0.0)
    tolerance: float = number(0.05, "m from the goal to stop within", minimum=LEAST_TOLERANCE)
    yaw_tolerance: float = number(
        0.03, "rad from its heading to stop within", minimum=LEAST_TOLERANCE
    )
    heading: bool = boolean(True, "turn to the goal's heading at the end")


class GoalDriver:
    """Computes the velocity towards one goal, tick by tick.

    Args:
        goal: pose (m, m, rad) in the frame of the odometry.
        limits: for the drive.
        command: the last command, if the robot is already moving.

    Attributes:
        phase: the present one.
        moving: the last command (m/s, rad/s).

    Raises:
        GoalDriverError: the goal is not finite.

    Example:
        >>> driver = GoalDriver((1.0, 0.0, 0.0))
        >>> driver.command((0.0, 0.0, 0.0), seconds=0.5)
        (0.2, 0.0)
        >>> driver.distance((0.0, 0.0, 0.0))
        1.0
    """

    def __init__(
        self, goal: PlanarPose, limits: GoalLimits = GoalLimits(), command: Command = STANDSTILL
    ):
        if not all(map(math.isfinite, goal)):
            raise GoalDriverError(f"the goal {goal} is not finite")
        self.goal = goal
        self.phase = DrivePhase.DRIVING
        self._limits = limits
        self.moving = command
        self._on_the_spot = False

    def distance(self, pose: PlanarPose) -> float:
        """Return the distance (m) of a pose from the goal."""
        return math.hypot(self.goal[0] - pose[0], self.goal[1] - pose[1])

    def turn_left(self, pose: PlanarPose) -> float:
        """Return the remaining turn (rad, in [-pi, pi)) from a pose to the goal's heading."""
        return wrap(self.goal[2] - pose[2])

    def command(self, pose: PlanarPose, seconds: float) -> Command:
        """Return the velocity (m/s, rad/s) for the present pose; zeros once arrived.

        Args:
            pose: m, m, rad.
            seconds: since the previous command, for the accelerations.
        """
        v_goal, w_goal = self._control(pose)
        limits, (v, w) = self._limits, self.moving
        v += _clip(v_goal - v, limits.acceleration * seconds)
        w += _clip(w_goal - w, limits.turn_acceleration * seconds)
        # On arrival the speed is so low that no braking is needed.
        self.moving = STANDSTILL if self.phase is DrivePhase.ARRIVED else (v, w)
        return self.moving

    def stopped(self) -> None:
        """Start from rest, as something else has stopped the robot."""
        self.moving = STANDSTILL

    def _control(self, pose: PlanarPose) -> Command:
        """Return the velocity without limits of acceleration, and change the phase."""
        limits, left = self._limits, self.distance(pose)
        if self.phase is DrivePhase.DRIVING and left <= ARRIVAL * limits.tolerance:
            self.phase = DrivePhase.TURNING if limits.heading else DrivePhase.ARRIVED
        elif self.phase is not DrivePhase.DRIVING and left > limits.tolerance:
            self.phase = DrivePhase.DRIVING
        if self.phase is DrivePhase.DRIVING:
            return self._drive(pose, left)
        return self._turn(self.turn_left(pose)) if limits.heading else STANDSTILL

    def _drive(self, pose: PlanarPose, left: float) -> Command:
        limits = self._limits
        off = wrap(math.atan2(self.goal[1] - pose[1], self.goal[0] - pose[0]) - pose[2])
        if abs(off) > (TURN_UNTIL if self._on_the_spot else TURN_BEYOND):
            self._on_the_spot = True
            return 0.0, math.copysign(self._turn_speed(off), off)
        self._on_the_spot = False
        fastest = min(limits.speed, math.sqrt(2.0 * limits.acceleration * left))
        speed = approach(left, fastest, SLOWEST_DRIVE, limits.gain)
        return speed * math.cos(off), _clip(limits.turn_gain * off, limits.turn_speed)

    def _turn(self, left: float) -> Command:
        if abs(left) <= self._limits.yaw_tolerance:
            self.phase = DrivePhase.ARRIVED
            return STANDSTILL
        self.phase = DrivePhase.TURNING
        return 0.0, math.copysign(self._turn_speed(left), left)

    def _turn_speed(self, left: float) -> float:
        limits = self._limits
        fastest = min(limits.turn_speed, math.sqrt(2.0 * limits.turn_acceleration * abs(left)))
        return approach(abs(left), fastest, SLOWEST_TURN, limits.turn_gain)


def _clip(value: float, limit: float) -> float:
    """Return a value, at most `limit` away from 0."""
    return max(-limit, min(limit, value))
