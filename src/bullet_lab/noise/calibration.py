"""Maximum likelihood estimates and intervals of noise parameters and systematic errors.

The maximum of the likelihood of `Problem` is found by Fisher's scoring with Levenberg's damping.
An interval holds the values of a parameter for which the others can be chosen so that twice the
logarithm of the likelihood is at most 3.84 below its maximum (docs/jobs/calibrate.md). Its ends
are found by false position on the root of the fall, which is nearly straight.

All functions work on many odometries at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Iterator, List, Sequence, Tuple

import numpy as np
from numpy import ndarray
from scipy.stats import chi2

from bullet_lab.noise.likelihood import Problem
from bullet_lab.noise.odometry_noise import NoiseRule, rule_of

# Root of twice the fall of the logarithm of the likelihood at the ends of an interval.
_ROOT = math.sqrt(chi2.ppf(0.95, 1))
_MAX_STEPS = 100
# Of a search that mostly finds the maximum that is already known.
_MIRRORED_STEPS = 25
# Of a search that begins beside the maximum.
_PROFILE_STEPS = 20
# Gain by a step at which the search ends; the next step would gain a hundredth of it.
_ENOUGH = 2e-3
# Distance to the end of an interval, in standard deviations, at which the search ends.
_CLOSE = 3e-3


@dataclass(frozen=True, eq=False)
class Fit:
    """A maximum of the likelihood for each of b odometries, by k coordinates.

    Attributes:
        problem: that was fitted.
        coordinates: shape (b, k).
        log_likelihood: natural logarithm, shape (b,).
        information: Fisher's, in the coordinates, shape (b, k, k).
    """

    problem: Problem
    coordinates: ndarray
    log_likelihood: ndarray
    information: ndarray

    @property
    def estimates(self) -> ndarray:
        """The parameters, those of the noise model first, shape (b, k)."""
        is_zero = self.problem.logarithmic & (self.coordinates <= self.problem.low)
        return np.where(is_zero, 0.0, self.problem.values(self.coordinates))

    def values(self) -> Dict[str, float]:
        """Return the estimates of the first odometry by name."""
        return dict(zip(self.problem.names, self.estimates[0].tolist()))

    def rule(self) -> NoiseRule:
        """Return the noise rule of the first odometry."""
        return rule_of(self.problem.model, self.values())

    def some(self, rows: ndarray) -> Fit:
        """Return the maxima of some of the odometries."""
        arrays = (self.coordinates, self.log_likelihood, self.information)
        return Fit(self.problem.some(rows), *(array[rows] for array in arrays))


def fit(problem: Problem) -> Fit:
    """Return the fit with the largest likelihood."""
    best = _maximise(problem, problem.start)
    if not problem.known:
        for _, other in _mirrored(best):
            better = other.log_likelihood > best.log_likelihood
            for name in ("coordinates", "log_likelihood", "information"):
                getattr(best, name)[better] = getattr(other, name)[better]
    return best


def on_limit(found: Fit) -> List[str]:
    """Return the parameters of one odometry whose estimate is the largest or least possible one."""
    problem, coordinates = found.problem, found.coordinates[0]
    reached = np.abs(coordinates) >= np.abs(problem.high) - 1e-9
    beyond = reached & (~problem.logarithmic | (coordinates > 0.0))
    return [name for name, is_there in zip(problem.names, beyond) if is_there]


def intervals(found: Fit) -> ndarray:
    """Return the 95 % intervals of a fit, shape (b, k, 2): lower and upper ends.

    An end is 0 or infinite if the likelihood does not limit the interval there. If the steps do not
    depend on a parameter, its interval goes from 0, or minus infinity, to infinity. If the
    likelihood has a second maximum that cannot be excluded, with an error of the other sign, the
    interval goes from the lowest to the highest value of both.
    """
    result = _ends(found, found.log_likelihood)
    for j, other in _mirrored(found):
        elsewhere = other.coordinates[:, j] * found.coordinates[:, j] < 0.0
        possible = _beyond_end(found.log_likelihood, other.log_likelihood) < 0.0
        rows = np.flatnonzero(elsewhere & possible)
        more = _ends(other.some(rows), found.log_likelihood[rows])
        result[rows, :, 0] = np.minimum(result[rows, :, 0], more[..., 0])
        result[rows, :, 1] = np.maximum(result[rows, :, 1], more[..., 1])
    return result


def profile(found: Fit, name: str, values: Sequence[float]) -> ndarray:
    """Return by how much twice the logarithm of the likelihood falls if a parameter is held fixed.

    The fit is that of one odometry. The falls are >= 0, one for each of the values, which are in
    order; the interval ends at 3.84.
    """
    problem = found.problem
    j = problem.names.index(name)
    falls = []
    start = found.coordinates
    for value in values:
        held = np.full_like(start, value)
        start = start.copy()
        start[:, j] = np.maximum(problem.coordinates(held)[:, j], problem.low[j])
        reached = _maximise(problem, start, held=j)
        start = reached.coordinates
        falls.append(2.0 * (found.log_likelihood[0] - reached.log_likelihood[0]))
    return np.maximum(falls, 0.0)


def _maximise(problem: Problem, start: ndarray, held: int = -1, most: int = _MAX_STEPS) -> Fit:
    """Find the maximum of each odometry; coordinate `held`, if >= 0, is fixed."""
    x = np.clip(start, problem.low, problem.high)
    count, k = x.shape
    best = problem.logarithm(x)
    information = np.zeros((count, k, k))
    damping = np.full(count, 1e-4)
    running = np.arange(count)
    for _ in range(most):
        if not running.size:
            break
        here, part = x[running], problem.some(running)
        gradient, information[running] = part.slopes(here)
        step, gain = _step(problem, here, gradient, information[running], damping[running], held)
        there = np.clip(here + step, problem.low, problem.high)
        reached = part.logarithm(there)
        better = reached > best[running]
        moved = running[better]
        x[moved], best[moved] = there[better], reached[better]
        damping[running] *= np.where(better, 0.1, 10.0)
        running = running[(gain > _ENOUGH) & (damping[running] < 1e6)]
    return Fit(problem, x, best, information)


def _mirrored(best: Fit) -> Iterator[Tuple[int, Fit]]:
    """Yield the index of each systematic error, and the maxima found from its other sign.

    If the noise is in proportion to a part that only an error causes, the noise vanishes as the
    error goes through 0, and there is a maximum on either side.
    """
    for j in np.flatnonzero(~best.problem.logarithmic):
        start = best.coordinates.copy()
        start[:, j] *= -1.0
        yield int(j), _maximise(best.problem, start, most=_MIRRORED_STEPS)


def _ends(optimum: Fit, best: ndarray) -> ndarray:
    """Return the ends of the intervals around a maximum, (b, k, 2).

    `best` is the logarithm of the largest likelihood, (b,).
    """
    every = range(optimum.coordinates.shape[1])
    found = [[_end(optimum, best, j, side) for side in (-1.0, 1.0)] for j in every]
    return np.moveaxis(np.array(found), -1, 0)


def _end(optimum: Fit, best: ndarray, j: int, side: float) -> ndarray:
    """Return the lower (side -1) or upper (1) end of the interval of parameter j."""
    problem = optimum.problem
    limit = (problem.low if side < 0.0 else problem.high)[j]
    tangent, reach = _ahead(optimum, j)
    warm = optimum.coordinates.copy()
    # The farthest point within the end and the nearest one beyond it, with how far they are
    # beyond the end: a negative distance for the inner one.
    inner, outer = warm[:, j].copy(), np.full(len(best), side * np.inf)
    below, above = _beyond_end(best, optimum.log_likelihood), np.full(len(best), np.nan)
    running = np.arange(len(best))
    for _ in range(_MAX_STEPS):
        running = running[side * (limit - inner[running]) > 0.0]
        if not running.size:
            break
        tried = np.where(
            np.isfinite(outer[running]),
            _between(inner[running], below[running], outer[running], above[running]),
            inner[running] + side * reach[running],
        )
        tried = np.minimum(side * tried, side * limit) * side
        start = warm[running]
        start += tangent[running] * (tried - start[:, j])[:, np.newaxis]
        start[:, j] = tried
        reached = _maximise(problem.some(running), start, j, _PROFILE_STEPS)
        warm[running] = reached.coordinates
        beyond = _beyond_end(best[running], reached.log_likelihood)
        out = beyond >= 0.0
        outer[running[out]], above[running[out]] = tried[out], beyond[out]
        inner[running[~out]], below[running[~out]] = tried[~out], beyond[~out]
        reach[running] *= 2.0
        close = (np.abs(beyond) < _CLOSE) | (np.abs(outer[running] - inner[running]) < 1e-6)
        running = running[~close]
    at_limit = side * (limit - inner) <= 0.0
    x = optimum.coordinates.copy()
    x[:, j] = np.where(np.abs(above) < np.abs(below), outer, inner)
    nothing = 0.0 if side < 0.0 and problem.logarithmic[j] else side * np.inf
    return np.where(at_limit, nothing, problem.values(x)[:, j])


def _ahead(optimum: Fit, j: int) -> Tuple[ndarray, ndarray]:
    """Return the way to the ends of the interval of parameter j, by the information.

    It is by how much all coordinates change with that of the parameter, (b, k), and about the half
    width of the interval, (b,).
    """
    problem = optimum.problem
    inverse, scale = covariance(optimum.information)
    variance = inverse[:, j, j]
    along = inverse[:, :, j] / variance[:, np.newaxis]
    slopes = along * scale[:, j, np.newaxis] / scale
    error = np.sqrt(np.maximum(variance, 1.0)) / scale[:, j]
    half = 1.02 * _ROOT * np.minimum(error, 0.5 * problem.longest[j])
    return np.where(optimum.coordinates > problem.low, slopes, 0.0), half


def _step(
    problem: Problem,
    x: ndarray,
    gradient: ndarray,
    information: ndarray,
    damping: ndarray,
    held: int,
) -> Tuple[ndarray, ndarray]:
    """Return the step, and its gain if the likelihood were a parabola."""
    outwards = ((x <= problem.low) & (gradient < 0.0)) | ((x >= problem.high) & (gradient > 0.0))
    free = ~outwards & (np.arange(x.shape[1]) != held)
    gradient = np.where(free, gradient, 0.0)
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    extra = np.where(free, damping[:, np.newaxis] * diagonal + 1e-14, 1.0)
    both = free[:, :, np.newaxis] & free[:, np.newaxis, :]
    matrix = np.where(both, information, 0.0) + extra[:, :, np.newaxis] * np.eye(x.shape[1])
    step = np.linalg.solve(matrix, gradient[..., np.newaxis])[..., 0]
    gain = 0.5 * np.sum(gradient * step, axis=1)
    return np.clip(step, -problem.longest, problem.longest), gain


def covariance(information: ndarray) -> Tuple[ndarray, ndarray]:
    """Return the inverse of information scaled to diagonals of 1, (b, k, k), and scales, (b, k)."""
    scale = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-12))
    relative = information / (scale[:, :, np.newaxis] * scale[:, np.newaxis, :])
    return np.linalg.inv(relative + 1e-9 * np.eye(scale.shape[1])), scale


def _beyond_end(best: ndarray, logarithm: ndarray) -> ndarray:
    """Return how far beyond the end of an interval a likelihood is, in standard deviations."""
    return np.sqrt(np.maximum(2.0 * (best - logarithm), 0.0)) - _ROOT


def _between(inner, below, outer, above) -> ndarray:
    """Return the false position between points on both sides of the root, or the middle.

    The middle is taken where the outer point is too far for the false position to be accurate.
    """
    with np.errstate(invalid="ignore"):
        share = np.clip(-below / (above - below), 0.05, 0.95)
        share = np.where(above > 4.0 * _ROOT, 0.5, share)
        return inner + share * (outer - inner)
