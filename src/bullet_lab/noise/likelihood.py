"""Likelihood of the steps of an odometry under a noise model, given the true steps.

For a step of direction psi, signed length d and turn phi, `NoisyPath` reports direction psi + e1,
length d + et and turn phi + e1 + e2, with independent Gaussian e1, et and e2 of the variances a, s²
and b. The truth's position has the variance p and its heading q in a step of the true length D:

    l = D e1 ~ N(0, D² a + p),    et ~ N(0, s² + p),    w = e1 + e2 ~ N(0, a + b + q),
    Cov(l, w) = D a.

w - k l with k = D a / (D² a + p) is independent of l and has the variance b + q + a p / (D² a + p).
A step shorter than `MIN_TRANSLATION` has no direction: D is 0. p and q also cover the rounding of a
file; without them a robot that drives exactly straight, by a rule that gives no noise to turns of
0, would have a likelihood of 0 or infinity. docs/jobs/calibrate.md derives the rest.

Parameters that cannot be negative are represented by their logarithm.
"""

from __future__ import annotations

import copy
import math
from dataclasses import astuple, dataclass, replace
from typing import Optional, Sequence, Tuple, Union

import numpy as np
from numpy import ndarray

from bullet_lab.core.parameters import declarations
from bullet_lab.core.se2 import columns, wrap, wrapped
from bullet_lab.noise.odometry_noise import (
    LARGEST_PARAMETER,
    MIN_TRANSLATION,
    NoiseRule,
    line_of_travel,
    model_named,
)
from bullet_lab.noise.systematic import LARGEST_ERRORS, SYSTEMATIC, SystematicErrors, end_of

RESOLUTION = 1e-9
"""m and rad; standard deviation of the truth's poses by default."""

PARTS = ("rot1", "trans", "rot2")

# The limit of an estimate is the largest multiple that is less than the largest parameter.
_LIMIT_STEP = 1e6 / 2.0**60
_LEVELS = np.geomspace(1e-6, 10.0, 36)
# Of a coordinate that may be negative.
_UNIT = 0.01
_ROBUST_STEPS = 30
_DIFFERENCE = 1e-4
# Change of a residual by _DIFFERENCE; a larger one is an angle that wraps.
_LARGEST_JUMP = 0.01
# This share of the start value is taken for 0.
_ZERO = math.log(1e-10)


@dataclass(frozen=True, eq=False)
class StepPairs:
    """True steps, and the steps of b odometries that share them.

    Attributes:
        true: (dx m, dy m, dyaw rad) in the body frame before each step, shape (n, 3).
        odometry: the same as the odometries report it, shape (b, n, 3).
        truth_std_m: standard deviation of the truth's position, on each axis, > 0.
        truth_std_rad: standard deviation of the truth's heading, > 0.
        within: the shorter true steps that each consists of, filled up with zeros, shape
            (n, m, 3), if they are known.
    """

    true: ndarray
    odometry: ndarray
    truth_std_m: float = RESOLUTION
    truth_std_rad: float = RESOLUTION
    within: Optional[ndarray] = None

    @property
    def floor(self) -> ndarray:
        """Variances of x (m²), y (m²) and yaw (rad²) of a step from the truth's errors, (3,)."""
        stds = np.array((self.truth_std_m, self.truth_std_m, self.truth_std_rad))
        return 2.0 * stds * stds


@dataclass(frozen=True, eq=False)
class PartErrors:
    """The noise that was added to each part of each step.

    Attributes:
        error: of rot1, as m at the end of the true step, of trans (m), and of rot1 and rot2
            together (rad, in [-pi, pi)), shape (b, n, 3).
        lever: m, length of the true steps, 0 for those without a direction, shape (n,).
        parts: rot1, trans and rot2 of the steps without noise, shape (3, n) or (3, b, n).
        floor: as of `StepPairs`: p, p and q.
    """

    error: ndarray
    lever: ndarray
    parts: ndarray
    floor: ndarray

    def residuals(self, rule: NoiseRule) -> Tuple[ndarray, ndarray]:
        """Return the errors, with that of rot2 alone and made independent of rot1, and variances.

        Both are of shape (b, n, 3). Under the rule, whose parameters may be arrays of shape (b, 1),
        the errors are independent and Gaussian.

        >>> from bullet_lab.noise.odometry_noise import ReportRule
        >>> pairs = StepPairs(np.array([[1.0, 0.0, 0.0]]), np.array([[[1.2, 0.0, 0.0]]]))
        >>> error, variance = part_errors(pairs, pairs.true).residuals(ReportRule(0.1))
        >>> error.round(6), variance.round(6)
        (array([[[0. , 0.2, 0. ]]]), array([[[0.  , 0.01, 0.  ]]]))
        """
        p, _, q = self.floor
        variance1, variance_trans, variance2 = rule.variances(*self.parts)
        moved = self.lever * variance1
        variance_sideways = self.lever * moved + p
        errors = self.error.copy()
        errors[..., 2] -= moved / variance_sideways * errors[..., 0]
        variances = np.empty_like(errors)
        variances[..., 0], variances[..., 1] = variance_sideways, variance_trans + p
        variances[..., 2] = variance2 + q + variance1 * (p / variance_sideways)
        return errors, variances


