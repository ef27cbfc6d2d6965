"""Statistics of thousands of noisy versions of one path, with their moments in closed form.

The metrics are the usual ones of an odometry, without alignment, as the noisy and the perfect path
share their origin. Names and definitions are those of evo, rpg_trajectory_evaluation and the KITTI
benchmark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core.se2 import SQUARE_RADIUS
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.noisy_paths import NoisyBlock, NoisySteps, noisy_blocks, noisy_steps
from bullet_lab.noise.odometry_noise import MIN_TRANSLATION
from bullet_lab.studies.noise_study.regions import (
    Ellipsoids,
    Regions,
    Theory,
    level_rule,
    position_of,
    theory,
)

DELTA_TOLERANCE = 0.25
"""Tolerance of the distance between two poses, as a share of the RPE's delta."""

LAP_TOLERANCE = math.radians(10.0)
"""rad; a last lap may lack so much of a full turn."""

MOST_LAPS = 50
"""Largest number of laps; the rest of the path is ignored."""

QUANTILE_PATHS = 100_000
"""Number of paths for medians and 95 % quantiles; everything else uses all paths."""

KEPT_PATHS = 60

def find_laps(trajectory: Trajectory) -> tuple[ndarray, ndarray]:
    """Return the first and the last pose of each lap of a path, indices (l,) and (l,).

    A lap ends where the heading has completed another full turn, in either direction.

    The last lap may lack `LAP_TOLERANCE`. A path without a full turn has no laps; only the first
    `MOST_LAPS` count.
    """
    heading = np.unwrap(trajectory.poses[:, 2])
    turned = np.maximum.accumulate(np.abs(heading - heading[0]))
    goals = math.tau * np.arange(1, MOST_LAPS + 1)
    ends = np.searchsorted(turned, goals)
    ends, last = ends[ends < len(turned)], len(turned) - 1
    is_whole = len(ends) == MOST_LAPS or last in ends
    if not is_whole and turned[-1] >= goals[len(ends)] - LAP_TOLERANCE:
        ends = np.append(ends, last)
    return np.append(0, ends)[: len(ends)], ends


def pairs_at_distance(trajectory: Trajectory, delta: float) -> tuple[ndarray, ndarray]:
    """Return indices of poses, and of those whose distance along the path is nearest to delta.

    Pairs that differ from delta by more than `DELTA_TOLERANCE` are left out. These are the pairs
    of evo, taken from the reference with `all_pairs`. Raises LabError if there is none.
    """
    travelled = trajectory.travelled()
    count = len(travelled)
    # The nearest is the last one at or below the wanted distance or the first one above it. Of
    # poses at the same distance, where the robot did not move, it is the first.
    above = np.searchsorted(travelled, travelled + delta, side="left")
    below = np.searchsorted(travelled, travelled[np.maximum(above - 1, 0)], side="left")
    first = np.arange(count)
    below = np.maximum(below, first + 1)
    above_miss, below_miss = (
        np.where(i < count, np.abs(travelled[np.minimum(i, count - 1)] - travelled - delta), np.inf)
        for i in (above, below)
    )
    second = np.where(below_miss <= above_miss, below, above)
    kept = np.minimum(below_miss, above_miss) <= DELTA_TOLERANCE * delta
    if not kept.any():
        raise LabError(
            f"no two poses are {delta:g} m apart along the path, give or take "
            f"{100 * DELTA_TOLERANCE:g} %: another delta or a higher rate is needed"
        )
    return first[kept], second[kept]


ELLIPSES = ("first_order", "exact", "published")
"""Ellipses of the last position: each of the first two around its mean, and the one that
noisy_odom publishes, around the published pose."""


