"""Poses of a dock in the robot's frame, as Gaussians."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.docking.motion import MotionStep
from bullet_lab.numerics import se2
from bullet_lab.numerics.angles import wrap


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
