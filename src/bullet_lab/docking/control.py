"""Controllers: turn on the spot, follow a way, track the dock's axis within its lane.

Poses of the robot against the dock are (x m, y m, yaw rad) in the dock's frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.docking.database import Dock
from bullet_lab.docking.types import STANDSTILL, Command, DockingSettings, Point, RobotShape

_TURN_GAIN = 2.5
_SLOWEST_TURN = 0.06
_TURNED = math.radians(1.0)
_ARRIVED = 0.05
_LOOKAHEAD = 0.35
_MARKER_ANGLE = math.radians(24.0)
# Distance before the walls' front edges, m, from which on the robot counts as between them, and
# from which on a course towards an edge is noticed, with so much tolerance.
_ENTRANCE = 0.35
_BEFORE_ENTRANCE = 0.55
_EDGE_PLAY = 0.08
# Half width of the lane where the robot stops, m; from so much left to go on, it widens by so much
# for each metre, and more outside of the walls.
_NARROWEST = 0.006
_STRAIGHT = 0.25
_WIDENING = 0.22
_WIDENING_OUTSIDE = 0.3
# Least and most way left to go at which an approach begins, m.
_LEAST_LEFT = 0.05
_LONGEST = 4.5


def clip(value: float, limit: float) -> float:
    """Return a value, at most `limit` away from 0.

    >>> clip(-3.0, 2.0)
    -2.0
    """
    return max(-limit, min(limit, value))


class CommandRamp:
    """Keeps accelerations within limits."""

    def __init__(self, settings: DockingSettings):
        self._limits = settings.acceleration, settings.turn_acceleration
        self.command: Command = STANDSTILL

    def towards(self, target: Command, seconds: float) -> Command:
        """Return the command after so many seconds on the way to a target, both m/s, rad/s."""
        parts = zip(self.command, target, self._limits)
        v, w = (now + clip(aim - now, limit * seconds) for now, aim, limit in parts)
        self.command = (v, w)
        return self.command

    def stop(self) -> Command:
        """Stop at once."""
        self.command = STANDSTILL
        return STANDSTILL


def turn_command(left: float, fastest: float, tolerance: float = _TURNED) -> Command:
    """Return the command that turns on the spot by what is left (rad); zero when done.

    >>> turn_command(-1.0, fastest=0.8)
    (0.0, -0.8)
    """
    if abs(left) <= tolerance:
        return STANDSTILL
    speed = min(fastest, max(_SLOWEST_TURN, _TURN_GAIN * abs(left)))
    return 0.0, math.copysign(speed, left)


class PathFollower:
    """Drives along straight lines, turning on the spot between them.

    `way` are points (m, m) in the odometry frame, the first where the robot stands.
    """

    def __init__(self, way: Sequence[Point], settings: DockingSettings):
        self._way: List[Point] = list(way)
        self._settings = settings
        self._turning = True

    @property
    def left(self) -> Tuple[Point, ...]:
        """The points still to be driven to."""
        return tuple(self._way[1:])

    def command(self, pose: PlanarPose) -> Command:
        """Return the command for the present pose; zero when there."""
        while len(self._way) > 1:
            start, end = self._way[0], self._way[1]
            direction = math.atan2(end[1] - start[1], end[0] - start[0])
            length = math.dist(start, end)
            cos, sin = math.cos(direction), math.sin(direction)
            done = cos * (pose[0] - start[0]) + sin * (pose[1] - start[1])
            if length - done > _ARRIVED:
                aim = min(done + _LOOKAHEAD, length)
                target = (start[0] + aim * cos, start[1] + aim * sin)
                return self._steer(pose, target, length - done)
            self._way.pop(0)
            self._turning = True
        return STANDSTILL

    def _steer(self, pose: PlanarPose, target: Point, left: float) -> Command:
        off = wrap(math.atan2(target[1] - pose[1], target[0] - pose[0]) - pose[2])
        if self._turning or abs(off) > 0.6:
            self._turning = abs(off) > 0.06
            if self._turning:
                return turn_command(off, self._settings.turn_speed, 0.0)
        speed = min(self._settings.drive_speed, math.sqrt(0.6 * self._settings.acceleration * left))
        return speed * math.cos(off), clip(2.0 * off, 0.7 * self._settings.turn_speed)


@dataclass(frozen=True)
class AxisTracker:
    """Drives along a dock's axis, forwards or backwards, with the marker kept in sight."""

    settings: DockingSettings
    camera_ahead: float  #: m, of the camera before the robot's middle

    def forwards(self, robot: np.ndarray, left: float) -> Command:
        """Return the command of an approach at (3,) in the dock's frame, with m left to go."""
        length = min(max(0.3 * left, 0.10), 0.6)
        most = math.radians(25.0 if left > 0.5 else 5.0 + 40.0 * max(left - 0.1, 0.0))
        target = -clip(math.atan(float(robot[1]) / length), most)
        target *= min(1.0, max(left, 0.0) / 0.04)
        off = wrap(self._in_sight(robot, target) - float(robot[2]))
        braking = math.sqrt(2.0 * 0.08 * max(left, 0.0))
        speed = min(self.settings.approach_speed, braking, 0.8 * left + 0.008)
        speed *= max(0.0, 1.0 - abs(off) / 0.35)
        return speed, clip(2.0 * off, 0.5)

    def backwards(self, robot: np.ndarray, left: float) -> Command:
        """Return the command of a retreat by what is left (m)."""
        target = clip(math.atan(float(robot[1]) / 0.5), math.radians(15.0))
        off = wrap(self._in_sight(robot, target) - float(robot[2]))
        braking = math.sqrt(2.0 * 0.2 * max(left, 0.0))
        speed = min(self.settings.approach_speed, braking + 0.02)
        speed *= max(0.0, 1.0 - abs(off) / 0.35)
        return -speed, clip(2.0 * off, 0.5)

    def _in_sight(self, robot: np.ndarray, target: float) -> float:
        """Return the heading nearest a target that keeps the marker in the image."""
        x = float(robot[0]) + self.camera_ahead * math.cos(robot[2])
        y = float(robot[1]) + self.camera_ahead * math.sin(robot[2])
        bearing = math.atan2(-y, -x)
        return bearing + clip(wrap(target - bearing), _MARKER_ANGLE)


