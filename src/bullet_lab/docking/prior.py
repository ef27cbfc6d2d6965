"""Particle filter on the dock's pose, for the time before its marker was seen.

The particles live in the robot's frame, so that errors of the odometry spread them as the robot
moves. They start from the database, and learn from what was free to stand on and from looks
that did not find the marker.
"""

from __future__ import annotations

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.angles import wrap
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.database import Dock
from bullet_lab.docking.filter import GaussianPose
from bullet_lab.docking.geometry import clearance, wall_boxes
from bullet_lab.docking.odometry import MotionStep

PARTICLES = 600
# The database may lie somewhat more than it says.
_MARGIN = 1.1
_SIZE_PLAY = 0.05


class DockParticles:
    """Weighted poses of a dock in the robot's frame.

    Args:
        dock: what the database says of it.
        rough: its rough pose in the robot's frame.
        rng: what draws the poses.
    """

    def __init__(self, dock: Dock, rough: PlanarPose, rng: np.random.Generator):
        self._rng = rng
        self._boxes = wall_boxes(dock)
        # The uncertainty is along the axes of the frame that the pose is given in, which may be
        # any; drawn on a disc and a square it makes little difference.
        position = _MARGIN * dock.uncertainty.position + 0.01
        yaw = _MARGIN * dock.uncertainty.yaw + 0.005
        off = rng.uniform(-1.0, 1.0, (PARTICLES, 3)) * (position, position, yaw)
        self.poses = np.asarray(rough, dtype=float) + off
        self.poses[:, 2] = wrap(self.poses[:, 2])
        self.weights = np.full(PARTICLES, 1.0 / PARTICLES)
        self.mass = 1.0

    def move(self, motion: MotionStep) -> None:
        """Follow a step of the robot."""
        roots = _root(motion.covariance)
        steps = np.asarray(motion.step) + self._rng.standard_normal((len(self.poses), 3)) @ roots.T
        self.poses = se2.between(steps, self.poses)

    def stands_free(self, radius: float) -> bool:
        """Drop what would have the robot touch a wall: a circle about it is free.

        Returns:
            Whether that is possible at all.
        """
        free = clearance(se2.inverse(self.poses)[:, :2], self._boxes) > radius
        if not np.all(free):
            self._learn(np.where(free, 1.0, 1e-6), counts=False)
        return bool(np.any(free))

    def add_miss(self, expected: np.ndarray, missed: float, counts: bool = True) -> None:
        """Learn from a look that found nothing.

        Args:
            expected: (n,) probability that the marker is found, for each pose.
            missed: probability that a look misses what it should find.
            counts: whether `mass`, the share of the prior that is left, falls.
        """
        self._learn(1.0 - (1.0 - missed) * expected, counts)

    def concentrate(self, estimate: GaussianPose, play: float) -> None:
        """Move the particles to a pose, with so much more play to either side in m."""
        count = len(self.poses)
        # How large the copy is, and so how far, is known to some per cent only.
        far = np.outer(estimate.mean[:2], estimate.mean[:2]) * _SIZE_PLAY**2
        covariance = estimate.covariance + np.diag([0.02, 0.01, 0.012]) ** 2
        covariance[:2, :2] += far
        root = _root(covariance)
        drawn = estimate.mean + self._rng.standard_normal((count, 3)) @ root.T
        beside = np.zeros((count, 3))
        beside[:, 1] = self._rng.uniform(-play, play, count)
        self.poses = se2.compose(drawn, beside)
        self.weights = np.full(count, 1.0 / count)

    def mix_in(self, poses: np.ndarray, share: float) -> None:
        """Replace a share of the particles by other poses (n, 3)."""
        count = int(share * len(self.poses))
        keep = self._rng.choice(len(self.poses), len(self.poses) - count, p=self.weights)
        drawn = poses[self._rng.integers(len(poses), size=count)]
        self.poses = np.concatenate([self.poses[keep], drawn])
        self.weights = np.full(len(self.poses), 1.0 / len(self.poses))

    def gaussian(self) -> GaussianPose:
        """Return mean and covariance, widened a little."""
        mean = self.weights @ self.poses
        turn = np.exp(1j * self.poses[:, 2])
        mean[2] = np.angle(self.weights @ turn)
        off = self.poses - mean
        off[:, 2] = wrap(off[:, 2])
        covariance = (self.weights[:, None] * off).T @ off
        return GaussianPose(mean, 1.2 * covariance + np.diag([0.05, 0.05, 0.03]) ** 2)

    def samples(self, count: int) -> np.ndarray:
        """Draw (count, 3) poses."""
        return self.poses[self._rng.choice(len(self.poses), count, p=self.weights)]

    def _learn(self, likelihood: np.ndarray, counts: bool) -> None:
        weights = self.weights * likelihood
        total = float(np.sum(weights))
        if total <= 0.0:
            return
        if counts:
            self.mass *= total
        self.weights = weights / total
        if 1.0 / np.sum(self.weights**2) < 0.4 * len(self.poses):
            self._resample()

    def _resample(self) -> None:
        count = len(self.poses)
        places = (np.arange(count) + self._rng.uniform()) / count
        chosen = np.minimum(np.searchsorted(np.cumsum(self.weights), places), count - 1)
        jitter = self._rng.standard_normal((count, 3)) * (0.02, 0.02, 0.008)
        self.poses = self.poses[chosen] + jitter
        self.weights = np.full(count, 1.0 / count)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return a matrix whose product with its transpose is a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))
