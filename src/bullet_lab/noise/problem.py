"""The likelihood of odometries as a function of the parameters that are to be calibrated.

The likelihood is that of `likelihood.residuals`, for b odometries at once. Parameters that cannot
be negative are represented by their logarithm.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, Callable, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.parameters import Declaration, declarations
from bullet_lab.noise.likelihood import PartErrors, StepPairs, part_errors
from bullet_lab.noise.odometry_noise import NoiseError, NoiseRule, model_named
from bullet_lab.noise.systematic import SystematicErrors

SYSTEMATIC = ("scale_error", "base_error", "diameter_error", "gyro_bias_per_metre")
"""Those of `SystematicErrors` that a path determines; its wheel_base has to be known."""

_LEVELS = np.geomspace(1e-6, 10.0, 36)
# Of a coordinate that may be negative.
_UNIT = 0.01
_ROBUST_STEPS = 30
_DIFFERENCE = 1e-4
# Change of a residual by _DIFFERENCE; a larger one is an angle that wraps.
_LARGEST_JUMP = 0.01
# This share of the start value is taken for 0.
_ZERO = math.log(1e-10)


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
    """

    def __init__(
        self,
        pairs: StepPairs,
        model: str,
        systematic: Sequence[str] = (),
        wheel_base: float = SystematicErrors.wheel_base,
        start: Optional[np.ndarray] = None,
    ):
        self.pairs = pairs
        self.kind = model_named(model)
        self.systematic = tuple(systematic)
        self.wheel_base = wheel_base
        declared = declarations(self.kind)
        known = {**declarations(SystematicErrors), **declared}
        self.names = (*declared, *systematic)
        self._own = len(declared)
        limits = np.array([_limits(known[name]) for name in self.names])
        self.logarithmic = limits[:, 0] >= 0.0
        self._true = part_errors(pairs)
        low, self.high = (self.coordinates(limit) for limit in limits.T)
        self.known = start is not None
        self.start = self._start() if start is None else np.tile(start, (len(self), 1))
        self.low = np.where(self.logarithmic, self.start.min(axis=0) + _ZERO, low)

    def __len__(self) -> int:
        return len(self.pairs.odometry)

    def values(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the parameters of coordinates, shapes (b, k)."""
        return np.where(self.logarithmic, np.exp(coordinates), _UNIT * coordinates)

    def coordinates(self, values: np.ndarray) -> np.ndarray:
        """Return the coordinates of parameters; the logarithm of 0 is that of 1e-300."""
        positive = np.log(np.maximum(values, 1e-300))
        return np.where(self.logarithmic, positive, values / _UNIT)

    def rule(self, values: np.ndarray) -> NoiseRule:
        """Return the rule of b sets of parameters, (b, k), with arrays (b, 1) and unchecked."""
        return unchecked(self.kind, self.names[: self._own], values)

    def expected(self, values: np.ndarray) -> np.ndarray:
        """Return the steps that odometry without noise would report, shape (b, n, 3)."""
        if not self.systematic:
            return np.broadcast_to(self.pairs.true, (len(values), *self.pairs.true.shape))
        base = np.full((len(values), 1), self.wheel_base)
        errors = unchecked(
            SystematicErrors,
            (*self.systematic, "wheel_base"),
            np.hstack((values[:, self._own :], base)),
        )
        return errors.steps(self.pairs.true)

    def errors(self, values: np.ndarray, rows: np.ndarray) -> PartErrors:
        """Return the errors of the parts for some of the odometries, by parameters (rows, k)."""
        is_all = len(rows) == len(self)
        if not self.systematic:
            return self._true if is_all else self._true.some(rows)
        pairs = self.pairs if is_all else self.pairs.some(rows)
        return part_errors(pairs, self.expected(values))

    def evaluate(self, values: np.ndarray, errors: PartErrors) -> Tuple[np.ndarray, np.ndarray]:
        """Return residuals and the logarithms of their variances, (rows, 3 n)."""
        found, variances = errors.residuals(self.rule(values), *self.pairs.truth_variances)
        shape = (len(values), -1)
        return found.reshape(shape), np.log(variances).reshape(shape)

    def logarithm(self, coordinates: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the logarithm of the likelihood of some of the odometries, (rows,)."""
        values = self.values(coordinates)
        return _logarithm(*self.evaluate(values, self.errors(values, rows)))

    def slopes(self, coordinates: np.ndarray, rows: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return gradient, (rows, k), and Fisher's information, (rows, k, k), of some of them."""
        values = self.values(coordinates)
        errors = self.errors(values, rows)
        found, logarithms = self.evaluate(values, errors)
        by_found = np.empty((len(rows), len(self.names), found.shape[1]))
        by_log = np.empty_like(by_found)
        for j in range(len(self.names)):
            moved = coordinates.copy()
            moved[:, j] += _DIFFERENCE
            values = self.values(moved)
            # The noise that was added does not depend on the rule.
            there = errors if j < self._own else self.errors(values, rows)
            change, log_there = self.evaluate(values, there)
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

    def _start(self) -> np.ndarray:
        """Return the level of noise that fits best, as coordinates, shape (b, k)."""
        values = np.zeros((len(self), len(self.names)))
        errors = self._true
        if self.systematic:
            values[:, self._own :] = self._robust()
            errors = part_errors(self.pairs, self.expected(values))
        found, best = np.full(len(self), -np.inf), values.copy()
        for level in _LEVELS.tolist():
            try:
                rule = self.kind.at_level(level)
            except NoiseError:
                continue
            own = [max(getattr(rule, name), 1e-3 * level**2) for name in self.names[: self._own]]
            values[:, : self._own] = own
            logarithms = _logarithm(*self.evaluate(values, errors))
            better = logarithms > found
            found[better], best[better] = logarithms[better], values[better]
        return self.coordinates(best)

    def _robust(self) -> np.ndarray:
        """Return systematic errors that minimise the absolute errors of the parts, (b, s).

        With least squares, the large errors of turns would outweigh the far smaller ones of
        translations: noise in proportion to a part is small where the part is.
        """
        values = np.zeros((len(self), len(self.names)))
        for share in np.geomspace(1.0, 1e-4, _ROBUST_STEPS):
            here = self._raw(values)
            columns = []
            for j in range(self._own, len(self.names)):
                moved = values.copy()
                moved[:, j] += _UNIT * _DIFFERENCE
                columns.append((self._raw(moved) - here) / (_UNIT * _DIFFERENCE))
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

    def _raw(self, values: np.ndarray) -> np.ndarray:
        errors = part_errors(self.pairs, self.expected(values))
        return np.stack((errors.sideways, errors.along, errors.turned), axis=-1)


def _logarithm(found: np.ndarray, logarithms: np.ndarray) -> np.ndarray:
    terms = found * found * np.exp(-logarithms) + logarithms
    return -0.5 * (terms.sum(axis=1) + terms.shape[1] * math.log(2.0 * math.pi))


def _limits(declaration: Declaration) -> Tuple[float, float]:
    """Return the lowest and the highest allowed value of a parameter."""

    def allowed(value: float) -> bool:
        try:
            declaration.check.accept(value)
        except (ValueError, TypeError, LookupError, OverflowError):
            return False
        return True

    return -_farthest(lambda size: allowed(-size)), _farthest(allowed)


def _farthest(allowed: Callable[[float], bool]) -> float:
    """Return the largest allowed size within 1e6, by bisection; 0 is allowed."""
    low, high = 0.0, 1e6
    if allowed(high):
        return high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(middle) else (low, middle)
    return low


def unchecked(kind: type, names: Sequence[str], values: np.ndarray) -> Any:
    """Return an object with parameters that are arrays of shape (b, 1), from an array (b, k).

    Other fields have their defaults.
    """
    made = object.__new__(kind)
    for entry in fields(kind):
        object.__setattr__(made, entry.name, np.full((len(values), 1), entry.default))
    for name, column in zip(names, values.T):
        object.__setattr__(made, name, column[:, np.newaxis])
    return made
