"""The files of a noise study: the perfect path it reads, and the results it leaves."""

from __future__ import annotations

import contextlib
import csv
import math
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.angles import yaw_from_quaternion
from bullet_lab.core.files import FileError, make_folder
from bullet_lab.core.trajectory import Trajectory, TrajectoryError, read_tum, tum_row
from bullet_lab.errors import LabError
from bullet_lab.studies.noise_study.statistics import Case

LONGEST_PATH = 1e7
"""m; a path that is longer is not one of a robot on this planet."""

CSV_COLUMNS = ("stamp", "x", "y", "yaw")
ODOMETRY_KIND = "nav_msgs/Odometry"
SUMMARY = "summary.json"

_DISTANCES_PER_CASE = 100


class PathFileError(LabError):
    """A path cannot be read, or no noise can be studied on it."""


def read_path(path: Path, topic: str = "/odom") -> Trajectory:
    """Read a perfect path: a bag (.bag), a table (.csv), otherwise a file in TUM format.

    A table has a first line that names its columns, `CSV_COLUMNS` among them, in s, m and rad:
    the paths.csv of the squares is one.

    Args:
        path: the file.
        topic: of a bag, with messages of `ODOMETRY_KIND`.

    Raises:
        LabError: the file cannot be read, or does not hold a path that leads anywhere.
    """
    readers = {".bag": lambda name: _read_bag(name, topic), ".csv": _read_csv}
    trajectory = readers.get(Path(path).suffix.lower(), read_tum)(path)
    try:
        check_path(trajectory)
    except PathFileError as error:
        raise PathFileError(f"{path}: {error}") from None
    return trajectory


def check_path(trajectory: Trajectory) -> None:
    """Raise PathFileError unless the path has two poses and a length that makes sense."""
    if len(trajectory) < 2:
        raise PathFileError("the path has only one pose")
    if np.abs(trajectory.poses[:, :2]).max() > LONGEST_PATH or trajectory.length() > LONGEST_PATH:
        raise PathFileError(f"the path leads farther than {LONGEST_PATH:g} m")
    if trajectory.length() < 1e-3:
        raise PathFileError("the path leads nowhere")


def _read_csv(path: Path) -> Trajectory:
    rows: List[List[float]] = []
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            missing = set(CSV_COLUMNS) - set(reader.fieldnames or ())
            if missing:
                raise PathFileError(
                    f"{path}: the first line has to name the columns {', '.join(CSV_COLUMNS)}"
                )
            for row in reader:
                rows.append(_csv_values(row, f"{path}, line {reader.line_num}"))
    except OSError as error:
        raise PathFileError(f"cannot read {path}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error):
        raise PathFileError(f"cannot read {path}: it is not a table") from None
    return _trajectory(path, rows)


def _csv_values(row: Dict[str, Any], where: str) -> List[float]:
    try:
        values = [float(row[name]) for name in CSV_COLUMNS]
    except (TypeError, ValueError):
        raise PathFileError(f"{where}: a value is not a number") from None
    if not all(map(math.isfinite, values)):
        raise PathFileError(f"{where}: a value is not finite")
    return values


def _read_bag(path: Path, topic: str) -> Trajectory:
    try:
        import rosbag
    except ImportError as error:
        raise PathFileError(f"cannot read {path} without ROS's rosbag: {error}") from None
    try:
        with rosbag.Bag(str(path)) as bag:
            _, seen = bag.get_type_and_topic_info()
            topics = {name: info.msg_type for name, info in seen.items()}
            wanted = [name for name in topics if name.strip("/") == topic.strip("/")]
            # Without a topic rosbag reads all of them.
            found = bag.read_messages(topics=wanted) if wanted else ()
            messages = [message for _, message, _ in found]
    except OSError as error:
        raise PathFileError(f"cannot read {path}: {error.strerror or error}") from None
    except Exception as error:  # rosbag raises whatever it stumbles over in a broken bag
        raise PathFileError(f"cannot read {path}: {error or type(error).__name__}") from None
    if not messages:
        paths = sorted(name for name, kind in topics.items() if kind == ODOMETRY_KIND)
        there = f"odometry is on {', '.join(paths)}" if paths else "there is no odometry"
        raise PathFileError(f"{path}: nothing on the topic {topic}; {there}")
    if messages[0]._type != ODOMETRY_KIND:
        raise PathFileError(f"{path}: {topic} is of {messages[0]._type}, not {ODOMETRY_KIND}")
    return _trajectory(path, [_odometry_values(message) for message in messages])


def _odometry_values(message) -> List[float]:
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    yaw = yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w)
    return [message.header.stamp.to_sec(), place.x, place.y, yaw]


def _trajectory(path: Path, rows: Sequence[Sequence[float]]) -> Trajectory:
    table = np.array(rows, dtype=float).reshape(-1, 4)
    try:
        return Trajectory(table[:, 0], table[:, 1:])
    except TrajectoryError as error:
        raise PathFileError(f"{path}: {error}") from None


