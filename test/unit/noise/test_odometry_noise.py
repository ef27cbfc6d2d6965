"""Noise rules, and the noisy path that they make, pose by pose."""

import dataclasses
import math

import numpy as np
import pytest
from noise_paths import RULES, played, reported, wandering
from numpy.testing import assert_allclose, assert_array_equal
from recorded_paths import make_rule
from shared import cases

from bullet_lab.core import se2
from bullet_lab.noise.odometry_noise import (
    MODELS,
    NoiseError,
    NoisyPath,
    ProbabilisticRule,
    ReportRule,
    decompose,
)


# The last steps are below and beyond MIN_TRANSLATION, below which a translation has no direction.
@cases("""
step, degrees1, way, degrees2:
  - [[0.0, -0.2, 0.0], -90.0, 0.2, 90.0]
  - [[-0.1, -0.1, 0.5], 45.0, -0.1414213562373095, -16.35211024345884]
  - [[-0.1, 0.1, 3.0], -45.0, -0.1414213562373095, -143.11266146075303]
  - [[-0.0, -0.0, 0.7], 0.0, 0.0, 40.10704565915762]
  - [[0.0, 9.0e-5, 0.7], 0.0, 9.0e-5, 40.10704565915762]
  - [[-9.0e-5, 0.0, 0.7], 0.0, -9.0e-5, 40.10704565915762]
  - [[0.0, 1.1e-4, 0.0], 90.0, 1.1e-4, -90.0]
""")
def test_decompose(step, degrees1, way, degrees2):
    expected = math.radians(degrees1), way, math.radians(degrees2)
    assert_allclose(decompose(step), expected, atol=1e-14)


@cases("""
model, parameters, step, variances:
  # In proportion to each part.
  - [report, [0.1], [0.2, -0.3, -0.4], [4.0e-4, 9.0e-4, 16.0e-4]]
  # By metres and radians; strafing is no turn.
  - [rate_invariant, [0.1], [0.0, -0.3, 0.0], [0.0015, 0.003, 0.0015]]
  - [rate_invariant, [0.1], [0.0, 0.0, -0.4], [0.002, 0.0, 0.002]]
  - [rate_invariant, [0.1], [1.5707963267948966, 0.3, -1.5707963267948966], [0.0015, 0.003, 0.0015]]
  # Table 5.6: of 0.1, -0.2, 0.3.
  - [probabilistic, [1, 2, 3, 4], [0.1, -0.2, 0.3], [0.09, 0.52, 0.17]]
""")
def test_variances(model, parameters, step, variances):
    assert MODELS[model](*parameters).variances(*step) == pytest.approx(variances)


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