def part_errors(pairs: StepPairs, expected: ndarray) -> PartErrors:
    """Compare the reported steps with those that the odometries would report without the noise.

    These have the shape (n, 3) or (b, n, 3).
    """
    direction, trans = line_of_travel(expected[..., 0], expected[..., 1])
    cos, sin = np.cos(direction), np.sin(direction)
    dx, dy, turn = columns(pairs.odometry)
    ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
    side = np.where(ahead < 0.0, -1.0, 1.0)
    # The true step decides whether there is a direction. Otherwise the likelihood would jump where
    # a systematic error turns a rotation on the spot into a translation of 0.1 mm.
    lever = np.hypot(pairs.true[:, 0], pairs.true[:, 1])
    lever = np.where(lever >= MIN_TRANSLATION, lever, 0.0)
    rot1 = np.where(lever > 0.0, direction, 0.0)
    error = np.empty(pairs.odometry.shape)
    error[..., 0] = lever * np.arctan2(side * aside, np.abs(ahead))
    error[..., 1] = side * np.hypot(ahead, aside) - trans
    error[..., 2] = wrap(turn - expected[..., 2])
    parts = np.stack((rot1, trans, wrap(expected[..., 2] - rot1)))
    return PartErrors(error, lever, parts, pairs.floor)


def walk_shares(within: ndarray) -> ndarray:
    """Return what a random walk's variances do to the ends of long steps of shorter ones.

    The shorter steps are (n, m, 3). The result has covariances by 1 m² per metre of the
    translations, by 1 rad² per metre and by 1 rad² per radian of the headings, in order and frame
    of `LongErrors`, (3, n, 3, 3).
    """
    heading = np.cumsum(within[..., 2], axis=1) - within[..., 2]
    moves = (within[..., 0] + 1j * within[..., 1]) * np.exp(1j * heading)
    way, angle = np.abs(moves), np.abs(within[..., 2])
    places = np.cumsum(moves, axis=1)
    # A turn in the middle of a short step swings the rest of the long one.
    rest = places[:, -1:] - (places - 0.5 * moves)
    levers = np.stack((rest.real, -rest.imag, np.ones(rest.shape)), axis=-1)
    along = moves / np.where(way > 0.0, way, 1.0)
    along = np.stack((along.imag, along.real, np.zeros(along.shape)), axis=-1)
    pairs = ((along, way), (levers, way), (levers, angle))
    return np.stack([np.einsum("nmi,nmj,nm->nij", one, one, size) for one, size in pairs])


@dataclass(frozen=True, eq=False)
class LongErrors:
    """Errors at the ends of steps that consist of shorter ones, for a random walk.

    Attributes:
        error: aside (m), ahead (m) and turned (rad), in the frame of the begin, (b, n, 3).
        shares: of the variances, as of `walk_shares`, (3, n, 3, 3).
        floor: variances of these errors from the truth's own, (3,).
    """

    error: ndarray
    shares: ndarray
    floor: ndarray

    @classmethod
    def of(cls, pairs: StepPairs, expected: ndarray, shares: ndarray) -> LongErrors:
        """Compare odometries with steps without noise, (b, n, 3)."""
        error = wrapped(pairs.odometry - expected)[..., [1, 0, 2]]
        return cls(error, shares, pairs.floor)

    def covariance(self, rule: NoiseRule) -> ndarray:
        """Return the covariances by a random walk with parameters of shape (b, 1), (b, n, 3, 3)."""
        (on_ways, moved), (in_turns, _) = rule.walked(1.0, 0.0), rule.walked(0.0, 1.0)
        rows = zip((moved, on_ways, in_turns), self.shares)
        every = (np.asarray(size)[..., np.newaxis, np.newaxis] * share for size, share in rows)
        return sum(every) + np.diag(self.floor)

    def residuals(self, rule: NoiseRule) -> Tuple[ndarray, ndarray]:
        """Return independent errors and their variances, as `PartErrors` does, (b, n, 3)."""
        root = np.linalg.cholesky(self.covariance(rule))
        size = np.diagonal(root, axis1=-2, axis2=-1)
        whitened = np.linalg.solve(root, self.error[..., np.newaxis])[..., 0]
        return whitened * size, np.broadcast_to(size * size, whitened.shape)