class PathMetrics:
    """Metrics of noisy versions of one perfect path.

    Args:
        trajectory: the perfect path.
        steps: of the path.
        delta: m, of the relative pose error and the drift.

    Raises:
        LabError: no two poses are delta apart.
    """

    def __init__(self, trajectory: Trajectory, steps: NoisySteps, delta: float):
        self._first, self._second = pairs_at_distance(trajectory, delta)
        self._position = steps.position
        self._relative = steps.position[self._second] - steps.position[self._first]
        travelled = trajectory.travelled()
        distance = travelled[self._second] - travelled[self._first]
        # The mean of a ratio is a product with these.
        self._share = 1.0 / (distance * len(distance))
        self._tangent = _tangents(steps).conj()
        self._starts, self._ends = find_laps(trajectory)

    def values(self, block: NoisyBlock) -> tuple[list[str], ndarray]:
        """Return the names of k metrics, and their values for each path, shape (b, k)."""
        heading = block.heading_error
        error = block.position - self._position
        error *= self._tangent
        along, across = error.real, error.imag
        square = np.square(along) + np.square(across)
        relative, relative_heading = self._relative_errors(block)
        columns = {
            "final_error_m": np.sqrt(square[:, -1]),
            "final_heading_error_deg": np.degrees(np.abs(_short_way(heading[:, -1]))),
            "ape_rmse_m": np.sqrt(np.mean(square, axis=1)),
            "ape_heading_rmse_deg": np.degrees(_rms(_short_way(heading))),
            "rpe_rmse_m": _rms(relative),
            "rpe_heading_rmse_deg": np.degrees(_rms(relative_heading)),
            "drift_percent": 100.0 * (relative @ self._share),
            "drift_deg_per_m": np.degrees(np.abs(relative_heading) @ self._share),
            "along_track_rms_m": _rms(along),
            "cross_track_rms_m": _rms(across),
        }
        laps = np.abs(block.position[:, self._ends] - block.position[:, self._starts])
        names = [*columns, *(f"closure_error_lap_{i + 1}_m" for i in range(len(self._ends)))]
        return names, np.column_stack([*columns.values(), laps])

    def _relative_errors(self, block: NoisyBlock) -> tuple[ndarray, ndarray]:
        """Return the relative pose errors in m and rad, each of shape (b, number of pairs).

        Turned by the perfect heading they are exp(-i H) (P_j - P_i) - (p_j - p_i).
        """
        heading = block.heading_error
        start = np.take(heading, self._first, axis=1)
        moved = np.take(block.position, self._second, axis=1)
        moved -= np.take(block.position, self._first, axis=1)
        turn = np.empty(start.shape, dtype=complex)
        np.cos(start, out=turn.real)
        np.negative(np.sin(start), out=turn.imag)
        moved *= turn
        moved -= self._relative
        length = np.sqrt(np.square(moved.real) + np.square(moved.imag))
        return length, _short_way(np.take(heading, self._second, axis=1) - start)


def _short_way(angle: ndarray) -> ndarray:
    """Wrap angles (rad) into [-pi, pi]; faster than `wrap`, with rounding errors."""
    return angle - math.tau * np.rint(angle / math.tau)


def _rms(values: ndarray) -> ndarray:
    return np.sqrt(np.einsum("ij,ij->i", values, values) / values.shape[1])


def _tangents(steps: NoisySteps) -> ndarray:
    """Return the direction of motion at each pose as a complex unit number, shape (n+1,).

    It is that of the step to the pose, at rest that of the last motion, and before the first
    motion that of the first. Backwards is along the same line.
    """
    moves = np.abs(steps.trans) >= MIN_TRANSLATION
    if not moves.any():
        raise LabError("the path does not move")
    begin = int(np.argmax(moves))
    latest = np.maximum.accumulate(np.where(moves, np.arange(len(steps)), begin))
    return steps.direction[np.concatenate([[begin], latest])]


@dataclass(frozen=True, eq=False)
class Case:
    """Statistics of many noisy versions of a path, for one noise level, model and message rate.

    Attributes:
        trajectory: the perfect path at this rate.
        model: name of the rule.
        rate: Hz.
        std: the level.
        theory: moments in closed form.
        regions: coverage of the regions of all three coordinates along the path.
        metrics: mean, 50 % and 95 % quantile of each metric by name, such as drift_percent_p95.
        coverage: share of the paths whose last position lies in the 95 % ellipse, for each of
            `ELLIPSES`. None for an ellipse without area.
        rms_distance: m, root mean square distance from the perfect path at each pose, (n+1,).
        kept: poses of the first `KEPT_PATHS` (m, m, rad), (k, n+1, 3).
    """

    trajectory: Trajectory
    model: str
    rate: float
    std: float
    theory: Theory
    regions: Regions
    metrics: dict[str, float]
    coverage: dict[str, float | None]
    rms_distance: ndarray
    kept: ndarray

    @property
    def key(self) -> dict[str, Any]:
        """The case in the tables, by the names of their columns."""
        return {"model": self.model, "rate_hz": self.rate, "std": self.std}


