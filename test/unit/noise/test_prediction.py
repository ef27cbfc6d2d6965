"""Where steps end by a fit of others: regions that hold, and dispersions that make them."""

from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from noise_checks import drawn_errors
from numpy.testing import assert_allclose
from shared import cases

from bullet_lab.noise.calibration import Problem, fit
from bullet_lab.noise.goodness import INSIDE, LENGTHS, drawn_pairs, judged, predicted, windows
from bullet_lab.noise.likelihood import LongErrors, StepPairs, walk_shares
from bullet_lab.noise.noisy_paths import noisy_steps
from bullet_lab.noise.odometry_noise import RandomWalkRule, rule_of
from bullet_lab.noise.systematic import SystematicErrors, end_of, path_of

RULE = RandomWalkRule(0.02, 0.03, 0.05)
ERRORS = SystematicErrors(0.02, -0.03, 0.01, way_per_turn=0.03)
NAMES = ("scale_error", "base_error", "diameter_error", "way_per_turn")
LAP = [(0.05, 0.0, 0.0)] * 20 + [(0.04, 0.0, 0.06)] * 25 + [(0.04, 0.0, -0.05)] * 15
STEPS = np.array(LAP * 14)


def reported(seed):
    true = StepPairs(STEPS, STEPS[np.newaxis])
    return drawn_pairs(true, RULE, np.random.default_rng(seed), 1, ERRORS.steps(STEPS))


def halves_of(pairs):
    every = np.ones(len(pairs.true), dtype=bool)
    number = np.arange(len(every))
    for own in (number < len(every) // 2, number >= len(every) // 2):
        halved = StepPairs(pairs.true[own], pairs.odometry[:, own])
        found = fit(Problem(halved, "random_walk", NAMES))
        others = StepPairs(pairs.true[~own], pairs.odometry[:, ~own], 1e-3, 2e-3)
        for length in LENGTHS[:2]:
            yield predicted(found, others, every[~own], length)


def test_the_right_model_predicts_the_other_half():
    squares = []
    for seed in range(8):
        squares += [np.stack((*one.squares(), one.apart)) for one in halves_of(reported(seed))]
    for first in (0, 1):
        rows = np.concatenate(squares[first::2], axis=1)
        held = np.mean(rows[0, rows[2] > 0] <= INSIDE)
        # Of 48 windows of 5 m, 41 or fewer at 95 % have a probability of 1 %.
        assert held > 0.87


def test_noise_that_is_larger_than_steps_show_disperses():
    every = list(halves_of(reported(3)))
    calm = judged(every)
    slow = np.repeat(np.random.default_rng(1).normal(0.0, 0.01, 42), 20)
    pairs = reported(3)
    drifting = pairs.odometry + slow[:, np.newaxis] * [0.0, 0.0, 1.0]
    more = judged(list(halves_of(StepPairs(pairs.true, drifting))))
    assert more.dispersion > 1.5 * calm.dispersion
    assert more.density < calm.density
    # Whether the farthest of few ends is held is a matter of rounding.
    few = [more.dispersion, more.density, judged(every[1:2]).dispersion]
    found = {"windows": tuple(every[:2]), "calm": calm, "density": calm.density, "few": few}
    assert_as_before(lines_of(found, ""), Path(__file__).with_name("predicted.txt"))


@cases("gap: [0, 40, 100]")
def test_windows_go_over_no_gap_and_have_their_length(gap):
    steps = np.tile([0.125, 0.0, 0.0], (100, 1))
    begins, ends = windows(steps, np.arange(100) != gap, 2.5)
    assert begins.tolist() == [at for at in range(0, 80, 5) if not at < gap < at + 20]
    assert (ends - begins).tolist() == [20] * len(begins)


def test_shares_of_a_long_step_are_the_moments_of_many_paths():
    within = STEPS[15:40]
    errors = LongErrors(np.zeros((1, 1, 3)), walk_shares(within[np.newaxis]), np.zeros(3))
    said = errors.covariance(RULE)[0]
    steps = noisy_steps(path_of(within), RULE)
    seen = np.cov(drawn_errors(steps, np.random.default_rng(2), 20000)[:, [1, 0, 2]].T)
    scale = np.sqrt(np.diagonal(seen))
    # 20000 paths determine a variance to 1 %, and the moments are of first order.
    size = np.outer(scale, scale)
    assert_allclose(said / size, seen / size, atol=0.04)


def test_long_steps_give_the_parameters_that_short_ones_have():
    pairs = reported(5)
    groups = STEPS.reshape(-1, 10, 3)
    odometry = end_of(pairs.odometry.reshape(-1, 10, 3))
    long = StepPairs(end_of(groups), odometry[np.newaxis], within=groups)
    found = fit(Problem(long, "random_walk", NAMES)).values()
    rule = rule_of("random_walk", found)
    assert rule.way_std == pytest.approx(RULE.way_std, rel=0.35)
    for name in NAMES:
        assert found[name] == pytest.approx(getattr(ERRORS, name), abs=0.02)
