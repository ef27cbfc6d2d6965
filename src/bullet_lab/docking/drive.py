"""How commands are made: turning on the spot, following a way, tracking the dock's axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from bullet_lab.core.angles import wrap
from bullet_lab.docking.floor_map import Point
from bullet_lab.docking.settings import DockingSettings
from bullet_lab.docking.types import STANDSTILL, Command, PlanarPose

_TURN_GAIN = 2.5
_SLOWEST_TURN = 0.06
_TURNED = math.radians(1.0)
_ARRIVED = 0.05
_LOOKAHEAD = 0.35
_MARKER_ANGLE = math.radians(24.0)


def clip(value: float, limit: float) -> float:
    """Return a value, at most `limit` away from 0."""
    return max(-limit, min(limit, value))


class CommandRamp:
    """Keeps accelerations within limits."""

    def __init__(self, settings: DockingSettings):
        self._acceleration = settings.acceleration
        self._turn_acceleration = settings.turn_acceleration
        self.command: Command = STANDSTILL

    def towards(self, wanted: Command, seconds: float) -> Command:
        """Return the command for the next moment on the way to a wanted one."""
        v = self.command[0] + clip(wanted[0] - self.command[0], self._acceleration * seconds)
        w = self.command[1] + clip(wanted[1] - self.command[1], self._turn_acceleration * seconds)
        self.command = (v, w)
        return self.command

    def stop(self) -> Command:
        """Stop at once."""
        self.command = STANDSTILL
        return STANDSTILL


def turn_command(left: float, fastest: float, tolerance: float = _TURNED) -> Command:
    """Return the command that turns on the spot by what is left (rad); zero when done."""
    if abs(left) <= tolerance:
        return STANDSTILL
    speed = min(fastest, max(_SLOWEST_TURN, _TURN_GAIN * abs(left)))
    return 0.0, math.copysign(speed, left)


class FollowWay:
    """Drives along straight lines, turning on the spot between them.

    Args:
        way: points (m, m) in the odometry frame, the first where the robot stands.
        settings: for the speeds.
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
    """Drives along a dock's axis, forwards or backwards, with the marker kept in sight.

    Attributes:
        settings: for the speeds.
        camera_ahead: m, of the camera before the robot's middle.
    """

    settings: DockingSettings
    camera_ahead: float

    def forwards(self, robot: np.ndarray, left: float) -> Command:
        """Return the command of an approach.

        Args:
            robot: (3,) its pose in the dock's frame.
            left: m to go along the axis.
        """
        wanted = self.heading(robot, left)
        off = wrap(wanted - float(robot[2]))
        braking = math.sqrt(2.0 * 0.08 * max(left, 0.0))
        speed = min(self.settings.approach_speed, braking, 0.8 * left + 0.008)
        speed *= max(0.0, 1.0 - abs(off) / 0.35)
        return speed, clip(2.0 * off, 0.5)

    def backwards(self, robot: np.ndarray, left: float) -> Command:
        """Return the command of a retreat by what is left (m)."""
        wanted = clip(math.atan(float(robot[1]) / 0.5), math.radians(15.0))
        off = wrap(self._in_sight(robot, wanted) - float(robot[2]))
        braking = math.sqrt(2.0 * 0.2 * max(left, 0.0))
        speed = min(self.settings.approach_speed, braking + 0.02)
        speed *= max(0.0, 1.0 - abs(off) / 0.35)
        return -speed, clip(2.0 * off, 0.5)

    def heading(self, robot: np.ndarray, left: float) -> float:
        """Return the heading (rad, against the axis) to have on an approach."""
        length = min(max(0.3 * left, 0.10), 0.6)
        most = math.radians(25.0 if left > 0.5 else 5.0 + 40.0 * max(left - 0.1, 0.0))
        wanted = -clip(math.atan(float(robot[1]) / length), most)
        wanted *= min(1.0, max(left, 0.0) / 0.04)
        return self._in_sight(robot, wanted)

    def _in_sight(self, robot: np.ndarray, wanted: float) -> float:
        """Return the heading nearest the wanted one that keeps the marker in the image."""
        x = float(robot[0]) + self.camera_ahead * math.cos(robot[2])
        y = float(robot[1]) + self.camera_ahead * math.sin(robot[2])
        bearing = math.atan2(-y, -x)
        return bearing + clip(wrap(wanted - bearing), _MARKER_ANGLE)