def by_model_of(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Return the cases of each model, in the given order."""
    result: dict[str, list[Case]] = {}
    for case in cases:
        result.setdefault(case.model, []).append(case)
    return result


def noisy_levels(cases: Sequence[Case]) -> list[Case]:
    """Return the cases with noise, from low to high."""
    return sorted((case for case in cases if case.std > 0.0), key=lambda case: case.std)


def shown_levels(cases: Sequence[Case], count: int) -> list[Case]:
    """Return some of the cases with noise, from low to high."""
    return spread(noisy_levels(cases), count)


def spread(values: Sequence, count: int) -> list:
    """Return some of the values, evenly spread, with the first and the last."""
    indices = np.linspace(0, len(values) - 1, min(count, len(values))).round().astype(int)
    return [values[i] for i in indices]


def study_case(
    trajectory: Trajectory,
    case: tuple[str, float, float],
    generator: np.random.Generator,
    paths: int,
    delta: float,
) -> Case:
    """Draw some noisy versions of a path and measure them.

    Args:
        trajectory: the perfect path, at the rate of the case.
        case: model, level and rate.
        generator: of the normal draws.
        paths: number of paths, >= 2.
        delta: m, of the relative pose error.

    Raises:
        LabError: no two poses of the path are delta apart.
    """
    model, std, rate = case
    steps = noisy_steps(trajectory.poses, level_rule(model, std))
    known = theory(steps)
    metrics = PathMetrics(trajectory, steps, delta)
    regions, ellipses = Regions(trajectory, steps, known), _last_ellipses(known)
    squares, inside = np.zeros(len(steps) + 1), np.zeros(len(ELLIPSES), dtype=int)
    sums, values = 0.0, []
    kept = []
    # In memory that does not grow with the number of paths.
    for block in noisy_blocks(steps, generator, paths):
        regions.add(block)
        error = block.position - steps.position
        squares += np.einsum("ij,ij->j", error.real, error.real)
        squares += np.einsum("ij,ij->j", error.imag, error.imag)
        last = np.column_stack([error[:, -1].real, error[:, -1].imag])
        nees = ellipses.nees(last[:, None])
        inside += np.count_nonzero(nees <= SQUARE_RADIUS, axis=(1, 2))
        names, found = metrics.values(block)
        sums = sums + found.sum(axis=0)
        values.append(found[: max(0, QUANTILE_PATHS - block.first)])
        if block.first < KEPT_PATHS:
            kept.append(block.poses(trajectory.poses)[: KEPT_PATHS - block.first])
    median, high = np.quantile(np.concatenate(values), [0.5, 0.95], axis=0)
    columns = [f"{name}_{part}" for name in names for part in ("mean", "p50", "p95")]
    shares = np.where(ellipses.known[:, 0], inside / paths, None)
    return Case(
        trajectory,
        model,
        rate,
        std,
        known,
        regions,
        dict(zip(columns, np.ravel((sums / paths, median, high), order="F").tolist())),
        dict(zip(ELLIPSES, shares.tolist())),
        np.sqrt(squares / paths),
        np.concatenate(kept),
    )


def _last_ellipses(known: Theory) -> Ellipsoids:
    """Return the 95 % `ELLIPSES` of the last position."""
    published = known.exact.about_perfect()[-1, :2, :2]
    covariances = (position_of(known.first_order), position_of(known.exact), published)
    means = (np.zeros(2), known.exact.mean[-1, :2], np.zeros(2))
    return Ellipsoids(np.array(means)[:, None], np.array(covariances)[:, None])