@dataclass(frozen=True)
class Lane:
    """The lane into a dock, which narrows towards it."""

    dock: Dock
    shape: RobotShape
    margin: float  #: kept between robot and walls, m
    ahead: float  #: of the camera before the robot's middle, m

    @property
    def depth(self) -> float:
        """Of the walls, m; 0 without."""
        return 0.0 if self.dock.walls is None else self.dock.walls.depth

    @property
    def corridor(self) -> float:
        """How far off the axis (m) the robot may be between the walls, turned or not."""
        if self.dock.walls is None:
            return math.inf
        free = 0.5 * self.dock.walls.opening - self.margin
        return max(free - self.shape.turning_radius, 0.02)

    def within_walls(self, robot: np.ndarray) -> bool:
        """Return whether a pose is between the walls or just before them."""
        walls = self.dock.walls
        if walls is None:
            return False
        return -float(robot[0]) < walls.depth + _ENTRANCE and abs(robot[1]) < 0.5 * walls.opening

    def half_width(self, left: float) -> float:
        """Return how far off the axis (m) an approach may be with so much left to go."""
        lane = _NARROWEST + _WIDENING * max(left - _STRAIGHT, 0.0)
        if self.dock.walls is None:
            return lane
        entrance = self.depth + _ENTRANCE - self.dock.docked_distance - self.ahead
        return min(lane, self.corridor + _WIDENING_OUTSIDE * max(left - entrance, 0.0))

    def leads_at_an_edge(self, robot: np.ndarray, deviation: float) -> bool:
        """Return whether going on from a pose (3,) would lead to a wall's front edge.

        `deviation` is the standard deviation of its distance from the axis, m.
        """
        walls, before = self.dock.walls, -float(robot[0])
        if walls is None or not walls.depth < before < walls.depth + _BEFORE_ENTRANCE:
            return False
        beside = abs(float(robot[1])) + 2.0 * deviation
        return beside > self.corridor + _EDGE_PLAY + 0.4 * (before - walls.depth)

    def holds(self, robot: np.ndarray, left: float, deviation: float) -> bool:
        """Return whether the robot can approach from where it is, with so much left to go in m."""
        lane = self.half_width(left)
        # The estimate improves during the approach; the gate aborts it if it does not.
        beside = abs(float(robot[1])) + min(2.0 * deviation, 0.4 * lane)
        return _LEAST_LEFT < left < _LONGEST and beside < lane
