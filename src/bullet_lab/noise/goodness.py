"""Goodness of fit of a noise model, from its whitened residuals.

If the model is right, they are standard normal and independent. Three tests:

    shape       distance of their distribution from the normal one (Kolmogorov and Smirnov)
    size        the mean square of each part, which is 1
    neighbours  the correlation of each part with that of the next step, which is 0

The parameters are estimated from the same residuals, so these look better than they are. A
parametric bootstrap, data drawn from the fitted model and fitted again, measures by how much. Of
long paths a few hundred steps are drawn: the distribution of sqrt(n) times a deviation does not
depend on n.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List

import numpy as np
from numpy import ndarray
from scipy.special import ndtr

from bullet_lab.noise.calibration import Fit, Problem, fit
from bullet_lab.noise.likelihood import PARTS, LongErrors, StepPairs, part_errors, walk_shares
from bullet_lab.noise.odometry_noise import NoiseRule, line_of_travel

SIGNIFICANCE = 0.05
_REPLICAS = 199
# Steps of a replica.
_MAX_STEPS = 400
# Residuals that a mean square or a correlation needs.
_MIN_COUNT = 8
_MIN_SPREAD = 0.05
_PART_NAMES = {
    "rot1": "the turn before the way",
    "trans": "the way",
    "rot2": "the turn after the way",
}


@dataclass(frozen=True, eq=False)
class Goodness:
    """How well a fitted model describes the steps.

    Attributes:
        whitened: residuals over their standard deviations, NaN as of `whitened`, (n, 3).
        distance: of their distribution from the normal one (Kolmogorov and Smirnov), 0 to 1.
        shape_p: p-value of that.
        mean_squares: of the parts rot1, trans and rot2; 1 is right, NaN if too few, (3,).
        size_p: p-value of the one that is farthest from 1, corrected for three tests.
        correlations: of each part with that of the next step, (3,).
        neighbours_p: p-value of the one that is farthest from 0, corrected likewise.
        nees: mean of the squares of a step, over the number of its parts; 1 is right.
    """

    whitened: ndarray
    distance: float
    shape_p: float
    mean_squares: ndarray
    size_p: float
    correlations: ndarray
    neighbours_p: float
    nees: float

    @property
    def p_value(self) -> float:
        """Of all three tests together (Bonferroni)."""
        return min(1.0, 3.0 * min(self.shape_p, self.size_p, self.neighbours_p))

    @property
    def fits(self) -> bool:
        """Whether no test rejects the model at the level of `SIGNIFICANCE`."""
        return self.p_value >= SIGNIFICANCE

    def words(self) -> List[str]:
        """Return a sentence for each test that rejects the model; empty if it fits."""
        found = []
        limit = SIGNIFICANCE / 3.0
        if self.shape_p < limit:
            seen = self.whitened[np.isfinite(self.whitened)]
            heavy = np.mean(seen**4) > 3.0 * np.mean(seen**2) ** 2
            kind = "more large and more small ones" if heavy else "more middling ones"
            found.append(f"the errors are not Gaussian: {kind} than there should be")
        if self.size_p < limit:
            part = int(np.nanargmax(np.abs(np.log(self.mean_squares))))
            times = math.sqrt(self.mean_squares[part])
            name = _PART_NAMES[PARTS[part]]
            found.append(f"{name} is {times:.2g} times as noisy as the model has it")
        if self.neighbours_p < limit:
            part = int(np.nanargmax(np.abs(self.correlations)))
            value = self.correlations[part]
            why = (
                "something systematic or slow is left in them"
                if value > 0.0
                else "the truth's own noise (truth_std_m, truth_std_rad), or too short steps"
            )
            where = f"correlation {value:.2f} in {_PART_NAMES[PARTS[part]]}"
            found.append(f"errors of neighbouring steps go together ({where}): {why}")
        return found


def whitened(pairs: StepPairs, rule: NoiseRule, expected=None) -> ndarray:
    """Return the errors of all parts over their standard deviations, shape (b, n, 3).

    If rule and expectation are right, they are standard normal. NaN if the rule gives the part less
    noise than the truth's poses have, and the error is not larger than that.

    Args:
        pairs: b odometries of n steps.
        rule: the noise rule.
        expected: as of `part_errors`.
    """
    errors = part_errors(pairs, expected)
    error, variance = errors.residuals(rule)
    shown = (variance > 2.0 * errors.floor) | (error * error > 25.0 * errors.floor)
    return np.where(shown, error / np.sqrt(variance), np.nan)


def drawn_pairs(
    pairs: StepPairs, rule: NoiseRule, generator: np.random.Generator, count: int, expected=None
) -> StepPairs:
    """Draw odometries whose `whitened` errors are standard normal.

    Args:
        pairs: with the true steps, n of them.
        rule: the noise rule.
        generator: of the normal draws, three for each step.
        count: how many odometries.
        expected: steps without noise, shape (n, 3); the true ones by default.
    """
    expected = pairs.true if expected is None else expected
    if pairs.within is not None:
        errors = LongErrors.of(pairs, expected[np.newaxis], walk_shares(pairs.within))
        roots = np.linalg.cholesky(errors.covariance(rule))
        draws = generator.standard_normal((count, len(expected), 3, 1))
        added = (roots @ draws)[..., 0]
        return replace(pairs, odometry=expected + added[..., [1, 0, 2]])
    errors = part_errors(replace(pairs, odometry=expected[np.newaxis]), expected)
    _, variance = errors.residuals(rule)
    draws = generator.standard_normal((count, len(expected), 3)) * np.sqrt(variance)
    moved = errors.lever * rule.variances(*errors.parts)[0]
    turned = draws[..., 2] + moved / (errors.lever * moved + errors.floor[0]) * draws[..., 0]
    direction, trans = line_of_travel(expected[:, 0], expected[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        direction = direction + np.where(errors.lever > 0.0, draws[..., 0] / errors.lever, 0.0)
    trans = trans + draws[..., 1]
    steps = (trans * np.cos(direction), trans * np.sin(direction), expected[:, 2] + turned)
    return replace(pairs, odometry=np.stack(steps, axis=-1))


def goodness(found: Fit, follows: ndarray, seed: int) -> Goodness:
    """Test the fit of one odometry.

    Args:
        found: the fit, b = 1.
        follows: whether each step begins where the one before it ended, shape (n,).
        seed: of the bootstrap, >= 0.
    """
    seen = _whitened(found)[0]
    counts = np.isfinite(seen).sum(axis=0)
    distance, squares = _distance(seen), _mean_squares(seen)
    distances, spread = _replicas(found, seed)
    scaled = math.sqrt(counts.sum()) * distance
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.sqrt(counts) * (squares - 1.0) / spread
    correlations, pairs = _correlations(seen, follows)
    return Goodness(
        whitened=seen,
        distance=distance,
        shape_p=float((1 + np.sum(distances >= scaled)) / (1 + len(distances))),
        mean_squares=squares,
        size_p=_smallest_p(off),
        correlations=correlations,
        neighbours_p=_smallest_p(correlations * np.sqrt(pairs)),
        nees=float(np.nanmean(seen**2)),
    )


def _whitened(found: Fit) -> ndarray:
    problem, values = found.problem, found.estimates
    if problem.pairs.within is None:
        return whitened(problem.pairs, problem.rule(values), problem.expected(values))
    error, variance = problem.step_errors(values).residuals(problem.rule(values))
    return error / np.sqrt(variance)


def _replicas(found: Fit, seed: int):
    """Return the scaled distances of replicas, and the spread of their mean squares, (3,)."""
    generator = np.random.default_rng([seed, 2])
    problem, pairs = found.problem, found.problem.pairs
    chosen = np.arange(len(pairs.true))
    if len(chosen) > _MAX_STEPS:
        chosen = np.sort(generator.choice(chosen, _MAX_STEPS, replace=False))
    expected = problem.expected(problem.values(found.coordinates))[0][chosen]
    within = None if pairs.within is None else pairs.within[chosen]
    some = replace(pairs, true=pairs.true[chosen], within=within)
    drawn = drawn_pairs(some, found.rule(), generator, _REPLICAS, expected)
    again = Problem(
        drawn, problem.model, problem.systematic, problem.wheel_base, found.coordinates[0]
    )
    seen = _whitened(fit(again))
    counts = np.isfinite(seen).sum(axis=1)
    distances = np.array([math.sqrt(max(c.sum(), 1)) * _distance(z) for z, c in zip(seen, counts)])
    squares = np.array([_mean_squares(z) for z in seen])
    with np.errstate(invalid="ignore"):
        spread = np.sqrt(np.mean(counts * (squares - 1.0) ** 2, axis=0))
    # A mean square that a parameter fits to 1 differs from it by rounding only.
    spread = np.maximum(spread, _MIN_SPREAD)
    return distances, spread


def _distance(seen: ndarray) -> float:
    values = np.sort(seen[np.isfinite(seen)])
    if not values.size:
        return 0.0
    share, ranks = ndtr(values), np.arange(values.size + 1) / values.size
    return float(max(np.max(ranks[1:] - share), np.max(share - ranks[:-1])))


def _mean_squares(seen: ndarray) -> ndarray:
    counts = np.isfinite(seen).sum(axis=0)
    total = np.nansum(seen**2, axis=0)
    return np.where(counts >= _MIN_COUNT, total / np.maximum(counts, 1), np.nan)


def _correlations(seen: ndarray, follows: ndarray):
    """Return the correlation of each part with that of the next step, and their number, (3,)."""
    # Clipped, as a few large residuals would dominate.
    clipped = np.clip(seen, -3.0, 3.0)
    now, before = clipped[1:][follows[1:]], clipped[:-1][follows[1:]]
    both = np.isfinite(now) & np.isfinite(before)
    now, before = np.where(both, now, 0.0), np.where(both, before, 0.0)
    count = both.sum(axis=0)
    scale = np.sqrt(np.sum(now**2, axis=0) * np.sum(before**2, axis=0))
    with np.errstate(invalid="ignore"):
        found = np.sum(now * before, axis=0) / scale
    return np.where(count >= _MIN_COUNT, found, np.nan), count


def _smallest_p(deviations: ndarray) -> float:
    """Return the p-value of the largest of some standard normal numbers (Bonferroni)."""
    known = np.abs(deviations[np.isfinite(deviations)])
    return float(min(1.0, 2.0 * len(known) * ndtr(-known.max()))) if known.size else 1.0
