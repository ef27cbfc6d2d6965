"""Moments of pose errors in closed form, and how often regions of confidence hold the pose.

A region is of all three coordinates: all poses whose square Mahalanobis length, the NEES, is below
the quantile of chi-square with 3 degrees of freedom. Headings are those of poses, without full
turns. The bands around shares are Clopper and Pearson's, those around the mean NEES come from its
sample deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
from scipy.special import betaincinv, chdtri, ndtri

from bullet_lab.core.se2 import logarithm, wrap
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.exact_moments import (
    Moments,
    exact_moments,
    exponential_moments,
    first_order_moments,
    quadratic_covariances,
    quadratic_shares,
)
from bullet_lab.noise.noisy_paths import NoisyBlock, NoisySteps
from bullet_lab.noise.odometry_noise import NoiseRule, model_named

FIRST_ORDER_SHARE = 0.05
GAUSSIAN_SHARE = 0.1
"""Largest share of the variance that is quadratic in the noise; see `Theory`."""

_SINGULAR = 1e-12


def level_rule(model: str, std: float) -> NoiseRule:
    """Return the rule of a model at a level of noise; raises NoiseError."""
    return model_named(model).at_level(std)


@dataclass(frozen=True, eq=False)
class Theory:
    """Moments of the pose errors, computed without drawing a path.

    `quadratic_share` decides whether an error is Gaussian enough. It is the largest share of the
    variance in any direction of (x, y, heading) that is quadratic in the noise, in closed form. The
    limits were measured: up to `GAUSSIAN_SHARE` the published 95 % regions, of the position and of
    all three coordinates, hold 95 ± 1 %; up to `FIRST_ORDER_SHARE` those of first order do.

    Attributes:
        exact: the exact moments at each pose.
        first_order: those to first order.
        quadratic: covariance of the part that is quadratic in the noise, at each pose, (n+1, 3, 3).
    """

    exact: Moments
    first_order: Moments
    quadratic: np.ndarray

    def shift(self) -> float:
        """Return the error of the first-order mean at the end, in standard deviations.

        This is the Mahalanobis length, in the position, of the exact bias; 0 without noise.
        """
        bias, inverse = self.exact.mean[-1, :2], inverse_of(position_of(self.first_order))
        return 0.0 if inverse is None else math.sqrt(float(bias @ inverse @ bias))

    def area_ratio(self) -> float:
        """Return the area of the first-order ellipse at the end over that of the exact one."""
        first, exact = (np.linalg.det(position_of(m)) for m in (self.first_order, self.exact))
        return math.sqrt(max(first, 0.0) / exact) if exact > 0.0 else 1.0

    def quadratic_share(self, pose: int = -1) -> float:
        """Return the largest share of the variance at a pose that is quadratic in the noise."""
        return float(quadratic_shares(self.quadratic[pose], self.exact.covariance[pose]))

    def gaussian_enough(self, pose: int = -1) -> bool:
        """Return whether a Gaussian in x, y and heading with the exact moments is good enough."""
        return self.quadratic_share(pose) <= GAUSSIAN_SHARE

    def first_order_enough(self, pose: int = -1) -> bool:
        """Return whether one with the first-order covariance and no bias is good enough."""
        return self.quadratic_share(pose) <= FIRST_ORDER_SHARE


def theory(steps: NoisySteps) -> Theory:
    """Return the moments of the noisy versions of a path."""
    return Theory(exact_moments(steps), first_order_moments(steps), quadratic_covariances(steps))


def position_of(moments: Moments) -> np.ndarray:
    """Return the covariance (m²) of the last position."""
    return moments.covariance[-1, :2, :2]


def inverse_of(covariance: np.ndarray) -> Optional[np.ndarray]:
    """Return the inverse of a covariance, None if it is singular to rounding."""
    scale = np.sqrt(np.abs(np.diag(covariance)))
    if (scale == 0.0).any():
        return None
    correlation = covariance / np.outer(scale, scale)
    if np.linalg.eigvalsh(correlation)[0] < _SINGULAR:
        return None
    return np.linalg.inv(correlation) / np.outer(scale, scale)


METHODS = {
    "first_order": "first order",
    "exact": "exact moments",
    "exponential": "exponential",
    "published": "as noisy_odom sends it",
}
"""Names of the methods for the user. The published region is that of `NoisyPath`, around the pose
that it sends."""

LEVELS = (0.5, 0.95, 0.99)
BOUNDS = chdtri(3, 1.0 - np.array(LEVELS))
"""Quantiles of chi-square with 3 degrees of freedom."""

MEANT = 1
"""Index of the level of verdicts, 95 %."""

TOLERANCE = 0.01
"""Tolerance of the share that a region holds."""

CHECKPOINTS = 8
CLOUD = 1000
"""Number of positions that are kept for figures."""

BAND = 0.95
"""Confidence of the bands."""


def checkpoints(trajectory: Trajectory) -> np.ndarray:
    """Return the indices of `CHECKPOINTS` poses at equal distances along a path, with the last.

    A path of few poses has fewer.
    """
    travelled = trajectory.travelled()
    goals = travelled[-1] * np.arange(1, CHECKPOINTS) / CHECKPOINTS
    return np.unique([*np.maximum(np.searchsorted(travelled, goals), 1), len(travelled) - 1])


def share_band(inside: int, trials: int) -> Tuple[float, float]:
    """Return the 95 % interval of Clopper and Pearson (1934) around a share.

    >>> [round(bound, 3) for bound in share_band(95, 100)]
    [0.887, 0.984]
    """
    tail = 0.5 * (1.0 - BAND)
    low = betaincinv(inside, trials - inside + 1, tail) if inside else 0.0
    high = betaincinv(inside + 1, trials - inside, 1.0 - tail) if inside < trials else 1.0
    return float(low), float(high)


@dataclass(frozen=True)
class Region:
    """Statistics of the regions of one method at one pose.

    Attributes:
        coverage: share of the paths in the region of each of `LEVELS`.
        bands: their 95 % intervals.
        nees: mean, 3 for a correct covariance.
        nees_band: its 95 % interval.
    """

    coverage: Tuple[float, ...]
    bands: Tuple[Tuple[float, float], ...]
    nees: float
    nees_band: Tuple[float, float]

    def wrong(self) -> bool:
        """Return whether the 95 % region does not hold 95 ± 1 %, with confidence `BAND`."""
        low, high = self.bands[MEANT]
        return high < LEVELS[MEANT] - TOLERANCE or low > LEVELS[MEANT] + TOLERANCE


def right_up_to(
    places: Sequence[float], regions: Sequence[Optional[Region]]
) -> Optional[float]:
    """Return the last of some places before the first wrong region; 0 if the first one is wrong.

    Returns None if there is no region.
    """
    limit = None
    for place, region in zip(places, regions):
        if region is not None:
            if region.wrong():
                return limit or 0.0
            limit = float(place)
    return limit


@dataclass(frozen=True, eq=False)
class Regions:
    """The regions of a case.

    Attributes:
        poses: indices of their poses, shape (k,).
        travelled: m, up to these poses, shape (k,).
        gaussian_enough: whether the error at each pose is; see `Theory`.
        found: for each method and pose, None if the region has no volume.
        exponential: moments in exponential coordinates, at each pose.
        cloud: x + iy (m), errors of the first paths' positions at each pose, shape (b, k).
    """

    poses: np.ndarray
    travelled: np.ndarray
    gaussian_enough: List[bool]
    found: Dict[str, List[Optional[Region]]]
    exponential: Moments
    cloud: np.ndarray

    def right_until(self, method: str) -> Optional[float]:
        """Return the distance (m) up to which the 95 % region is right, None without regions."""
        return right_up_to(self.travelled, self.found[method])

    def rows(self) -> Iterator[List]:
        """Yield a row for each method and pose; see `HEADER`."""
        for method, regions in self.found.items():
            for travelled, enough, region in zip(self.travelled, self.gaussian_enough, regions):
                if region is not None:
                    shares = zip(region.coverage, region.bands)
                    figures = [f for share, band in shares for f in (share, *band)]
                    nees = (region.nees, *region.nees_band)
                    yield [method, float(travelled), str(enough).lower(), *figures, *nees]


HEADER = (
    *("method", "travelled_m", "gaussian_enough"),
    *(f"coverage_{100 * level:g}{end}" for level in LEVELS for end in ("", "_low", "_high")),
    *("nees_mean", "nees_low", "nees_high"),
)


class RegionCounter:
    """Counts the noisy paths in the regions, in memory that does not grow with their number.

    Args:
        trajectory: the perfect path.
        steps: of the path.
        known: moments of its noisy versions.
    """

    def __init__(self, trajectory: Trajectory, steps: NoisySteps, known: Theory):
        self._poses = checkpoints(trajectory)
        self._travelled = trajectory.travelled()[self._poses]
        self._enough = [known.gaussian_enough(pose) for pose in self._poses]
        self._perfect = steps.position[self._poses]
        at = self._poses
        self._exponential = exponential = exponential_moments(steps, at)
        nothing = np.zeros((len(at), 3))
        centres = {
            "first_order": (nothing, known.first_order.covariance[at]),
            "exact": (known.exact.mean[at], known.exact.covariance[at]),
            "exponential": (exponential.mean, exponential.covariance),
            "published": (nothing, known.exact.about_perfect()[at]),
        }
        inverses = [[inverse_of(c) for c in covariances] for _, covariances in centres.values()]
        self._known = np.array([[i is not None for i in row] for row in inverses])
        self._inverses = np.array(
            [[np.zeros((3, 3)) if i is None else i for i in row] for row in inverses]
        )
        self._centres = np.array([centre for centre, _ in centres.values()])
        self._in_exponential = np.array([name == "exponential" for name in centres])
        self._names = list(centres)
        self._paths = 0
        self._cloud: List[np.ndarray] = []
        self._inside = np.zeros((*self._known.shape, len(LEVELS)), dtype=int)
        self._sums = np.zeros((2, *self._known.shape))

    def add(self, block: NoisyBlock) -> None:
        """Count the paths of a block."""
        off = block.position[:, self._poses] - self._perfect
        heading = wrap(block.heading_error[:, self._poses])
        if self._paths < CLOUD:
            self._cloud.append(off[: CLOUD - self._paths])
        errors = np.stack([off.real, off.imag, heading], axis=-1)
        errors = np.where(self._in_exponential[:, None, None, None], logarithm(errors), errors)
        errors -= self._centres[:, None]
        nees = np.einsum("mbki,mkij,mbkj->mbk", errors, self._inverses, errors, optimize=_ORDER)
        self._paths += len(block)
        self._inside += np.count_nonzero(nees[..., None] <= BOUNDS, axis=1)
        self._sums += nees.sum(axis=1), np.square(nees).sum(axis=1)

    def regions(self) -> Regions:
        """Return the statistics of all paths."""
        found = {
            name: [self._region(row, k) for k in range(len(self._poses))]
            for row, name in enumerate(self._names)
        }
        cloud = np.concatenate(self._cloud)
        return Regions(self._poses, self._travelled, self._enough, found, self._exponential, cloud)

    def _region(self, row: int, k: int) -> Optional[Region]:
        if not self._known[row, k]:
            return None
        n, inside = self._paths, self._inside[row, k].tolist()
        mean = self._sums[0, row, k] / n
        variance = max(0.0, self._sums[1, row, k] / n - mean * mean)
        half = float(ndtri(0.5 + 0.5 * BAND)) * math.sqrt(variance / n)
        return Region(
            tuple(count / n for count in inside),
            tuple(share_band(count, n) for count in inside),
            float(mean),
            (float(mean - half), float(mean + half)),
        )


# The product of the errors and the inverses comes first.
_ORDER = ["einsum_path", (0, 1), (0, 1)]
