"""Statistics of the noise; each bound is two-sided at 99.9 %, with fixed seeds."""

import math

import numpy as np
import pytest
from recorded_paths import recover_noise
from scipy import stats

from bullet_lab.core import se2
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
    drive, rotate = np.zeros((count, 3)), np.zeros((count, 3))
    drive[:, 0] = side / count
    rotate[:, 2] = turn / count
    poses = [np.zeros(3)]
    for move in np.concatenate([drive, rotate, drive]):
        poses.append(se2.compose(poses[-1], move))
    return np.array(poses).tolist()


def line(count, length):
    return [(length * k / count, 0.0, 0.0) for k in range(count + 1)]


def last_step(rule, seed, poses):
    path = NoisyPath(rule, seed)
    for pose in poses:
        step = path.update(*pose)
    return step


def assert_standard_normal(values):
    n = len(values)
    assert n > 1000
    assert abs(np.mean(values)) < QUANTILE / math.sqrt(n)
    square_sum = np.sum(np.square(values))
    assert stats.chi2.ppf(TAIL, n) < square_sum < stats.chi2.isf(TAIL, n)
    assert stats.kstest(values, "norm").pvalue > 2 * TAIL


@pytest.mark.parametrize(
    "rule", [ReportRule(0.1), RateInvariantRule(0.02), ProbabilisticRule(0.01, 0.01, 0.02, 0.01)]
)
def test_residuals_are_standard_normal(rule):
    generator = np.random.default_rng(20)
    moves = generator.normal(0.0, [0.05, 0.02, 0.1], (3000, 3))
    moves[1000:2000, :2] = 0.0
    poses = [np.zeros(3)]
    for move in moves:
        poses.append(se2.compose(poses[-1], move))
    path = NoisyPath(rule, 21)
    noisy = [path.update(*pose).pose for pose in np.array(poses).tolist()]
    for values in recover_noise(poses, noisy).standardised(rule).T:
        assert_standard_normal(values[np.isfinite(values)])


def test_spread_of_the_report_rule_is_std_times_distance():
    # Written out, without the helper: one step of 2 m has a standard deviation of 0.2 m.
    generator_seeds = range(1500)
    errors = [
        last_step(
            ReportRule(0.1), seed, [(0, 0, 0.5), (2 * math.cos(0.5), 2 * math.sin(0.5), 0.5)]
        ).motion_error[0]
        for seed in generator_seeds
    ]
    assert_standard_normal(np.array(errors) / 0.2)


def covariances(rule, counts):
    return [last_step(rule, 30, corner(count)).covariance for count in counts]


def test_rate_invariant_covariance_does_not_depend_on_the_subdivision():
    k = 1e-6  # so small that the noisy path is the perfect one
    coarse, fine = covariances(RateInvariantRule(k), (20, 400))
    assert coarse[2, 2] == pytest.approx(fine[2, 2], rel=1e-9)
    assert fine[2, 2] == pytest.approx(k**2 * (2.0 + math.pi / 2 + 2.0), rel=1e-9)
    np.testing.assert_allclose(coarse, fine, rtol=2e-3)


def test_report_covariance_does_depend_on_the_subdivision():
    coarse, fine = covariances(ReportRule(1e-6), (20, 400))
    assert coarse[2, 2] == pytest.approx(20 * fine[2, 2], rel=1e-6)


def test_straight_line_covariance_has_its_closed_form():
    k, length = 1e-6, 7.0
    q = k**2
    covariance = last_step(RateInvariantRule(k), 31, line(100, length)).covariance
    expected = [
        [q * length, 0.0, 0.0],
        [0.0, q * length**3 / 3, q * length**2 / 2],
        [0.0, q * length**2 / 2, q * length],
    ]
    np.testing.assert_allclose(covariance, expected, rtol=1e-3, atol=1e-3 * q)


def test_straight_line_spread_has_its_closed_form():
    k, length, count = 0.01, 4.0, 500
    offsets = [
        last_step(RateInvariantRule(k), seed, line(40, length)).pose[1] for seed in range(count)
    ]
    ratio = np.sum(np.square(offsets)) / (k**2 * length**3 / 3)
    assert stats.chi2.ppf(TAIL, count) < ratio < stats.chi2.isf(TAIL, count)


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


def test_motion_covariance_is_that_of_many_steps():
    rule, count = ProbabilisticRule(0.002, 0.001, 0.003, 0.001), 2000
    poses = [(1.0, 2.0, 2.5), tuple(se2.compose([1.0, 2.0, 2.5], [-0.8, 0.3, 0.4]).tolist())]
    steps = [last_step(rule, seed, poses) for seed in range(count)]
    errors = np.array([step.motion_error for step in steps])
    reported = np.mean([step.motion_covariance for step in steps], axis=0)
    variances = np.diag(reported)
    sampling_std = np.sqrt((np.outer(variances, variances) + reported**2) / count)
    assert (np.abs(errors.T @ errors / count - reported) < QUANTILE * sampling_std).all()
