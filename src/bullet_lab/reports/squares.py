"""A driven square: its paths as files, what it comes down to, and its figure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLACK, BLUE, GREEN, ORANGE, VERMILION, new_figure
from bullet_lab.core.files import RowFile, make_folder
from bullet_lab.core.trajectory import (
    CSV_HEADER,
    Trajectory,
    closure_error,
    csv_row,
    path_error,
    tum_row,
)
from bullet_lab.errors import LabError

TURNING_RADIUS = 0.1
"""m; a message is part of a drive if the curve it lies on is at least this wide."""

MIN_SIDE = 0.05
"""m; a shorter drive is no side but a disturbance of the turns beside it."""

MIN_TURN = math.radians(5.0)
"""rad; a smaller turn is no corner but a disturbance of the drives beside it."""

MIN_STRAIGHTNESS = 0.9
"""Distance between the ends of a side over the way driven; below, the path is a curve."""


@dataclass(frozen=True)
class SquarePath:
    """What a path of straight drives and turns on the spot is made of.

    Attributes:
        side_lengths_m: distance between the ends of each side, in the order driven.
        turns_deg: heading change after each side, unwrapped, as a magnitude: clockwise and
            counter-clockwise look the same. One less than the sides if the path ends on a side.
        closure_error_m: distance from the start of the path to its end.
    """

    side_lengths_m: list[float]
    turns_deg: list[float]
    closure_error_m: float


def analyse(trajectory: Trajectory) -> SquarePath:
    """Cut a path into its sides and the turn after each.

    Rests belong to what they interrupt, and so do crawls and stray messages: only drives of at
    least `MIN_SIDE` and turns of at least `MIN_TURN` count. A path that stops half way gives as
    many sides and turns as it has; one that does not move or is not made of straight drives
    gives none.
    """
    positions = trajectory.poses[:, :2]
    headings = np.unwrap(trajectory.poses[:, 2])
    drives, turns = _cut(positions, headings)
    if not all(_is_straight(positions[start : end + 1]) for start, end in drives):
        drives, turns = [], []
    # The message in which a drive and a turn meet has a share of both, hence one more at each
    # end; of a message that is all drive or all turn this adds nothing to the other.
    last = len(trajectory) - 1
    return SquarePath(
        [
            float(np.hypot(*(positions[min(end + 1, last)] - positions[max(start - 1, 0)])))
            for start, end in drives
        ],
        [
            float(np.degrees(abs(headings[min(end + 1, last)] - headings[start - 1])))
            for start, end in turns
        ],
        closure_error(trajectory),
    )


def _cut(positions: np.ndarray, headings: np.ndarray):
    """Return the drives, and the turns after the first of them, as pairs of pose indices."""
    ways = np.hypot(*np.diff(positions, axis=0).T)
    is_drive = ways >= TURNING_RADIUS * np.abs(np.diff(headings))
    if not is_drive.size:
        return [], []
    edges = np.concatenate([[0], np.flatnonzero(np.diff(is_drive)) + 1, [is_drive.size]])
    first_is_drive = bool(is_drive[0])

    # Pieces alternate. The least significant one is given to its neighbours, which become one
    # piece then, until all that are left matter.
    while True:
        drive = (np.arange(len(edges) - 1) % 2 == 0) == first_is_drive
        distance = np.hypot(*np.diff(positions[edges], axis=0).T)
        turn = np.abs(np.diff(headings[edges]))
        significance = np.where(drive, distance / MIN_SIDE, turn / MIN_TURN)
        least = int(np.argmin(significance))
        if significance[least] >= 1.0:
            break
        if len(edges) == 2:
            return [], []
        if least == 0:
            first_is_drive = not first_is_drive
        inner = [edge for edge in (least, least + 1) if 0 < edge < len(edges) - 1]
        edges = np.delete(edges, inner)

    pieces = list(zip(edges[:-1].tolist(), edges[1:].tolist()))
    first_drive = 0 if first_is_drive else 1
    return pieces[first_drive::2], pieces[first_drive + 1 :: 2]


def _is_straight(positions: np.ndarray) -> bool:
    way = np.hypot(*np.diff(positions, axis=0).T).sum()
    return bool(np.hypot(*(positions[-1] - positions[0])) >= MIN_STRAIGHTNESS * way)


def squares_summary(
    perfect: Optional[Trajectory], pairs: Optional[Tuple[Trajectory, Trajectory]]
) -> Dict[str, Any]:
    """Return the figures of a driven square; null where there is nothing to measure.

    Args:
        perfect: the whole perfect path.
        pairs: the perfect and the noisy path at common stamps.
    """
    square = None if perfect is None else analyse(perfect)
    error = None if pairs is None else path_error(*pairs)
    return {
        "side_lengths_m": [] if square is None else square.side_lengths_m,
        "turns_deg": [] if square is None else square.turns_deg,
        "closure_error_m": None if square is None else square.closure_error_m,
        "path_length_m": None if perfect is None else perfect.length(),
        "final_error_m": None if error is None else error.final_error_m,
        "final_heading_error_deg": None if error is None else error.final_heading_error_deg,
        "ape_rmse_m": None if error is None else error.ape_rmse_m,
        "ape_max_m": None if error is None else error.ape_max_m,
        "heading_rmse_deg": None if error is None else error.heading_rmse_deg,
        "pairs": 0 if pairs is None else len(pairs[0]),
    }


PlanarPose = Tuple[float, float, float]
NANOSECONDS = 1_000_000_000


class RecordingError(LabError):
    """A pose cannot be recorded."""


class PathsRecording:
    """Writes odom.tum, noisy_odom.tum and paths.csv while poses come in.

    Poses of the two paths are paired where their stamps are the same to the nanosecond. Each row
    is in the file as soon as it is known; `finish` writes the files once more, whole.

    Args:
        folder: where the files go; made if need be.

    Raises:
        FileError: a file cannot be written, here and in all that adds to the files.
    """

    PERFECT, NOISY, PAIRS = "odom.tum", "noisy_odom.tum", "paths.csv"

    def __init__(self, folder: Path):
        self.folder = make_folder(folder)
        self._perfect: Dict[int, PlanarPose] = {}
        self._noisy: Dict[int, PlanarPose] = {}
        self._last: Dict[str, int] = {}
        self._files = {
            name: RowFile(folder / name) for name in (self.PERFECT, self.NOISY, self.PAIRS)
        }
        self._files[self.PAIRS].write(CSV_HEADER)

    def add_perfect(self, stamp: int, pose: PlanarPose) -> None:
        """Record a perfect pose (m, m, rad) at a stamp in ns.

        Raises:
            RecordingError: not finite, or not later than the one before.
        """
        self._add(self.PERFECT, self._perfect, stamp, pose)
        self._write_pair(stamp)

    def add_noisy(self, stamp: int, pose: PlanarPose) -> None:
        """Record a noisy pose; see `add_perfect`."""
        self._add(self.NOISY, self._noisy, stamp, pose)
        self._write_pair(stamp)

    def last(self, name: str) -> Optional[int]:
        """Return the last stamp in ns in PERFECT or NOISY, or None."""
        return self._last.get(name)

    def perfect(self) -> Optional[Trajectory]:
        """Return the whole perfect path, or None while there is none."""
        return _trajectory(self._perfect, sorted(self._perfect))

    def pairs(self) -> Optional[Tuple[Trajectory, Trajectory]]:
        """Return the paired poses of both paths, or None while there are none."""
        stamps = self._paired_stamps()
        if not stamps:
            return None
        return _trajectory(self._perfect, stamps), _trajectory(self._noisy, stamps)

    def finish(self, until: Optional[int] = None) -> None:
        """Close the files; leave out what came after the stamp `until` in ns, if given."""
        self.close()
        if until is not None:
            for poses in (self._perfect, self._noisy):
                for stamp in [s for s in poses if s > until]:
                    del poses[stamp]
        self._files[self.PERFECT].rewrite(self._tum_rows(self._perfect))
        self._files[self.NOISY].rewrite(self._tum_rows(self._noisy))
        self._files[self.PAIRS].rewrite(
            [CSV_HEADER] + [self._pair_row(stamp) for stamp in self._paired_stamps()]
        )

    def close(self) -> None:
        """Close the files as they are."""
        for file in self._files.values():
            file.close()

    def _add(self, name: str, poses: Dict[int, PlanarPose], stamp: int, pose: PlanarPose) -> None:
        if not all(map(math.isfinite, pose)):
            raise RecordingError(f"a pose that is not finite: {pose}")
        last = self._last.get(name)
        if last is not None and stamp <= last:
            raise RecordingError(f"time goes back from {last / 1e9:.9f} s to {stamp / 1e9:.9f} s")
        self._last[name] = stamp
        poses[stamp] = pose
        self._files[name].write(tum_row(stamp / NANOSECONDS, *pose))

    def _write_pair(self, stamp: int) -> None:
        if stamp in self._perfect and stamp in self._noisy:
            self._files[self.PAIRS].write(self._pair_row(stamp))

    def _pair_row(self, stamp: int) -> str:
        return csv_row(stamp / NANOSECONDS, self._perfect[stamp], self._noisy[stamp])

    def _paired_stamps(self) -> List[int]:
        return sorted(self._perfect.keys() & self._noisy.keys())

    @staticmethod
    def _tum_rows(poses: Dict[int, PlanarPose]) -> List[str]:
        return [tum_row(stamp / NANOSECONDS, *poses[stamp]) for stamp in sorted(poses)]


def _trajectory(poses: Dict[int, PlanarPose], stamps: List[int]) -> Optional[Trajectory]:
    if not stamps:
        return None
    return Trajectory([s / NANOSECONDS for s in stamps], [poses[s] for s in stamps])


def noise_figure(
    perfect: Optional[Trajectory],
    pairs: Optional[Tuple[Trajectory, Trajectory]],
    title: str = "Noise generated by /noisy_odom",
    ellipses: Sequence[np.ndarray] = (),
) -> Figure:
    """Draw both paths, each coordinate against time, and the error against distance.

    Args:
        perfect: the whole perfect path; None for nothing yet.
        pairs: the perfect and the noisy path at common stamps; None for nothing yet.
        title: above all.
        ellipses: outlines around noisy poses, (n, 2) arrays in m.
    """
    figure = new_figure(11.0, 6.6)
    figure.suptitle(title)
    left, right = figure.add_gridspec(
        1, 2, width_ratios=(1.25, 1.0), wspace=0.2, left=0.07, right=0.98, top=0.91, bottom=0.08
    )
    above, below = right.subgridspec(2, 1, height_ratios=(3.4, 1.0), hspace=0.24)
    noisy = None if pairs is None else pairs[1]
    axes = figure.add_subplot(left)
    _draw_ellipses(axes, ellipses)
    _draw_paths(axes, perfect, noisy)
    rows = above.subgridspec(3, 1, hspace=0.12)
    _draw_coordinates([figure.add_subplot(row) for row in rows], perfect, noisy)
    _draw_error(figure.add_subplot(below), pairs)
    return figure


def _draw_paths(axes: Axes, perfect: Optional[Trajectory], noisy: Optional[Trajectory]) -> None:
    axes.set(xlabel="x Distance (m)", ylabel="y Distance (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    for path, colour, name in ((noisy, BLUE, "Noisy odom"), (perfect, ORANGE, "Perfect odom")):
        if path is None:
            continue
        x, y = path.poses[:, 0], path.poses[:, 1]
        axes.plot(x, y, color=colour, linewidth=1.6, label=name)
        axes.plot(x[-1], y[-1], "s", color=colour, markeredgecolor=BLACK, markersize=7)
    if perfect is not None:
        start = perfect.poses[0]
        axes.plot(start[0], start[1], "o", color=GREEN, markeredgecolor=BLACK, label="start")
        axes.plot([], [], "s", color="white", markeredgecolor=BLACK, label="ends")
        axes.legend(loc="center")


def _draw_ellipses(axes: Axes, ellipses: Sequence[np.ndarray]) -> None:
    for number, outline in enumerate(ellipses):
        label = None if number else "95 % ellipses"
        axes.plot(*outline.T, color=BLUE, linewidth=0.8, alpha=0.7, label=label)


def _draw_coordinates(
    rows: list, perfect: Optional[Trajectory], noisy: Optional[Trajectory]
) -> None:
    for path, colour in ((noisy, BLUE), (perfect, ORANGE)):
        if path is None:
            continue
        heading = np.degrees(np.unwrap(path.poses[:, 2]))
        for axes, values in zip(rows, (path.poses[:, 0], path.poses[:, 1], heading)):
            axes.plot(path.stamps, values, color=colour, linewidth=1.2)
    for axes, label in zip(rows, ("x (m)", "y (m)", "heading (°)")):
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    for axes in rows[:-1]:
        axes.tick_params(labelbottom=False)
    rows[-1].set_xlabel("simulated time (s)")


def _draw_error(axes: Axes, pairs: Optional[Tuple[Trajectory, Trajectory]]) -> None:
    axes.set(xlabel="distance travelled (m)", ylabel="error (m)")
    axes.grid(alpha=0.3)
    if pairs is None:
        return
    error = path_error(*pairs)
    axes.plot(error.travelled, error.error, color=VERMILION, linewidth=1.4)
    axes.set_ylim(bottom=0.0)
