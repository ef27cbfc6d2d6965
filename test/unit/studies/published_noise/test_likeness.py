import math

import numpy as np
import pytest

from bullet_lab.studies.published_noise.results import (
    RESOLUTION,
    TOLERANCE,
    LikenessError,
    compare,
    log_likelihood,
)

SCALE = RESOLUTION / TOLERANCE


def lengths(rng, count):
    """Return lengths as of a run: two below what can be read, one far above."""
    return np.abs(rng.normal(size=(count, 3))) * [0.001, 0.002, 0.2]


def measure(rng, true):
    """Return lengths as they are read, with the error that the module assumes."""
    scaled = np.arcsinh(true / SCALE) + TOLERANCE * rng.standard_normal(true.shape)
    return np.abs(np.sinh(scaled) * SCALE)


def test_likelihood_of_one_run_is_a_gaussian():
    runs = np.full((2, 1), 0.2)
    step = np.arcsinh(0.25 / SCALE) - np.arcsinh(0.2 / SCALE)
    expected = -0.5 * (step / TOLERANCE) ** 2 - math.log(TOLERANCE * math.sqrt(2 * math.pi))
    assert compare([0.25], runs, 1).log_likelihood == pytest.approx(expected)
    assert log_likelihood([0.25], runs) == pytest.approx(expected)


def test_a_resolution_below_the_tolerance_is_one_sigma():
    runs = np.zeros((2, 1))
    near, far = (log_likelihood([length], runs) for length in (0.0, RESOLUTION))
    assert near - far == pytest.approx(0.5, rel=0.05)


def test_likelihood_is_that_of_a_size():
    # Both signs of the error of a length that is 0 are read as the same.
    expected = math.log(2.0 / (TOLERANCE * math.sqrt(2 * math.pi)))
    assert log_likelihood([0.0], np.zeros((2, 1))) == pytest.approx(expected)


def test_p_value_judges_each_run_by_the_others():
    # Each of these is further from the other than the measurement is from either.
    assert compare([0.5], [[0.1], [10.0]], 1).p_value == 1.0


def test_likelihood_is_the_mean_over_the_runs():
    one, other = ([[a], [a]] for a in (0.1, 0.3))
    both = log_likelihood([0.2], [[0.1], [0.3]])
    mean = np.mean([math.exp(log_likelihood([0.2], runs)) for runs in (one, other)])
    assert math.exp(both) == pytest.approx(mean)


def test_runs_that_are_like_it_are_likelier():
    rng = np.random.default_rng(1)
    runs = lengths(rng, 400)
    measured = [0.001, 0.002, 0.2]
    fits = compare(measured, runs, 1)
    worse = [compare(measured, runs * factor, 1) for factor in (0.05, 20.0)]
    assert all(fits.log_likelihood > other.log_likelihood + 2.0 for other in worse)
    assert fits.p_value > 0.1
    assert all(other.p_value < 0.05 for other in worse)


def test_nearest_and_percentiles():
    runs = np.array([[0.1, 0.001], [0.2, 0.001], [0.4, 0.001], [0.8, 0.001]])
    found = compare([0.41, 0.001], runs, 1)
    assert found.nearest == 2
    assert found.percentiles[0] == pytest.approx(0.635, abs=0.02)
    # Below what can be read, the error alone decides: 1/3 of its sigma on either side of 0.
    assert found.percentiles[1] == pytest.approx(0.5 - 0.2525, abs=0.002)


def test_p_value_of_a_measurement_of_such_a_run_is_uniform():
    rng = np.random.default_rng(2)
    runs = lengths(rng, 300)
    measured = [measure(rng, true) for true in lengths(rng, 200)]
    values = np.array([compare(each, runs, 1).p_value for each in measured])
    # 99.9 % of the time a uniform one is this near.
    for share in (0.1, 0.5, 0.9):
        assert abs(np.mean(values <= share) - share) < 3.3 * math.sqrt(share * (1 - share) / 200)


def test_p_value_has_a_floor():
    assert compare([5.0], np.full((99, 1), 0.001), 1).p_value == pytest.approx(0.01)


def test_error_of_the_likelihood_is_that_of_other_runs():
    rng = np.random.default_rng(3)
    found = [compare([0.001, 0.002, 0.2], lengths(rng, 200), 1) for _ in range(60)]
    scatter = np.std([each.log_likelihood for each in found])
    said = np.mean([each.log_likelihood_error for each in found])
    assert said == pytest.approx(scatter, rel=0.35)


@pytest.mark.parametrize(
    "measured, runs",
    [
        ([1.0], [[1.0, 2.0]] * 3),
        ([1.0], [[1.0]]),
        ([1.0], [[math.nan]] * 3),
        ([math.inf], [[1.0]] * 3),
        ([-1.0], [[1.0]] * 3),
    ],
)
def test_lengths_that_cannot_be_compared(measured, runs):
    with pytest.raises(LikenessError):
        compare(measured, runs, 1)
