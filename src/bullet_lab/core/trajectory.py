"""Trajectories, their text files, and the error of one relative to another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike
from typing import Any, Iterable, List, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core.se2 import hypot, quaternion_from_yaw, wrap, yaw_from_quaternion
from bullet_lab.errors import LabError

CSV_HEADER = "stamp,x,y,yaw,noisy_x,noisy_y,noisy_yaw"
"""First line of a file of two paths; s, m and rad."""

_COLUMNS = (8, 4, 3)


class TrajectoryError(LabError):
    """A trajectory is invalid, or its file cannot be read."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Stamped planar poses, at least one; the arrays are copied and read-only.

    Attributes:
        stamps: s, strictly increasing, shape (n,).
        poses: x (m), y (m) and yaw (rad), finite, shape (n, 3).
        remark: what was left out as the file was read; empty if nothing was.

    Raises:
        TrajectoryError: a shape or a value is wrong.
    """

    stamps: ndarray
    poses: ndarray
    remark: str = ""

    def __post_init__(self):
        object.__setattr__(self, "stamps", _read_only(self.stamps))
        object.__setattr__(self, "poses", _read_only(self.poses))
        if self.stamps.size == 0:
            raise TrajectoryError("the trajectory has no poses")
        if self.stamps.ndim != 1 or self.poses.shape != (len(self.stamps), 3):
            raise TrajectoryError(
                "n stamps and poses of shape (n, 3) are needed, "
                f"not {self.stamps.shape} and {self.poses.shape}"
            )
        if not (np.isfinite(self.stamps).all() and np.isfinite(self.poses).all()):
            raise TrajectoryError("a stamp or a pose is not finite")
        backwards = np.flatnonzero(np.diff(self.stamps) <= 0.0)
        if backwards.size:
            raise TrajectoryError(
                f"stamps must increase, but {self.stamps[backwards[0] + 1]:.9f} "
                f"follows {self.stamps[backwards[0]]:.9f}"
            )

    def __len__(self) -> int:
        return len(self.stamps)

    def travelled(self) -> ndarray:
        """Return the distance (m) travelled up to each pose, shape (n,)."""
        dx, dy = np.diff(self.poses[:, :2], axis=0).T
        return np.concatenate([[0.0], np.cumsum(hypot(dx, dy))])

    def length(self) -> float:
        """Return the length (m) of the path."""
        return float(self.travelled()[-1])


def _read_only(values) -> ndarray:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise TrajectoryError("stamps and poses must be arrays of numbers") from None
    array.setflags(write=False)
    return array


def tum_row(stamp: float, x: float, y: float, yaw: float) -> str:
    """Return a line `timestamp tx ty tz qx qy qz qw` in the format of the TUM benchmark.

    The stamp (s) has 9 decimals; the pose (m, m, rad) has every digit of its doubles, so
    reading it gives x and y bit for bit. There is no line end.

    >>> tum_row(0.05, 1.0, 2.0, 0.0)
    '0.050000000 1.0 2.0 0 0 0 0.0 1.0'
    """
    _, _, z, w = quaternion_from_yaw(yaw)
    return f"{stamp:.9f} {float(x)!r} {float(y)!r} 0 0 0 {float(z)!r} {float(w)!r}"


def read_tum(path: str | PathLike) -> Trajectory:
    """Read a trajectory from a text file with 8, 4 or 3 columns.

    They are those of TUM, without height, roll and pitch; stamp, x, y and yaw; or stamp, speed
    (m/s) and turn rate (rad/s), as of `integrated`. Empty lines and those that begin with # are
    skipped. Of poses with the same stamp the first is kept, and the remark counts the others.

    Raises:
        TrajectoryError: the file cannot be read or is invalid; the message names the line.
    """
    try:
        with open(path, encoding="utf-8") as file:
            lines = [(f"line {number}", line.split()) for number, line in enumerate(file, start=1)]
    except OSError as error:
        raise TrajectoryError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TrajectoryError(f"cannot read {path}: it is not a text file") from None
    lines = [(place, words) for place, words in lines if words and not words[0].startswith("#")]
    count = len(lines[0][1]) if lines else _COLUMNS[0]
    needed = str(count) if count in _COLUMNS else " or ".join(map(str, _COLUMNS))
    rows = []
    for place, words in lines:
        where = f"{path}, {place}"
        if len(words) != count or count not in _COLUMNS:
            raise TrajectoryError(f"{where}: {needed} values needed, not {len(words)}")
        values = finite_numbers(words, where)
        if count == _COLUMNS[0]:
            stamp, x, y, _, *quaternion = values
            if not any(quaternion):
                raise TrajectoryError(f"{where}: the quaternion is zero")
            values = [stamp, x, y, yaw_from_quaternion(*quaternion)]
        rows.append(values)
    return trajectory_of(rows, path, [place for place, _ in lines])


def finite_numbers(words: Iterable[Any], where: str) -> List[float]:
    """Return the numbers of a line; raises TrajectoryError, with `where`, if one is not finite."""
    try:
        values = [float(word) for word in words]
    except (TypeError, ValueError):
        raise TrajectoryError(f"{where}: a value is not a number") from None
    if not all(map(math.isfinite, values)):
        raise TrajectoryError(f"{where}: a value is not finite")
    return values


def trajectory_of(
    rows: Sequence[Sequence[float]], path: str | PathLike, places: Sequence[str]
) -> Trajectory:
    """Return the trajectory of rows of a file, whose places in it are given in words.

    A row is stamp (s), x, y (m) and yaw (rad), or stamp, speed (m/s) and turn rate (rad/s). Of
    those with the same stamp the first is kept. Raises TrajectoryError if they are invalid, with
    the path and the place.
    """
    table = np.array(rows, dtype=float).reshape(len(rows), -1 if rows else 4)
    waits = np.diff(table[:, 0], prepend=-np.inf)
    again = waits == 0.0
    where, remark = str(path), ""
    if (waits < 0.0).any():
        where = f"{path}, {places[int(np.argmax(waits < 0.0))]}"
    elif again.any():
        remark = (
            f"{again.sum()} with the stamp of the one before left out, "
            f"the first in {places[int(np.argmax(again))]}"
        )
    table = table[~again]
    try:
        poses = table[:, 1:] if table.shape[1] == 4 else integrated(*table.T)
        return Trajectory(table[:, 0], poses, remark)
    except TrajectoryError as error:
        raise TrajectoryError(f"{where}: {error}") from None


def integrated(stamps: ndarray, speed: ndarray, turn_rate: ndarray) -> ndarray:
    """Return the poses (m, m, rad) if each velocity is held until the next stamp (s), (n, 3).

    The speeds (m/s) and turn rates (rad/s, counter-clockwise > 0) are of shape (n,).

    >>> integrated(np.array([0.0, 2.0, 3.0]), np.ones(3), np.array([0.0, np.pi, 0.0])).round(3)
    array([[ 0.   ,  0.   ,  0.   ],
           [ 2.   ,  0.   ,  0.   ],
           [ 2.   ,  0.637, -3.142]])
    """
    seconds = np.diff(stamps)
    turns = turn_rate[:-1] * seconds
    heading = np.cumsum(turns)
    moves = speed[:-1] * seconds * np.sinc(turns / math.tau) * np.exp(1j * (heading - 0.5 * turns))
    places = np.concatenate(([0j], np.cumsum(moves)))
    return np.column_stack((places.real, places.imag, wrap(np.concatenate(([0.0], heading)))))


@dataclass(frozen=True, eq=False)
class PathError:
    """The absolute pose error (APE) of an estimate, estimate minus reference at each stamp.

    Attributes:
        ape_rmse_m: root mean square of the distances between the two positions.
        ape_max_m: the largest.
        heading_rmse_deg: root mean square of the heading errors.
        final_error_m: distance at the last stamp.
        final_heading_error_deg: heading error at the last stamp, signed, in [-180, 180).
        travelled: m, along the reference up to each stamp, shape (n,).
        error: m, distance at each stamp, shape (n,).
        heading_error: rad, signed, in [-pi, pi), at each stamp, shape (n,).
    """

    ape_rmse_m: float
    ape_max_m: float
    heading_rmse_deg: float
    final_error_m: float
    final_heading_error_deg: float
    travelled: ndarray
    error: ndarray
    heading_error: ndarray


def path_error(reference: Trajectory, estimate: Trajectory) -> PathError:
    """Compare an estimate with the reference, pose by pose.

    Raises TrajectoryError if the stamps are not exactly the same.

    >>> perfect = Trajectory([0.0, 1.0], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    >>> noisy = Trajectory([0.0, 1.0], [(0.0, 0.0, 0.0), (1.0, 0.5, 0.0)])
    >>> path_error(perfect, noisy).final_error_m
    0.5
    """
    if not np.array_equal(reference.stamps, estimate.stamps):
        raise TrajectoryError("only trajectories with the same stamps can be compared")
    dx, dy, dyaw = (estimate.poses - reference.poses).T
    error, heading_error = hypot(dx, dy), wrap(dyaw)
    return PathError(
        ape_rmse_m=_rms(error),
        ape_max_m=float(np.max(error)),
        heading_rmse_deg=math.degrees(_rms(heading_error)),
        final_error_m=float(error[-1]),
        final_heading_error_deg=math.degrees(heading_error[-1]),
        travelled=reference.travelled(),
        error=error,
        heading_error=heading_error,
    )


def _rms(values: ndarray) -> float:
    return math.sqrt(np.mean(np.square(values)))
