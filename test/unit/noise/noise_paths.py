"""Noise rules, perfect paths that they act on, and a check of the errors that they make.

Poses are x (m), y (m) and yaw (rad), shape (n+1, 3).
"""

import math

import numpy as np

from bullet_lab.core import se2
from bullet_lab.noise.odometry_noise import ProbabilisticRule, RateInvariantRule, ReportRule

RULES = (ReportRule(0.1), RateInvariantRule(0.05), ProbabilisticRule(0.02, 0.01, 0.03, 0.004))


def drive(start, *legs):
    """Return the poses of a drive; a leg is a number of equal steps and the step."""
    return composed(start, [step for count, step in legs for _ in range(count)])


def composed(start, moves):
    poses = [np.array(start, dtype=float)]
    for move in moves:
        poses.append(se2.compose(poses[-1], move))
    return np.array(poses)


def square(count=12, side=2.0, turn=math.pi / 2, start=(0.3, -0.2, 0.4)):
    """Each side takes `count` steps, each turn half as many."""
    ahead, corner = (side / count, 0.0, 0.0), (0.0, 0.0, turn / (count // 2))
    return drive(start, *[(count, ahead), (count // 2, corner)] * 4)


def played(path, poses):
    """Return what a noisy or systematic path makes of perfect poses, one after the other."""
    return [path.update(*pose) for pose in np.asarray(poses, dtype=float).tolist()]


def reported(steps):
    """Return the poses of steps that `played` returns, shape (n, 3)."""
    return np.array([step.pose for step in steps])


def line(length, count):
    return drive((0.0, 0.0, 0.0), (count, (length / count, 0.0, 0.0)))


def wandering(count=200, seed=4):
    """Arcs, straight ahead and back, turns on the spot, rests, and steps without a direction."""
    generator = np.random.default_rng(seed)
    moves = generator.normal(0.0, [0.05, 0.02, 0.2], (count, 3))
    kind = generator.integers(0, 8, count)
    moves[kind == 1, :2] = 0.0
    moves[kind == 2, 1:] = 0.0
    moves[kind == 3] = 0.0
    moves[kind == 4, :2] = 2e-5
    return composed((3.0, -2.0, 3.0), moves)


def assert_moments(sample, mean, covariance, quantile):
    """Check mean and covariance of errors, shape (n, k), up to some standard deviations.

    The standard deviation of a covariance is taken from the fourth moments of the sample, as the
    errors need not be Gaussian.
    """
    rounding, root = 1e-12, math.sqrt(len(sample))
    centred = sample - mean
    limit = quantile * np.sqrt(np.diag(covariance)) / root
    assert (np.abs(centred.mean(axis=0)) <= limit + rounding).all()
    products = centred[:, :, None] * centred[:, None, :]
    limit = quantile * products.std(axis=0) / root
    assert (np.abs(products.mean(axis=0) - covariance) <= limit + rounding).all()
