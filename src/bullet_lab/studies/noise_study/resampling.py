"""A path as messages at another rate would show it, and its corners."""

from __future__ import annotations

import math

import numpy as np

from bullet_lab.core.angles import wrap
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError

MOST_POSES = 2_000_000
"""A path of more poses is more likely a mistake than a path."""

_SAME_STAMP = 1e-6  # s; closer than messages ever are


class ResamplingError(LabError):
    """A path cannot be resampled at a rate."""


def resample(trajectory: Trajectory, rate: float) -> Trajectory:
    """Return the poses that messages at a rate would carry: at start + k / rate, and at the end.

    The last pose is always one of them, so that all rates end in the same place. Between two
    poses of the path, position and heading are interpolated, the heading the short way round.

    Args:
        trajectory: the path, two poses at least.
        rate: Hz, > 0.

    Raises:
        ResamplingError: the path has one pose, or the rate makes no sense for it.
    """
    if len(trajectory) < 2:
        raise ResamplingError("the path has only one pose")
    if not 0.0 < rate < math.inf:
        raise ResamplingError(f"a rate must be finite and > 0 Hz, not {rate!r}")
    start, end = trajectory.stamps[[0, -1]]
    count = (end - start) * rate
    if count >= MOST_POSES:
        raise ResamplingError(f"{rate:g} Hz for {end - start:g} s are too many messages")
    stamps = start + np.arange(math.floor(count) + 1) / rate
    if end - stamps[-1] > _SAME_STAMP:
        stamps = np.append(stamps, end)
    stamps = _snapped(stamps, trajectory.stamps)
    x, y, yaw = trajectory.poses.T
    columns = [np.interp(stamps, trajectory.stamps, values) for values in (x, y, np.unwrap(yaw))]
    columns[2] = wrap(columns[2])
    return Trajectory(stamps, np.column_stack(columns))


def _snapped(stamps: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Replace stamps by known ones that are the same but for rounding."""
    after = np.minimum(np.searchsorted(known, stamps), len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(stamps - known[before] < known[after] - stamps, before, after)
    return np.where(np.abs(known[nearer] - stamps) <= _SAME_STAMP, known[nearer], stamps)


def find_corners(trajectory: Trajectory, most: int = 12) -> np.ndarray:
    """Return the indices of the poses between which a path is nearly straight, start left out.

    They are the vertices that Ramer, Douglas and Peucker's simplification keeps, the farthest
    ones first, until what is left is within 5 % of the size of the path or there are enough.

    Args:
        trajectory: the path.
        most: how many there may be, the end included.
    """
    x, y, _ = trajectory.poses.T
    position = x + 1j * y
    tolerance = 0.05 * max(np.ptp(x), np.ptp(y))
    kept = [0, len(position) - 1]
    while len(kept) <= most:
        farthest = max(
            (_farthest(position, i, j) for i, j in zip(kept[:-1], kept[1:])), default=(0.0, 0)
        )
        if farthest[0] <= tolerance:
            break
        kept = sorted([*kept, farthest[1]])
    return np.array(kept[1:])


def _farthest(position: np.ndarray, first: int, last: int) -> tuple[float, int]:
    """Return how far (m) a path goes from the line between two of its poses, and where."""
    between = position[first:last] - position[first]
    chord = position[last] - position[first]
    along = (between * np.conj(chord)).real / max(abs(chord) ** 2, 1e-12)
    distance = np.abs(between - np.clip(along, 0.0, 1.0) * chord)
    index = int(np.argmax(distance))
    return float(distance[index]), first + index
