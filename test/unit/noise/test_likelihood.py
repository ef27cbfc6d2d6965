"""The likelihood of steps: it recovers the noise that NoisyPath added, with its variances."""

from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from noise_paths import RULES, played, reported, wandering
from scipy import stats
from shared import cases

from bullet_lab.core import se2
from bullet_lab.noise.goodness import whitened
from bullet_lab.noise.likelihood import Problem, StepPairs, part_errors
from bullet_lab.noise.odometry_noise import MODELS, NoisyPath, ProbabilisticRule
from bullet_lab.noise.systematic import SYSTEMATIC, SystematicErrors, end_of


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("errors", [SystematicErrors(), SystematicErrors(0.02, -0.03, 0.01, 0.02)])
def test_the_draws_of_a_noisy_path_are_found_again(rule, errors):
    true = wandering()
    noisy = reported(played(NoisyPath(rule, 7), errors.path(true)))
    steps = se2.steps(true)
    pairs = StepPairs(steps, se2.steps(noisy)[np.newaxis])
    problem = Problem(pairs, rule.name, SYSTEMATIC, errors.wheel_base)
    values = [*astuple(rule), *(getattr(errors, name) for name in SYSTEMATIC)]
    (found,) = whitened(problem, np.array([values]))
    draws = np.random.default_rng(7).standard_normal((len(steps), 3))[:, [1, 0, 2]]
    ahead = np.hypot(*steps[:, :2].T) > 1e-3
    assert np.isfinite(found[ahead, 1]).all()
    # Where a rule gives next to no noise there is none to be found.
    _, variance = part_errors(pairs, errors.steps(steps)).residuals(rule)
    seen = (variance[0].min(axis=1) > 1e-12) & ahead
    assert seen.sum() > 80
    np.testing.assert_allclose(found[seen], draws[seen], atol=2e-5)
    assert np.isnan(found[~steps.any(axis=1)]).all()


@cases("""
model, long:
  - [report, false]
  - [rate_invariant, false]
  - [rate_invariant, true]
  - [probabilistic, false]
  - [random_walk, true]
""")
def test_the_likelihood_and_its_slopes_are_as_before(model, long):
    # Also turns on the spot, which tell both rotations together.
    poses, errors = wandering(120), SystematicErrors(0.02, -0.03, 0.01, 0.02, way_per_turn=0.01)
    rule, within = MODELS[model].at_level(0.05), se2.steps(poses)
    noisy = reported(played(NoisyPath(rule, 7), errors.path(poses)))
    true, odometry, more = within, se2.steps(noisy), {}
    if long:
        more["within"] = within.reshape(-1, 10, 3)
        true, odometry = (end_of(steps.reshape(-1, 10, 3)) for steps in (within, odometry))
    pairs = StepPairs(true, np.stack((odometry, true)), 1e-3, 2e-3, **more)
    problem = Problem(pairs, model, SYSTEMATIC[:: 2 if long else 1])
    found = {name: getattr(problem, name) for name in ("start", "low", "high", "longest")}
    beside = problem.start + 0.1
    found["there"] = problem.logarithm(beside), *problem.slopes(beside)
    found["whitened"] = whitened(problem, problem.values(beside))
    text = f"{model}{'_long' * long}.txt"
    assert_as_before(lines_of(found, ""), Path(__file__).with_name(text))


def test_the_likelihood_is_that_of_the_three_gaussians():
    rule, sigma = ProbabilisticRule(0.01, 0.02, 0.03, 0.004), (0.002, 0.001)
    true = np.array([[0.3, 0.0, 0.2]])
    error1, along, error2 = 0.03, -0.02, 0.01
    step = [(0.3 + along) * np.cos(error1), (0.3 + along) * np.sin(error1), 0.2 + error1 + error2]
    pairs = StepPairs(true, np.array([[step]]), *sigma)
    a, s2, b = rule.variances(0.0, 0.3, 0.2)
    p, q = 2.0 * sigma[0] ** 2, 2.0 * sigma[1] ** 2
    sideways = [[0.09 * a + p, 0.3 * a], [0.3 * a, a + b + q]]
    expected = stats.multivariate_normal([0.0, 0.0], sideways).logpdf(
        [0.3 * error1, error1 + error2]
    ) + stats.norm(0.0, np.sqrt(s2 + p)).logpdf(along)
    problem = Problem(pairs, rule.name)
    coordinates = problem.coordinates(np.array([astuple(rule)]))
    assert problem.logarithm(coordinates) == pytest.approx(expected, rel=1e-12)


def test_a_turn_on_the_spot_tells_both_rotations_together():
    pairs = StepPairs(np.array([[0.0, 0.0, 0.5]]), np.array([[[0.0, 0.0, 0.6]]]))
    ((found,),) = whitened(Problem(pairs, "rate_invariant"), np.array([[0.1]]))
    assert np.isnan(found[0])
    assert found[2] == pytest.approx(0.1 / np.sqrt(0.01 * 0.5))
