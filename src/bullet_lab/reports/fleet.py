"""The squares of a fleet: their paths, what they come down to, and all of them side by side."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from typing import Any, Collection, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, new_figure
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports.squares import (
    OdometryReport,
    PathsRecording,
    settings_line,
    squares_summary,
)

# Neighbours differ; the numbers tell the rest apart.
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, VERMILION, "#56B4E9")
WIDTH = 9.0
HEIGHTS = (4.0, 11.0)
# Inches around the paths for title, labels and legend: left, right, below, above.
FRAME = (0.7, 0.2, 1.0, 0.75)
# m around the paths.
MARGIN = 0.3

Paths = Tuple[Optional[Trajectory], Optional[Trajectory]]
"""The perfect and the noisy path of a robot; None for what is not there yet."""

# Of each robot, and in the mean over all of them.
ERRORS = ("final_error_m", "final_heading_error_deg", "ape_rmse_m")


class FleetReport(OdometryReport):
    """The perfect and the noisy path of each robot, in a folder of its own.

    The seeds are those of the robots' noise, by their names, which are their namespaces as well.
    """

    def __init__(self, folder: Path, seeds: Mapping[str, int]):
        clear_away(folder, seeds)
        super().__init__(folder, seeds)
        self._seeds = dict(seeds)

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        robots = [
            {"name": name, "seed": seed, **squares_summary(paths.perfect(), paths.pairs())}
            for (name, paths), seed in zip(self.robots.items(), self._seeds.values())
        ]
        return {"finished": finished, **run, **fleet_summary(robots)}

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        paths = {name: (its.perfect(), its.pairs()) for name, its in self.robots.items()}
        drawn = {name: (perfect, pairs and pairs[1]) for name, (perfect, pairs) in paths.items()}
        title = f"{len(drawn)} robots with noisy odometry{settings_line(self.about)}"
        return {"fleet.png": fleet_figure(drawn, title)}

    def line(self, summary: Mapping[str, Any]) -> str:
        robots = summary["robots"]
        squares = sum(len(robot["side_lengths_m"]) for robot in robots)
        parts = [f"{len(robots)} robots, {squares} sides"]
        if summary["final_error_m_rms"] is not None:
            parts.append(
                f"noisy paths end {summary['final_error_m_rms']:.3f} m rms off, "
                f"{summary['final_error_m_largest']:.3f} m at most"
            )
        if summary["real_time_factor"] is not None:
            parts.append(f"{summary['real_time_factor']:.1f} times real time")
        return "; ".join(parts)


def clear_away(folder: Path, names: Collection[str]) -> None:
    """Remove what an earlier, larger fleet has left in a folder, and nothing else."""
    for old in folder.glob("robot*"):
        if old.name in names or not old.name[len("robot") :].isdigit():
            continue
        for path in PathsRecording.FILES:
            with contextlib.suppress(FileNotFoundError):
                (old / path).unlink()
        # Somebody may keep files of their own there.
        with contextlib.suppress(OSError):
            old.rmdir()


def fleet_summary(robots: Sequence[Mapping[str, Any]]) -> Dict[str, Any]:
    """Return what `squares_summary` says of each robot, and figures of all.

    These are root mean squares and the largest of the errors; null where a robot has none.
    """
    values: Dict[str, Any] = {}
    for name in ERRORS:
        errors = [robot[name] for robot in robots]
        complete = bool(errors) and None not in errors
        values[f"{name}_rms"] = float(np.sqrt(np.mean(np.square(errors)))) if complete else None
        values[f"{name}_largest"] = float(np.max(np.abs(errors))) if complete else None
    return {**values, "robots": [dict(robot) for robot in robots]}


def fleet_figure(robots: Mapping[str, Paths], title: str) -> Figure:
    """Draw the perfect and the noisy path of each robot, with its name in the middle."""
    drawn = [path.poses[:, :2] for paths in robots.values() for path in paths if path is not None]
    places = np.concatenate(drawn) if drawn else np.zeros((1, 2))
    low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
    # To one scale in both directions, in inches.
    left, right, below, above = FRAME
    across, along = high - low
    scale = (WIDTH - left - right) / across
    height = float(np.clip(scale * along + below + above, *HEIGHTS))
    figure = new_figure(WIDTH, height)
    figure.suptitle(title)
    place = (left, below, WIDTH - left - right, height - below - above)
    axes = figure.add_axes(np.divide(place, (WIDTH, height, WIDTH, height)))
    axes.set(xlabel="x Distance (m)", ylabel="y Distance (m)")
    axes.set_aspect("equal")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.grid(alpha=0.3)
    for (name, paths), colour in zip(robots.items(), itertools.cycle(COLOURS)):
        _draw(axes, name, paths, colour)
    # What is what, in no robot's colour.
    axes.plot([], [], color=BLACK, linewidth=0.8, label="Perfect odom")
    axes.plot([], [], color=GREY, linewidth=1.8, label="Noisy odom, a colour for each robot")
    axes.plot([], [], "s", color=GREY, markeredgecolor=BLACK, markersize=5, label="its end")
    figure.legend(loc="lower center", ncol=3, frameon=False)
    return figure


def _draw(axes: Axes, name: str, paths: Paths, colour: str) -> None:
    perfect, noisy = paths
    if noisy is not None:
        axes.plot(*noisy.poses[:, :2].T, color=colour, linewidth=1.8)
        x, y = noisy.poses[-1, :2]
        axes.plot(x, y, "s", color=colour, markeredgecolor=BLACK, markersize=5)
    if perfect is not None:
        axes.plot(*perfect.poses[:, :2].T, color=BLACK, linewidth=0.8)
        x, y = perfect.poses[:, :2].min(axis=0) + perfect.poses[:, :2].max(axis=0)
        axes.text(0.5 * x, 0.5 * y, name, color=colour, ha="center", va="center")
