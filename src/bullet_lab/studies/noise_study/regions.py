"""How often regions of confidence hold the pose that they are meant to hold, along a path.

A region is of all three coordinates: all poses whose square Mahalanobis length, the NEES, is below
the quantile of chi-square with 3 degrees of freedom. The heading is that of a pose, which knows of
no full turns. The bands around shares are Clopper and Pearson's, those around the mean NEES from
its sample deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Iterator, List, Optional, Tuple

import numpy as np
from scipy.special import betaincinv, chdtri, ndtri

from bullet_lab.core.se2 import logarithm, wrap
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.exact_moments import Moments, exponential_moments
from bullet_lab.noise.noisy_paths import NoisyBlock, NoisySteps
from bullet_lab.studies.noise_study.theory import Theory, inverse_of

METHODS = {
    "first_order": "first order",
    "exact": "exact moments",
    "exponential": "exponential",
    "published": "as noisy_odom sends it",
}
"""What they are called. The published one is that of `NoisyPath`, about what it sends."""

LEVELS = (0.5, 0.95, 0.99)
BOUNDS = chdtri(3, 1.0 - np.array(LEVELS))
"""Quantiles of chi-square with 3 degrees of freedom."""

MEANT = 1
"""Index of the level that verdicts are about, 95 %."""

TOLERANCE = 0.01
"""A region is right that holds its share, give or take so much."""

CHECKPOINTS = 8
CLOUD = 1000
"""So many positions are kept for pictures."""

BAND = 0.95
"""Confidence of the bands."""


def checkpoints(trajectory: Trajectory) -> np.ndarray:
    """Return the indices of `CHECKPOINTS` poses at equal distances along a path, the last included.

    They are fewer on a path of few poses.
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
    """What was found of one method at one pose.

    Attributes:
        coverage: share of the paths in the region of each of `LEVELS`.
        bands: their 95 % intervals.
        nees: mean, 3 where all is right.
        nees_band: its 95 % interval.
    """

    coverage: Tuple[float, ...]
    bands: Tuple[Tuple[float, float], ...]
    nees: float
    nees_band: Tuple[float, float]

    def wrong(self) -> bool:
        """Return whether the 95 % region certainly does not hold 95 ± 1 %."""
        low, high = self.bands[MEANT]
        return high < LEVELS[MEANT] - TOLERANCE or low > LEVELS[MEANT] + TOLERANCE


@dataclass(frozen=True, eq=False)
class Regions:
    """The regions of a case.

    Attributes:
        poses: indices of the poses where they are, shape (k,).
        travelled: m, up to there, shape (k,).
        gaussian_enough: whether the error is, at each pose; see `Theory`.
        found: for each method and pose, None where a region has no volume.
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
        """Return the distance (m) after which the 95 % region is wrong, None if there is none."""
        known = [(m, region) for m, region in zip(self.travelled, self.found[method]) if region]
        wrong = [number for number, (_, region) in enumerate(known) if region.wrong()]
        if not known:
            return None
        return float(known[-1][0] if not wrong else known[wrong[0] - 1][0] if wrong[0] else 0.0)

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
    """Counts how many noisy paths are in the regions, in memory that does not grow with them.

    Args:
        trajectory: the perfect path.
        steps: of it.
        known: of its noisy versions.
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
        """Count some more paths."""
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
        """Return what was found."""
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


# A product of the errors and the inverses first.
_ORDER = ["einsum_path", (0, 1), (0, 1)]
