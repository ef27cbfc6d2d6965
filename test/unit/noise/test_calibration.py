"""Calibration: against closed forms, and how often its intervals hold the truth."""

from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from noise_paths import RULES
from numpy.testing import assert_allclose
from scipy import optimize, stats

from bullet_lab.noise.calibration import Problem, fit, intervals, on_limit, profile
from bullet_lab.noise.goodness import drawn_pairs, goodness
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.odometry_noise import (
    ProbabilisticRule,
    RandomWalkRule,
    RateInvariantRule,
    ReportRule,
)
from bullet_lab.noise.systematic import SYSTEMATIC, SystematicErrors

HERE = Path(__file__).parent
STRAIGHT = np.tile([0.1, 0.0, 0.0], (50, 1))
WRONG = SystematicErrors(0.02, -0.03, 0.005, 0.01)


def drive(count=3):
    """Ahead, turns on the spot, arcs both ways and back."""
    lap = [(0.04, 0.0, 0.0)] * 12 + [(0.0, 0.0, 0.1)] * 10 + [(0.04, 0.0, 0.06)] * 12
    return np.array((lap + [(-0.03, 0.0, -0.04)] * 10 + [(0.0, 0.0, -0.1)] * 8) * count)


def drawn(rule, count, seed=1, steps=None, errors=None):
    steps = drive() if steps is None else steps
    expected = steps if errors is None else errors.steps(steps)
    pairs = StepPairs(steps, steps[np.newaxis])
    return drawn_pairs(pairs, rule, np.random.default_rng(seed), count, expected)


def test_one_standard_deviation_has_its_closed_form():
    pairs = drawn(ReportRule(0.2), 3, steps=STRAIGHT)
    found = fit(Problem(pairs, "report"))
    squares = (np.hypot(*np.moveaxis(pairs.odometry[..., :2], -1, 0)) - 0.1) ** 2 / 0.01
    best = squares.mean(axis=1)
    assert_allclose(found.estimates[:, 0], np.sqrt(best), rtol=1e-3)

    def fall(std, variance):
        return 50.0 * (variance / std**2 - 1.0 - np.log(variance / std**2)) - 3.8415

    for ends, variance in zip(intervals(found)[:, 0], best):
        std = np.sqrt(variance)
        brackets = (0.3 * std, std), (std, 3.0 * std)
        expected = [optimize.brentq(fall, *bracket, (variance,)) for bracket in brackets]
        assert ends == pytest.approx(expected, rel=2e-3)


def test_the_profile_ends_the_interval():
    found = fit(Problem(drawn(RULES[2], 1), "probabilistic"))
    ends = intervals(found)[0]
    for name, pair in zip(found.problem.names, ends):
        assert_allclose(profile(found, name, pair), 3.84, atol=0.05)


def test_estimates_and_intervals_are_as_before():
    """As on the day when intervals of 95 of 100 held the truth."""
    walk, some = RandomWalkRule(0.02, 0.03, 0.05), SYSTEMATIC[1::3]
    found = {}
    for rule, names in (*((rule, ()) for rule in RULES), (RULES[1], SYSTEMATIC), (walk, some)):
        problem = Problem(drawn(rule, 1, errors=WRONG if names else None), rule.name, names)
        best = fit(problem)
        both = best.estimates, best.log_likelihood
        found[f"{rule.name} {len(names)}"] = *both, intervals(best), on_limit(best)
    # What the steps say nothing of has no ends.
    straight = Problem(drawn(RULES[2], 1, steps=STRAIGHT), "probabilistic", ("base_error",))
    exact = Problem(drawn(RateInvariantRule(1e-5), 1, errors=WRONG), "rate_invariant", SYSTEMATIC)
    found["straight"] = intervals(fit(straight))
    # On the spot no noise would be seen, and 0 would be certain.
    ways = drive()[np.hypot(*drive()[:, :2].T) > 0.0]
    rule = ProbabilisticRule(0.02, 0.01, 0.03, 0.0)
    nothing = fit(Problem(drawn(rule, 20, steps=ways), "probabilistic"))
    found["nothing"] = nothing.estimates[:, 3], intervals(nothing)[:, 3]
    found["exact"] = fit(exact).estimates
    assert_as_before(lines_of(found, ""), HERE / "intervals.txt")


def held(rule, count, seed, errors=None):
    """Return how many intervals hold the truth, by parameter."""
    names = () if errors is None else SYSTEMATIC
    steps = drive()
    if errors is not None:
        # On the spot, unequal wheels of either sign would be as good; see docs/jobs/calibrate.md.
        steps[steps[:, 0] == 0.0, 0] = 0.004
    found = fit(Problem(drawn(rule, count, seed, steps, errors), rule.name, names))
    low, high = np.moveaxis(intervals(found), -1, 0)
    known = [getattr(errors if name in names else rule, name) for name in found.problem.names]
    return ((low <= known) & (known <= high)).sum(axis=0)


@pytest.mark.parametrize(
    "rule, count, seed, errors",
    [*((rule, 150, 3, None) for rule in RULES), (RULES[2], 20, 4, WRONG)],
)
def test_intervals_hold_the_truth(rule, count, seed, errors):
    # Two-sided at 99.9 % of what 95 % give.
    low, high = stats.binom.ppf([5e-4, 1 - 5e-4], count, 0.95)
    counts = held(rule, count, seed, errors)
    assert (low <= counts).all() and (counts <= high).all()


