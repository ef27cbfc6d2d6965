"""Moments of pose errors in closed form, and how often regions of confidence hold the pose.

A region is of all three coordinates: all poses whose square Mahalanobis length, the NEES, is below
the quantile of chi-square with 3 degrees of freedom. Headings are those of poses, without full
turns. The bands around shares are Clopper and Pearson's, those around the mean NEES come from its
sample deviation.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Iterator, NamedTuple, Sequence, Tuple

import numpy as np
from numpy import ndarray
from scipy.special import chdtri, ndtri

from bullet_lab.core.se2 import logarithm, straightening, wrap
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
from bullet_lab.noise.odometry_noise import MODELS, NoiseRule
from bullet_lab.studies.study import Record, clopper_pearson

FIRST_ORDER_SHARE = 0.05
GAUSSIAN_SHARE = 0.1
"""Largest share of the variance that is quadratic in the noise; see `Theory`."""

_SINGULAR = 1e-12
# Headings of a mean over headings, and their reach in standard deviations.
_HEADINGS = 41
_REACH = 4.5


def level_rule(model: str, std: float) -> NoiseRule:
    """Return the rule of a model at a level of noise."""
    return MODELS[model].at_level(std)


@dataclass(frozen=True, eq=False)
class Theory:
    """Moments of the pose errors, computed without drawing a path.

    `quadratic_share` decides whether an error is Gaussian enough. It is the largest share of the
    variance in any direction of (x, y, heading) that is quadratic in the noise, in closed form. The
    limits were measured: up to `GAUSSIAN_SHARE` the published 95 % regions, of the position and of
    all three coordinates, hold 95 ± 1 %; up to `FIRST_ORDER_SHARE` those of first order do.

    `quadratic` is the covariance of the part that is quadratic in the noise, (n+1, 3, 3).
    """

    exact: Moments
    first_order: Moments
    quadratic: ndarray

    def shift(self) -> float:
        """Return the error of the first-order mean at the end, in standard deviations.

        This is the Mahalanobis length, in the position, of the exact bias; 0 without noise.
        """
        bias, inverse = self.exact.mean[-1, :2], inverse_of(position_of(self.first_order))
        return math.sqrt(float(bias @ inverse @ bias))

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


def position_of(moments: Moments) -> ndarray:
    """Return the covariance (m²) of the last position."""
    return moments.covariance[-1, :2, :2]


def inverse_of(covariance: ndarray) -> ndarray:
    """Return the inverse of a covariance, zeros if it is singular to rounding."""
    scale = np.sqrt(np.abs(np.diag(covariance)))
    size = np.outer(scale, scale)
    if not scale.all() or np.linalg.eigvalsh(covariance / size)[0] < _SINGULAR:
        return np.zeros_like(size)
    return np.linalg.inv(covariance / size) / size


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

_TAIL = 0.5 * (1.0 - BAND)


def checkpoints(trajectory: Trajectory) -> ndarray:
    """Return the indices of `CHECKPOINTS` poses at equal distances along a path, with the last.

    A path of few poses has fewer.
    """
    travelled = trajectory.travelled()
    goals = travelled[-1] * np.arange(1, CHECKPOINTS) / CHECKPOINTS
    return np.unique([*np.maximum(np.searchsorted(travelled, goals), 1), len(travelled) - 1])


@dataclass(frozen=True)
class Region:
    """Shares of paths in the regions of each of `LEVELS`, and the mean NEES, with 95 % bands."""

    coverage: tuple[float, ...]
    bands: tuple[tuple[float, float], ...]
    nees: float
    nees_band: tuple[float, float]

    def wrong(self) -> bool:
        """Return whether the 95 % region does not hold 95 ± 1 %, with confidence `BAND`."""
        low, high = self.bands[MEANT]
        return high < LEVELS[MEANT] - TOLERANCE or low > LEVELS[MEANT] + TOLERANCE


def right_up_to(
    places: Sequence[float], regions: Sequence[Region | None]
) -> float | None:
    """Return the last place before the first wrong region, 0 if there is none.

    Returns None if there is no region.
    """
    limit = None
    for place, region in zip(places, regions):
        if region is not None:
            if region.wrong():
                return limit or 0.0
            limit = float(place)
    return limit


Gaussian = Tuple[ndarray, ndarray]
"""Its mean (3,) and covariance (3, 3), in m and rad."""


class Cloud(NamedTuple):
    """Errors of some positions at a pose, and their Gaussians by three methods.

    Attributes:
        points: x + iy (m), shape (b,).
        travelled: m, up to the pose.
        exact: by exact moments.
        first_order: by those of first order.
        exponential: in exponential coordinates.
    """

    points: ndarray
    travelled: float
    exact: Gaussian
    first_order: Gaussian
    exponential: Gaussian


class Ellipsoids:
    """Regions around the means of errors, (m, k, d), by m methods at k poses.

    Attributes:
        known: whether a region has a volume, shape (m, k).
    """

    def __init__(self, means, covariances):
        self._means = np.asarray(means)
        self._inverses = np.array([list(map(inverse_of, of_method)) for of_method in covariances])
        self.known = self._inverses.any(axis=(-2, -1))

    def nees(self, errors: ndarray) -> ndarray:
        """Return the square Mahalanobis lengths of b errors, (m, b, k, d) to (m, b, k)."""
        off = errors - self._means[:, None]
        return np.einsum("mbki,mkij,mbkj->mbk", off, self._inverses, off, optimize=_ORDER)


# The product of the errors and the inverses comes first.
_ORDER = ["einsum_path", (0, 1), (0, 1)]


class Regions:
    """The noisy paths in the regions of a case, in memory that does not grow with their number.

    Args:
        trajectory: the perfect path.
        steps: of the path.
        known: moments of its noisy versions.

    Attributes:
        paths: number of paths so far.
        poses: indices of the poses with regions, shape (k,).
        travelled: m, up to these poses, shape (k,).
        gaussian_enough: whether the error at each pose is; see `Theory`.
    """

    def __init__(self, trajectory: Trajectory, steps: NoisySteps, known: Theory):
        self._known = known
        self.poses = at = checkpoints(trajectory)
        self.travelled = trajectory.travelled()[at]
        self.gaussian_enough = [known.gaussian_enough(pose) for pose in at]
        self._perfect = steps.position[at]
        self._exponential = exponential = exponential_moments(steps, at)
        nothing = np.zeros((len(at), 3))
        first_order, exact = known.first_order.covariance[at], known.exact.covariance[at]
        published = known.exact.about_perfect()[at]
        # In the order of `METHODS`.
        self._ellipsoids = Ellipsoids(
            (nothing, known.exact.mean[at], exponential.mean, nothing),
            (first_order, exact, exponential.covariance, published),
        )
        self.paths = 0
        self._cloud: list[ndarray] = []
        shape = self._ellipsoids.known.shape
        self._inside = np.zeros((*shape, len(LEVELS)), dtype=int)
        self._sums = np.zeros((2, *shape))

    def add(self, block: NoisyBlock) -> None:
        """Count the paths of a block."""
        off = block.position[:, self.poses] - self._perfect
        heading = wrap(block.heading_error[:, self.poses])
        if self.paths < CLOUD:
            self._cloud.append(off[: CLOUD - self.paths])
        errors = np.stack([off.real, off.imag, heading], axis=-1)
        nees = self._ellipsoids.nees(np.stack([errors, errors, logarithm(errors), errors]))
        self.paths += len(block)
        self._inside += np.count_nonzero(nees[..., None] <= BOUNDS, axis=1)
        self._sums += nees.sum(axis=1), np.square(nees).sum(axis=1)

    @functools.cached_property
    def found(self) -> dict[str, list[Region | None]]:
        """For each method and pose the region of all paths, None if it has no volume."""
        places = range(len(self.poses))
        return {
            name: [self._region(row, k) for k in places] for row, name in enumerate(METHODS)
        }

    def _region(self, row: int, k: int) -> Region | None:
        if not self._ellipsoids.known[row, k]:
            return None
        n, inside = self.paths, self._inside[row, k].tolist()
        mean, squares = (self._sums[:, row, k] / n).tolist()
        half = float(ndtri(0.5 + 0.5 * BAND)) * math.sqrt(max(0.0, squares - mean * mean) / n)
        return Region(
            tuple(count / n for count in inside),
            tuple(clopper_pearson(count, n, _TAIL) for count in inside),
            mean,
            (mean - half, mean + half),
        )

    def most_bent(self) -> int:
        """Return the number of the pose whose cloud is bent most, by the moments of the case."""
        return int(np.argmax([self._known.quadratic_share(pose) for pose in self.poses]))

    def cloud(self, k: int) -> Cloud:
        """Return the cloud at one of the poses."""
        exact, first_order, exponential = (
            (moments.mean[pose], moments.covariance[pose])
            for moments, pose in (
                (self._known.exact, self.poses[k]),
                (self._known.first_order, self.poses[k]),
                (self._exponential, k),
            )
        )
        points = np.concatenate(self._cloud)[:, k]
        return Cloud(points, float(self.travelled[k]), exact, first_order, exponential)

    def right_until(self, method: str) -> float | None:
        """Return the distance (m) up to which the 95 % region is right, None without regions."""
        return right_up_to(self.travelled, self.found[method])

    def records(self) -> Iterator[Record]:
        """Yield a record for each method and pose whose region has a volume."""
        for method, regions in self.found.items():
            for travelled, enough, region in zip(self.travelled, self.gaussian_enough, regions):
                if region is None:
                    continue
                record = {"method": method, "travelled_m": float(travelled)}
                record["gaussian_enough"] = enough
                for level, share, band in zip(LEVELS, region.coverage, region.bands):
                    name = f"coverage_{100 * level:g}"
                    record.update({name: share, f"{name}_low": band[0], f"{name}_high": band[1]})
                low, high = region.nees_band
                yield {**record, "nees_mean": region.nees, "nees_low": low, "nees_high": high}


def position_density(mean: ndarray, covariance: ndarray, place: ndarray) -> ndarray:
    """Return the density of positions x + iy (m) whose exponential coordinates are Gaussian.

    For each heading the first two coordinates are a linear function of the position; the density is
    the mean of theirs over the headings.
    """
    deviation = math.sqrt(covariance[2, 2])
    result = np.zeros(place.shape)
    slope = covariance[:2, 2] / covariance[2, 2]
    inverse = np.linalg.inv(covariance[:2, :2] - np.outer(slope, covariance[2, :2]))
    for h in np.linspace(-_REACH, _REACH, _HEADINGS) * deviation:
        if abs(h) < math.pi:
            straight = straightening(h)
            off = straight * place - complex(*(mean[:2] + slope * h))
            square = inverse[0, 0] * off.real**2 + inverse[1, 1] * off.imag**2
            square += 2.0 * inverse[0, 1] * off.real * off.imag + (h / deviation) ** 2
            result += np.exp(-0.5 * square) * abs(straight) ** 2
    return result
