"""Paths from files, with truth or without, at another message rate, and their corners."""

from __future__ import annotations

import csv
import math
import os
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from pathlib import Path
from typing import Iterator, Mapping, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.se2 import pose_from_above, wrap
from bullet_lab.core.trajectory import (
    Trajectory,
    finite_numbers,
    read_tum,
    trajectory_of,
    tum_row,
)
from bullet_lab.errors import LabError

LONGEST_PATH = 1e7
"""m; longer paths are errors of units or of a file."""

SHORTEST_PATH = 1e-3
"""m; shorter paths are those of a robot at rest."""

ODOMETRY = "nav_msgs/Odometry"

VELOCITIES = ("v", "omega")
"""Columns of a table with speed (m/s) and turn rate (rad/s) instead of poses."""

_POSES = {
    ODOMETRY: attrgetter("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/PoseStamped": attrgetter("pose.position", "pose.orientation"),
    "geometry_msgs/PoseWithCovarianceStamped": attrgetter(
        "pose.pose.position", "pose.pose.orientation"
    ),
    "geometry_msgs/TransformStamped": attrgetter("transform.translation", "transform.rotation"),
}
"""Functions that return position and orientation of a message, by type."""


def read_path(path: Path, topic: str = "/odom", prefix: str = "") -> Trajectory:
    """Read a path from a bag (.bag), a table (.csv), or any other file as of `read_tum`.

    The first line of a table names its columns, with stamp, x, y and yaw among them, in s, m and
    rad, or else stamp, v and omega, in m/s and rad/s. An example is paths.csv of the squares.
    `prefix` begins the names of x, y and yaw. A bag has odometry, stamped poses or transforms on
    the topic.

    Raises LabError if the file cannot be read, or the path does not move.
    """
    kind = Path(path).suffix.lower()
    if kind == ".bag":
        trajectory = _read_bag(path, topic)
    elif kind == ".csv":
        trajectory = _read_csv(path, prefix)
    else:
        trajectory = read_tum(path)
    check_path(trajectory, f"{path}: ")
    return trajectory


def check_path(trajectory: Trajectory, where: str = "") -> None:
    """Raise LabError, which begins with `where`, without two poses and a plausible length."""
    if len(trajectory) < 2:
        raise LabError(f"{where}the path has only one pose")
    if np.abs(trajectory.poses[:, :2]).max() > LONGEST_PATH or trajectory.length() > LONGEST_PATH:
        raise LabError(f"{where}the path is longer than {LONGEST_PATH:g} m: are positions in m?")
    if trajectory.length() < SHORTEST_PATH:
        raise LabError(f"{where}the path is shorter than {SHORTEST_PATH:g} m: did the robot move?")


def read_table(
    path: Path, *choices: Sequence[str]
) -> tuple[Sequence[str], list[tuple[str, Mapping[str, str]]]]:
    """Read a CSV file whose first line names its columns, with one of some sets among them.

    Returns the first of the sets that the file has; and each row by column, with its place in
    words. Raises LabError if the file cannot be read, or lacks columns.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            names = set(reader.fieldnames or ())
            rows = [(f"{path}, line {reader.line_num}", row) for row in reader]
    except OSError as error:
        raise LabError(f"cannot read {path}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error):
        raise LabError(f"cannot read {path}: it is not a table") from None
    for columns in choices:
        if names >= set(columns):
            return columns, rows
    wanted = " or ".join(", ".join(columns) for columns in choices)
    raise LabError(f"{path}: the first line has to name the columns {wanted}")


def _read_csv(path: Path, prefix: str) -> Trajectory:
    pose = tuple(f"{prefix}{name}" for name in ("x", "y", "yaw"))
    columns, rows = read_table(path, ("stamp", *pose), ("stamp", *VELOCITIES))
    poses = [finite_numbers([row[name] for name in columns], where) for where, row in rows]
    return trajectory_of(poses, path, [where.rsplit(", ", 1)[-1] for where, _ in rows])


def _read_bag(path: Path, topic: str) -> Trajectory:
    try:
        import rosbag
        from roslib.message import get_message_class
    except ImportError as error:
        raise LabError(f"cannot read {path} without ROS's rosbag: {error}") from None
    kinds = list(filter(None, map(get_message_class, _POSES)))
    # rosbag would compile the message types in a bag, which may contain any program.
    rosbag.bag._message_types.update((kind._md5sum, kind) for kind in kinds)
    known = {(kind._type, kind._md5sum) for kind in kinds}
    try:
        with rosbag.Bag(str(path)) as bag:
            there = list(bag._get_connections())
            wanted = [info for info in there if info.topic.strip("/") == topic.strip("/")]
            foreign = [one.datatype for one in wanted if (one.datatype, one.md5sum) not in known]
            messages = []
            # Without a topic rosbag would read all of them.
            if wanted and not foreign:
                names = [info.topic for info in wanted]
                messages = [message for _, message, _ in bag.read_messages(topics=names)]
    except OSError as error:
        raise LabError(f"cannot read {path}: {error.strerror or error}") from None
    except Exception as error:  # rosbag raises any kind for a broken bag
        raise LabError(f"cannot read {path}: {error or type(error).__name__}") from None
    if foreign:
        strange = f"another {foreign[0]}" if foreign[0] in _POSES else foreign[0]
        raise LabError(f"{path}: {topic} is of {strange}, not {', '.join(_POSES)}")
    if not messages:
        paths = sorted({info.topic for info in there if info.datatype == ODOMETRY})
        known_paths = f"odometry is on {', '.join(paths)}" if paths else "there is no odometry"
        raise LabError(f"{path}: nothing on the topic {topic}; {known_paths}")
    places = [f"message {number} of {topic}" for number in range(1, len(messages) + 1)]
    poses = (pose_from_above(*_POSES[message._type](message)) for message in messages)
    rows = [(m.header.stamp.to_sec(), *pose) for m, pose in zip(messages, poses)]
    return trajectory_of(rows, path, places)


def tum_text(trajectory: Trajectory) -> str:
    """Return a path in the TUM format, which evo_traj and evo_ape read."""
    rows = [tum_row(stamp, *pose) for stamp, pose in zip(trajectory.stamps, trajectory.poses)]
    return "".join(f"{row}\n" for row in rows)


MOST_POSES = 2_000_000
"""Largest number of poses of a resampled path."""

_SAME_STAMP = 1e-6  # s; closer than messages ever are



def resample(trajectory: Trajectory, rate: float) -> Trajectory:
    """Return the poses of messages at a rate (Hz): at start + k / rate, and at the end.

    The last pose of the path, which has two at least, is always included, so that all rates end at
    the same pose. Position and heading are interpolated between two poses, the heading along the
    shorter turn. Raises LabError if the rate is too high for the path.
    """
    start, end = trajectory.stamps[[0, -1]]
    count = (end - start) * rate
    if count >= MOST_POSES:
        raise LabError(f"{rate:g} Hz for {end - start:g} s are too many messages")
    stamps = start + np.arange(math.floor(count) + 1) / rate
    if end - stamps[-1] > _SAME_STAMP:
        stamps = np.append(stamps, end)
    stamps = snapped(stamps, trajectory.stamps)
    x, y, yaw = trajectory.poses.T
    columns = [np.interp(stamps, trajectory.stamps, values) for values in (x, y, np.unwrap(yaw))]
    columns[2] = wrap(columns[2])
    return Trajectory(stamps, np.column_stack(columns))


def snapped(stamps: ndarray, known: ndarray) -> ndarray:
    """Replace stamps by known ones that are equal except for rounding."""
    after = np.minimum(np.searchsorted(known, stamps), len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(stamps - known[before] < known[after] - stamps, before, after)
    return np.where(np.abs(known[nearer] - stamps) <= _SAME_STAMP, known[nearer], stamps)


def find_corners(trajectory: Trajectory, most: int = 12) -> ndarray:
    """Return the indices of the poses between which a path is nearly straight, without the start.

    They are the vertices of Ramer, Douglas and Peucker's simplification with a tolerance of 5 % of
    the size of the path, the farthest ones first, at most `most` with the end.
    """
    x, y, _ = trajectory.poses.T
    position = x + 1j * y
    tolerance = 0.05 * max(np.ptp(x), np.ptp(y))
    kept = [0, len(position) - 1]
    while len(kept) <= most:
        distance, index = max(_farthest(position, i, j) for i, j in zip(kept, kept[1:]))
        if distance <= tolerance:
            break
        kept = sorted([*kept, index])
    return np.array(kept[1:])


def _farthest(position: ndarray, first: int, last: int) -> tuple[float, int]:
    """Return the largest distance (m) from the line between two poses of a path, and its index."""
    between = position[first:last] - position[first]
    chord = position[last] - position[first]
    along = (between * np.conj(chord)).real / max(abs(chord) ** 2, 1e-12)
    distance = np.abs(between - np.clip(along, 0.0, 1.0) * chord)
    index = int(np.argmax(distance))
    return float(distance[index]), first + index


NAMES = (
    ("odom", "noisy_odom"),
    *product(("truth", "groundtruth", "ground_truth"), ("odom", "odometry")),
)
"""Ends of the names of the two files of a recording, truth first; the rest is the same.

Capital letters do not matter.
"""

TRUTH_PREFIXES = ("truth_", "ground_truth_", "")
ODOMETRY_PREFIXES = ("noisy_", "odom_", "odometry_", "")
"""Prefixes of the columns x, y and yaw of a table with both paths; the first match counts."""

_SUFFIXES = (".tum", ".txt", ".dat", ".csv")


@dataclass(frozen=True, eq=False)
class Recording:
    """The true path and its odometry, each in its own frame, and the name of the file."""

    name: str
    truth: Trajectory
    odometry: Trajectory


Topics = Tuple[str, str]
"""Topics of the truth and of the odometry in a bag."""


def read_pair(truth: Path, odometry: Path, topics: Topics) -> Recording:
    """Read a recording from two files; raises LabError."""
    paths = (read_path(*one) for one in zip((truth, odometry), topics))
    return Recording(str(odometry), *paths)


def find_recordings(paths: Sequence[Path], topics: Topics) -> list[Recording]:
    """Read all recordings in files and folders; raises LabError, also if there is none.

    A recording is a bag with two topics, a table with both paths such as paths.csv of the squares,
    or two files in a folder whose names differ as in `NAMES`. Such pairs are ignored in folders
    with tables. Folders include those below them.
    """
    found = [recording for path in paths for recording in _recordings(path, topics)]
    if not found:
        places = ", ".join(map(str, paths))
        names = ", ".join(f"*{truth}.tum with *{odometry}.tum" for truth, odometry in NAMES[:3])
        raise LabError(
            f"{places}: no bag, no table with both paths, and no two files such as {names}"
        )
    return found


def _recordings(path: Path, topics: Topics) -> Iterator[Recording]:
    if not os.path.exists(path):
        raise LabError(f"cannot read {path}: there is no such file or folder")
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
        return read_pair(path, path, topics)
    prefixes = _prefixes(path)
    if prefixes is None:
        raise LabError(
            f"{path}: neither a bag nor a table with both paths, whose first line names stamp, "
            "x, y, yaw, noisy_x, noisy_y and noisy_yaw; two files are truth and odometry"
        )
    return Recording(str(path), *(read_path(path, prefix=prefix) for prefix in prefixes))


def _prefixes(path: Path) -> tuple[str, str] | None:
    """Return the prefixes of the columns of both paths, None if a file lacks one of them."""
    columns = columns_of(path)
    truth, odometry = (
        next((p for p in known if {f"{p}x", f"{p}y", f"{p}yaw"} <= columns), None)
        for known in (TRUTH_PREFIXES, ODOMETRY_PREFIXES)
    )
    if truth is None or odometry is None or truth == odometry or "stamp" not in columns:
        return None
    return truth, odometry


def _pairs(files: Sequence[Path]) -> Iterator[tuple[Path, Path]]:
    by_stem = {file.stem.lower(): file for file in files if file.suffix in _SUFFIXES}
    taken = set()
    for truth, odometry in NAMES:
        for stem in sorted(by_stem):
            partner = stem[: -len(truth)] + odometry
            # noisy_odom ends with odom, but is not the truth.
            if stem.endswith(truth) and partner in by_stem and not {stem, partner} & taken:
                taken |= {stem, partner}
                yield by_stem[stem], by_stem[partner]


def columns_of(path: Path) -> set[str]:
    """Return the names of the columns of a table; none of another file."""
    if path.suffix != ".csv":
        return set()
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return set(next(csv.reader(file), ()))
    except (OSError, UnicodeDecodeError, csv.Error):
        return set()
