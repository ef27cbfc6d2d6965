"""What a robot's sensors measured on a drive: recorded and drawn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Optional, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION, new_figure
from bullet_lab.core.series import Series

# A push below this (N) is a touch that has just ended.
TOUCH = 0.1


@dataclass(frozen=True)
class Angles:
    """Of the rays of a scan, in rad: the first one's and the step to the next."""

    first: float
    step: float

    def of(self, count: int) -> np.ndarray:
        """Return the angles of so many rays."""
        return self.first + self.step * np.arange(count)


class SensorsRecording:
    """Writes odom.csv, scan.csv, range.csv, imu.csv and bumper.csv row by row.

    Args:
        folder: where they go.
        rays: number of a scan's.

    Raises:
        FileError: one cannot be written, here and in all that adds to it.
    """

    def __init__(self, folder: Path, rays: int):
        self.odom = Series(folder / "odom.csv", ("x", "y", "yaw"))
        self.scan = Series(folder / "scan.csv", [f"range_{ray}" for ray in range(rays)])
        self.range = Series(folder / "range.csv", ("range",))
        self.imu = Series(folder / "imu.csv", ("ax", "ay", "az", "wx", "wy", "wz"))
        self.bumper = Series(folder / "bumper.csv", ("points", "fx", "fy", "fz"))

    def all(self) -> Dict[str, Series]:
        """Return all series by name."""
        return dict(vars(self))

    def finish(self, until: Optional[int]) -> None:
        """Close all files; leave out what came after a stamp in ns, if one is given."""
        for series in self.all().values():
            series.finish(until)


def scan_points(recording: SensorsRecording, angles: Angles) -> np.ndarray:
    """Return what the scans saw, in the odometry's frame.

    A scan is placed by the pose of the same stamp, or the last one before it; the scanner is
    taken to stand above the robot's origin.

    Returns:
        Points (m, m), shape (n, 2).
    """
    stamps, poses = recording.odom.table()
    scan_stamps, ranges = recording.scan.table()
    if not len(stamps) or not len(scan_stamps):
        return np.zeros((0, 2))
    index = np.searchsorted(stamps, scan_stamps + 1e-9) - 1
    chosen = index >= 0
    x, y, yaw = (column[:, None] for column in poses[index[chosen]].T)
    bearing = yaw + angles.of(ranges.shape[1])[None, :]
    seen = np.isfinite(ranges[chosen])
    reach = np.where(seen, ranges[chosen], 0.0)
    points = np.stack([x + reach * np.cos(bearing), y + reach * np.sin(bearing)], axis=-1)
    return points[seen]


def sensors_summary(recording: SensorsRecording, touched: Sequence[str]) -> Dict[str, Any]:
    """Return the figures for summary.json; null where a sensor said nothing.

    Args:
        recording: of all sensors.
        touched: names of what the bumper touched.
    """
    _, ranges = recording.range.table()
    _, scans = recording.scan.table()
    _, inertial = recording.imu.table()
    stamps, bumps = recording.bumper.table()
    force = np.hypot(bumps[:, 1], bumps[:, 2])
    pushed = force > TOUCH
    return {
        "messages": {name: len(series.table()[0]) for name, series in recording.all().items()},
        "nearest_scan_m": _least(scans[np.isfinite(scans)]),
        "nearest_range_m": _least(ranges),
        "mean_upward_acceleration_mps2": float(inertial[:, 2].mean()) if len(inertial) else None,
        "greatest_turn_rate_radps": float(np.abs(inertial[:, 5]).max()) if len(inertial) else None,
        "touched": sorted(touched),
        "first_touch_s": float(stamps[pushed][0]) if pushed.any() else None,
        "median_push_N": float(np.median(force[pushed])) if pushed.any() else None,
    }


def _least(values: np.ndarray) -> Optional[float]:
    return float(values.min()) if values.size else None


def sensors_figure(recording: SensorsRecording, angles: Angles, title: str) -> Figure:
    """Draw all series.

    Args:
        recording: of all sensors; a series without rows is an empty panel.
        angles: of the scans' rays.
        title: above all.
    """
    figure = new_figure(12.5, 7.6)
    figure.suptitle(title)
    grid = figure.add_gridspec(5, 2, width_ratios=(1.0, 1.1))
    figure.subplots_adjust(left=0.06, right=0.98, top=0.93, bottom=0.07, hspace=0.22, wspace=0.18)
    _draw_plan(figure.add_subplot(grid[:, 0]), recording, angles)
    panels = [figure.add_subplot(grid[row, 1]) for row in range(5)]
    _draw_scan(panels[0], recording)
    stamps, ranges = recording.range.table()
    panels[1].plot(stamps, ranges, color=GREEN, linewidth=1.0)
    panels[1].set(ylabel="range (m)")
    stamps, inertial = recording.imu.table()
    for column, (name, colour) in enumerate(zip("xyz", (BLUE, ORANGE, PURPLE))):
        panels[2].plot(stamps, inertial[:, column], color=colour, linewidth=0.8, label=name)
        panels[3].plot(stamps, inertial[:, 3 + column], color=colour, linewidth=0.8, label=name)
    panels[2].set(ylabel="IMU (m/s²)")
    panels[3].set(ylabel="IMU (rad/s)")
    for panel in panels[2:4]:
        panel.legend(loc="upper left", ncol=3, fontsize=7)
    stamps, bumps = recording.bumper.table()
    panels[4].plot(stamps, np.hypot(bumps[:, 1], bumps[:, 2]), color=VERMILION, linewidth=1.0)
    panels[4].set(ylabel="bumper (N)", xlabel="simulated time (s)")
    _share_time(panels, recording)
    return figure


def _draw_plan(axes: Axes, recording: SensorsRecording, angles: Angles) -> None:
    axes.set(xlabel="x (m)", ylabel="y (m)", title="laser scans, placed by the odometry")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    points = scan_points(recording, angles)
    axes.plot(points[:, 0], points[:, 1], ".", color=VERMILION, markersize=1.0, alpha=0.3)
    _, poses = recording.odom.table()
    if len(poses):
        axes.plot(poses[:, 0], poses[:, 1], color=BLACK, linewidth=1.4)
        axes.plot(*poses[0, :2], "o", color="white", markeredgecolor=BLACK, label="start")
        axes.plot(*poses[-1, :2], "s", color=BLACK, label="end")
        axes.legend(loc="best")


def _draw_scan(axes: Axes, recording: SensorsRecording) -> None:
    stamps, scans = recording.scan.table()
    # A ray that meets nothing is +inf; one that meets something too near is -inf.
    nearest = [row[np.isfinite(row)].min(initial=np.inf) for row in scans]
    axes.plot(stamps, nearest, color=VERMILION, linewidth=1.0)
    axes.set(ylabel="nearest ray (m)")


def _share_time(panels, recording: SensorsRecording) -> None:
    stamps = [series.table()[0] for series in recording.all().values()]
    ends = [(column[0], column[-1]) for column in stamps if len(column)]
    for panel in panels:
        panel.grid(alpha=0.3)
        if ends:
            panel.set_xlim(min(first for first, _ in ends), max(last for _, last in ends))
        if panel is not panels[-1]:
            panel.set_xticklabels([])
