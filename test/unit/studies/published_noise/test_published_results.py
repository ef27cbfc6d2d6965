import math

import numpy as np
import pytest

from bullet_lab.noise.published_noise import NONE, Defects, combinations
from bullet_lab.studies.published_noise.results import (
    EVIDENCE,
    NEEDED,
    RULED_OUT,
    UNKNOWN,
    PValue,
    Result,
    groups_of_same,
    nearest,
    p_value,
    ranked,
    verdict,
)


def lengths(rng, count):
    """Return lengths as of a run, which hang together."""
    size = np.exp(rng.standard_normal((count, 1)))
    return np.abs(size * rng.normal(size=(count, 3)) * [0.001, 0.002, 0.2])


def test_p_value_of_one_length_is_twice_its_rank():
    runs = 0.1 * np.arange(1, 100)[:, np.newaxis]
    assert p_value([0.31], runs).value == pytest.approx(2 * 4 / 100)
    assert p_value([9.65], runs).value == pytest.approx(2 * 4 / 100)
    assert p_value([5.0], runs).value == pytest.approx(1.0)
    assert p_value([100.0], runs).value == pytest.approx(2 / 100)


def test_of_several_lengths_the_most_unusual_one_counts():
    runs = np.column_stack([np.arange(1, 1000), np.arange(1, 1000)])
    assert p_value([500, 9.5], runs).value == pytest.approx(2 * 2 * 10 / 1000)


def test_p_values_of_replays_are_below_a_share_at_most_as_often():
    rng = np.random.default_rng(2)
    values = []
    for _ in range(400):
        every = lengths(rng, 200)
        values.append(p_value(every[0], every[1:]).value)
    for share in (0.05, 0.1, 0.5):
        # 99.9 % of the time.
        sigma = math.sqrt(share * (1 - share) / 400)
        assert np.mean(np.array(values) <= share) < share + 3.1 * sigma
    assert np.mean(np.array(values) <= 0.5) > 0.25


def test_the_bound_holds_as_often_as_it_says():
    rng = np.random.default_rng(3)
    true = 0.04
    # Of a length that is uniform, 2 % are above 0.98.
    found = np.array([p_value([0.98], rng.random((150, 1))).high for _ in range(1000)])
    missed = np.mean(found < true)
    # One-sided 95 % for each of the two tails together; 99.9 % of the time.
    assert missed < 0.025 + 3.1 * math.sqrt(0.025 * 0.975 / 1000)


def test_the_bound_of_none_in_many():
    high = p_value([2.0], np.linspace(0, 1, 1000)[:, np.newaxis]).high
    assert high == pytest.approx(2 * (1 - 0.025 ** (1 / 1000)))


def test_too_few_runs_exclude_nothing():
    few, many = (p_value([2.0], np.linspace(0, 1, count)[:, np.newaxis]) for count in (99, 999))
    assert not few.explains and not few.excludes
    assert many.excludes


def result(defects, value, high, size=1.0):
    p_values = dict.fromkeys(EVIDENCE, PValue(value, high))
    return Result(defects, np.full((3, 6), size), p_values, np.zeros(6))


def judged(explains, name):
    """Return the verdict on a defect if some combinations explain the figure."""
    found = [result(d, *((0.5, 0.6) if explains(d) else (1e-3, 1e-2))) for d in combinations()]
    return verdict(name, found, "all")


def test_verdicts():
    assert judged(lambda d: d.aliasing and not d.unbent, "aliasing") == NEEDED
    assert judged(lambda d: d.aliasing and not d.unbent, "unbent") == RULED_OUT
    assert judged(lambda d: d.aliasing and not d.unbent, "sampled") == UNKNOWN
    assert judged(lambda d: False, "aliasing") == UNKNOWN


def test_what_is_not_excluded_leaves_the_verdict_open():
    found = [
        result(d, *((0.5, 0.6) if d.aliasing else (0.01, 0.06) if d == NONE else (1e-3, 1e-2)))
        for d in combinations()
    ]
    assert verdict("aliasing", found, "all") == UNKNOWN


def test_ranks_and_groups():
    low, high = result(NONE, 0.1, 0.2), result(Defects(aliasing=True), 0.6, 0.7, size=2.0)
    twin = result(Defects(aliasing=True, unbent=True), 0.6, 0.7, size=2.0)
    assert ranked([low, high, twin]) == [high, twin, low]
    assert groups_of_same([high, twin, low]) == [[high, twin], [low]]


def test_nearest():
    runs = np.array([[0.1, 0.001], [0.2, 0.001], [0.4, 0.001], [0.4, 0.3]])
    assert nearest(np.array([0.41, 0.001]), runs) == 2
