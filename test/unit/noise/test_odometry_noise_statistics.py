"""Statistics of the noise; each bound is two-sided at 99.9 %, with fixed seeds."""

import math

import numpy as np
import pytest
from noise_paths import drive
from scipy import stats

from bullet_lab.noise.odometry_noise import (
    NoisyPath,
    ProbabilisticRule,
    RateInvariantRule,
    ReportRule,
)

TAIL = 0.0005
QUANTILE = stats.norm.isf(TAIL)


def corner(count, side=2.0, turn=math.pi / 2):
    """Ahead, turn on the spot, ahead; `count` messages for each."""
    ahead = (count, (side / count, 0.0, 0.0))
    return drive((0.0, 0.0, 0.0), ahead, (count, (0.0, 0.0, turn / count)), ahead).tolist()


def last_step(rule, seed, poses):
    path = NoisyPath(rule, seed)
    for pose in poses:
        step = path.update(*pose)
    return step


def test_spread_of_the_report_rule_is_std_times_distance():
    # Written out, without the helper: one step of 2 m has a standard deviation of 0.2 m.
    poses = [(0, 0, 0.5), (2 * math.cos(0.5), 2 * math.sin(0.5), 0.5)]
    errors = [last_step(ReportRule(0.1), seed, poses).motion_error[0] for seed in range(500)]
    assert stats.kstest(np.array(errors) / 0.2, "norm").pvalue > 2 * TAIL


def test_rate_invariant_covariance_does_not_depend_on_the_subdivision():
    k = 1e-6  # so small that the noisy path is the perfect one
    coarse, fine = (last_step(RateInvariantRule(k), 30, corner(n)).covariance for n in (20, 400))
    assert coarse[2, 2] == pytest.approx(fine[2, 2], rel=1e-9)
    assert fine[2, 2] == pytest.approx(k**2 * (2.0 + math.pi / 2 + 2.0), rel=1e-9)
    np.testing.assert_allclose(coarse, fine, rtol=2e-3)


@pytest.mark.parametrize(
    "rule",
    [
        ReportRule(0.03),
        RateInvariantRule(0.01),
        ProbabilisticRule(0.001, 0.0005, 0.001, 0.0005),
    ],
)
def test_reported_covariance_is_that_of_many_paths(rule):
    poses, count = corner(15), 600
    steps = [last_step(rule, seed, poses) for seed in range(count)]
    errors = np.array([step.pose for step in steps]) - poses[-1]
    reported = np.mean([step.covariance for step in steps], axis=0)
    sample = errors.T @ errors / count
    variances = np.diag(reported)
    sampling_std = np.sqrt((np.outer(variances, variances) + reported**2) / count)
    assert (np.abs(sample - reported) < QUANTILE * sampling_std).all()
    nees = [e @ np.linalg.solve(step.covariance, e) for e, step in zip(errors, steps)]
    assert stats.chi2.ppf(TAIL, 3 * count) < np.sum(nees) < stats.chi2.isf(TAIL, 3 * count)
