"""Maxima of a likelihood that many data sets have each for themselves, and ends of intervals.

The maximum is looked for by Fisher's scoring with Levenberg's damping; where the profile of the
likelihood has fallen by so much, by false position on the root of the fall, which is nearly
straight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Protocol, Tuple

import numpy as np
from scipy.stats import chi2

INTERVAL = 0.95
ROOT = math.sqrt(chi2.ppf(INTERVAL, 1))
"""Of twice the fall of the logarithm of the likelihood at the ends of an interval."""

_MOST_STEPS = 100
_MIRRORED_STEPS = 25  # of a search that mostly leads where one has been
_PROFILE_STEPS = 20  # of one that begins beside the maximum
_ENOUGH = 2e-3  # gain by a step; the next one would gain a hundredth of it
_CLOSE = 3e-3  # to the end of an interval, in standard deviations


class Likelihood(Protocol):
    """What is looked at: the likelihood of b data sets by k coordinates.

    Attributes:
        logarithmic: which coordinates are logarithms, shape (k,).
        low: limits of the coordinates, shape (k,).
        high: likewise.
    """

    logarithmic: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def logarithm(self, coordinates: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the logarithm of the likelihood of some of the data sets, (rows,)."""

    def slopes(self, coordinates: np.ndarray, rows: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return its gradient, (rows, k), and Fisher's information, (rows, k, k)."""

    def values(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the parameters that the coordinates stand for, (rows, k)."""


@dataclass(eq=False)
class Optimum:
    """A maximum for each of some data sets.

    Attributes:
        coordinates: shape (b, k).
        log_likelihood: natural logarithm, shape (b,).
        information: Fisher's, in the coordinates, shape (b, k, k).
    """

    coordinates: np.ndarray
    log_likelihood: np.ndarray
    information: np.ndarray

    def some(self, rows: np.ndarray) -> Optimum:
        """Return those of some of the data sets."""
        return Optimum(self.coordinates[rows], self.log_likelihood[rows], self.information[rows])

    def replace(self, rows: np.ndarray, other: Optimum) -> None:
        """Take others for some of the data sets."""
        self.coordinates[rows] = other.coordinates
        self.log_likelihood[rows] = other.log_likelihood
        self.information[rows] = other.information


class Search:
    """Looks for maxima of the likelihood."""

    def __init__(self, problem: Likelihood):
        self._problem, self._low, self._high = problem, problem.low, problem.high
        self._longest = np.where(problem.logarithmic, 4.0, 30.0)

    def maximise(
        self, rows: np.ndarray, start: np.ndarray, held: int = -1, most: int = _MOST_STEPS
    ) -> Optimum:
        """Find the maximum for some of the data sets, one of the coordinates held or none."""
        x = np.clip(start, self._low, self._high)
        count, k = x.shape
        best = self._problem.logarithm(x, rows)
        information = np.zeros((count, k, k))
        damping = np.full(count, 1e-4)
        running = np.arange(count)
        for _ in range(most):
            if not running.size:
                break
            here = x[running]
            gradient, information[running] = self._problem.slopes(here, rows[running])
            step, gain = self._step(here, gradient, information[running], damping[running], held)
            there = np.clip(here + step, self._low, self._high)
            reached = self._problem.logarithm(there, rows[running])
            better = reached > best[running]
            moved = running[better]
            x[moved], best[moved] = there[better], reached[better]
            damping[running] *= np.where(better, 0.1, 10.0)
            running = running[(gain > _ENOUGH) & (damping[running] < 1e6)]
        return Optimum(x, best, information)

    def mirrored(self, best: Optimum) -> Iterator[Tuple[int, Optimum]]:
        """Yield the maxima that are found from a systematic error of the other sign, and its index.

        Where the noise is in proportion to a part that an error alone gives, it vanishes as the
        error goes through 0, and there is a maximum on either side.
        """
        for j in np.flatnonzero(~self._problem.logarithmic):
            start = best.coordinates.copy()
            start[:, j] *= -1.0
            yield int(j), self.maximise(np.arange(len(start)), start, most=_MIRRORED_STEPS)

    def ends(self, rows: np.ndarray, optimum: Optimum, best: np.ndarray) -> np.ndarray:
        """Return where the intervals around a maximum end, (rows, k, 2).

        Args:
            rows: of the data sets.
            optimum: for each of them.
            best: logarithm of the largest likelihood that there is, (rows,).
        """
        every = range(optimum.coordinates.shape[1])
        found = [[self._end(rows, optimum, best, j, s) for s in (-1.0, 1.0)] for j in every]
        return np.moveaxis(np.array(found), -1, 0)

    def _end(
        self, rows: np.ndarray, optimum: Optimum, best: np.ndarray, j: int, side: float
    ) -> np.ndarray:
        """Return where the interval of parameter j ends, on its lower (-1) or upper (1) side."""
        limit = (self._low if side < 0.0 else self._high)[j]
        warm, tangent = optimum.coordinates.copy(), self._tangent(optimum, j)
        inner, below = warm[:, j].copy(), beyond_end(best, optimum.log_likelihood)
        outer, above = np.full(len(rows), side * np.inf), np.full(len(rows), np.nan)
        reach = self._first_reach(optimum, j)
        running = np.arange(len(rows))
        for _ in range(_MOST_STEPS):
            running = running[side * (limit - inner[running]) > 0.0]
            if not running.size:
                break
            tried = _next(
                inner[running], below[running], outer[running], above[running], reach[running], side
            )
            tried = np.minimum(side * tried, side * limit) * side
            start = warm[running]
            start += tangent[running] * (tried - start[:, j])[:, np.newaxis]
            start[:, j] = tried
            reached = self.maximise(rows[running], start, j, _PROFILE_STEPS)
            warm[running] = reached.coordinates
            beyond = beyond_end(best[running], reached.log_likelihood)
            _narrow(running, tried, beyond, inner, below, outer, above)
            reach[running] *= 2.0
            close = (np.abs(beyond) < _CLOSE) | (np.abs(outer[running] - inner[running]) < 1e-6)
            running = running[~close]
        at_limit = side * (limit - inner) <= 0.0
        x = optimum.coordinates.copy()
        x[:, j] = np.where(np.abs(above) < np.abs(below), outer, inner)
        nothing = 0.0 if side < 0.0 and self._problem.logarithmic[j] else side * np.inf
        return np.where(at_limit, nothing, self._problem.values(x)[:, j])

    def _first_reach(self, found: Optimum, j: int) -> np.ndarray:
        """Return about how far the interval of parameter j goes, by the information."""
        inverse, scale = covariance(found.information)
        error = np.sqrt(np.maximum(inverse[:, j, j], 1.0)) / scale[:, j]
        return 1.02 * ROOT * np.minimum(error, 0.5 * self._longest[j])

    def _tangent(self, found: Optimum, j: int) -> np.ndarray:
        """Return how all coordinates go along with that of parameter j, (b, k)."""
        inverse, scale = covariance(found.information)
        along = inverse[:, :, j] / inverse[:, j, j, np.newaxis]
        slopes = along * scale[:, j, np.newaxis] / scale
        return np.where(found.coordinates > self._low, slopes, 0.0)

    def _step(
        self,
        x: np.ndarray,
        gradient: np.ndarray,
        information: np.ndarray,
        damping: np.ndarray,
        held: int,
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Return where to go, and what would be gained if the likelihood were a parabola."""
        outwards = ((x <= self._low) & (gradient < 0.0)) | ((x >= self._high) & (gradient > 0.0))
        free = ~outwards & (np.arange(x.shape[1]) != held)
        gradient = np.where(free, gradient, 0.0)
        diagonal = np.diagonal(information, axis1=1, axis2=2)
        extra = np.where(free, damping[:, np.newaxis] * diagonal + 1e-14, 1.0)
        both = free[:, :, np.newaxis] & free[:, np.newaxis, :]
        matrix = np.where(both, information, 0.0) + extra[:, :, np.newaxis] * np.eye(x.shape[1])
        step = np.linalg.solve(matrix, gradient[..., np.newaxis])[..., 0]
        gain = 0.5 * np.sum(gradient * step, axis=1)
        return np.clip(step, -self._longest, self._longest), gain


def covariance(information: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the inverse of information scaled to diagonals of 1, (b, k, k), and scales, (b, k)."""
    scale = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-12))
    relative = information / (scale[:, :, np.newaxis] * scale[:, np.newaxis, :])
    return np.linalg.inv(relative + 1e-9 * np.eye(scale.shape[1])), scale


def beyond_end(best: np.ndarray, logarithm: np.ndarray) -> np.ndarray:
    """Return how far beyond the end of an interval a likelihood is, in standard deviations."""
    return np.sqrt(np.maximum(2.0 * (best - logarithm), 0.0)) - ROOT


def _next(inner, below, outer, above, reach, side: float) -> np.ndarray:
    """Return where to look for the root: farther out, or between places on both sides of it."""
    with np.errstate(invalid="ignore"):
        # The false position, or the middle where the far one is too far to tell.
        share = np.clip(-below / (above - below), 0.05, 0.95)
        share = np.where(above > 4.0 * ROOT, 0.5, share)
        between = inner + share * (outer - inner)
    return np.where(np.isfinite(outer), between, inner + side * reach)


def _narrow(rows, tried, beyond, inner, below, outer, above) -> None:
    """Replace one of the two places, by what was found between or beyond them."""
    out = beyond >= 0.0
    outer[rows[out]], above[rows[out]] = tried[out], beyond[out]
    inner[rows[~out]], below[rows[~out]] = tried[~out], beyond[~out]
