"""Runs of a real robot: from bags, tables and TUM files."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import List

import numpy as np

from bullet_lab.core.se2 import steps
from bullet_lab.core.trajectory import CSV_HEADER, Trajectory, finite_numbers
from bullet_lab.studies.noise_study.paths import read_path
from bullet_lab.studies.umbmark.runs import CLOCKWISE, DIRECTIONS, Run, RunError

ODOMETRY, TRUTH = "_odom.tum", "_truth.tum"
"""How the names of two TUM files of a run end."""

RETURNS = ("direction", "x", "y", "yaw")
"""Columns of a table of what was measured with a rule at the end of each run."""

PAIRS = tuple(CSV_HEADER.split(","))

AT_REST = 0.01
"""Distance, m, from the first or last pose within which the robot counts as resting there."""


def read_runs(path: Path, topic: str, truth_topic: str, side: float) -> List[Run]:
    """Read runs: one from each bag, table of two paths, or pair of TUM files in a folder.

    In a table of two paths (`PAIRS`, as paths.csv of the squares) the true pose comes first and
    the odometry second. Of a table of returns (`RETURNS`: cw or ccw, m, m, rad) each row is a run:
    where the robot really was when its odometry was back, as seen from its start, at a square
    that was perfect by its odometry.

    Args:
        path: the folder, or one file with several runs.
        topic: of a bag's odometry.
        truth_topic: of a bag's true poses.
        side: of the square, m, for tables of returns.

    Raises:
        LabError: a file cannot be read, or there is none.
    """
    files = sorted(path.iterdir()) if os.path.isdir(path) else [path]
    runs: List[Run] = []
    for file in files:
        if file.name.endswith(ODOMETRY):
            truth = file.with_name(file.name[: -len(ODOMETRY)] + TRUTH)
            runs.append(_run(file, read_path(file), read_path(truth)))
        elif file.suffix == ".bag":
            runs.append(_run(file, read_path(file, topic), read_path(file, truth_topic)))
        elif file.suffix == ".csv":
            runs += _read_table(file, side)
    if not runs:
        raise RunError(f"{path}: there is no bag, no table and no *{ODOMETRY} of a run")
    return runs


def _run(file: Path, odometry: Trajectory, truth: Trajectory) -> Run:
    """Return a run between the first and the last pose of both: the robot rests there."""
    _check_times(file, odometry, truth)
    first, last = truth.poses[[0, -1]].tolist()
    turns = [steps(one.poses)[:, 2].sum() for one in (odometry, truth)]
    if turns[0] * turns[1] < 0.0:
        raise RunError(
            f"{file}: odometry and truth turn in opposite directions: "
            "is the y axis or the yaw of one of them mirrored?"
        )
    return Run(file.stem, odometry.poses, tuple(first), tuple(last))


def _check_times(file: Path, odometry: Trajectory, truth: Trajectory) -> None:
    """Raise RunError where the truth does not cover the time that the robot drives."""
    from_start, from_end = (
        np.flatnonzero(np.hypot(*(odometry.poses - rest)[:, :2].T) > AT_REST)
        for rest in odometry.poses[[0, -1]]
    )
    if not (from_start.size and from_end.size):
        return
    begin, end = odometry.stamps[[from_start[0], from_end[-1]]]
    if truth.stamps[0] > begin or truth.stamps[-1] < end:
        raise RunError(
            f"{file}: the robot drives from {begin:.3f} to {end:.3f} s, but the truth covers "
            f"{truth.stamps[0]:.3f} to {truth.stamps[-1]:.3f} s: are both of one run and one clock?"
        )


def _read_table(path: Path, side: float) -> List[Run]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            columns = set(reader.fieldnames or ())
            rows = [(f"{path}, line {reader.line_num}", row) for row in reader]
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error):
        raise RunError(f"cannot read {path}: it is not a table") from None
    if columns >= set(PAIRS):
        table = [finite_numbers([row[name] for name in PAIRS], where) for where, row in rows]
        values = np.array(table).reshape(-1, len(PAIRS))
        if len(values) < 2:
            raise RunError(f"{path}: two rows at least are needed")
        odometry, truth = values[:, [0, 4, 5, 6]], values[:, :4]
        return [_run(path, *(Trajectory(one[:, 0], one[:, 1:]) for one in (odometry, truth)))]
    if columns >= set(RETURNS):
        return [_measured(where, row, side) for where, row in rows]
    raise RunError(
        f"{path}: the first line has to name the columns {', '.join(PAIRS)} or {', '.join(RETURNS)}"
    )


def _measured(where: str, row, side: float) -> Run:
    direction = (row["direction"] or "").strip().lower()
    if direction not in DIRECTIONS:
        raise RunError(f"{where}: the direction has to be one of {', '.join(DIRECTIONS)}")
    x, y, yaw = finite_numbers([row[name] for name in RETURNS[1:]], where)
    return Run(where, perfect_square(side, direction), (0.0, 0.0, 0.0), (x, y, yaw))


def perfect_square(side: float, direction: str) -> np.ndarray:
    """Return the poses of a perfect square, before and after each turn, shape (13, 3).

    >>> perfect_square(2.0, "ccw")[3].round(6)
    array([2.      , 0.      , 1.570796])
    """
    turn = -0.5 * np.pi if direction == CLOCKWISE else 0.5 * np.pi
    poses = [np.zeros(3)]
    for _ in range(4):
        x, y, yaw = poses[-1]
        x, y = x + side * np.cos(yaw), y + side * np.sin(yaw)
        # Half a turn at a time, so that its direction is known.
        poses += [np.array((x, y, yaw + share * turn)) for share in (0.0, 0.5, 1.0)]
    return np.array(poses)
