"""Notices that a robot does not do what it is told."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Tuple

from bullet_lab.docking.types import STANDSTILL, Command

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
