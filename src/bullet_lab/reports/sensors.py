"""What a robot's sensors measured on a drive: recorded and drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Set

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
from bullet_lab.core.series import Series
from bullet_lab.reports import Reading, Report

# A push below this (N) is a touch that has just ended.
TOUCH = 0.1


class SensorsReport(Report):
    """Series of all sensors: odom.csv, scan.csv, range.csv, imu.csv and bumper.csv.

    Attributes:
        angles: rad, of the first ray of the newest scan, and the step to the next.
        touched: names of what the bumper touched.

    Args:
        folder: where the files go.
        rays: number of a scan's.
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
        """Record what a sensor measured; see `Report`."""
        super().take(topic, reading)
        if topic == "scan":
            self.angles = reading.detail
        elif topic == "bumper":
            self.touched.update(reading.detail)
        return True

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        """Return the figures for summary.json; null where a sensor said nothing."""
        _, ranges = self.range.table()
        _, scans = self.scan.table()
        _, inertial = self.imu.table()
        stamps, bumps = self.bumper.table()
        force = np.hypot(bumps[:, 1], bumps[:, 2])
        pushed = force > TOUCH
        turns = np.abs(inertial[:, 5])
        return {
            "finished": finished,
            "messages": {
                "range" if topic == "sonar" else topic: len(series)
                for topic, series in self.series.items()
            },
            "nearest_scan_m": _least(scans[np.isfinite(scans)]),
            "nearest_range_m": _least(ranges),
            "mean_upward_acceleration_mps2": (
                float(inertial[:, 2].mean()) if len(inertial) else None
            ),
            "greatest_turn_rate_radps": float(turns.max()) if len(turns) else None,
            "touched": sorted(self.touched),
            "first_touch_s": float(stamps[pushed][0]) if pushed.any() else None,
            "median_push_N": float(np.median(force[pushed])) if pushed.any() else None,
            **run,
        }

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        """Return the picture by the name of its file."""
        figure = new_figure(12.5, 7.6)
        figure.suptitle("What the sensors measured")
        grid = figure.add_gridspec(5, 2, width_ratios=(1.0, 1.1))
        figure.subplots_adjust(
            left=0.06, right=0.98, top=0.93, bottom=0.07, hspace=0.22, wspace=0.18
        )
        _draw_plan(figure.add_subplot(grid[:, 0]), self)
        panels = [figure.add_subplot(grid[row, 1]) for row in range(5)]
        _draw_scan(panels[0], self)
        stamps, ranges = self.range.table()
        panels[1].plot(stamps, ranges, color=GREEN, linewidth=1.0)
        panels[1].set(ylabel="range (m)")
        stamps, inertial = self.imu.table()
        for column, (name, colour) in enumerate(zip("xyz", (BLUE, ORANGE, PURPLE))):
            panels[2].plot(stamps, inertial[:, column], color=colour, linewidth=0.8, label=name)
            panels[3].plot(stamps, inertial[:, 3 + column], color=colour, linewidth=0.8, label=name)
        panels[2].set(ylabel="IMU (m/s²)")
        panels[3].set(ylabel="IMU (rad/s)")
        for panel in panels[2:4]:
            panel.legend(loc="upper left", ncol=3, fontsize=7)
        stamps, bumps = self.bumper.table()
        panels[4].plot(stamps, np.hypot(bumps[:, 1], bumps[:, 2]), color=VERMILION, linewidth=1.0)
        panels[4].set(ylabel="bumper (N)", xlabel="simulated time (s)")
        _share_time(panels, self)
        return {"sensors.png": figure}

    def line(self, summary: Mapping[str, Any]) -> str:
        """Return where all is."""
        return f"what the sensors measured is in {self.folder}"


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


def _least(values: np.ndarray) -> Optional[float]:
    return float(values.min()) if values.size else None


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


def _draw_scan(axes: Axes, report: SensorsReport) -> None:
    stamps, scans = report.scan.table()
    # A ray that meets nothing is +inf; one that meets something too near is -inf.
    nearest = [row[np.isfinite(row)].min(initial=np.inf) for row in scans]
    axes.plot(stamps, nearest, color=VERMILION, linewidth=1.0)
    axes.set(ylabel="nearest ray (m)")


def _share_time(panels, report: SensorsReport) -> None:
    stamps = [series.table()[0] for series in report.series.values()]
    ends = [(column[0], column[-1]) for column in stamps if len(column)]
    for panel in panels:
        panel.grid(alpha=0.3)
        if ends:
            panel.set_xlim(min(first for first, _ in ends), max(last for _, last in ends))
        if panel is not panels[-1]:
            panel.set_xticklabels([])
