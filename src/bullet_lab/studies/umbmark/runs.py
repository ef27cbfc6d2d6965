"""Squares that a robot drove by odometry, and the files with those of a real robot."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose, wrapped
from bullet_lab.core.trajectory import Trajectory, finite_numbers
from bullet_lab.errors import LabError
from bullet_lab.studies.paths import Recording, Topics, columns_of, find_recordings, read_table

CLOCKWISE, COUNTER_CLOCKWISE = "cw", "ccw"
DIRECTIONS = (CLOCKWISE, COUNTER_CLOCKWISE)
# m; a robot on wheels drives no square farther away, and sums of squares stay finite.
FARTHEST = 1e6

RETURNS = ("direction", "x", "y", "yaw")
"""Columns of a table with the true pose at the end of each run, measured with a ruler."""

AT_REST = 0.01
"""m from the first or last pose, within which the robot counts as at rest."""



@dataclass(frozen=True, eq=False)
class SquareRun:
    """One square, until the odometry reports the pose of its start.

    Attributes:
        name: of the run, for the user.
        odometry: reported poses: x (m), y (m) and yaw (rad), shape (n, 3).
        start: true pose at the first of these, in any frame.
        end: true pose at the last, in the same frame.
        base: distance of the wheels that the odometry assumed, m.

    Raises:
        LabError: the odometry does not turn by 360°, or a number is out of range.
    """

    name: str
    odometry: ndarray
    start: PlanarPose
    end: PlanarPose
    base: float

    def __post_init__(self) -> None:
        """Check that it is a square."""
        if len(self.odometry) < 2 or not np.isfinite(self.odometry).all():
            raise LabError(f"{self.name}: there is no odometry of a square")
        largest = max(np.abs(self.odometry).max(), *map(abs, (*self.start, *self.end)))
        if largest > FARTHEST:
            raise LabError(
                f"{self.name}: {largest:g} is out of range: positions are in m, angles in rad, "
                f"and at most {FARTHEST:g}"
            )
        turned = abs(self.turned())
        if not 0.75 < turned / (2.0 * np.pi) < 1.25:
            raise LabError(
                f"{self.name}: the odometry turns by {np.degrees(turned):.0f}°, not once round, "
                "as on a square with the turn after its last side"
            )

    def turned(self) -> float:
        """Return the total change of the reported heading, rad, counter-clockwise > 0."""
        return float(self.steps()[:, 2].sum())

    @property
    def direction(self) -> str:
        """One of `DIRECTIONS`."""
        return COUNTER_CLOCKWISE if self.turned() > 0.0 else CLOCKWISE

    def steps(self) -> ndarray:
        """Return the reported steps (dx m, dy m, dyaw rad), shape (n - 1, 3)."""
        return se2.steps(self.odometry)

    def side(self) -> float:
        """Return the reported length (m) of a side: a quarter of the path."""
        return float(np.hypot(*np.diff(self.odometry[:, :2], axis=0).T).sum() / 4.0)

    def moved(self) -> ndarray:
        """Return the true end in the frame of the true start: (m, m, rad)."""
        return se2.between(self.start, self.end)

    def return_error(self) -> ndarray:
        """Return true minus reported end (m, m, rad), x ahead and y to the left at the start."""
        return wrapped(self.moved() - se2.between(self.odometry[0], self.odometry[-1]))


def return_errors(runs: Sequence[SquareRun], direction: str) -> ndarray:
    """Return the return errors of the runs in a direction, shape (n, 3)."""
    errors = [run.return_error() for run in runs if run.direction == direction]
    return np.array(errors).reshape(-1, 3)


def read_runs(path: Path, topics: Topics, side: float, base: float) -> list[SquareRun]:
    """Read a run from each recording that `find_recordings` finds, or from each row of a table.

    Such a table of returns (`RETURNS`: cw or ccw, m, m, rad) has the true pose at the end of each
    run, in the frame of its start; its odometry reports a perfect square.

    Args:
        path: the folder, or one file with several runs.
        topics: of a bag's true poses and odometry.
        side: of the square, m, for tables of returns.
        base: that the odometry assumed, m.

    Raises:
        LabError: a file cannot be read, or there is none.
    """
    files = sorted(path.iterdir()) if os.path.isdir(path) else [path]
    runs = [
        _measured_run(where, row, side, base)
        for file in files
        if set(RETURNS) <= columns_of(file)
        for where, row in read_table(file, RETURNS)[1]
    ]
    return runs or [_run(one, base) for one in find_recordings([path], topics)]


def _run(recording: Recording, base: float) -> SquareRun:
    """Return a run from the first to the last poses of both: the robot rests there."""
    truth, odometry, name = recording.truth, recording.odometry, Path(recording.name).stem
    _check_times(name, odometry, truth)
    first, last = truth.poses[[0, -1]].tolist()
    turns = [se2.steps(one.poses)[:, 2].sum() for one in (odometry, truth)]
    if turns[0] * turns[1] < 0.0:
        raise LabError(
            f"{name}: odometry and truth turn in opposite directions: "
            "is the y axis or the yaw of one of them mirrored?"
        )
    remarks = "; ".join(filter(None, (odometry.remark, truth.remark)))
    name = f"{name} ({remarks})" if remarks else name
    return SquareRun(name, odometry.poses, tuple(first), tuple(last), base)


def _check_times(name: str, odometry: Trajectory, truth: Trajectory) -> None:
    """Raise LabError unless the truth covers the time in which the robot drives."""
    from_start, from_end = (
        np.flatnonzero(np.hypot(*(odometry.poses - rest)[:, :2].T) > AT_REST)
        for rest in odometry.poses[[0, -1]]
    )
    if not (from_start.size and from_end.size):
        return
    begin, end = odometry.stamps[[from_start[0], from_end[-1]]]
    if truth.stamps[0] > begin or truth.stamps[-1] < end:
        raise LabError(
            f"{name}: the robot drives from {begin:.3f} to {end:.3f} s, but the truth covers "
            f"{truth.stamps[0]:.3f} to {truth.stamps[-1]:.3f} s: are both of one run and one clock?"
        )


def _measured_run(where: str, row: Mapping[str, str], side: float, base: float) -> SquareRun:
    direction = (row["direction"] or "").strip().lower()
    if direction not in DIRECTIONS:
        raise LabError(f"{where}: the direction has to be one of {', '.join(DIRECTIONS)}")
    x, y, yaw = finite_numbers([row[name] for name in RETURNS[1:]], where)
    square = perfect_square(side, direction)
    return SquareRun(where, square, (0.0, 0.0, 0.0), (x, y, yaw), base)


def perfect_square(side: float, direction: str) -> ndarray:
    """Return the poses of a perfect square, before and after each turn, shape (13, 3).

    >>> perfect_square(2.0, "ccw")[3].round(6)
    array([2.      , 0.      , 1.570796])
    """
    turn = -0.5 * np.pi if direction == CLOCKWISE else 0.5 * np.pi
    poses = [np.zeros(3)]
    for _ in range(4):
        x, y, yaw = poses[-1]
        x, y = x + side * np.cos(yaw), y + side * np.sin(yaw)
        # Half a turn at a time, so that the direction of the turn is defined.
        poses += [np.array((x, y, yaw + share * turn)) for share in (0.0, 0.5, 1.0)]
    return np.array(poses)
