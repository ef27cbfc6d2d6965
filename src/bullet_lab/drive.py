"""Driving: in squares, open loop by the clock or closed loop by odometry, and to a goal.

The code is independent of ROS and of the simulation: its user sends the commands, those of a
square at its `rate`.

The way to a goal is the P-controller of the course, for robots that steer. The speed is
proportional to the remaining distance and the turn rate to the remaining angle, both within limits,
as in the course's drive_to_goal. A robot with two wheels cannot move sideways: if the goal is
beside or behind it, it turns on the spot first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any, Generator, Iterator, Optional, Tuple

from bullet_lab.core.parameters import boolean, checked, integer, number
from bullet_lab.core.se2 import PlanarPose, atan2, hypot, wrap
from bullet_lab.errors import LabError

Command = Tuple[float, float]
STANDSTILL: Command = (0.0, 0.0)

OPEN_LOOP, CLOSED_LOOP = "open_loop", "closed_loop"
MODES = (OPEN_LOOP, CLOSED_LOOP)
OPEN_LOOP_RATE = 10.0
CLOSED_LOOP_RATE = 20.0

# Near the target the speed falls with the remaining distance, down to the slowest speed. This is
# slow enough to stop within the tolerance at the rate of the odometry, and overcomes friction.
SLOWING_GAIN = 2.0
SLOWEST_DRIVE = 0.02
SLOWEST_TURN = 0.1
# A robot that turned by less than this (rad) between this many commands in a row is held.
HELD_TURN = 5e-4
HELD_COMMANDS = 5
DRIVE_TOLERANCE = 0.001
# Allowed undershoot and overshoot of a turn. Together they are larger than the slowest turn between
# two odometry messages without friction, 0.29°, so that the robot cannot oscillate for ever.
TURN_TOLERANCE = math.radians(0.1)
TURN_EXCESS = math.radians(0.2)
# Odometry by the ticks of encoders may step over these tolerances. So a turn also ends when the
# robot has turned too far and back again.
MOST_CROSSINGS = 2

# The drive ends at this share of the tolerance, and resumes beyond the whole of it. So a turn on
# the spot, or the next noisy pose, does not make the robot drive back and forth.
ARRIVAL = 0.5
# Angles (rad) to the goal at which a turn on the spot begins and ends.
TURN_BEYOND = math.radians(60.0)
TURN_UNTIL = math.radians(6.0)
# Smaller tolerances are not reached at 20 Hz with the slowest speeds that overcome friction.
LEAST_TOLERANCE = 0.01


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


def clip(value: float, limit: float) -> float:
    """Return a value, at most `limit` away from 0.

    >>> clip(-3.0, 2.0)
    -2.0
    """
    return max(-limit, min(limit, value))


def approach(left: float, fastest: float, slowest: float, gain: float = SLOWING_GAIN) -> float:
    """Return the speed for the remaining distance or angle `left` (m or rad, > 0).

    It is `fastest` far from the target and `slowest` close to it, unless `fastest` is slower still,
    and in between `gain` (1/s) for each remaining unit.

    >>> approach(1.0, 0.2, 0.02), approach(0.05, 0.2, 0.02), approach(0.001, 0.2, 0.02)
    (0.2, 0.1, 0.02)
    """
    return min(fastest, max(slowest, gain * left))


class SlowestTurn:
    """The slowest speed that turns a robot on the spot, in rad/s.

    The friction of a robot that planar_move drives takes some of its turn in each step, and all
    of a slow one. So the speed grows while the robot should turn and does not.
    """

    def __init__(self) -> None:
        self.speed = SLOWEST_TURN
        self._before = math.inf
        self._held = 0

    def now(self, left: float) -> float:
        """Return the speed with an angle (rad) left to go."""
        self._held = self._held + 1 if abs(left - self._before) < HELD_TURN else 0
        self._before = left
        if self._held >= HELD_COMMANDS:
            self.speed *= 1.1
        return self.speed


_Commands = Generator[Command, Optional[PlanarPose], None]


class SquareDriver:
    """Computes the commands at `rate` Hz, until the square is driven.

    Attributes:
        needs_pose: whether `command` needs the pose of the robot.
        sides_done: number of sides that have been driven, with the turn after each.

    Raises:
        LabError: the mode is not one of `MODES`.

    >>> driver = SquareDriver(Square(sides=1, side=0.04, turn_commands=1))
    >>> driver.command(), driver.command(), driver.command(), driver.command()
    ((0.2, 0.0), (0.2, 0.0), (0.0, -0.5236), None)
    """

    def __init__(self, square: Square, mode: str = OPEN_LOOP):
        if mode not in MODES:
            raise LabError(f"mode '{mode}' is not one of {', '.join(MODES)}")
        self._square = square
        self.needs_pose = mode == CLOSED_LOOP
        self.rate = CLOSED_LOOP_RATE if self.needs_pose else OPEN_LOOP_RATE
        self.sides_done = 0
        self._slowest_turn = SlowestTurn()
        self._commands = self._by_odometry() if self.needs_pose else self._by_clock()
        next(self._commands)

    def command(self, pose: Optional[PlanarPose] = None) -> Optional[Command]:
        """Return the next command (m/s, rad/s), or None at the end; open loop needs no pose."""
        try:
            return self._commands.send(pose)
        except StopIteration:
            return None

    def _by_clock(self) -> _Commands:
        yield STANDSTILL  # before the first command
        for _ in range(self._square.sides):
            yield from open_loop_side(self._square)
            self.sides_done += 1

    def _by_odometry(self) -> _Commands:
        pose = yield STANDSTILL  # before the first command
        square, heading = self._square, pose[2]
        for _ in range(square.sides):
            x, y, _yaw = pose
            progress, turning, done = 0.0, False, False
            before, crossings = 0.0, 0
            # From the heading before, so that errors of the turns do not accumulate.
            goal = heading + math.copysign(0.5 * math.pi, square.turn_speed)
            while not done:
                left = square.side - progress
                turning = turning or left <= DRIVE_TOLERANCE
                if turning:
                    angle = wrap(goal - pose[2])
                    crossings += before * angle < 0.0
                    before = angle
                    done, command = self._turn(angle, crossings)
                else:
                    command = approach(left, square.speed, SLOWEST_DRIVE), 0.0
                pose = yield command
                dx, dy = pose[0] - x, pose[1] - y
                progress = dx * math.cos(heading) + dy * math.sin(heading)
            heading = goal
            self.sides_done += 1

    def _turn(self, left: float, crossings: int) -> Tuple[bool, Command]:
        """Return whether a turn is done with an angle (rad) left to go, and the command for it.

        `crossings` is how many times the robot has turned past its goal.
        """
        turn_speed = self._square.turn_speed
        near = -TURN_EXCESS <= math.copysign(left, left * turn_speed) <= TURN_TOLERANCE
        if near or crossings >= MOST_CROSSINGS:
            return True, STANDSTILL
        speed = approach(abs(left), abs(turn_speed), self._slowest_turn.now(left))
        return False, (0.0, math.copysign(speed, left))


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
    """Computes the velocity towards one goal, a pose in the frame of the odometry, tick by tick.

    `moving` is the last command (m/s, rad/s), at the start that of a robot which is moving already.
    Who stops the robot otherwise sets it to `STANDSTILL`.

    Raises:
        LabError: the goal is not finite.

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
            raise LabError(f"the goal {goal} is not finite")
        self.goal = goal
        self.phase = DrivePhase.DRIVING
        self._limits = limits
        self.moving = command
        self._on_the_spot = False
        self._slowest_turn = SlowestTurn()

    def distance(self, pose: PlanarPose) -> float:
        """Return the distance (m) of a pose from the goal."""
        return hypot(self.goal[0] - pose[0], self.goal[1] - pose[1])

    def turn_left(self, pose: PlanarPose) -> float:
        """Return the remaining turn (rad, in [-pi, pi)) from a pose to the goal's heading."""
        return wrap(self.goal[2] - pose[2])

    def command(self, pose: PlanarPose, seconds: float) -> Command:
        """Return the velocity (m/s, rad/s) for the present pose (m, m, rad); zeros once arrived.

        `seconds` is the time since the previous command, for the accelerations.
        """
        v_goal, w_goal = self._control(pose)
        limits, (v, w) = self._limits, self.moving
        v += clip(v_goal - v, limits.acceleration * seconds)
        w += clip(w_goal - w, limits.turn_acceleration * seconds)
        # On arrival the speed is so low that no braking is needed.
        self.moving = STANDSTILL if self.phase is DrivePhase.ARRIVED else (v, w)
        return self.moving

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
        off = wrap(atan2(self.goal[1] - pose[1], self.goal[0] - pose[0]) - pose[2])
        if abs(off) > (TURN_UNTIL if self._on_the_spot else TURN_BEYOND):
            self._on_the_spot = True
            return self._turn_by(off)
        self._on_the_spot = False
        fastest = min(limits.speed, math.sqrt(2.0 * limits.acceleration * left))
        speed = approach(left, fastest, SLOWEST_DRIVE, limits.gain)
        return speed * math.cos(off), clip(limits.turn_gain * off, limits.turn_speed)

    def _turn(self, left: float) -> Command:
        if abs(left) <= self._limits.yaw_tolerance:
            self.phase = DrivePhase.ARRIVED
            return STANDSTILL
        self.phase = DrivePhase.TURNING
        return self._turn_by(left)

    def _turn_by(self, left: float) -> Command:
        limits = self._limits
        fastest = min(limits.turn_speed, math.sqrt(2.0 * limits.turn_acceleration * abs(left)))
        speed = approach(abs(left), fastest, self._slowest_turn.now(left), limits.turn_gain)
        return 0.0, math.copysign(speed, left)
