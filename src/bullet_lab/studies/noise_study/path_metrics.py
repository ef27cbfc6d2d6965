"""What people measure of an odometry, for whole blocks of noisy paths at once.

No alignment: the noisy and the perfect path share their origin. Names and definitions are those
of evo, rpg_trajectory_evaluation and the KITTI benchmark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.noisy_paths import NoisyBlock, NoisySteps
from bullet_lab.noise.odometry_noise import MIN_TRANSLATION

DELTA_TOLERANCE = 0.25
"""How far, as a share of it, the distance between two poses may be from the delta of the RPE."""

LAP_TOLERANCE = math.radians(10.0)
"""rad; a path that ends this close to a full turn has made its lap."""

MOST_LAPS = 50
"""Who turns round more often than this is not going round in laps."""

METRICS = (
    "final_error_m",
    "final_heading_error_deg",
    "ape_rmse_m",
    "ape_heading_rmse_deg",
    "rpe_rmse_m",
    "rpe_heading_rmse_deg",
    "drift_percent",
    "drift_deg_per_m",
    "along_track_rms_m",
    "cross_track_rms_m",
)
"""The columns that `PathMetrics.values` always has; a closure error for each lap follows."""


class PathMetricsError(LabError):
    """A path on which the metrics are not defined."""


@dataclass(frozen=True, eq=False)
class Laps:
    """Where the laps of a path begin and end.

    Attributes:
        start: index of the first pose of each lap, shape (l,).
        end: index of its last pose, shape (l,).
    """

    start: np.ndarray
    end: np.ndarray


def find_laps(trajectory: Trajectory) -> Laps:
    """Cut a path where its heading has gone another full turn round, either way.

    The last lap may lack `LAP_TOLERANCE`. A path without a full turn has no laps; of very many
    the first `MOST_LAPS` count.
    """
    heading = np.unwrap(trajectory.poses[:, 2])
    turned = np.abs(heading - heading[0])
    ends = []
    while len(ends) < MOST_LAPS:
        goal = (len(ends) + 1) * math.tau
        there = np.flatnonzero(turned >= goal)
        if not there.size:
            there = np.flatnonzero(turned >= goal - LAP_TOLERANCE)
            if there.size and len(trajectory) - 1 > (ends[-1] if ends else 0):
                ends.append(len(trajectory) - 1)
            break
        ends.append(int(there[0]))
    return Laps(np.array([0, *ends[:-1]][: len(ends)], dtype=int), np.array(ends, dtype=int))


def pairs_at_distance(trajectory: Trajectory, delta: float) -> tuple[np.ndarray, np.ndarray]:
    """Pair each pose with the one whose distance along the path is nearest to delta.

    Pairs that miss delta by more than `DELTA_TOLERANCE` are left out. These are the pairs of
    evo, taken from the reference with `all_pairs`.

    Returns:
        Indices of the first and second poses, two arrays of the same length.

    Raises:
        PathMetricsError: delta is not > 0, or there is no pair.
    """
    if not 0.0 < delta < math.inf:
        raise PathMetricsError(f"delta must be finite and > 0, not {delta!r}")
    travelled = trajectory.travelled()
    count = len(travelled)
    # The nearest is the last at or below the wanted distance or the first above it; of those at
    # the same distance, where the robot did not move, it is the first.
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
        raise PathMetricsError(
            f"no two poses are {delta:g} m apart along the path, give or take "
            f"{100 * DELTA_TOLERANCE:g} %: another delta or a higher rate is needed"
        )
    return first[kept], second[kept]


class PathMetrics:
    """Measures noisy versions of one perfect path.

    Args:
        trajectory: the perfect path.
        steps: of it.
        delta: m, of the relative pose error and the drift.

    Raises:
        PathMetricsError: no two poses are delta apart.
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
        self.laps = find_laps(trajectory)
        laps = [f"closure_error_lap_{i + 1}_m" for i in range(len(self.laps.end))]
        self.names = (*METRICS, *laps)

    def values(self, block: NoisyBlock) -> np.ndarray:
        """Return the metrics of each path, shape (b, len(names)); see `names`."""
        heading = block.heading_error
        error = block.position - self._position
        error *= self._tangent
        along, across = error.real, error.imag
        square = np.square(along) + np.square(across)
        relative, relative_heading = self._relative_errors(block)
        columns = [
            np.sqrt(square[:, -1]),
            np.degrees(np.abs(_short_way(heading[:, -1]))),
            np.sqrt(np.mean(square, axis=1)),
            np.degrees(_rms(_short_way(heading))),
            _rms(relative),
            np.degrees(_rms(relative_heading)),
            100.0 * (relative @ self._share),
            np.degrees(np.abs(relative_heading) @ self._share),
            _rms(along),
            _rms(across),
        ]
        laps = np.abs(block.position[:, self.laps.end] - block.position[:, self.laps.start])
        return np.column_stack([*columns, laps])

    def perfect_closure(self) -> list[float]:
        """Return the closure error (m) that the perfect path itself has in each lap."""
        return np.abs(self._position[self.laps.end] - self._position[self.laps.start]).tolist()

    def _relative_errors(self, block: NoisyBlock) -> tuple[np.ndarray, np.ndarray]:
        """Return the relative pose errors in m and rad, each of shape (b, number of pairs).

        The displacement, seen from the noisy pose, less the perfect one seen from the perfect
        pose. Turned by the perfect heading this is exp(-i H) (P_j - P_i) - (p_j - p_i).
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


def _short_way(angle: np.ndarray) -> np.ndarray:
    """Wrap angles (rad) into [-pi, pi], a good deal faster than `wrap` and to rounding only."""
    return angle - math.tau * np.rint(angle / math.tau)


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("ij,ij->i", values, values) / values.shape[1])


def _tangents(steps: NoisySteps) -> np.ndarray:
    """Return the line of motion at each pose as a unit number, shape (n+1,).

    It is that of the step that led to the pose; at rest it is that of the last motion, and
    before the first one that of the first. Backwards is along the same line.
    """
    moves = np.abs(steps.trans) >= MIN_TRANSLATION
    if not moves.any():
        raise PathMetricsError("the path does not move")
    begin = int(np.argmax(moves))
    latest = np.maximum.accumulate(np.where(moves, np.arange(len(steps)), begin))
    return steps.direction[np.concatenate([[begin], latest])]
