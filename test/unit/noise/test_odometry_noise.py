"""Noise rules, and the noisy path that they make, pose by pose."""

import dataclasses
import math

import numpy as np
import pytest
from noise_paths import RULES, played, reported, wandering
from numpy.testing import assert_allclose, assert_array_equal
from recorded_paths import make_rule

from bullet_lab.core import se2
from bullet_lab.core.parameters import ParameterError, check_parameters
from bullet_lab.noise.odometry_noise import (
    MIN_TRANSLATION,
    NoiseError,
    NoisyPath,
    ProbabilisticRule,
    RateInvariantRule,
    ReportRule,
    decompose,
)


@pytest.mark.parametrize(
    "step, expected",
    [
        ((0.0, -0.2, 0.0), (-math.pi / 2, 0.2, math.pi / 2)),
        ((-0.1, -0.1, 0.5), (math.pi / 4, -math.sqrt(0.02), 0.5 - math.pi / 4)),
        ((-0.1, 0.1, 3.0), (-math.pi / 4, -math.sqrt(0.02), 3.0 + math.pi / 4 - 2 * math.pi)),
        ((-0.0, -0.0, 0.7), (0.0, 0.0, 0.7)),
        ((0.0, 0.9 * MIN_TRANSLATION, 0.7), (0.0, 0.9 * MIN_TRANSLATION, 0.7)),
        ((-0.9 * MIN_TRANSLATION, 0.0, 0.7), (0.0, -0.9 * MIN_TRANSLATION, 0.7)),
        ((0.0, 1.1 * MIN_TRANSLATION, 0.0), (math.pi / 2, 1.1 * MIN_TRANSLATION, -math.pi / 2)),
    ],
)
def test_decompose(step, expected):
    assert_allclose(decompose(step), expected, atol=1e-15)


@pytest.mark.parametrize(
    "rule, step, variances",
    [
        # In proportion to each part.
        (ReportRule(0.1), (0.2, -0.3, -0.4), (4e-4, 9e-4, 16e-4)),
        # By metres and radians; strafing is no turn.
        (RateInvariantRule(0.1), (0.0, -0.3, 0.0), (0.0015, 0.003, 0.0015)),
        (RateInvariantRule(0.1), (0.0, 0.0, -0.4), (0.002, 0.0, 0.002)),
        (RateInvariantRule(0.1), decompose((0.0, 0.3, 0.0)), (0.0015, 0.003, 0.0015)),
        # Table 5.6.
        (ProbabilisticRule(1, 2, 3, 4), (0.1, -0.2, 0.3), (0.01 + 0.08, 0.12 + 0.4, 0.09 + 0.08)),
    ],
)
def test_variances(rule, step, variances):
    assert rule.variances(*step) == pytest.approx(variances)


@pytest.mark.parametrize("bad", [-0.1, math.nan, 1e300])
def test_bad_parameters_are_refused(bad):
    for name, rule in (
        ("std", ReportRule(bad)),
        ("std", RateInvariantRule(bad)),
        ("alpha3", ProbabilisticRule(0.1, 0.1, bad, 0.1)),
    ):
        with pytest.raises(ParameterError, match=f"{name} is"):
            check_parameters(rule)


def test_rules_are_made_by_name():
    assert make_rule("probabilistic", 0.0, [1, 2, 3, 4]) == ProbabilisticRule(1, 2, 3, 4)
    usual = dataclasses.astuple(ProbabilisticRule())
    assert dataclasses.astuple(ProbabilisticRule.at_level(0.1)) == pytest.approx(usual)
    with pytest.raises(NoiseError, match="'gauss'.*report, rate_invariant, probabilistic"):
        make_rule("gauss", 0.1)
    with pytest.raises(NoiseError, match="4 alphas, not 3"):
        make_rule("probabilistic", 0.1, [0.1] * 3)


@pytest.mark.parametrize("rule", RULES)
def test_each_step_has_its_error_and_its_covariance(rule):
    poses = wandering()
    steps = played(NoisyPath(rule, 3), poses)
    noisy, moves = reported(steps), se2.steps(poses)
    errors = np.array([step.motion_error for step in steps[1:]])
    difference = se2.steps(noisy) - moves
    assert_allclose(errors, np.c_[difference[:, :2], se2.wrap(difference[:, 2])], atol=1e-12)
    assert_array_equal(noisy[:, 2], se2.wrap(noisy[:, 2]))
    for move, step in zip(moves, steps[1:]):
        # That of a path of one step.
        _, own = played(NoisyPath(rule, 0), [(0.0, 0.0, 0.0), move])
        assert_allclose(step.motion_covariance, own.covariance, atol=1e-15)
    assert np.linalg.eigvalsh(steps[-1].covariance).min() > 0.0


def test_restart_begins_anew_but_draws_on():
    poses = wandering(10)
    path = NoisyPath(ReportRule(0.1), 11)
    before = played(path, poses)
    path.restart()
    first, *_, last = played(path, poses)
    # The first pose is unchanged.
    assert (first.pose, first.motion_error) == (tuple(poses[0]), (0.0, 0.0, 0.0))
    assert not first.covariance.any() and not first.motion_covariance.any()
    assert not first.covariance.flags.writeable
    assert np.abs(np.subtract(last.pose, before[-1].pose)).max() > 1e-4
