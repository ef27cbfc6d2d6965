"""Exact moments against samples, and against a quadrature over the noise of three steps.

Confidence: 99.9 % for the family of comparisons as a whole, shared out evenly (Bonferroni). Means
and covariances have 3 + 6 entries for 4 models, 10 levels with noise, 2 paths and 2 kinds of
coordinates, 1,440 in all: each is two-sided at 0.001 / 1,440, 5.0 standard deviations. The
sampling error of a covariance is taken from the fourth moments, as the errors are not Gaussian at
high levels.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from noise_checks import drawn_errors
from noise_paths import assert_moments, composed, line, square
from numpy.polynomial.hermite_e import hermegauss
from numpy.testing import assert_allclose
from scipy import stats
from shared import cases

from bullet_lab.core import se2
from bullet_lab.core.se2 import ellipse_points
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.exact_moments import (
    exact_moments,
    exponential_moments,
    first_order_moments,
    quadratic_covariances,
    quadratic_shares,
)
from bullet_lab.noise.noisy_paths import noisy_steps, study_generator
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.noise_study.regions import BOUNDS, METHODS, level_rule
from bullet_lab.studies.noise_study.statistics import study_case
from bullet_lab.studies.noise_study.study import StudySettings

# Those of the study, and noise in which nothing of the path is left.
LEVELS = (*StudySettings().levels, 10.0)
PATHS = 10_000
FAMILY = 0.001


def quantile(comparisons):
    """Return the limit of each comparison of a family, in standard deviations."""
    return stats.norm.isf(0.5 * FAMILY / comparisons)


PATHS_BY_NAME = {"square": square(), "line": line(4.0, 40)}


@pytest.mark.parametrize("name", PATHS_BY_NAME)
@pytest.mark.parametrize("model", MODELS)
def test_moments_are_as_before(name, model):
    found = {}
    for std in LEVELS:
        steps = noisy_steps(PATHS_BY_NAME[name], level_rule(model, std))
        every = exact_moments(steps), first_order_moments(steps)
        last = [moments.covariance[-1] for moments in every]
        shares = quadratic_shares(quadratic_covariances(steps), every[0].covariance)[::10]
        found[std] = *last, every[0].mean[-1], shares, every[0].rms_distance()[::10]
        found[f"{std} exponential"] = exponential_moments(steps, [5, len(steps)])
    found["ellipse"] = ellipse_points(last[0])
    text = Path(__file__).with_name("moments") / f"{model}_{name}.txt"
    assert_as_before(lines_of(found, ""), text)


def test_the_quadratic_share_is_that_of_the_worst_direction():
    quadratic, covariance = np.diag([1.0, 2.0, 0.0]), np.diag([4.0, 4.0, 1.0])
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turned = (turn @ quadratic @ turn.T, turn @ covariance @ turn.T)
    assert quadratic_shares(*turned) == pytest.approx(0.5)
    assert quadratic_shares(np.zeros((3, 3)), np.zeros((3, 3))) == 0.0
    # A direction without variance has no share.
    assert quadratic_shares(quadratic, np.diag([4.0, 4.0, 0.0])) == pytest.approx(0.5)


def case_of(name, std, model="rate_invariant", paths=2000):
    poses = PATHS_BY_NAME[name]
    trajectory = Trajectory(0.2 * np.arange(len(poses)), poses)
    generator = study_generator(52, model, std, 5.0)
    return study_case(trajectory, (model, std, 5.0), generator, paths, 1.0)


def quadrature(steps):
    """Return noise of three steps, and the weights in moments, (n,), by Gauss's rule.

    The noise is that of the heading of each translation and at the end, (n, 4), and that of the
    translations, in which all errors are linear, (n, 3).
    """
    turns = np.append(steps.variance1, 0.0) + np.insert(steps.variance2, 0, 0.0)
    rules = [hermegauss(12)] * len(turns) + [hermegauss(2)] * len(steps)
    x, w = (np.stack(np.meshgrid(*every, indexing="ij")).reshape(7, -1).T for every in zip(*rules))
    weights = w.prod(axis=1)
    heading = np.cumsum(x[:, :4] * np.sqrt(turns), axis=1)
    return heading, x[:, 4:] * np.sqrt(steps.variance_trans), weights / weights.sum()


def weighted(errors, weights):
    mean = weights @ errors
    return mean, (errors - mean).T * weights @ (errors - mean)


def assert_weighted(found, errors, weights):
    """Compare the last moments with those of weighted errors."""
    mean, covariance = weighted(errors, weights)
    scale = np.sqrt(np.diag(covariance))
    assert_allclose(found.mean[-1] / scale, mean / scale, atol=1e-6)
    size = np.outer(scale, scale)
    assert_allclose(found.covariance[-1] / size, covariance / size, atol=1e-6)


# Short steps with much noise, and a way on which bending outweighs the noise along it.
@cases("std, length: [[0.2, 0.3], [0.05, 10.0], [1.0e-7, 1.0]]")
@pytest.mark.parametrize("model", MODELS)
def test_moments_are_those_by_quadrature(model, std, length):
    moves = [(length, 0.0, 0.4), (length, 0.2 * length, -0.3), (-length, 0.0, 0.2)]
    steps = noisy_steps(composed((1.0, 2.0, 0.5), moves), level_rule(model, std))
    heading, added, weights = quadrature(steps)
    moves = (steps.trans + added) * np.exp(1j * (steps.angle + heading[:, :3]))
    off = moves.sum(axis=1) - steps.position[-1]
    errors = np.column_stack((off.real, off.imag, heading[:, 3]))
    assert_weighted(exact_moments(steps), errors, weights)
    assert_weighted(exponential_moments(steps, [3]), se2.logarithm(errors), weights)
    if std < 1e-6:
        assert_weighted(first_order_moments(steps), errors, weights)
    # What is quadratic in the noise.
    terms = steps.direction * (1j * added - 0.5 * steps.trans * heading[:, :3]) * heading[:, :3]
    quadratic = quadratic_covariances(steps)
    for pose, found in enumerate(quadratic):
        part = terms[:, :pose].sum(axis=1)
        _, covariance = weighted(np.column_stack((part.real, part.imag, 0.0 * off.real)), weights)
        assert_allclose(found, covariance, rtol=1e-9, atol=1e-12 * quadratic.max())


def test_no_noise_is_no_error():
    case = case_of("square", 0.0, "report", 10)
    assert case.rms_distance.max() < 1e-12
    assert case.metrics["ape_rmse_m_p95"] < 1e-12
    assert all(set(found) == {None} for found in case.regions.found.values())
    assert case.regions.found.keys() == set(METHODS)
    assert set(case.coverage.values()) == {None}
    assert case.theory.gaussian_enough()


@pytest.mark.parametrize("name", PATHS_BY_NAME)
def test_the_study_says_where_the_error_is_not_gaussian(name):
    case = case_of(name, 0.3)
    assert not case.theory.gaussian_enough()
    assert case.coverage["first_order"] < 0.935
    assert case.theory.shift() > 0.3
    if name == "square":
        # NEES tells it, too.
        assert case.regions.found["first_order"][-1].nees > 3.8
        # A mean of e' M^-1 e is 3 whatever the noise, if M is the mean of e e'.
        low, high = case.regions.found["published"][-1].nees_band
        assert low - 0.1 < 3.0 < high + 0.1


def test_a_mean_of_blocks_is_the_mean_of_all():
    case = case_of("square", 0.2, paths=PATHS)
    steps = noisy_steps(PATHS_BY_NAME["square"], level_rule("rate_invariant", 0.2))
    errors = drawn_errors(steps, study_generator(52, "rate_invariant", 0.2, 5.0), PATHS)
    distances = np.hypot(*errors[:, :2].T)
    expected = [distances.mean(), np.median(distances), np.quantile(distances, 0.95)]
    found = [case.metrics[f"final_error_m_{part}"] for part in ("mean", "p50", "p95")]
    assert found == pytest.approx(expected)
    assert case.rms_distance[-1] == pytest.approx(math.sqrt(np.mean(distances**2)))


def test_bounds_are_quantiles_of_chi_square():
    assert_allclose(BOUNDS, stats.chi2.ppf([0.5, 0.95, 0.99], 3))


@pytest.mark.parametrize("name", PATHS_BY_NAME)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("std", LEVELS)
def test_sample_moments_are_the_exact_ones(name, model, std):
    steps = noisy_steps(PATHS_BY_NAME[name], level_rule(model, std))
    errors = drawn_errors(steps, study_generator(50, model, std, 1.0), PATHS)
    limit = quantile(2 * 9 * len(MODELS) * (len(LEVELS) - 1) * len(PATHS_BY_NAME))
    exact, exponential = exact_moments(steps), exponential_moments(steps, [len(steps)])
    assert_moments(errors, exact.mean[-1], exact.covariance[-1], limit)
    coordinates = se2.logarithm(errors)
    assert_moments(coordinates, exponential.mean[0], exponential.covariance[0], limit)


def test_an_ellipse_holds_95_percent_of_a_gaussian():
    covariance = np.array([[2.0, 0.7, 0.0], [0.7, 0.5, 0.0], [0.0, 0.0, 1.0]])
    points = ellipse_points(covariance)
    lengths = np.einsum("ni,ij,nj->n", points, np.linalg.inv(covariance[:2, :2]), points)
    assert_allclose(lengths, stats.chi2.ppf(0.95, 2))
