"""What thousands of noisy versions of one path come down to, beside what theory says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List

import numpy as np

from bullet_lab.core.ellipse import SQUARE_RADIUS
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.exact_moments import (
    Moments,
    exact_moments,
    first_order_moments,
    published_covariances,
)
from bullet_lab.noise.noisy_paths import NoisyBlock, NoisySteps, noisy_blocks, noisy_steps
from bullet_lab.noise.odometry_noise import NoiseRule, make_rule
from bullet_lab.studies.noise_study.path_metrics import PathMetrics

NEES_BOUND = 7.814727903251179
"""The quantile at `LEVEL` of chi-square with 3 degrees of freedom."""

QUANTILE_PATHS = 100_000
"""Medians and 95 % quantiles are of the first so many paths; everything else is of all."""

GAUSSIAN_SHIFT, GAUSSIAN_AREA = 0.1, 0.05
"""Standard deviations, and a share of the area; see `Theory.gaussian_enough`."""

_SINGULAR = 1e-12


def level_rule(model: str, std: float) -> NoiseRule:
    """Return the rule of a model at a level of noise.

    The probabilistic model, which has no std, gets alpha1 = alpha3 = std² and alpha2 = alpha4 =
    std² / 10: at 0.1 these are the defaults of noisy_odom.

    Raises:
        NoiseError: an unknown model, or a level that is not finite and >= 0.
    """
    if model != "probabilistic":
        return make_rule(model, std)
    rule = make_rule("report", std)
    square = rule.std * rule.std
    return make_rule(model, 0.0, (square, 0.1 * square, square, 0.1 * square))


@dataclass(frozen=True, eq=False)
class Theory:
    """What is known of the pose errors without drawing a path.

    Attributes:
        exact: the exact moments at each pose.
        first_order: those to first order.
    """

    exact: Moments
    first_order: Moments

    def shift(self) -> float:
        """Return how far first order misses the mean at the end, in its standard deviations.

        This is the Mahalanobis length, in the position, of the exact bias; 0 without noise.
        """
        return math.sqrt(_square_length(self.exact.mean[-1, :2], _position(self.first_order)))

    def area_ratio(self) -> float:
        """Return the area of the first-order ellipse at the end over that of the exact one."""
        first, exact = (np.linalg.det(_position(m)) for m in (self.first_order, self.exact))
        return math.sqrt(max(first, 0.0) / exact) if exact > 0.0 else 1.0

    def gaussian_enough(self) -> bool:
        """Return whether first order is good enough for its 95 % ellipse to cover 95 ± 1 %.

        The sign that it is not is the bias: a bent path ends short of the straight one, and the
        cloud of ends is a banana; where all sense of direction is lost, so is that of the area.
        See `GAUSSIAN_SHIFT` and `GAUSSIAN_AREA`.
        """
        area_is_right = abs(self.area_ratio() - 1.0) <= GAUSSIAN_AREA
        return self.shift() <= GAUSSIAN_SHIFT and area_is_right


def theory(steps: NoisySteps) -> Theory:
    """Return the exact and the first-order moments of the noisy versions of a path."""
    return Theory(exact_moments(steps), first_order_moments(steps))


@dataclass(frozen=True, eq=False)
class Sample:
    """What was measured of many noisy versions of a path.

    Attributes:
        paths: how many.
        mean: of the errors of the last pose: x (m), y (m), heading (rad, not wrapped), (3,).
        covariance: of the same, (3, 3).
        metrics: for each metric its mean, 50 % and 95 % quantile.
        coverage: share of the paths whose last position lies in the 95 % ellipse, by the ellipse:
            "first_order" and "exact", each around its mean, and "published", the one that
            noisy_odom sends along, around what it sends. None for an ellipse without area.
        nees: mean of the normalised estimation error squared of the last pose under the
            published covariance, 3 if that is right; None where it is singular.
        nees_within: share of the paths with a NEES below its 95 % bound.
        rms_distance: m, root mean square distance from the perfect path at each pose, (n+1,).
        kept: x + iy (m), the first paths themselves, seen from their start, (k, n+1).
        kept_heading: rad, their heading errors, (k, n+1).
    """

    paths: int
    mean: np.ndarray
    covariance: np.ndarray
    metrics: Dict[str, Dict[str, float]]
    coverage: Dict[str, float]
    nees: float
    nees_within: float
    rms_distance: np.ndarray
    kept: np.ndarray
    kept_heading: np.ndarray


@dataclass(frozen=True, eq=False)
class Case:
    """One level of noise, model and message rate on one path.

    Attributes:
        trajectory: the perfect path at this rate.
        model: name of the rule.
        rate: Hz.
        std: the level.
        theory: what is known.
        sample: what was measured.
        perfect_closure: m, closure error of the perfect path in each lap.
    """

    trajectory: Trajectory
    model: str
    rate: float
    std: float
    theory: Theory
    sample: Sample
    perfect_closure: List[float]


def study_case(
    trajectory: Trajectory,
    case: tuple[str, float, float],
    generator: np.random.Generator,
    paths: int,
    delta: float,
    keep: int = 0,
) -> Case:
    """Draw many noisy versions of a path and measure them.

    Args:
        trajectory: the perfect path, at the rate of the case.
        case: model, level and rate.
        generator: of the normal draws.
        paths: how many, >= 2.
        delta: m, of the relative pose error.
        keep: how many of the paths to keep.

    Raises:
        LabError: a level, path or delta that makes no sense.
    """
    model, std, rate = case
    steps = noisy_steps(trajectory.poses, level_rule(model, std))
    known = theory(steps)
    metrics = PathMetrics(trajectory, steps, delta)
    sampler = _Sampler(steps, known, metrics, paths, keep)
    for block in noisy_blocks(steps, generator, paths):
        sampler.add(block)
    return Case(trajectory, model, rate, std, known, sampler.sample(), metrics.perfect_closure())


class _Sampler:
    """Sums up blocks of noisy paths, in memory that does not grow with their number."""

    def __init__(
        self, steps: NoisySteps, known: Theory, metrics: PathMetrics, paths: int, keep: int
    ):
        self._steps = steps
        self._metrics = metrics
        self._exact_mean = known.exact.mean[-1]
        self._inverses = {
            name: _inverse(_position(moments))
            for name, moments in (("first_order", known.first_order), ("exact", known.exact))
        }
        self._centres = {"first_order": np.zeros(2), "exact": self._exact_mean[:2]}
        self._paths = 0
        self._sum = np.zeros(3)
        self._squares = np.zeros((3, 3))
        self._metric_sums = np.zeros(len(metrics.names))
        self._metric_values = np.empty((min(paths, QUANTILE_PATHS), len(metrics.names)))
        self._inside = {"first_order": 0, "exact": 0, "published": 0}
        self._nees_sum, self._nees_inside = 0.0, 0
        self._published_is_regular = _inverse(known.first_order.covariance[-1]) is not None
        self._distance_squares = np.zeros(len(steps) + 1)
        self._kept = np.empty((min(keep, paths), len(steps) + 1), dtype=complex)
        self._kept_heading = np.empty(self._kept.shape)

    def add(self, block: NoisyBlock) -> None:
        b = len(block)
        self._paths += b
        error = block.position - self._steps.position
        self._distance_squares += np.einsum("ij,ij->j", error.real, error.real)
        self._distance_squares += np.einsum("ij,ij->j", error.imag, error.imag)
        last = np.column_stack([error[:, -1].real, error[:, -1].imag, block.heading_error[:, -1]])
        # About the exact mean, so that little is lost to rounding.
        centred = last - self._exact_mean
        self._sum += centred.sum(axis=0)
        self._squares += centred.T @ centred
        self._add_metrics(block)
        self._add_coverage(last[:, :2])
        self._add_published(block, last)
        kept = max(0, min(len(self._kept) - block.first, b))
        self._kept[block.first : block.first + kept] = block.position[:kept]
        self._kept_heading[block.first : block.first + kept] = block.heading_error[:kept]

    def _add_metrics(self, block: NoisyBlock) -> None:
        values = self._metrics.values(block)
        self._metric_sums += values.sum(axis=0)
        room = max(0, min(len(self._metric_values) - block.first, len(block)))
        self._metric_values[block.first : block.first + room] = values[:room]

    def _add_coverage(self, position: np.ndarray) -> None:
        for name, inverse in self._inverses.items():
            if inverse is not None:
                off = position - self._centres[name]
                lengths = np.einsum("ni,ij,nj->n", off, inverse, off)
                self._inside[name] += int(np.count_nonzero(lengths <= SQUARE_RADIUS))

    def _add_published(self, block: NoisyBlock, error: np.ndarray) -> None:
        if not self._published_is_regular:
            return
        covariance = published_covariances(self._steps, block)
        position = error[:, :2]
        lengths = _square_lengths(position, covariance[:, :2, :2])
        self._inside["published"] += int(np.count_nonzero(lengths <= SQUARE_RADIUS))
        nees = _square_lengths(error, covariance)
        self._nees_sum += float(nees.sum())
        self._nees_inside += int(np.count_nonzero(nees <= NEES_BOUND))

    def sample(self) -> Sample:
        n = self._paths
        shift = self._sum / n
        known = {
            "first_order": self._inverses["first_order"] is not None,
            "exact": self._inverses["exact"] is not None,
            "published": self._published_is_regular,
        }
        return Sample(
            paths=n,
            mean=self._exact_mean + shift,
            covariance=(self._squares - n * np.outer(shift, shift)) / (n - 1),
            metrics=self._metric_summaries(),
            coverage={k: self._inside[k] / n if regular else None for k, regular in known.items()},
            nees=self._nees_sum / n if self._published_is_regular else None,
            nees_within=self._nees_inside / n if self._published_is_regular else None,
            rms_distance=np.sqrt(self._distance_squares / n),
            kept=self._kept,
            kept_heading=self._kept_heading,
        )

    def _metric_summaries(self) -> Dict[str, Dict[str, float]]:
        means = self._metric_sums / self._paths
        median, high = np.quantile(self._metric_values, [0.5, 0.95], axis=0)
        return {
            name: {"mean": float(means[i]), "p50": float(median[i]), "p95": float(high[i])}
            for i, name in enumerate(self._metrics.names)
        }


def _position(moments: Moments) -> np.ndarray:
    return moments.covariance[-1, :2, :2]


def _inverse(covariance: np.ndarray):
    """Return the inverse of a covariance, None where that is lost in rounding."""
    scale = np.sqrt(np.abs(np.diag(covariance)))
    if (scale == 0.0).any():
        return None
    correlation = covariance / np.outer(scale, scale)
    if np.linalg.eigvalsh(correlation)[0] < _SINGULAR:
        return None
    return np.linalg.inv(correlation) / np.outer(scale, scale)


def _square_length(vector: np.ndarray, covariance: np.ndarray) -> float:
    inverse = _inverse(covariance)
    return 0.0 if inverse is None else float(vector @ inverse @ vector)


def _square_lengths(vectors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Return v' C^-1 v for each of the vectors (b, d) and its covariance (b, d, d)."""
    solved = np.linalg.solve(covariances, vectors[..., None])[..., 0]
    return np.einsum("ni,ni->n", vectors, solved)
