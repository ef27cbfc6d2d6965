"""What a robot's sensors measured: a plan of the scans, and the others over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.plotting.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION, new_figure
from bullet_lab.recording.sensors import Angles, SensorsRecording, scan_points


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
