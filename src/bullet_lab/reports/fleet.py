"""The report of the job `fleet`: the squares of several robots, and their paths side by side."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from typing import Collection, Mapping, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    new_figure,
    plan_axes,
)
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports import Figures, Reading, Report, Summary, earliest
from bullet_lab.reports.squares import SquaresReport, settings_line, squares_summary

# Robots beside each other differ in colour; their numbers tell the others apart.
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, VERMILION, "#56B4E9")
# Inches of the figure; its height depends on the paths, within limits.
WIDTH = 9.0
HEIGHTS = (4.0, 11.0)
# Inches around the paths for title, labels and legend: left, right, below, above.
FRAME = (0.7, 0.2, 1.0, 0.75)
# m around the paths.
MARGIN = 0.3

Paths = Tuple[Optional[Trajectory], Optional[Trajectory]]
"""The perfect and the noisy path of a robot; None for none."""

# Figures of each robot that summary.json also has for the whole fleet.
ERRORS = ("final_error_m", "final_heading_error_deg", "ape_rmse_m")


class FleetReport(Report):
    """The perfect and the noisy path of each robot, in a folder of its own.

    Args:
        folder: for the files.
        seeds: of the robots' noise, by their names, which are also their namespaces.

    Attributes:
        robots: the recording of each robot.
    """

    def __init__(self, folder: Path, seeds: Mapping[str, int]):
        clear_away(folder, seeds)
        super().__init__(folder)
        self._seeds = seeds
        self.robots = {name: SquaresReport(folder / name, name) for name in seeds}
        for paths in self.robots.values():
            self.topics.update(paths.topics)
            paths.on_reset = lambda old: self.on_reset(old)

    def take(self, topic: str, reading: Reading) -> bool:
        # Without the covariances, which the figures of a fleet do not show.
        return self.robots[topic.partition("/")[0]].take(topic, reading._replace(detail=None))

    def newest(self) -> int | None:
        return earliest(paths.newest() for paths in self.robots.values())

    def finish(self, until: int | None = None) -> None:
        for paths in self.robots.values():
            paths.finish(until)

    def seconds(self) -> float:
        return max(paths.seconds() for paths in self.robots.values())

    def summary(self, finished: bool, run: Summary) -> Summary:
        robots = []
        for name, paths in self.robots.items():
            figures = squares_summary(paths.perfect(), paths.pairs())
            robots.append({"name": name, "seed": self._seeds[name], **figures})
        return {"finished": finished, **run, **fleet_summary(robots)}

    def figures(self, summary: Summary) -> Figures:
        drawn = {}
        for name, paths in self.robots.items():
            pairs = paths.pairs()
            drawn[name] = (paths.perfect(), pairs and pairs[1])
        title = f"{len(drawn)} robots with noisy odometry{settings_line(self.about)}"
        return {"fleet.png": fleet_figure(drawn, title)}

    def line(self, summary: Summary) -> str:
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
    """Remove the files of an earlier, larger fleet from a folder, and no other files."""
    for old in folder.glob("robot*"):
        if old.name in names or not old.name[len("robot") :].isdigit():
            continue
        for path in SquaresReport.FILES:
            with contextlib.suppress(FileNotFoundError):
                (old / path).unlink()
        # The folder stays if there are files of the user in it.
        with contextlib.suppress(OSError):
            old.rmdir()


def fleet_summary(robots: Sequence[Summary]) -> Summary:
    """Return the entries of the robots, and the root mean square and the largest of each error.

    Those are None if a robot has no error.
    """
    values = {}
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
    figure, axes = _figure_for(high - low, title)
    limits = {"xlim": (low[0], high[0]), "ylim": (low[1], high[1])}
    labels = {"xlabel": "x Distance (m)", "ylabel": "y Distance (m)"}
    plan_axes(axes, **labels, adjustable="box", **limits)
    for (name, paths), colour in zip(robots.items(), itertools.cycle(COLOURS)):
        _draw(axes, name, paths, colour)
    # The legend has no robot's colour.
    axes.plot([], [], color=BLACK, linewidth=0.8, label="Perfect odom")
    axes.plot([], [], color=GREY, linewidth=1.8, label="Noisy odom, a colour for each robot")
    axes.plot([], [], "s", color=GREY, markeredgecolor=BLACK, markersize=5, label="its end")
    figure.legend(loc="lower center", ncol=3, frameon=False)
    return figure


def _figure_for(size: np.ndarray, title: str) -> tuple[Figure, Axes]:
    """Return a figure, and axes in it for an area (m, m) with one scale in both directions."""
    left, right, below, above = FRAME
    across, along = size
    width = WIDTH - left - right
    height = float(np.clip(width / across * along + below + above, *HEIGHTS))
    figure = new_figure(WIDTH, height, title)
    place = (left, below, width, height - below - above)
    return figure, figure.add_axes(np.divide(place, (WIDTH, height, WIDTH, height)))


def _draw(axes: Axes, name: str, paths: Paths, colour: str) -> None:
    perfect, noisy = paths
    if noisy is not None:
        x, y, _ = noisy.poses.T
        axes.plot(x, y, color=colour, linewidth=1.8)
        axes.plot(x[-1], y[-1], "s", color=colour, markeredgecolor=BLACK, markersize=5)
    if perfect is not None:
        x, y, _ = perfect.poses.T
        axes.plot(x, y, color=BLACK, linewidth=0.8)
        middle = 0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())
        axes.text(*middle, name, color=colour, ha="center", va="center")
