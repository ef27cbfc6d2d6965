"""Odometry for docking: steps with their covariance, recent poses, jumps and stuck wheels."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Optional, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.types import STANDSTILL, Command, Odometry

# Variances by distance and turn of wheels that slip, added to those of the message.
_ALONG = 0.004**2  # m²/m
_TURN_BY_WAY = 0.004**2  # rad²/m
_TURN_BY_TURN = 0.006**2  # rad²/rad
_ACROSS_BY_WAY = 0.0015**2  # m²/m
_ACROSS_BY_TURN = 0.002**2  # m²/rad
# A robot is stuck if in so many seconds it was commanded to move by so much, m or rad, and did less
# than this share of it.
_SECONDS = 2.0
_LEAST_WAY = 0.08
_LEAST_TURN = 0.25
_DONE = 0.3


@dataclass(frozen=True, eq=False)
class MotionStep:
    """A step of the robot in its frame before it: (dx m, dy m, dyaw rad) and (3, 3) covariance."""

    step: Tuple[float, float, float]
    covariance: np.ndarray


def motion_step(before: Odometry, after: Odometry) -> MotionStep:
    """Return the step between two messages of odometry.

    >>> motion_step(Odometry(0.0, (1.0, 0.0, 0.0)), Odometry(0.1, (1.5, 0.0, 0.0))).step
    (0.5, 0.0, 0.0)
    """
    step = tuple(se2.between(before.pose, after.pose).tolist())
    way, turn = math.hypot(step[0], step[1]), abs(step[2])
    along = _ALONG * way
    rotation = _TURN_BY_WAY * way + _TURN_BY_TURN * turn
    across = _ACROSS_BY_WAY * way + _ACROSS_BY_TURN * turn
    covariance = np.diag([along, across, rotation])
    if after.twist_covariance is not None:
        seconds = after.stamp - before.stamp
        covariance = covariance + np.asarray(after.twist_covariance, dtype=float) * seconds**2
    return MotionStep(step, covariance)


def jump(step: MotionStep, seconds: float, speed: float, turn_speed: float) -> Optional[str]:
    """Return a message if a step is too large for these speeds (m/s, rad/s) and seconds, or None.

    Six standard deviations are tolerated.
    """
    way, turn = math.hypot(step.step[0], step.step[1]), abs(step.step[2])
    spread = 6.0 * np.sqrt(np.maximum(np.diag(step.covariance), 0.0))
    if way > 1.5 * speed * seconds + 0.08 + spread[0] + spread[1]:
        return f"odometry jumped by {way:.2f} m"
    if turn > 1.5 * turn_speed * seconds + 0.12 + spread[2]:
        return f"odometry jumped by {math.degrees(turn):.0f} degrees"
    return None


class OdometryBuffer:
    """Poses of the last seconds, to know where the robot was when an image was taken."""

    def __init__(self, seconds: float = 3.0):
        self._seconds = seconds
        self._past: Deque[Odometry] = deque()

    @property
    def last(self) -> Optional[Odometry]:
        """The newest message."""
        return self._past[-1] if self._past else None

    def add(self, odometry: Odometry) -> None:
        """Take the next message."""
        self._past.append(odometry)
        while odometry.stamp - self._past[0].stamp > self._seconds and len(self._past) > 2:
            self._past.popleft()

    def pose_at(self, stamp: float) -> Optional[PlanarPose]:
        """Return the pose at a time (s), interpolated; the newest after it, None before all."""
        if not self._past or stamp < self._past[0].stamp - 1e-6:
            return None
        after = self._past[-1]
        if stamp >= after.stamp:
            return after.pose
        for before in reversed(self._past):
            if before.stamp <= stamp + 1e-9:
                break
            after = before
        if after is before or after.stamp - before.stamp <= 0.0:
            return before.pose
        part = min(max((stamp - before.stamp) / (after.stamp - before.stamp), 0.0), 1.0)
        step = se2.between(before.pose, after.pose)
        return tuple(se2.compose(before.pose, part * step).tolist())


class StuckWatch:
    """Compares the commands of the last seconds with the odometry."""

    def __init__(self):
        self._command: Command = STANDSTILL
        self._past: Deque[Tuple[float, float, float, float, float]] = deque()

    def commanded(self, command: Command) -> None:
        """Note a command (m/s, rad/s), in force until the next one."""
        self._command = command

    def moved(self, step: Tuple[float, float, float], seconds: float) -> None:
        """Note a step of the odometry (m, m, rad) in so many seconds."""
        v, w = (abs(part) * seconds for part in self._command)
        self._past.append((seconds, v, w, abs(step[0]), abs(step[2])))
        while sum(entry[0] for entry in self._past) > _SECONDS:
            self._past.popleft()

    @property
    def stuck(self) -> bool:
        """Whether the robot was commanded to move, and did not."""
        _, way, turn, went, turned = map(sum, zip(*self._past or [(0.0,) * 5]))
        if way > _LEAST_WAY and went < _DONE * way:
            return True
        return turn > _LEAST_TURN and turned < _DONE * turn
