"""Distances to beacons: recorded beside the truth, and drawn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from bullet_lab.core.figures import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION, new_figure
from bullet_lab.core.files import RowFile, make_folder
from bullet_lab.core.trajectory import Trajectory

PlanarPose = Tuple[float, float, float]
NANOSECONDS = 1_000_000_000
FILE = "distances.csv"


class DistancesRecording:
    """Writes distances.csv while poses and distances come in.

    A row is written once the robot's pose and the distances to all beacons are there for one
    stamp: `stamp,x,y,yaw,<beacon>…,true_<beacon>…` in s, m and rad. The true distances follow
    from the pose and from where the beacons stand in the world.

    Args:
        folder: where the file goes; made if need be.
        beacons: true positions (m, m) by name.

    Raises:
        FileError: the file cannot be written, here and in all that adds to it.
    """

    def __init__(self, folder: Path, beacons: Mapping[str, Tuple[float, float]]):
        self.folder = make_folder(folder)
        self.beacons = dict(beacons)
        self._poses: Dict[int, PlanarPose] = {}
        self._measured: Dict[int, Dict[str, float]] = {}
        self._rows: Dict[int, List[float]] = {}
        names = [*self.beacons, *(f"true_{name}" for name in self.beacons)]
        self._header = ",".join(["stamp", "x", "y", "yaw", *names])
        self._file = RowFile(folder / FILE)
        self._file.write(self._header)

    def add_pose(self, stamp: int, pose: PlanarPose) -> None:
        """Record where the robot is (m, m, rad) at a stamp in ns."""
        self._poses[stamp] = pose
        self._complete(stamp)

    def add_distance(self, stamp: int, beacon: str, distance: float) -> None:
        """Record a measured distance in m at a stamp in ns."""
        self._measured.setdefault(stamp, {})[beacon] = distance
        self._complete(stamp)

    @property
    def newest(self) -> Optional[int]:
        """Stamp in ns of the newest whole row, or None."""
        return max(self._rows, default=None)

    def table(self) -> Optional[Tuple[Trajectory, np.ndarray, np.ndarray]]:
        """Return the robot's path and the measured and the true distances.

        Returns:
            A trajectory of n poses and two arrays (n, number of beacons) in m; None while there
            is no row.
        """
        stamps = sorted(self._rows)
        if not stamps:
            return None
        rows = np.array([self._rows[stamp] for stamp in stamps])
        path = Trajectory([stamp / NANOSECONDS for stamp in stamps], rows[:, :3])
        count = len(self.beacons)
        return path, rows[:, 3 : 3 + count], rows[:, 3 + count :]

    def finish(self, until: Optional[int] = None) -> None:
        """Close the file, in the order of the stamps; leave out what came after `until` in ns."""
        self._rows = {s: row for s, row in self._rows.items() if until is None or s <= until}
        lines = [self._header] + [_line(stamp, self._rows[stamp]) for stamp in sorted(self._rows)]
        self._file.rewrite(lines)

    def _complete(self, stamp: int) -> None:
        pose, measured = self._poses.get(stamp), self._measured.get(stamp, {})
        if pose is None or len(measured) < len(self.beacons):
            return
        true = [math.hypot(pose[0] - x, pose[1] - y) for x, y in self.beacons.values()]
        self._rows[stamp] = [*pose, *(measured[name] for name in self.beacons), *true]
        del self._poses[stamp], self._measured[stamp]
        self._file.write(_line(stamp, self._rows[stamp]))


def distances_summary(recording: DistancesRecording) -> Dict[str, Any]:
    """Return the figures of a recording for summary.json; empty lists without a row."""
    table = recording.table()
    names = list(recording.beacons)
    if table is None:
        return {"rows": 0, "beacons": names, "closest_m": [], "largest_error_m": []}
    path, measured, true = table
    return {
        "rows": len(path),
        "beacons": names,
        "closest_m": measured.min(axis=0).tolist(),
        "largest_error_m": np.abs(measured - true).max(axis=0).tolist(),
        "path_length_m": path.length(),
    }


def _line(stamp: int, row: Sequence[float]) -> str:
    return ",".join([f"{stamp / NANOSECONDS:.9f}", *(repr(float(value)) for value in row)])


BEACON_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE)
# Radius of meshes/beacon.dae in m.
BEACON_RADIUS = 0.25


def beacons_figure(
    beacons: Mapping[str, Tuple[float, float]],
    table: Optional[Tuple[Trajectory, np.ndarray, np.ndarray]],
    title: str = "Distances to the beacons",
) -> Figure:
    """Draw the way from above, and measured over true distances against time.

    Args:
        beacons: positions (m, m) by name.
        table: path, measured and true distances as of DistancesRecording; None for nothing yet.
        title: above all.
    """
    figure = new_figure(9.5, 7.0)
    figure.suptitle(title)
    above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": (1.0, 1.8)})
    figure.subplots_adjust(left=0.08, right=0.86, top=0.92, bottom=0.08, hspace=0.26)
    _draw_way(above, beacons, None if table is None else table[0])
    below.set(xlabel="simulated time (s)", ylabel="distance (m)")
    below.grid(alpha=0.3)
    if table is not None:
        _draw_distances(below, beacons, table)
    return figure


def _draw_way(
    axes: Axes, beacons: Mapping[str, Tuple[float, float]], path: Optional[Trajectory]
) -> None:
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    for (name, (x, y)), colour in zip(beacons.items(), _colours(len(beacons))):
        axes.add_patch(Circle((x, y), BEACON_RADIUS, facecolor=colour, edgecolor=BLACK))
        axes.annotate(name, (x, y + 1.2 * BEACON_RADIUS), ha="center", va="bottom")
        # A patch does not count for the limits of the axes.
        axes.plot(x, y, ".", color=colour)
    if path is not None:
        x, y = path.poses[:, 0], path.poses[:, 1]
        axes.plot(x, y, color=BLACK, linewidth=1.4)
        axes.plot(x[0], y[0], "o", color=GREEN, markeredgecolor=BLACK, label="start")
        axes.plot(x[-1], y[-1], "s", color="white", markeredgecolor=BLACK, label="end")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _draw_distances(
    axes: Axes,
    beacons: Mapping[str, Tuple[float, float]],
    table: Tuple[Trajectory, np.ndarray, np.ndarray],
) -> None:
    path, measured, true = table
    for column, (name, colour) in enumerate(zip(beacons, _colours(len(beacons)))):
        axes.plot(path.stamps, true[:, column], color=colour, linewidth=6.0, alpha=0.3)
        axes.plot(path.stamps, measured[:, column], color=colour, linewidth=1.5, label=name)
    axes.plot([], [], color=BLACK, linewidth=6.0, alpha=0.3, label="truth")
    axes.set_ylim(0.0, 1.05 * max(measured.max(), true.max()))
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _colours(count: int) -> list:
    return [BEACON_COLOURS[number % len(BEACON_COLOURS)] for number in range(count)]
