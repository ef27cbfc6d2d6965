"""The report's noise with its defects as switches, against the two versions it joins."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from noise_paths import drive, played, reported
from numpy.testing import assert_allclose, assert_array_equal
from shared import cases

from bullet_lab.core import se2
from bullet_lab.core.se2 import atan2, hypot
from bullet_lab.noise.odometry_noise import NoisyPath, ReportRule
from bullet_lab.noise.published_noise import (
    ALL,
    DEFECTS,
    NONE,
    Defects,
    PublishedNoise,
    Sampler,
    combinations,
    noisy_paths,
    sampled,
)

SEEDS = range(20)
STD = 0.1
# To the last bit what PublishedNoise uses.
OF_FLOATS = {"sin": math.sin, "cos": math.cos, "arctan2": atan2, "hypot": hypot}
PYTHON = SimpleNamespace(
    **{name: np.vectorize(f, otypes=[float]) for name, f in OF_FLOATS.items()}
)
REST = (5, (0.0, 0.0, 0.0))
START = (0.0, 0.0, 0.0)
SIDE, CORNER = (12, (0.15, 0.0, 0.0)), (7, (0.0, 0.0, math.radians(-90.3) / 7))
LAP = drive(START, REST, *[SIDE, CORNER] * 4, REST)


def draws(poses, seeds=SEEDS):
    """Return what the generators of live algorithms draw."""
    shape = (len(poses) - 1, 3)
    return np.stack([np.random.default_rng(s).standard_normal(shape) for s in seeds], axis=1)


def noisy(poses, *defects, std=STD, seeds=SEEDS, **functions):
    """Return paths with the named defects."""
    enabled = Defects(**dict.fromkeys(defects, True))
    return noisy_paths(poses[:, np.newaxis], draws(poses, seeds), std, enabled, **functions)


def published(poses, seed):
    return np.array(played(PublishedNoise(STD, seed), poses))


def mended(poses, seed):
    return reported(played(NoisyPath(ReportRule(STD), seed), poses))


@pytest.mark.parametrize(
    "poses",
    [
        se2.compose((1.0, -2.0, 3.1), LAP),
        drive(START, (30, (-0.1, 0.02, 0.3)), REST, (10, (0.0, 0.0, -0.7))),
        drive((0, 0, 10.0), (30, (0.1, 0.0, 0.0))),
    ],
)
def test_with_all_defects_it_is_the_published_algorithm_bit_for_bit(poses):
    replay = noisy(poses, *DEFECTS, functions=PYTHON)
    for number, seed in enumerate(SEEDS):
        assert_array_equal(replay[:, number], published(poses, seed))


def test_without_defects_it_is_the_mended_algorithm():
    poses = se2.compose((1.0, -2.0, 0.4), LAP)
    expected = np.stack([mended(poses, seed) for seed in SEEDS], axis=1)
    assert_allclose(se2.between(expected, noisy(poses)), 0.0, atol=1e-12)


def test_combinations():
    found = combinations()
    assert len(set(found)) == len(found) == 32
    assert found[0] == NONE and found[-1] == ALL
    assert (str(found[0]), str(found[-1])) == ("none", " + ".join(DEFECTS))
    counts = [len(defects.names) for defects in found]
    assert counts == sorted(counts)


@pytest.mark.parametrize("defects", combinations())
def test_without_noise_every_combination_gives_the_perfect_path(defects):
    errors = se2.between(LAP[:, np.newaxis], noisy(LAP, *defects.names, std=0.0, seeds=[1]))
    assert np.abs(errors).max() < 1e-12


def test_what_each_defect_does_is_as_before():
    """In turns past half a turn, at rest, on ways ahead and back, and beside the heading."""
    there_and_back = (9, (0.2, 0.0, 0.15)), REST, (9, (-0.2, 0.02, 0.3)), (2, (0.0, 0.0, -0.7))
    poses = drive((1.0, 2.0, 2.5), *there_and_back)
    found = {str(one): noisy(poses, *one.names, seeds=[1, 2])[3::7] for one in combinations()}
    assert_as_before(lines_of(found, ""), Path(__file__).with_name("defects.txt"))


def test_many_paths_are_each_what_they_are_alone():
    other = LAP + [1.0, 0.0, 0.2]
    together = noisy_paths(np.stack([LAP, other], axis=1), draws(LAP, [1, 2]), STD, ALL)
    assert_allclose(together[:, 1:], noisy(other, *DEFECTS, seeds=[2]), atol=1e-9)


def test_published_algorithm_step_by_step():
    # The listings, by hand, for two steps; the second starts where the first noisy one ended.
    draws = np.random.default_rng(5).standard_normal(6)
    noise = PublishedNoise(0.1, 5)
    assert noise.update(1.0, 2.0, 3.0) == pytest.approx((1.0, 2.0, 3.0))
    x, y, yaw, summed = 1.0, 2.0, 3.0, 3.0
    for k, now in enumerate([(0.8, 1.9, -3.1), (0.6, 1.85, -3.0)]):
        trans = math.hypot(now[0] - x, now[1] - y)
        rot1 = math.atan2(now[1] - y, now[0] - x) - yaw
        rot2 = now[2] - yaw - rot1
        trans += 0.1 * trans * draws[3 * k]
        rot1 += 0.1 * abs(rot1) * draws[3 * k + 1]
        rot2 += 0.1 * abs(rot2) * draws[3 * k + 2]
        x, y = x + trans * math.cos(yaw + rot1), y + trans * math.sin(yaw + rot1)
        summed += rot1 + rot2
        yaw = math.atan2(math.sin(summed), math.cos(summed))
        assert noise.update(*now) == pytest.approx((x, y, yaw))
    noise.restart()
    assert noise.update(4.0, 5.0, 0.6) == pytest.approx((4.0, 5.0, 0.6))


def due(sampler, stamps):
    return [stamp for stamp in stamps if sampler.due(stamp)]


TWENTIETHS = [0.05 + k / 20 for k in range(1000)]


@pytest.mark.parametrize(
    "rate, stamps, taken",
    [
        # Ticks at 1.1111 s, 2.2222 s, 3.3333 s and 4.4444 s after the first stamp.
        (0.9, [5.0 + k / 20 for k in range(100)], [6.15, 7.25, 8.35, 9.45]),
        # At the rate of the messages it takes each.
        (20.0, TWENTIETHS, TWENTIETHS[1:]),
        (20.0, [1.7e9 + stamp for stamp in TWENTIETHS], [1.7e9 + s for s in TWENTIETHS[1:]]),
        # It does not catch up after a gap.
        (1.0, [0.0, 0.5, 1.0, 5.5, 5.6, 6.0, 6.1], [1.0, 5.5, 6.0]),
    ],
)
def test_sampler_takes_the_first_message_after_each_tick(rate, stamps, taken):
    sampler = Sampler(rate)
    assert due(sampler, stamps) == pytest.approx(taken, rel=1e-15)
    sampler.restart()
    assert due(sampler, stamps) == pytest.approx(taken, rel=1e-15)


def test_sampled_looks_when_the_live_node_does():
    stamps = 5.0 + np.arange(300) / 20
    live = np.isin(stamps, due(Sampler(0.9), stamps))
    assert_array_equal(sampled(stamps, 0.9, [1.0 / 0.9])[:, 0], np.flatnonzero(live))


def test_sampled_with_phases():
    stamps = np.arange(41) / 20
    indices = sampled(stamps, 2.0, [0.0, 0.12, 0.49])
    assert_array_equal(indices, [[0, 3, 10], [10, 13, 20], [20, 23, 30], [30, 33, 40]])


def test_without_defects_going_backwards_still_counts_as_two_half_turns():
    poses = drive(START, (1, (-1.0, 0.0, 0.0)))
    error = noisy(poses)[1] - poses[1]
    draw1 = draws(poses)[0, :, 1]
    assert_allclose(np.sin(STD * math.pi * draw1) * -1.0, error[:, 1], rtol=0.5)
    assert np.abs(mended(poses, 1)[1, 1]) < 1e-12 < np.abs(error[:, 1]).min()


@cases("defects, steps: [[[], 100], [[aliasing], 1]]")
def test_aliasing_forgets_the_error_of_the_step_before(defects, steps):
    poses = drive(START, (100, (0.1, 0.0, 0.0)))
    off = noisy(poses, *defects, seeds=range(300))[-1] - poses[-1]
    rms = math.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1)))
    assert rms == pytest.approx(STD * 0.1 * math.sqrt(steps), rel=0.1)


@cases("defects: [[], [unwrapped]]")
def test_unwrapped_makes_noise_where_the_heading_passes_half_a_turn(defects):
    poses = drive((0, 0, 3.0), (10, (0.1, 0.0, 0.05)))
    passing = int(np.argmax(poses[:, 2] < 0.0))
    errors = np.abs(se2.between(poses[:, np.newaxis], noisy(poses, *defects))[..., 2])
    assert errors[passing - 1].max() < 0.05
    assert (np.median(errors[passing]) > 0.2) == bool(defects)


def test_noise_at_rest_turns_a_robot_that_stands_still():
    poses = drive((1.0, 2.0, 1.5), REST)
    still = noisy(poses)
    assert np.abs(still - still[0]).max() < 1e-12
    turned = noisy(poses, "noise_at_rest")
    assert np.std(turned[-1, :, 2]) > 0.3
    assert (turned[..., :2] == poses[0, :2]).all()


@cases("defects, bends: [[[], 1.0], [[unbent], 0.0]]")
def test_unbent_keeps_the_direction_whatever_the_heading(defects, bends):
    replay = noisy(drive(START, (10, (0.0, 0.0, 0.15)), (20, (0.1, 0.0, 0.0))), *defects)
    way = replay[-1] - replay[10]
    direction = np.arctan2(way[:, 1], way[:, 0]) - 1.5
    assert_allclose(direction, bends * (replay[10, :, 2] - 1.5), atol=1e-9)