@contextlib.contextmanager
def whole_results(folder: Path) -> Iterator[Path]:
    """Yield a folder for results, which are put into their place only when all are there.

    If anything fails meanwhile, the results that were there before still are.

    Args:
        folder: where the results go; made if need be.

    Raises:
        FileError: a file cannot be written.
    """
    make_folder(folder)
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".part_") as name:
            part = Path(name)
            yield part
            files = [path.relative_to(part) for path in sorted(part.rglob("*")) if path.is_file()]
            # The summary says that all is there.
            for file in sorted(files, key=lambda path: path.name == SUMMARY):
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (part / file).replace(folder / file)
    except OSError as error:
        raise FileError(f"cannot write to {folder}: {error.strerror or error}") from error


def case_summary(case: Case) -> Dict[str, Any]:
    """Return the figures of one case for summary.json; null where there is nothing to say."""
    sample, known = case.sample, case.theory
    return {
        "model": case.model,
        "rate_hz": case.rate,
        "std": case.std,
        "messages": len(case.trajectory),
        "paths": sample.paths,
        "final_pose_error": {
            "sample_mean": sample.mean.tolist(),
            "exact_mean": known.exact.mean[-1].tolist(),
            "sample_covariance": sample.covariance.tolist(),
            "exact_covariance": known.exact.covariance[-1].tolist(),
            "first_order_covariance": known.first_order.covariance[-1].tolist(),
        },
        "first_order": {
            "mean_missed_by_std": known.shift(),
            "ellipse_area_over_exact": known.area_ratio(),
            "gaussian_enough": known.gaussian_enough(),
        },
        "coverage_of_95_percent_ellipse": dict(sample.coverage),
        "nees": {
            "mean": sample.nees,
            "expected": 3.0,
            "share_within_95_percent": sample.nees_within,
        },
        "metrics": sample.metrics,
        "perfect_closure_m": case.perfect_closure,
    }


def write_metrics(path: Path, cases: Sequence[Case]) -> None:
    """Write one row for each case: metrics, coverage, NEES, and how far off first order is."""
    # At a low rate a lap may be missing.
    fullest = max((case.sample.metrics for case in cases), key=len)
    metrics = [(name, part) for name, parts in fullest.items() for part in parts]
    header = [
        *("model", "rate_hz", "std", "paths", *(f"{name}_{part}" for name, part in metrics)),
        *("coverage_first_order", "coverage_exact", "coverage_published"),
        *("nees_mean", "nees_within_95", "mean_missed_by_std", "area_over_exact"),
        "gaussian_enough",
    ]
    _write_table(path, header, (_metrics_row(case, metrics) for case in cases))


def _metrics_row(case: Case, metrics: Sequence[Tuple[str, str]]) -> List[Any]:
    sample, known = case.sample, case.theory
    return [
        *(case.model, case.rate, case.std, sample.paths),
        *(sample.metrics.get(name, {}).get(part) for name, part in metrics),
        *(sample.coverage[name] for name in ("first_order", "exact", "published")),
        *(sample.nees, sample.nees_within, known.shift(), known.area_ratio()),
        str(known.gaussian_enough()).lower(),
    ]


def write_error_by_distance(path: Path, cases: Sequence[Case]) -> None:
    """Write the root mean square distance from the perfect path, sampled and exact."""
    header = ["model", "rate_hz", "std", "travelled_m", "sample_rms_m", "exact_rms_m"]
    header.append("first_order_rms_m")
    _write_table(path, header, (row for case in cases for row in _distance_rows(case)))


def _distance_rows(case: Case) -> Iterator[List[Any]]:
    travelled = case.trajectory.travelled()
    columns = (
        travelled,
        case.sample.rms_distance,
        case.theory.exact.rms_distance(),
        case.theory.first_order.rms_distance(),
    )
    count = min(_DISTANCES_PER_CASE, len(travelled))
    for index in np.unique(np.linspace(0, len(travelled) - 1, count).round().astype(int)):
        yield [case.model, case.rate, case.std, *(float(column[index]) for column in columns)]


def _write_table(path: Path, header: Sequence[str], rows) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a path in the TUM format, which evo_traj and evo_ape read."""
    rows = [tum_row(stamp, *pose) for stamp, pose in zip(trajectory.stamps, trajectory.poses)]
    path.write_text("".join(f"{row}\n" for row in rows))


def kept_path(case: Case, number: int) -> Optional[Trajectory]:
    """Return one of the noisy paths that a case has kept, None where it has fewer."""
    if number >= len(case.sample.kept):
        return None
    perfect = case.trajectory.poses
    position = case.sample.kept[number]
    poses = np.column_stack(
        [
            perfect[0, 0] + position.real,
            perfect[0, 1] + position.imag,
            perfect[:, 2] + case.sample.kept_heading[number],
        ]
    )
    return Trajectory(case.trajectory.stamps, poses)
