"""Paths with truth, from bags, tables, TUM files and folders of them."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

from bullet_lab.core.trajectory import Trajectory, TrajectoryError
from bullet_lab.studies.paths import read_path

NAMES = (
    ("odom", "noisy_odom"),
    ("truth", "odom"),
    ("truth", "odometry"),
    ("groundtruth", "odom"),
    ("groundtruth", "odometry"),
    ("ground_truth", "odom"),
    ("ground_truth", "odometry"),
)
"""Ends of the names of the two files of a recording, truth first; the rest is the same."""

TRUTH_PREFIXES = ("truth_", "ground_truth_", "")
ODOMETRY_PREFIXES = ("noisy_", "odom_", "odometry_", "")
"""Prefixes of the columns x, y and yaw of a table with both paths; the first match counts."""

_SUFFIXES = (".tum", ".txt", ".csv")


class RecordingError(TrajectoryError):
    """A file or folder has no path with truth."""


@dataclass(frozen=True, eq=False)
class Recording:
    """The true path and its odometry, each in its own frame.

    Attributes:
        name: of the file.
        truth: the true path.
        odometry: the reported path.
    """

    name: str
    truth: Trajectory
    odometry: Trajectory


@dataclass(frozen=True)
class Topics:
    """Topics of the paths in a bag."""

    truth: str
    odometry: str


def read_pair(truth: Path, odometry: Path, topics: Topics) -> Recording:
    """Read a recording from two files; raises LabError."""
    return Recording(
        str(odometry), read_path(truth, topics.truth), read_path(odometry, topics.odometry)
    )


def find_recordings(paths: Sequence[Path], topics: Topics) -> List[Recording]:
    """Read all recordings in files and folders.

    A recording is a bag with two topics, a table with both paths such as paths.csv of the squares,
    or two files in a folder whose names differ as in `NAMES`. Such pairs are ignored in folders
    with tables. Folders include those below them.

    Raises:
        LabError: a file cannot be read, or there is no recording.
    """
    found = [recording for path in paths for recording in _recordings(path, topics)]
    if not found:
        places = ", ".join(map(str, paths))
        names = ", ".join(f"*{truth}.tum with *{odometry}.tum" for truth, odometry in NAMES[:3])
        raise RecordingError(
            f"{places}: no bag, no table with both paths, and no two files such as {names}"
        )
    return found


def _recordings(path: Path, topics: Topics) -> Iterator[Recording]:
    if not os.path.exists(path):
        raise RecordingError(f"cannot read {path}: there is no such file or folder")
    if not os.path.isdir(path):
        yield _read_file(path, topics)
        return
    folders = [path, *sorted(below for below in path.rglob("*") if below.is_dir())]
    for folder in folders:
        files = sorted(file for file in folder.iterdir() if file.is_file())
        tables = [file for file in files if _prefixes(file) is not None]
        for file in files:
            if file.suffix == ".bag" or file in tables:
                yield _read_file(file, topics)
        if not tables:
            for truth, odometry in _pairs(files):
                yield read_pair(truth, odometry, topics)


def _read_file(path: Path, topics: Topics) -> Recording:
    if path.suffix == ".bag":
        truth, odometry = (read_path(path, topic) for topic in (topics.truth, topics.odometry))
        return Recording(str(path), truth, odometry)
    prefixes = _prefixes(path)
    if prefixes is None:
        raise RecordingError(
            f"{path}: neither a bag nor a table with both paths, whose first line names stamp, "
            "x, y, yaw, noisy_x, noisy_y and noisy_yaw; two files are truth and odometry"
        )
    return Recording(str(path), *(read_path(path, prefix=prefix) for prefix in prefixes))


def _prefixes(path: Path) -> Optional[Tuple[str, str]]:
    """Return the prefixes of the columns of both paths, None if a file lacks one of them."""
    if path.suffix != ".csv":
        return None
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            columns = set(next(csv.reader(file), ()))
    except (OSError, UnicodeDecodeError, csv.Error):
        return None
    truth, odometry = (
        next((p for p in known if {f"{p}x", f"{p}y", f"{p}yaw"} <= columns), None)
        for known in (TRUTH_PREFIXES, ODOMETRY_PREFIXES)
    )
    if truth is None or odometry is None or truth == odometry or "stamp" not in columns:
        return None
    return truth, odometry


def _pairs(files: Sequence[Path]) -> Iterator[Tuple[Path, Path]]:
    by_stem: Dict[str, Path] = {file.stem: file for file in files if file.suffix in _SUFFIXES}
    taken = set()
    for truth, odometry in NAMES:
        for stem in sorted(by_stem):
            partner = stem[: -len(truth)] + odometry
            # noisy_odom ends with odom, but is not the truth.
            if stem.endswith(truth) and partner in by_stem and not {stem, partner} & taken:
                taken |= {stem, partner}
                yield by_stem[stem], by_stem[partner]
