"""How well a fitted noise model describes steps, and how well it predicts where others end.

Goodness of fit
---------------
If the model is right, whitened residuals are standard normal and independent. Three tests:

    shape       distance of their distribution from the normal one (Kolmogorov and Smirnov)
    size        the mean square of each part, which is 1
    neighbours  the correlation of each part with that of the next step, which is 0

The residuals look better than they are, as the parameters are estimated from them. Replicas, data
drawn from the fitted model and fitted again, measure by how much. Of long paths a few hundred steps
are drawn: the distribution of sqrt(n) times a deviation does not depend on n.

Prediction
----------
For each window of the truth's path, systematic errors give the pose that the odometry should report
at its end, and the noise the second moments of the difference. With the variances V of the
parameters and the slopes J of the end,

    M = dispersion (moments of the noise + J `OWN` V J').

The dispersion is that for which 95 % of the ends are within their regions (more of few ends, as in
conformal prediction: of n windows the share 0.95 (1 + 1/n)), for the length for which it is
largest: errors of a few metres are often larger than steps show, as they are neither independent
nor Gaussian. docs/jobs/calibrate.md has the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Sequence, Tuple

import numpy as np
from numpy import ndarray
from scipy.special import ndtr
from scipy.stats import chi2

from bullet_lab.core import se2
from bullet_lab.core.se2 import LEVEL
from bullet_lab.noise.calibration import Fit, Problem, covariance, fit
from bullet_lab.noise.exact_moments import exact_moments
from bullet_lab.noise.likelihood import (
    PARTS,
    LongErrors,
    PartErrors,
    StepPairs,
    part_errors,
    walk_shares,
)
from bullet_lab.noise.noisy_paths import noisy_steps
from bullet_lab.noise.odometry_noise import NoiseRule, line_of_travel
from bullet_lab.noise.systematic import path_of

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

LENGTHS = (1.0, 5.0, 20.0)
"""m, of windows."""

INSIDE = float(chi2.ppf(LEVEL, 3))
"""Square of a whitened error of the pose at the border of the region of 95 %."""

OWN = 2.0
"""Factor of the covariance of fitted parameters: the path that is predicted has its own errors."""

FEWEST = 6
"""Windows of a length that count."""

# Windows begin at each quarter of their length, as there are few of the long ones.
_OVERLAP = 4
_DIFFERENCE = 1e-5


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


def whitened(problem: Problem, values: ndarray) -> ndarray:
    """Return the errors of all parts over their standard deviations, shape (b, n, 3).

    If the parameters (b, k) are right, they are standard normal. NaN if the rule gives the part of
    a step less noise than the truth's poses have, and the error is not larger than that.
    """
    errors = problem.step_errors(values)
    error, variance = errors.residuals(problem.rule(values))
    if isinstance(errors, PartErrors):
        shown = (variance > 2.0 * errors.floor) | (error * error > 25.0 * errors.floor)
        error = np.where(shown, error, np.nan)
    return error / np.sqrt(variance)


def drawn_pairs(
    pairs: StepPairs,
    rule: NoiseRule,
    generator: np.random.Generator,
    count: int,
    expected: ndarray,
) -> StepPairs:
    """Draw odometries whose `whitened` errors are standard normal.

    Args:
        pairs: with the true steps, n of them.
        rule: the noise rule.
        generator: of the normal draws, three for each step.
        count: how many odometries.
        expected: steps without noise, shape (n, 3).
    """
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
    """Test the fit of one odometry; `follows` says whether each step follows the one before."""
    seen = whitened(found.problem, found.estimates)[0]
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
    seen = whitened(again, fit(again).estimates)
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


@dataclass(frozen=True, eq=False)
class Windows:
    """Ends of windows of one length, predicted and reported, for w windows and s errors.

    Attributes:
        length: m.
        error: reported minus predicted end (m, m, rad) in the frame of the start, (w, 3).
        moments: of the noise and of uncertain parameters, M without the dispersion, (w, 3, 3).
        apart: whether the window does not overlap the one before it that is, (w,).
    """

    length: float
    error: ndarray
    moments: ndarray
    apart: ndarray

    def __len__(self) -> int:
        return len(self.error)

    def squares(self, dispersion: float = 1.0):
        """Return whitened squares, (w,), and logarithms of the density, (w,)."""
        moments = dispersion * self.moments
        solved = np.linalg.solve(moments, self.error[..., np.newaxis])[..., 0]
        squares = np.einsum("wi,wi->w", self.error, solved)
        size = np.linalg.slogdet(2.0 * np.pi * moments)[1]
        return squares, -0.5 * (squares + size)


@dataclass(frozen=True)
class Score:
    """How windows of one length were predicted.

    Attributes:
        length: m.
        windows: number of those that do not overlap.
        density: mean logarithm of the density at the ends, of all windows.
        held: share of the ends within the region of 95 %, of all windows.
    """

    length: float
    windows: int
    density: float
    held: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """How well a model predicts each half of the steps by a fit of the other.

    Attributes:
        dispersion: factor of all variances, >= 1.
        scores: of each length of which there are enough windows.
    """

    dispersion: float
    scores: Tuple[Score, ...]

    @property
    def density(self) -> float:
        """Sum of the mean logarithms of all lengths: the more, the better."""
        return sum(score.density for score in self.scores)


def judged(found: Sequence[Windows]) -> Prediction:
    """Return the dispersion and the scores of windows."""
    lengths = sorted({one.length for one in found})
    groups = [[one for one in found if one.length == length] for length in lengths]
    groups = [group for group in groups if sum(map(len, group)) >= FEWEST]
    dispersion = 1.0
    for group in groups:
        squares = np.concatenate([one.squares()[0] for one in group])
        # With few windows the next one is more often beyond their quantile than 1 - LEVEL.
        level = min(1.0, LEVEL * (1.0 + 1.0 / _number_apart(group)))
        dispersion = max(dispersion, float(np.quantile(squares, level)) / INSIDE)
    return Prediction(dispersion, tuple(_score(group, dispersion) for group in groups))


def _number_apart(group: Sequence[Windows]) -> int:
    return sum(int(one.apart.sum()) for one in group)


def _score(group: Sequence[Windows], dispersion: float) -> Score:
    both = zip(*(one.squares(dispersion) for one in group))
    squares, densities = map(np.concatenate, both)
    held = float(np.mean(squares <= INSIDE))
    return Score(group[0].length, _number_apart(group), float(densities.mean()), held)


def predicted(found: Fit, pairs: StepPairs, follows: ndarray, length: float) -> Windows:
    """Predict windows of other steps by a fit.

    Args:
        found: fit of one odometry.
        pairs: short steps to predict, one odometry.
        follows: whether each begins where the one before it ended, (n,).
        length: of the windows, m of the truth.
    """
    problem, rule = found.problem, found.rule()
    moved = _DIFFERENCE * np.eye(len(problem.names))[~problem.logarithmic]
    values = found.estimates + np.vstack((np.zeros(len(problem.names)), moved))
    begins, ends = windows(pairs.true, follows, length)
    reported = path_of(pairs.odometry[0])
    paths = [path_of(steps) for steps in problem.errors(values, 1).steps(pairs.true)]
    expected, *others = (se2.between(path[begins], path[ends]) for path in paths)
    changes = [se2.between(expected, other) for other in others]
    slopes = _slopes(changes, expected)
    noise = [
        exact_moments(noisy_steps(paths[0][begin : end + 1], rule)).about_perfect()[-1]
        for begin, end in zip(begins, ends)
    ]
    noise = _turned(np.array(noise).reshape(-1, 3, 3), -paths[0][begins, 2])
    noise += np.diag(pairs.floor + 1e-12)
    spread = OWN * (slopes * parameter_variances(found)) @ slopes.swapaxes(1, 2)
    error = se2.wrapped(se2.between(reported[begins], reported[ends]) - expected)
    return Windows(length, error, noise + spread, _apart(begins, ends))


def parameter_variances(found: Fit) -> ndarray:
    """Return the variances of the systematic errors by the information of a fit, (s,)."""
    problem = found.problem
    inverse, scale = covariance(found.information)
    units = problem.values(np.ones((1, len(problem.names))))[0]
    variances = np.diagonal(inverse[0]) * np.square(units / scale[0])
    return variances[~problem.logarithmic]


def windows(true: ndarray, follows: ndarray, length: float):
    """Return indices of the poses at begin and end of windows, which go over no gap, (w,), (w,).

    `true` are steps (dx m, dy m, dyaw rad), (n, 3), and `follows` says whether each begins where
    the one before it ended, (n,); the length is in m.
    """
    way = np.concatenate(([0.0], np.cumsum(np.hypot(true[:, 0], true[:, 1]))))
    stretch = np.cumsum(~np.asarray(follows))
    begins = np.searchsorted(way, np.arange(0.0, way[-1] - length, length / _OVERLAP))
    ends = np.searchsorted(way, way[begins] + length)
    whole = ends < len(way)
    begins, ends = begins[whole], ends[whole]
    # Step k ends at pose k + 1.
    whole = stretch[ends - 1] == stretch[begins]
    return begins[whole], ends[whole]


def _apart(begins: ndarray, ends: ndarray) -> ndarray:
    last, apart = -1, np.zeros(len(begins), dtype=bool)
    for index, (begin, end) in enumerate(zip(begins, ends)):
        if begin >= last:
            apart[index], last = True, end
    return apart


def _slopes(moved: Sequence[ndarray], expected: ndarray) -> ndarray:
    """Return slopes (w, 3, s) from the changes of ends as seen from the expected ones."""
    if not moved:
        return np.zeros((*expected.shape, 0))
    return _rotations(expected[:, 2]) @ np.stack(moved, axis=-1) / _DIFFERENCE


def _rotations(angles: ndarray) -> ndarray:
    matrices = np.zeros((len(angles), 3, 3))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(angles)
    matrices[:, 1, 0] = np.sin(angles)
    matrices[:, 0, 1] = -matrices[:, 1, 0]
    matrices[:, 2, 2] = 1.0
    return matrices


def _turned(matrices: ndarray, angles: ndarray) -> ndarray:
    rotations = _rotations(angles)
    return rotations @ matrices @ rotations.swapaxes(1, 2)