class Problem:
    """The likelihood of steps by some parameters, with its derivatives and a start of the search.

    Args:
        pairs: steps with truth, of b odometries.
        model: the noise model, one of `MODELS`.
        systematic: which of `SYSTEMATIC` are fitted beside its parameters; the others are 0.
        wheel_base: m, as of `SystematicErrors`.
        start: coordinates to begin at, shape (k,), if they are known.

    Raises:
        NoiseError: the model is unknown.

    Attributes:
        names: of the k parameters, those of the model first.
        logarithmic: which coordinates are logarithms, shape (k,).
        known: whether the start is known.
        start: coordinates to begin at, shape (b, k).
        low: limits of the coordinates, shape (k,).
        high: likewise.
        longest: longest step of a search along each coordinate, shape (k,).
    """

    def __init__(
        self,
        pairs: StepPairs,
        model: str,
        systematic: Sequence[str] = (),
        wheel_base: float = SystematicErrors.wheel_base,
        start: Optional[ndarray] = None,
    ):
        self.pairs = pairs
        self.model = model
        self._kind = model_named(model)
        self.systematic = tuple(systematic)
        self.wheel_base = wheel_base
        own = tuple(declarations(self._kind))
        self.names = (*own, *systematic)
        self._own = len(own)
        self.logarithmic = np.arange(len(self.names)) < len(own)
        self.longest = np.where(self.logarithmic, 4.0, 30.0)
        self._shares = None if pairs.within is None else walk_shares(pairs.within)
        largest = [LARGEST_ERRORS.get(name, LARGEST_PARAMETER) for name in self.names]
        self.high = self.coordinates(np.array(largest) // _LIMIT_STEP * _LIMIT_STEP)
        self.known = start is not None
        self.start = self._start() if start is None else np.tile(start, (len(self), 1))
        self.low = np.where(self.logarithmic, self.start.min(axis=0) + _ZERO, -self.high)

    def __len__(self) -> int:
        return len(self.pairs.odometry)

    def some(self, rows: ndarray) -> Problem:
        """Return the problem of some of the odometries, with the same limits."""
        part = copy.copy(self)
        part.pairs = replace(self.pairs, odometry=self.pairs.odometry[rows])
        return part

    def values(self, coordinates: ndarray) -> ndarray:
        """Return the parameters of coordinates, shapes (b, k)."""
        return np.where(self.logarithmic, np.exp(coordinates), _UNIT * coordinates)

    def coordinates(self, values: ndarray) -> ndarray:
        """Return the coordinates of parameters; the logarithm of 0 is that of 1e-300."""
        positive = np.log(np.maximum(values, 1e-300))
        return np.where(self.logarithmic, positive, values / _UNIT)

    def rule(self, values: ndarray) -> NoiseRule:
        """Return the rule of b sets of parameters, (b, k), with arrays of shape (b, 1)."""
        return self._kind(*values.T[: self._own, :, np.newaxis])

    def expected(self, values: ndarray) -> ndarray:
        """Return the steps that odometry without noise would report, shape (b, n, 3)."""
        if not self.systematic:
            return np.broadcast_to(self.pairs.true, (len(values), *self.pairs.true.shape))
        if self.pairs.within is None:
            return self.errors(values, 1).steps(self.pairs.true)
        return end_of(self.errors(values, 2).steps(self.pairs.within))

    def errors(self, values: ndarray, axes: int) -> SystematicErrors:
        """Return the systematic errors of b sets of parameters, in arrays (b, 1 …) of more axes."""
        shape = (len(values), *(1,) * axes)
        columns = dict.fromkeys(SYSTEMATIC, np.zeros(shape))
        names = zip(self.systematic, values.T[self._own :])
        columns.update((name, column.reshape(shape)) for name, column in names)
        return SystematicErrors(**columns, wheel_base=self.wheel_base)

    def step_errors(self, values: ndarray) -> Union[PartErrors, LongErrors]:
        """Return the errors of the steps by parameters (b, k)."""
        expected = self.expected(values)
        if self._shares is None:
            return part_errors(self.pairs, expected)
        return LongErrors.of(self.pairs, expected, self._shares)

    def _evaluate(self, values: ndarray, errors) -> Tuple[ndarray, ndarray]:
        """Return residuals and the logarithms of their variances, (b, 3 n)."""
        found, variances = errors.residuals(self.rule(values))
        shape = (len(values), -1)
        return found.reshape(shape), np.log(variances).reshape(shape)

    def logarithm(self, coordinates: ndarray) -> ndarray:
        """Return the logarithm of the likelihood, (b,)."""
        values = self.values(coordinates)
        return _logarithm(*self._evaluate(values, self.step_errors(values)))

    def slopes(self, coordinates: ndarray) -> Tuple[ndarray, ndarray]:
        """Return gradient, (b, k), and Fisher's information, (b, k, k)."""
        values = self.values(coordinates)
        errors = self.step_errors(values)
        found, logarithms = self._evaluate(values, errors)
        by_found = np.empty((len(self), len(self.names), found.shape[1]))
        by_log = np.empty_like(by_found)
        for j in range(len(self.names)):
            moved = coordinates.copy()
            moved[:, j] += _DIFFERENCE
            values = self.values(moved)
            # The noise that was added does not depend on the rule.
            there = errors if j < self._own else self.step_errors(values)
            change, log_there = self._evaluate(values, there)
            change -= found
            by_found[:, j] = np.where(np.abs(change) < _LARGEST_JUMP, change, 0.0)
            by_log[:, j] = log_there - logarithms
        by_found /= _DIFFERENCE
        by_log /= _DIFFERENCE
        weight = np.exp(-logarithms)
        weighted = by_found * weight[:, np.newaxis]
        excess = 0.5 * (found * found * weight - 1.0)
        gradient = by_log @ excess[..., np.newaxis] - weighted @ found[..., np.newaxis]
        information = weighted @ by_found.swapaxes(1, 2) + 0.5 * (by_log @ by_log.swapaxes(1, 2))
        return gradient[..., 0], information

    def _start(self) -> ndarray:
        """Return the level of noise that fits best, as coordinates, shape (b, k)."""
        values = np.zeros((len(self), len(self.names)))
        if self.systematic:
            values[:, self._own :] = self._robust()
        errors = self.step_errors(values)
        found, best = np.full(len(self), -np.inf), values.copy()
        for level in _LEVELS.tolist():
            own = astuple(self._kind.at_level(level))
            values[:, : self._own] = np.maximum(own, 1e-3 * level**2)
            logarithms = _logarithm(*self._evaluate(values, errors))
            better = logarithms > found
            found[better], best[better] = logarithms[better], values[better]
        return self.coordinates(best)

    def _robust(self) -> ndarray:
        """Return systematic errors that minimise the absolute errors of the parts, (b, s).

        With least squares, the large errors of turns would outweigh the far smaller ones of
        translations: noise in proportion to a part is small where the part is.
        """
        values = np.zeros((len(self), len(self.names)))
        for share in np.geomspace(1.0, 1e-4, _ROBUST_STEPS):
            here = part_errors(self.pairs, self.expected(values)).error
            columns = []
            for j in range(self._own, len(self.names)):
                moved = values.copy()
                moved[:, j] += _UNIT * _DIFFERENCE
                there = part_errors(self.pairs, self.expected(moved)).error
                columns.append((there - here) / (_UNIT * _DIFFERENCE))
            slopes = np.stack(columns, axis=1)
            typical = np.median(np.abs(here), axis=1, keepdims=True) + 1e-12
            weighted = slopes / (here**2 + (share * typical) ** 2)[:, np.newaxis]
            flat = (len(self), len(self.systematic), -1)
            weighted, slopes = weighted.reshape(flat), slopes.reshape(flat)
            matrix = weighted @ slopes.swapaxes(1, 2)
            least = 1e-9 * np.trace(matrix, axis1=1, axis2=2) + 1e-12
            matrix += least[:, np.newaxis, np.newaxis] * np.eye(flat[1])
            pull = weighted @ here.reshape(len(self), -1, 1)
            values[:, self._own :] -= np.linalg.solve(matrix, pull)[..., 0]
            values = self.values(np.clip(self.coordinates(values), -self.high, self.high))
        return values[:, self._own :]


def _logarithm(found: ndarray, logarithms: ndarray) -> ndarray:
    terms = found * found * np.exp(-logarithms) + logarithms
    return -0.5 * (terms.sum(axis=1) + terms.shape[1] * math.log(2.0 * math.pi))
