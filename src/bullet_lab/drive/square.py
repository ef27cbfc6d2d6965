"""Driving squares, open loop by the clock or closed loop by odometry.

The code is independent of ROS and of the simulation: its user sends the commands at `rate` Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Generator, Iterator, Optional, Tuple

from bullet_lab.core.parameters import checked, integer, number
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.errors import LabError

Command = Tuple[float, float]

OPEN_LOOP, CLOSED_LOOP = "open_loop", "closed_loop"
MODES = (OPEN_LOOP, CLOSED_LOOP)
OPEN_LOOP_RATE = 10.0
CLOSED_LOOP_RATE = 20.0

# Near the target the speed falls with the remaining distance, down to the slowest speed. This is
# slow enough to stop within the tolerance at the rate of the odometry, and overcomes friction.
SLOWING_GAIN = 2.0
SLOWEST_DRIVE = 0.02
SLOWEST_TURN = 0.1
DRIVE_TOLERANCE = 0.001
# Allowed undershoot and overshoot of a turn. Together they are larger than the slowest turn between
# two odometry messages without friction, 0.29°, so that the robot cannot oscillate for ever.
TURN_TOLERANCE = math.radians(0.1)
TURN_EXCESS = math.radians(0.2)


class DriverError(LabError):
    """A mode is unknown."""


def _accept_turn_speed(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value) or value == 0.0:
        raise ValueError
    return float(value)


@dataclass(frozen=True)
class SquareSize:
    """The size of a square, a part of one, or several in a row; a full square has 4 sides."""

    sides: int = integer(4, "number of sides", minimum=1)
    side: float = number(2.0, "length of a side in m", above=0.0)


@dataclass(frozen=True)
class Square(SquareSize):
    """A square and how it is driven.

    Example:
        >>> Square(side=1.0).side_commands
        50
    """

    speed: float = number(0.2, "on the sides, m/s", above=0.0)
    turn_speed: float = checked(
        -0.5236,
        "at the corners, rad/s; negative is clockwise",
        "a number other than 0",
        _accept_turn_speed,
    )
    turn_commands: int = integer(34, "open loop: commands of a turn at 10 Hz", minimum=0)

    @property
    def side_commands(self) -> int:
        """Number of commands at 10 Hz of an open-loop side, without friction; at least one."""
        return max(1, round(OPEN_LOOP_RATE * self.side / self.speed))


def open_loop_side(square: Square) -> Iterator[Command]:
    """Yield the commands (m/s, rad/s) of one side and one turn, at 10 Hz, as in listing 9."""
    for _ in range(square.side_commands):
        yield square.speed, 0.0
    for _ in range(square.turn_commands):
        yield 0.0, square.turn_speed


class ClosedLoopSide:
    """One side and the turn after it, by odometry.

    Args:
        square: the one to drive.
        start: pose (m, m, rad) at the start of the side.
        heading: rad, of the side; the turn ends a quarter turn from it. As each heading is
            computed from the one before, errors of the turns do not accumulate.

    Attributes:
        next_heading: rad, of the next side.
        done: whether the turn has ended.
    """

    def __init__(self, square: Square, start: PlanarPose, heading: float):
        self._square = square
        self._start = start
        self.next_heading = heading + math.copysign(0.5 * math.pi, square.turn_speed)
        self._heading = heading
        self._turning = False
        self.done = False

    def progress(self, pose: PlanarPose) -> float:
        """Return the distance driven along the side, in m."""
        dx, dy = pose[0] - self._start[0], pose[1] - self._start[1]
        return dx * math.cos(self._heading) + dy * math.sin(self._heading)

    def command(self, pose: PlanarPose) -> Command:
        """Return the velocity (m/s, rad/s) for the present pose (m, m, rad)."""
        if not self._turning:
            left = self._square.side - self.progress(pose)
            if left > DRIVE_TOLERANCE:
                return approach(left, self._square.speed, SLOWEST_DRIVE), 0.0
            self._turning = True
        left = wrap(self.next_heading - pose[2])
        ahead = math.copysign(left, left * self._square.turn_speed)
        if not -TURN_EXCESS <= ahead <= TURN_TOLERANCE:
            speed = approach(abs(left), abs(self._square.turn_speed), SLOWEST_TURN)
            return 0.0, math.copysign(speed, left)
        self.done = True
        return 0.0, 0.0


def approach(left: float, fastest: float, slowest: float, gain: float = SLOWING_GAIN) -> float:
    """Return the speed for the remaining distance or angle.

    Args:
        left: the remaining distance or angle, in m or rad, > 0.
        fastest: the speed far from the target, in units of `left` per second.
        slowest: the speed close to it, unless `fastest` is slower still.
        gain: speed for each remaining unit, in between, 1/s.

    Example:
        >>> approach(1.0, 0.2, 0.02), approach(0.05, 0.2, 0.02), approach(0.001, 0.2, 0.02)
        (0.2, 0.1, 0.02)
    """
    return min(fastest, max(slowest, gain * left))


_Commands = Generator[Command, Optional[PlanarPose], None]


class SquareDriver:
    """Computes the commands at `rate` Hz, until the square is driven.

    Args:
        square: the one to drive.
        mode: one of `MODES`.

    Attributes:
        rate: commands per second.
        needs_pose: whether `command` needs the pose of the robot.
        sides_done: number of sides that have been driven, with the turn after each.

    Raises:
        DriverError: an unknown mode.

    Example:
        >>> driver = SquareDriver(Square(sides=1, side=0.04, turn_commands=1))
        >>> driver.command(), driver.command(), driver.command(), driver.command()
        ((0.2, 0.0), (0.2, 0.0), (0.0, -0.5236), None)
    """

    def __init__(self, square: Square, mode: str = OPEN_LOOP):
        if mode not in MODES:
            raise DriverError(f"mode '{mode}' is not one of {', '.join(MODES)}")
        self._square = square
        self.needs_pose = mode == CLOSED_LOOP
        self.rate = CLOSED_LOOP_RATE if self.needs_pose else OPEN_LOOP_RATE
        self.sides_done = 0
        self._commands: Optional[_Commands] = None

    def command(self, pose: Optional[PlanarPose] = None) -> Optional[Command]:
        """Return the next command (m/s, rad/s), or None at the end.

        Args:
            pose: of the robot (m, m, rad); not used in open loop.
        """
        try:
            if self._commands is None:
                self._commands = self._by_odometry(pose) if self.needs_pose else self._by_clock()
                return next(self._commands)
            return self._commands.send(pose)
        except StopIteration:
            return None

    def _by_clock(self) -> _Commands:
        for _ in range(self._square.sides):
            yield from open_loop_side(self._square)
            self.sides_done += 1

    def _by_odometry(self, pose: PlanarPose) -> _Commands:
        heading = pose[2]
        for _ in range(self._square.sides):
            side = ClosedLoopSide(self._square, pose, heading)
            while not side.done:
                pose = yield side.command(pose)
            heading = side.next_heading
            self.sides_done += 1
