"""What a robot's sensors and its distances to beacons were on a drive: recorded and drawn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, Iterator, Mapping, Optional, Set, Tuple

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
from bullet_lab.core.files import Join, Series, SeriesError, Values
from bullet_lab.reports import Reading, Report

# A push below this (N) is a touch that has just ended.
TOUCH = 0.1
DISTANCES = "distances.csv"
BEACON_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE)
# Radius of meshes/beacon.dae in m.
BEACON_RADIUS = 0.25


class SensorsReport(Report):
    """Series of all sensors: odom.csv, scan.csv (of so many rays), range.csv, imu.csv, bumper.csv.

    Attributes:
        angles: rad, of the first ray of the newest scan, and the step to the next.
        touched: names of what the bumper touched.
    """

    def __init__(self, folder: Path, rays: int):
        super().__init__(folder)
        self.topics = {
            "odom": "nav_msgs/Odometry",
            "scan": "sensor_msgs/LaserScan",
            "sonar": "sensor_msgs/Range",
            "imu": "sensor_msgs/Imu",
            "bumper": "gazebo_msgs/ContactsState",
        }
        self.odom = Series(folder / "odom.csv", ("x", "y", "yaw"))
        self.scan = Series(folder / "scan.csv", [f"range_{ray}" for ray in range(rays)])
        self.range = Series(folder / "range.csv", ("range",))
        self.imu = Series(folder / "imu.csv", ("ax", "ay", "az", "wx", "wy", "wz"))
        self.bumper = Series(folder / "bumper.csv", ("points", "fx", "fy", "fz"))
        every = (self.odom, self.scan, self.range, self.imu, self.bumper)
        self.series = dict(zip(self.topics, every))
        self.angles = (0.0, 0.0)
        self.touched: Set[str] = set()

    def take(self, topic: str, reading: Reading) -> bool:
        super().take(topic, reading)
        if topic == "scan":
            self.angles = reading.detail
        elif topic == "bumper":
            self.touched.update(reading.detail)
        return True

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        (_, ranges), (_, scans) = self.range.table(), self.scan.table()
        (_, inertial), (stamps, bumps) = self.imu.table(), self.bumper.table()
        force = np.hypot(bumps[:, 1], bumps[:, 2])
        pushed = force > TOUCH
        rows = {topic: len(series) for topic, series in self.series.items()}
        return {
            "finished": finished,
            "messages": {"range" if name == "sonar" else name: n for name, n in rows.items()},
            "nearest_scan_m": _of(np.min, scans[np.isfinite(scans)]),
            "nearest_range_m": _of(np.min, ranges),
            "mean_upward_acceleration_mps2": _of(np.mean, inertial[:, 2]),
            "greatest_turn_rate_radps": _of(np.max, np.abs(inertial[:, 5])),
            "touched": sorted(self.touched),
            "first_touch_s": _of(np.min, stamps[pushed]),
            "median_push_N": _of(np.median, force[pushed]),
            **run,
        }

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        figure = new_figure(12.5, 7.6)
        figure.suptitle("What the sensors measured")
        grid = figure.add_gridspec(5, 2, width_ratios=(1.0, 1.1))
        figure.subplots_adjust(
            left=0.06, right=0.98, top=0.93, bottom=0.07, hspace=0.22, wspace=0.18
        )
        _draw_plan(figure.add_subplot(grid[:, 0]), self)
        panels = [figure.add_subplot(grid[row, 1]) for row in range(5)]
        (scanned, scans), (ranged, ranges) = self.scan.table(), self.range.table()
        # A ray that meets nothing is +inf; one that meets something too near is -inf.
        nearest = [row[np.isfinite(row)].min(initial=np.inf) for row in scans]
        panels[0].plot(scanned, nearest, color=VERMILION, linewidth=1.0)
        panels[1].plot(ranged, ranges, color=GREEN, linewidth=1.0)
        stamps, inertial = self.imu.table()
        for column, (name, colour) in enumerate(zip("xyz", (BLUE, ORANGE, PURPLE))):
            panels[2].plot(stamps, inertial[:, column], color=colour, linewidth=0.8, label=name)
            panels[3].plot(stamps, inertial[:, 3 + column], color=colour, linewidth=0.8, label=name)
        for panel in panels[2:4]:
            panel.legend(loc="upper left", ncol=3, fontsize=7)
        stamps, bumps = self.bumper.table()
        panels[4].plot(stamps, np.hypot(bumps[:, 1], bumps[:, 2]), color=VERMILION, linewidth=1.0)
        panels[4].set(xlabel="simulated time (s)")
        units = ("nearest ray (m)", "range (m)", "IMU (m/s²)", "IMU (rad/s)", "bumper (N)")
        times = np.concatenate([series.table()[0] for series in self.series.values()])
        for panel, unit in zip(panels, units):
            panel.set(ylabel=unit)
            panel.grid(alpha=0.3)
            if times.size:
                panel.set_xlim(times.min(), times.max())
            if panel is not panels[-1]:
                panel.set_xticklabels([])
        return {"sensors.png": figure}


def scan_points(report: SensorsReport) -> np.ndarray:
    """Return what the scans saw, in the odometry's frame.

    A scan is placed by the pose of the same stamp, or the last one before it; the scanner is
    taken to stand above the robot's origin.

    Returns:
        Points in m, shape (n, 2).
    """
    stamps, poses = report.odom.table()
    scan_stamps, ranges = report.scan.table()
    if not len(stamps) or not len(scan_stamps):
        return np.zeros((0, 2))
    index = np.searchsorted(stamps, scan_stamps + 1e-9) - 1
    chosen = index >= 0
    x, y, yaw = (column[:, None] for column in poses[index[chosen]].T)
    first, step = report.angles
    bearing = yaw + (first + step * np.arange(ranges.shape[1]))[None, :]
    seen = np.isfinite(ranges[chosen])
    reach = np.where(seen, ranges[chosen], 0.0)
    points = np.stack([x + reach * np.cos(bearing), y + reach * np.sin(bearing)], axis=-1)
    return points[seen]


def _of(figure: Any, values: np.ndarray) -> Optional[float]:
    """Return a figure of some values; None where a sensor said nothing."""
    return float(figure(values)) if values.size else None


def _draw_plan(axes: Axes, report: SensorsReport) -> None:
    plan_axes(axes, title="laser scans, placed by the odometry")
    points = scan_points(report)
    axes.plot(points[:, 0], points[:, 1], ".", color=VERMILION, markersize=1.0, alpha=0.3)
    _, poses = report.odom.table()
    if len(poses):
        axes.plot(poses[:, 0], poses[:, 1], color=BLACK, linewidth=1.4)
        axes.plot(*poses[0, :2], "o", color="white", markeredgecolor=BLACK, label="start")
        axes.plot(*poses[-1, :2], "s", color=BLACK, label="end")
        axes.legend(loc="best")


class BeaconsReport(Report):
    """Rows `x,y,yaw,<beacon>…,true_<beacon>…` in m and rad, in distances.csv.

    A row is written once the robot's pose and the distances to all beacons are there for one
    stamp. The true distances follow from the pose and from where the beacons stand (m, m).
    """

    def __init__(self, folder: Path, beacons: Mapping[str, Tuple[float, float]]):
        super().__init__(folder)
        self.beacons = dict(beacons)
        ranges = {f"{name}/range": "sensor_msgs/Range" for name in self.beacons}
        self.topics = {"odom": "nav_msgs/Odometry", **ranges}
        columns = ["x", "y", "yaw", *self.beacons, *(f"true_{name}" for name in self.beacons)]
        self._rows = Series(folder / DISTANCES, columns, in_order=False)
        self.series = {DISTANCES: self._rows}
        self._join = Join(self.topics, self._complete)

    def take(self, topic: str, reading: Reading) -> bool:
        if not all(map(math.isfinite, reading.values)):
            raise SeriesError("a distance of {}".format(*reading.values))
        self._join.add(topic, reading.stamp, reading.values)
        return True

    def _complete(self, stamp: int, found: Dict[str, Values]) -> None:
        x, y, _ = pose = found["odom"]
        measured = [value for name in self.beacons for value in found[f"{name}/range"]]
        true = [math.hypot(x - bx, y - by) for bx, by in self.beacons.values()]
        self._rows.add(stamp, [*pose, *measured, *true])

    def _distances(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the measured and the true distances in m, shape (n, beacons)."""
        return tuple(np.hsplit(self._rows.table()[1][:, 3:], 2))

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        path, (measured, true) = self._rows.path(), self._distances()
        figures = {"rows": len(measured), "beacons": list(self.beacons)}
        if path is None:
            return {"finished": finished, **figures, "closest_m": [], "largest_error_m": [], **run}
        return {
            "finished": finished,
            **figures,
            "closest_m": measured.min(axis=0).tolist(),
            "largest_error_m": np.abs(measured - true).max(axis=0).tolist(),
            "path_length_m": path.length(),
            **run,
        }

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        figure = new_figure(9.5, 7.0)
        figure.suptitle("Distances to the beacons")
        above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": (1.0, 1.8)})
        figure.subplots_adjust(left=0.08, right=0.86, top=0.92, bottom=0.08, hspace=0.26)
        plan_axes(above)
        for name, (x, y), colour in self._coloured():
            above.add_patch(Circle((x, y), BEACON_RADIUS, facecolor=colour, edgecolor=BLACK))
            above.annotate(name, (x, y + 1.2 * BEACON_RADIUS), ha="center", va="bottom")
            # A patch does not count for the limits of the axes.
            above.plot(x, y, ".", color=colour)
        below.set(xlabel="simulated time (s)", ylabel="distance (m)")
        below.grid(alpha=0.3)
        if len(self._rows):
            self._draw_rows(above, below)
            for axes in (above, below):
                axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return {"distances.png": figure}

    def _draw_rows(self, way: Axes, curves: Axes) -> None:
        path, (measured, true) = self._rows.path(), self._distances()
        x, y = path.poses[:, 0], path.poses[:, 1]
        way.plot(x, y, color=BLACK, linewidth=1.4)
        way.plot(x[0], y[0], "o", color=GREEN, markeredgecolor=BLACK, label="start")
        way.plot(x[-1], y[-1], "s", color="white", markeredgecolor=BLACK, label="end")
        for column, (name, _, colour) in enumerate(self._coloured()):
            curves.plot(path.stamps, true[:, column], color=colour, linewidth=6.0, alpha=0.3)
            curves.plot(path.stamps, measured[:, column], color=colour, linewidth=1.5, label=name)
        curves.plot([], [], color=BLACK, linewidth=6.0, alpha=0.3, label="truth")
        curves.set_ylim(0.0, 1.05 * max(measured.max(), true.max()))

    def _coloured(self) -> Iterator[Tuple[str, Tuple[float, float], str]]:
        for number, (name, place) in enumerate(self.beacons.items()):
            yield name, place, BEACON_COLOURS[number % len(BEACON_COLOURS)]