@pytest.mark.long
@pytest.mark.parametrize("rule", RULES)
def test_intervals_hold_the_truth_in_95_of_100(rule):
    for counts in (held(rule, 1000, 5), held(rule, 1000, 6, WRONG)):
        assert (counts >= 930).all() and (counts <= 970).all()


def goodness_of(pairs, model, follows=True):
    return goodness(fit(Problem(pairs, model)), np.full(len(pairs.true), follows), 1)


def judged(rule, model, errors=None, seed=11, steps=None):
    return goodness_of(drawn(rule, 1, seed, steps, errors), model)


def with_jitter():
    """The truth has noise of its own that nobody says."""
    odometry = drawn(RateInvariantRule(0.01), 1).odometry
    jitter = np.random.default_rng(12).normal(0.0, 0.004, (len(drive()) + 1, 3))
    return StepPairs(drive() + np.diff(jitter, axis=0), odometry)


def bounded():
    """Errors of one size each."""
    errors = np.random.default_rng(4).choice([-0.01, 0.01], drive().shape)
    return StepPairs(drive(), (drive() + errors)[np.newaxis])


def test_right_models_fit_and_wrong_ones_are_told_as_before():
    found = {
        "right": tuple(judged(rule, rule.name) for rule in RULES),
        "wrong": tuple(judged(RULES[number], RULES[1 - number].name) for number in (0, 1)),
        # Nobody asked for them.
        "errors": judged(RateInvariantRule(0.005), "rate_invariant", SystematicErrors(0.0, 0.1)),
        "jitter": goodness_of(with_jitter(), "rate_invariant"),
        "bounded": goodness_of(bounded(), "probabilistic"),
        "alone": goodness_of(with_jitter(), "rate_invariant", False),
        "few": goodness_of(drawn(RULES[2], 1, steps=drive()[8:16]), "probabilistic"),
        "many": judged(RULES[2], "probabilistic", steps=drive(8)),
        "turns": goodness_of(drawn(RULES[1], 1, steps=drive()[12:21]), "rate_invariant"),
    }
    said = {name: [one.words() for one in np.atleast_1d(every)] for name, every in found.items()}
    assert_as_before(lines_of({**found, "said": said}, ""), HERE / "goodness.txt")
    assert [one.fits for one in found["right"]] == [True] * 3
    assert not any(found[name].fits for name in ("errors", "jitter"))


@pytest.mark.long
def test_right_models_are_refused_in_one_of_20():
    refused = sum(not judged(RULES[2], "probabilistic", seed=seed).fits for seed in range(100))
    # Three tests with Bonferroni's limits: at most 5 %; 99.9 % of that.
    assert refused <= stats.binom.ppf(0.999, 100, 0.05)


def test_nothing_is_an_estimate_that_an_interval_begins_at():
    rule = ProbabilisticRule(0.02, 0.01, 0.03, 0.0)
    # On the spot no noise would be seen, and 0 would be certain.
    steps = drive()[np.hypot(*drive()[:, :2].T) > 0.0]
    found = fit(Problem(drawn(rule, 20, steps=steps), "probabilistic"))
    lowest, highest = intervals(found)[:, 3].T
    # About half of the estimates are at the bound.
    assert 3 <= (found.estimates[:, 3] == 0.0).sum() <= 17
    assert (lowest[found.estimates[:, 3] == 0.0] == 0.0).all()
    assert (highest < 0.03).all()
    # An interval at its bound holds it more often than at 95 %.
    assert (lowest == 0.0).sum() >= 17


def test_what_the_steps_say_nothing_of_has_no_ends():
    pairs = drawn(RULES[2], 1, steps=STRAIGHT)
    found = fit(Problem(pairs, "probabilistic", ("base_error",)))
    ends = dict(zip(found.problem.names, intervals(found)[0].tolist()))
    assert ends["alpha1"] == ends["alpha4"] == [0.0, np.inf]
    assert ends["base_error"] == [-np.inf, np.inf]
    assert 0.015 < ends["alpha3"][0] < ends["alpha3"][1] < 0.06


def test_without_noise_to_speak_of_systematic_errors_are_exact():
    pairs = drawn(RateInvariantRule(1e-5), 1, errors=WRONG)
    found = fit(Problem(pairs, "rate_invariant", SYSTEMATIC)).values()
    for name in SYSTEMATIC:
        assert found[name] == pytest.approx(getattr(WRONG, name), abs=2e-5)


@pytest.mark.parametrize("rule", RULES)
def test_the_right_model_fits(rule):
    found = judged(rule, rule.name)
    assert found.fits and found.words() == []
    assert found.nees == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    "rule, model, errors, why",
    [
        (RULES[0], "rate_invariant", None, "the errors are not Gaussian"),
        (RULES[1], "report", None, "the errors are not Gaussian"),
        # Nobody asked for them.
        (
            RateInvariantRule(0.005), "rate_invariant", SystematicErrors(0.0, 0.1),
            "something systematic",
        ),
    ],
)  # fmt: skip
def test_a_wrong_model_does_not_fit(rule, model, errors, why):
    found = judged(rule, model, errors)
    assert not found.fits
    assert any(why in said for said in found.words())
    assert found.neighbours_p < 1e-3 or errors is None


def test_noise_of_the_truth_that_nobody_says_is_seen_in_neighbours():
    found = goodness_of(with_jitter(), "rate_invariant")
    assert any("the truth's own noise" in said for said in found.words())
