"""Poses of a dock in the robot's frame as Gaussians, and how steps of odometry move them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Optional, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.angles import wrap
from bullet_lab.docking.types import Odometry, PlanarPose

# Of odometry that does not say how good it is: m²/m, rad²/m, rad²/rad. Wheels on a floor slip.
_ALONG, _TURN_BY_WAY, _TURN_BY_TURN = 0.004**2, 0.004**2, 0.006**2


@dataclass(frozen=True, eq=False)
class MotionStep:
    """A step of the robot in its frame before it: (dx, dy, dyaw) and its (3, 3) covariance."""

    step: Tuple[float, float, float]
    covariance: np.ndarray


def motion_step(before: Odometry, after: Odometry) -> MotionStep:
    """Return the step between two messages of odometry."""
    step = tuple(se2.between(before.pose, after.pose).tolist())
    way, turn = math.hypot(step[0], step[1]), abs(step[2])
    along = _ALONG * way
    rotation = _TURN_BY_WAY * way + _TURN_BY_TURN * turn
    covariance = np.diag([along, along, rotation])
    if after.twist_covariance is not None:
        seconds = after.stamp - before.stamp
        covariance = covariance + np.asarray(after.twist_covariance, dtype=float) * seconds**2
    return MotionStep(step, covariance)


def jump(step: MotionStep, seconds: float, speed: float, turn_speed: float) -> Optional[str]:
    """Say what is wrong with a step that no robot of these speeds makes, None if nothing is."""
    way, turn = math.hypot(step.step[0], step.step[1]), abs(step.step[2])
    spread = 6.0 * np.sqrt(np.maximum(np.diag(step.covariance), 0.0))
    if way > 1.5 * speed * seconds + 0.08 + spread[0] + spread[1]:
        return f"odometry jumped by {way:.2f} m"
    if turn > 1.5 * turn_speed * seconds + 0.12 + spread[2]:
        return f"odometry jumped by {math.degrees(turn):.0f} degrees"
    return None


class OdometryTrack:
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
        """Return the pose at a time, None before the memory begins; the newest after it ends."""
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


@dataclass(frozen=True, eq=False)
class DockEstimate:
    """Pose of a dock in the robot's frame: mean (3,) and covariance (3, 3)."""

    mean: np.ndarray
    covariance: np.ndarray

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of x, y (m) and yaw (rad)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def turned_to(self, yaw: float, variance: float) -> DockEstimate:
        """Return it with a yaw (rad, rad²) taken into account that something else tells.

        If the two contradict each other, the more certain of them is right: few pixels are off
        together, and then in all images alike.
        """
        off = wrap(yaw - float(self.mean[2]))
        own = self.covariance
        doubt = off * off / (4.0 * (float(own[2, 2]) + variance))
        if doubt > 1.0:
            if variance > own[2, 2]:
                return self
            own = own * doubt
        gain = own[:, 2] / (own[2, 2] + variance)
        mean = self.mean + gain * off
        mean[2] = wrap(float(mean[2]))
        return DockEstimate(mean, own - np.outer(gain, own[2]))


@dataclass(frozen=True, eq=False)
class DockPrior:
    """What was believed before the marker was seen: mean (3,) and covariance (3, 3)."""

    mean: np.ndarray
    covariance: np.ndarray

    def excess(self, poses: np.ndarray) -> np.ndarray:
        """Return by how much (n, 3) poses are farther off than 3.3 standard deviations, squared."""
        off = poses - self.mean
        off[:, 2] = wrap(off[:, 2])
        squares = np.sum((off @ np.linalg.inv(self.covariance)) * off, axis=1)
        return np.maximum(squares - 11.0, 0.0)

    def moved(self, motion: MotionStep) -> DockPrior:
        """Return it as seen by a robot after a step."""
        mean = se2.between(motion.step, self.mean)
        by_state, by_step = step_derivatives(mean, motion.step[2])
        covariance = by_state @ self.covariance @ by_state.T
        return DockPrior(mean, covariance + by_step @ motion.covariance @ by_step.T)


def step_derivatives(poses: np.ndarray, turn: float) -> Tuple[np.ndarray, np.ndarray]:
    """Return what a step of the robot does to errors of (..., 3) poses, given after the step.

    Returns:
        Derivatives by the pose before, (3, 3), and by the step, (..., 3, 3).
    """
    cos, sin = math.cos(turn), math.sin(turn)
    by_pose = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    by_step = np.zeros((*poses.shape[:-1], 3, 3))
    by_step[..., :2, :2] = -by_pose[:2, :2]
    by_step[..., 0, 2], by_step[..., 1, 2] = poses[..., 1], -poses[..., 0]
    by_step[..., 2, 2] = -1.0
    return by_pose, by_step
