"""Distances to beacons: recorded beside the truth, and drawn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILION,
    new_figure,
    plan_axes,
)
from bullet_lab.core.series import Join, Series, SeriesError, Values
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports import Reading, Report

FILE = "distances.csv"
BEACON_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE)
# Radius of meshes/beacon.dae in m.
BEACON_RADIUS = 0.25
Table = Tuple[Trajectory, np.ndarray, np.ndarray]
"""The robot's path, and the measured and the true distances in m, shape (n, beacons)."""


class BeaconsReport(Report):
    """Rows `x,y,yaw,<beacon>…,true_<beacon>…` in m and rad, in distances.csv.

    A row is written once the robot's pose and the distances to all beacons are there for one
    stamp. The true distances follow from the pose and from where the beacons stand.

    Args:
        folder: where the files go.
        beacons: true positions (m, m) by name.
    """

    def __init__(self, folder: Path, beacons: Mapping[str, Tuple[float, float]]):
        super().__init__(folder)
        self.beacons = dict(beacons)
        self.topics = {
            "odom": "nav_msgs/Odometry",
            **{f"{name}/range": "sensor_msgs/Range" for name in self.beacons},
        }
        columns = ["x", "y", "yaw", *self.beacons, *(f"true_{name}" for name in self.beacons)]
        self._rows = Series(folder / FILE, columns, in_order=False)
        self.series = {FILE: self._rows}
        self._join = Join(self.topics, self._complete)

    def take(self, topic: str, reading: Reading) -> bool:
        """Record a pose or a distance; see `Report`."""
        if not all(map(math.isfinite, reading.values)):
            raise SeriesError("a distance of {}".format(*reading.values))
        self._join.add(topic, reading.stamp, reading.values)
        return True

    def table(self) -> Optional[Table]:
        """Return what was recorded; None while there is no row."""
        path, count = self._rows.path(), len(self.beacons)
        if path is None:
            return None
        distances = self._rows.table()[1][:, 3:]
        return path, distances[:, :count], distances[:, count:]

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        """Return the figures for summary.json; empty lists without a row."""
        return {"finished": finished, **self._distances(), **run}

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        """Return the picture by the name of its file."""
        table = self.table()
        figure = new_figure(9.5, 7.0)
        figure.suptitle("Distances to the beacons")
        above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": (1.0, 1.8)})
        figure.subplots_adjust(left=0.08, right=0.86, top=0.92, bottom=0.08, hspace=0.26)
        _draw_way(above, self.beacons, None if table is None else table[0])
        below.set(xlabel="simulated time (s)", ylabel="distance (m)")
        below.grid(alpha=0.3)
        if table is not None:
            _draw_distances(below, self.beacons, table)
        return {"distances.png": figure}

    def line(self, summary: Mapping[str, Any]) -> str:
        """Return where all is."""
        return f"distances to {len(self.beacons)} beacons in {self.folder}"

    def _distances(self) -> Dict[str, Any]:
        table = self.table()
        names = list(self.beacons)
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

    def _complete(self, stamp: int, found: Dict[str, Values]) -> None:
        x, y, _ = pose = found["odom"]
        measured = [value for name in self.beacons for value in found[f"{name}/range"]]
        true = [math.hypot(x - bx, y - by) for bx, by in self.beacons.values()]
        self._rows.add(stamp, [*pose, *measured, *true])


def _draw_way(
    axes: Axes, beacons: Mapping[str, Tuple[float, float]], path: Optional[Trajectory]
) -> None:
    plan_axes(axes)
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


def _draw_distances(axes: Axes, beacons: Mapping[str, Tuple[float, float]], table: Table) -> None:
    path, measured, true = table
    for column, (name, colour) in enumerate(zip(beacons, _colours(len(beacons)))):
        axes.plot(path.stamps, true[:, column], color=colour, linewidth=6.0, alpha=0.3)
        axes.plot(path.stamps, measured[:, column], color=colour, linewidth=1.5, label=name)
    axes.plot([], [], color=BLACK, linewidth=6.0, alpha=0.3, label="truth")
    axes.set_ylim(0.0, 1.05 * max(measured.max(), true.max()))
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _colours(count: int) -> list:
    return [BEACON_COLOURS[number % len(BEACON_COLOURS)] for number in range(count)]
