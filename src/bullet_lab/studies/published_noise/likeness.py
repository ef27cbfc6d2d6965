"""How well simulated runs explain measured lengths: likelihood, percentiles and p-value.

Two lengths count as alike when they differ by about the resolution of the measurement, or by
about a quarter of their size: a length d is known to sqrt(RESOLUTION² + (TOLERANCE · d)²). On
the scale asinh(d · TOLERANCE / RESOLUTION), straight for small lengths and logarithmic for large
ones, that is the same TOLERANCE everywhere. The likelihood of a measurement is that of a
Gaussian of that width around each simulated run, averaged over the runs; the Gaussian is folded
at 0, since what is read from a picture is the size of a deviation, never less than 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bullet_lab.errors import LabError

RESOLUTION = 0.003
"""m; what can be read from figure 1 of the report."""

TOLERANCE = 0.25
"""As a share; wide enough to have some of a thousand runs within it."""

SIGNIFICANCE = 0.05
"""Runs for which a measurement has a smaller p-value than this do not explain it."""

_MOST_REPLICAS = 500  # for the p-value, which takes the product of runs and replicas
_BLOCK = 100


class LikenessError(LabError):
    """The lengths cannot be compared."""


@dataclass(frozen=True, eq=False)
class Likeness:
    """How well the runs explain the measurement.

    Attributes:
        log_likelihood: natural logarithm of the likelihood, on the scale of this module; of use
            only beside that of other runs.
        log_likelihood_error: its standard error, from the number of runs.
        percentiles: share of the runs below each measured length, the measurement's error
            included, 0 to 1, shape (k,).
        p_value: share of runs, measured as badly, that would be as unlikely as the measurement
            or more, of 500 at most. Small: the runs do not explain it. Never less than 1 / 501.
        nearest: which of the runs is most like the measurement.
    """

    log_likelihood: float
    log_likelihood_error: float
    percentiles: np.ndarray
    p_value: float
    nearest: int


def log_likelihood(
    measured, runs, resolution: float = RESOLUTION, tolerance: float = TOLERANCE
) -> float:
    """Return the natural logarithm of the likelihood of a measurement, for some runs.

    Args:
        measured: k lengths (m), shape (k,).
        runs: the same of m simulated runs, shape (m, k).
        resolution: m; in place of `RESOLUTION`.
        tolerance: as a share; in place of `TOLERANCE`.

    Raises:
        LikenessError: the shapes do not go together or a length is not finite and >= 0.
    """
    measured, runs = _checked(measured, runs)
    point, cloud = (_scale(lengths, resolution, tolerance) for lengths in (measured, runs))
    return float(_log_mean(_exponents(point[np.newaxis], cloud, tolerance))[0])


def compare(measured, runs, seed: int) -> Likeness:
    """Say how well runs explain a measurement.

    Args:
        measured: k lengths (m), shape (k,).
        runs: the same of m simulated runs, shape (m, k), m at least 2.
        seed: of the errors that the runs get for the p-value.

    Raises:
        LikenessError: the shapes do not go together or a length is not finite and >= 0.
    """
    measured, runs = _checked(measured, runs)
    point, cloud = _scale(measured), _scale(runs)
    exponents = _exponents(point[np.newaxis], cloud)[0]
    logarithm = float(_log_mean(exponents))
    weights = np.exp(exponents - exponents.max())
    return Likeness(
        log_likelihood=logarithm,
        log_likelihood_error=float(np.std(weights) / np.mean(weights) / math.sqrt(len(runs))),
        percentiles=_share_below(point, cloud),
        p_value=_p_value(logarithm, cloud, seed),
        nearest=int(np.argmax(exponents)),
    )


def _checked(measured, runs) -> tuple[np.ndarray, np.ndarray]:
    measured, runs = np.asarray(measured, dtype=float), np.asarray(runs, dtype=float)
    if runs.ndim != 2 or measured.shape != runs.shape[1:] or len(runs) < 2:
        raise LikenessError(f"lengths of shape {measured.shape} and {runs.shape}")
    for lengths in (measured, runs):
        if not (np.isfinite(lengths).all() and (lengths >= 0.0).all()):
            raise LikenessError("a length is not finite and >= 0")
    return measured, runs


def _scale(
    lengths: np.ndarray, resolution: float = RESOLUTION, tolerance: float = TOLERANCE
) -> np.ndarray:
    return np.arcsinh(lengths * (tolerance / resolution))


def _exponents(points: np.ndarray, cloud: np.ndarray, tolerance: float = TOLERANCE) -> np.ndarray:
    """Return the logarithm of the folded Gaussian of each of the cloud at each point."""
    norm = cloud.shape[1] * math.log(tolerance * math.sqrt(2.0 * math.pi))
    exponents = np.full((len(points), len(cloud)), -norm)
    folds = np.ones_like(exponents)
    for point, centre in zip(points.T, cloud.T):
        exponents -= (point[:, np.newaxis] - centre) ** 2 / (2.0 * tolerance**2)
        folds *= 1.0 + np.exp(np.outer(point, centre) * (-2.0 / tolerance**2))
    return exponents + np.log(folds)


def _log_mean(exponents: np.ndarray) -> np.ndarray:
    """Return the logarithm of the mean of exp(exponents) over the last axis."""
    largest = exponents.max(axis=-1)
    return largest + np.log(np.exp(exponents - largest[..., np.newaxis]).mean(axis=-1))


def _p_value(log_likelihood: float, cloud: np.ndarray, seed: int) -> float:
    """Measure each run as the figure was measured, and judge it by the other runs."""
    count = min(len(cloud), _MOST_REPLICAS)
    errors = np.random.default_rng(seed).standard_normal((count, cloud.shape[1]))
    replicas = np.abs(cloud[:count] + TOLERANCE * errors)
    as_unlikely = 0
    for start in range(0, count, _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, count))
        exponents = _exponents(replicas[rows], cloud)
        exponents[np.arange(len(rows)), rows] = -np.inf
        others = _log_mean(exponents) + math.log(len(cloud) / (len(cloud) - 1))
        as_unlikely += int(np.count_nonzero(others <= log_likelihood))
    return (as_unlikely + 1) / (count + 1)


_erf = np.vectorize(math.erf, otypes=[float])


def _share_below(point: np.ndarray, cloud: np.ndarray) -> np.ndarray:
    """Return the share of the folded Gaussians below a point, shape (k,)."""
    width = TOLERANCE * math.sqrt(2.0)
    return 0.5 * (_erf((point - cloud) / width) + _erf((point + cloud) / width)).mean(axis=0)
