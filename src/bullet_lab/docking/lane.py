"""Where on the way into a dock the robot may be, and whether it does what it is told."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Tuple

import numpy as np

from bullet_lab.docking.database import Dock
from bullet_lab.docking.types import STANDSTILL, Command, RobotShape

# The walls count so far, in m, before their front edges; there, going at an edge is noticed.
_ENTRANCE, _BEFORE_ENTRANCE = 0.35, 0.55
_EDGE_PLAY = 0.08
# Half of the lane where the robot has stopped, how it widens from where on, and where it ends: m.
_NARROWEST, _WIDENING, _STRAIGHT, _LONGEST = 0.006, 0.22, 0.25, 4.5
_WIDENING_OUTSIDE = 0.3
_LEAST_LEFT = 0.05


@dataclass(frozen=True)
class Lane:
    """The lane into a dock, which narrows towards it. Poses are given in the dock's frame.

    Attributes:
        dock: what the database says.
        shape: of the robot.
        margin: kept between robot and walls, m.
        ahead: of the camera before the robot's middle, m.
    """

    dock: Dock
    shape: RobotShape
    margin: float
    ahead: float

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
        """Say whether a pose is between the walls or just before them."""
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
        """Say whether going on would lead at a wall's front edge, as far as is known.

        Args:
            robot: (3,) pose.
            deviation: standard deviation of its distance from the axis, m.
        """
        walls, before = self.dock.walls, -float(robot[0])
        if walls is None or not walls.depth < before < walls.depth + _BEFORE_ENTRANCE:
            return False
        beside = abs(float(robot[1])) + 2.0 * deviation
        return beside > self.corridor + _EDGE_PLAY + 0.4 * (before - walls.depth)

    def holds(self, robot: np.ndarray, left: float, deviation: float) -> bool:
        """Say whether the robot can approach from where it is, with so much left to go in m."""
        lane = self.half_width(left)
        # What is not known yet will be, on the way; the gate is there for what is not.
        beside = abs(float(robot[1])) + min(2.0 * deviation, 0.4 * lane)
        return _LEAST_LEFT < left < _LONGEST and beside < lane


_SECONDS = 2.0
_LEAST_WAY, _LEAST_TURN = 0.08, 0.25
_DONE = 0.3


class StuckWatch:
    """Compares what was commanded in the last seconds with what the odometry says."""

    def __init__(self):
        self._command: Command = STANDSTILL
        self._past: Deque[Tuple[float, float, float, float, float]] = deque()

    def commanded(self, command: Command) -> None:
        """Take note of a command (m/s, rad/s), in force until the next one."""
        self._command = command

    def moved(self, step: Tuple[float, float, float], seconds: float) -> None:
        """Take note of a step of the odometry (m, m, rad) in so many seconds."""
        v, w = self._command
        self._past.append((seconds, abs(v) * seconds, abs(w) * seconds, step[0], step[2]))
        while sum(entry[0] for entry in self._past) > _SECONDS:
            self._past.popleft()

    @property
    def stuck(self) -> bool:
        """Whether it was told to move, and did not."""
        way = sum(entry[1] for entry in self._past)
        turn = sum(entry[2] for entry in self._past)
        went = sum(math.fabs(entry[3]) for entry in self._past)
        turned = sum(math.fabs(entry[4]) for entry in self._past)
        if way > _LEAST_WAY and went < _DONE * way:
            return True
        return turn > _LEAST_TURN and turned < _DONE * turn
