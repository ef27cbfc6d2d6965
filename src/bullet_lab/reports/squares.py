"""The reports of the jobs `squares` and `fleet`: perfect and noisy paths, sides, turns, errors."""

from __future__ import annotations

import itertools
import math
import textwrap
from pathlib import Path
from typing import Any, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    gridded,
    new_figure,
    plan_axes,
)
from bullet_lab.core.files import Join, PathSeries, Series
from bullet_lab.core.parameters import declarations
from bullet_lab.core.se2 import ellipse_points, hypot
from bullet_lab.core.trajectory import CSV_HEADER, Trajectory, path_error
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.reports import Figures, Reading, Report, Summary, earliest

# Number of ellipses that are drawn along the noisy path.
ELLIPSES = 12
# Characters in a line of a title, in a small font; longer lines than the second need that font.
_TITLE_WIDTH = 130
_SMALL_FROM = 95
# A no-break space.
_FIXED = "\xa0"
# Figures of `path_error` in summary.json.
ERRORS = (
    "final_error_m",
    "final_heading_error_deg",
    "ape_rmse_m",
    "ape_max_m",
    "heading_rmse_deg",
)

TURNING_RADIUS = 0.1
"""m; a message is part of a drive if the radius of its curve is at least this large."""

MIN_SIDE = 0.05
"""m; a shorter drive is not a side and is merged into the turns beside it."""

MIN_TURN = math.radians(5.0)
"""rad; a smaller turn is not a corner and is merged into the drives beside it."""

MIN_STRAIGHTNESS = 0.9
"""Distance between the ends of a side over the distance driven; below, the path is a curve."""

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
FLEET_ERRORS = ("final_error_m", "final_heading_error_deg", "ape_rmse_m")


class SquarePath(NamedTuple):
    """The sides and turns of a path of straight drives and turns on the spot.

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

    Only drives of at least `MIN_SIDE` and turns of at least `MIN_TURN` count; rests and shorter
    pieces belong to the drive or turn that they interrupt. An unfinished square gives the sides
    and turns that it has. A path that does not move, or has a curved side, gives none.
    """
    positions = trajectory.poses[:, :2]
    headings = np.unwrap(trajectory.poses[:, 2])
    drives, turns = _cut(positions, headings)
    if not all(_is_straight(positions[start : end + 1]) for start, end in drives):
        drives, turns = [], []
    # The message between a drive and a turn has a share of both, hence one more at each end.
    last = len(trajectory) - 1
    sides = [
        float(hypot(*(positions[min(end + 1, last)] - positions[max(start - 1, 0)])))
        for start, end in drives
    ]
    angles = [
        float(np.degrees(abs(headings[min(end + 1, last)] - headings[start - 1])))
        for start, end in turns
    ]
    return SquarePath(sides, angles, float(hypot(*(positions[-1] - positions[0]))))


def _cut(positions: ndarray, headings: ndarray):
    """Return the drives, and the turns after the first of them, as pairs of pose indices."""
    distances = hypot(*np.diff(positions, axis=0).T)
    is_drive = distances >= TURNING_RADIUS * np.abs(np.diff(headings))
    if not is_drive.size:
        return [], []
    edges = np.concatenate([[0], np.flatnonzero(np.diff(is_drive)) + 1, [is_drive.size]])
    first_is_drive = bool(is_drive[0])

    # Drives and turns alternate. The least significant piece is merged with its neighbours, until
    # all that are left are significant.
    while True:
        drive = (np.arange(len(edges) - 1) % 2 == 0) == first_is_drive
        distance = hypot(*np.diff(positions[edges], axis=0).T)
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


def _is_straight(positions: ndarray) -> bool:
    driven = hypot(*np.diff(positions, axis=0).T).sum()
    return bool(hypot(*(positions[-1] - positions[0])) >= MIN_STRAIGHTNESS * driven)


class SquaresReport(Report):
    """The perfect and the noisy path of one robot: odom.tum, noisy_odom.tum and paths.csv.

    Poses of the two paths are paired if their stamps agree to the nanosecond. Each row is written
    at once; `finish` writes the files once more. The topics are in a namespace, if it is not empty.
    """

    PERFECT, NOISY = "odom", "noisy_odom"

    def __init__(self, folder: Path, namespace: str = ""):
        super().__init__(folder)
        for name in (self.NOISY, self.PERFECT):
            self.topics[f"{namespace}/{name}".lstrip("/")] = "nav_msgs/Odometry"
        # Covariance (m²) of the noisy position by stamp in ns, for the ellipses in the figure.
        self._covariances: dict[int, Any] = {}
        paths = (self.PERFECT, self.NOISY)
        self.series = {name: PathSeries(self.folder / f"{name}.tum") for name in paths}
        self._pairs = Series(self.folder / "paths.csv", CSV_HEADER.split(",")[1:])
        self._join = Join(
            self.series,
            lambda stamp, both: self._pairs.add(stamp, [*both[self.PERFECT], *both[self.NOISY]]),
        )

    def take(self, topic: str, reading: Reading) -> bool:
        name = topic.rpartition("/")[2]
        super().take(name, reading)
        self._join.add(name, reading.stamp, reading.values)
        if name == self.NOISY and reading.detail is not None:
            self._covariances[reading.stamp] = reading.detail
        return True

    def perfect(self) -> Trajectory | None:
        """Return the whole perfect path, or None while there is none."""
        return self.series[self.PERFECT].path()

    def pairs(self) -> tuple[Trajectory, Trajectory] | None:
        """Return the paired poses of both paths, or None while there are none."""
        return (self._pairs.path(0), self._pairs.path(3)) if len(self._pairs) else None

    def finish(self, until: int | None = None) -> None:
        super().finish(until)
        self._pairs.finish(until)

    def summary(self, finished: bool, run: Summary) -> Summary:
        return {"finished": finished, **self.measured(), **run}

    def measured(self) -> Summary:
        """Return the figures of the square; None for unknown."""
        perfect, pairs = self.perfect(), self.pairs()
        found = {"side_lengths_m": [], "turns_deg": []}
        found.update(dict.fromkeys(("closure_error_m", "path_length_m", *ERRORS)), pairs=0)
        if perfect is not None:
            found.update(analyse(perfect)._asdict(), path_length_m=perfect.length())
        if pairs is not None:
            error = path_error(*pairs)
            found.update({name: getattr(error, name) for name in ERRORS}, pairs=len(pairs[0]))
        return found

    def figures(self, summary: Summary) -> Figures:
        pairs = self.pairs()
        title = f"Noise generated by /noisy_odom{settings_line(self.about)}"
        # The algorithm of the report does not change the covariances of the odometry.
        has_covariances = pairs is not None and not self.about.get("as_published")
        ellipses = self._ellipses(pairs[1]) if has_covariances else []
        return {"paths.png": noise_figure(self.perfect(), pairs, title, ellipses)}

    @staticmethod
    def line(summary: Summary) -> str:
        sides = " ".join(f"{side:.3f}" for side in summary["side_lengths_m"])
        turns = " ".join(f"{turn:.2f}" for turn in summary["turns_deg"])
        parts = [f"sides {sides} m"] if sides else ["no sides"]
        if turns:
            parts.append(f"turns {turns} deg")
        if summary["final_error_m"] is not None:
            parts.append(
                f"noisy path ends {summary['final_error_m']:.3f} m and "
                f"{summary['final_heading_error_deg']:.1f} deg off"
            )
            rms, most = summary["ape_rmse_m"], summary["ape_max_m"]
            parts.append(f"APE {rms:.3f} m rms, {most:.3f} m at most")
        return "; ".join(parts)

    def _ellipses(self, noisy: Trajectory) -> list[ndarray]:
        """Return the 95 % ellipses of the noisy odometry, evenly spaced along its path."""
        travelled = noisy.travelled()
        places = np.linspace(0.0, travelled[-1], ELLIPSES + 1)[1:]
        chosen = np.unique(np.searchsorted(travelled, places).clip(max=len(noisy) - 1))
        found = [(i, self._covariances.get(round(noisy.stamps[i] * 1e9))) for i in chosen]
        return [
            noisy.poses[i, :2] + ellipse_points(covariance)
            for i, covariance in found
            if covariance is not None
        ]


def settings_line(about: Summary) -> str:
    """Return the settings of the noise as further lines of a title; may be empty."""
    model = None if about.get("as_published") else about.get("model")
    own = declarations(MODELS[model]) if model in MODELS else ("std",)
    keys = [key for key in (*own, "model", "mode", "seed") if key in about]
    systematic = declarations(SystematicErrors).items()
    keys += [key for key, its in systematic if about.get(key, its.default) != its.default]
    parts = [f"{key} = {about[key]}" for key in keys]
    if about.get("as_published"):
        parts.append("as published")
    # A line may end between two settings, but not within one.
    lines = textwrap.wrap(" ".join(f"{part.replace(' ', _FIXED)}," for part in parts), _TITLE_WIDTH)
    return "".join(f"\n{line}" for line in lines).replace(_FIXED, " ").rstrip(",")


def noise_figure(
    perfect: Trajectory | None,
    pairs: tuple[Trajectory, Trajectory] | None,
    title: str = "Noise generated by /noisy_odom",
    ellipses: Sequence[ndarray] = (),
) -> Figure:
    """Draw both paths, each coordinate against time, and the error against distance.

    Paths are as `SquaresReport` returns them; `ellipses` are outlines around noisy poses, (n, 2)
    arrays in m.
    """
    figure = new_figure(11.0, 6.6)
    is_long = max(map(len, title.split("\n"))) > _SMALL_FROM
    figure.suptitle(title, fontsize="small" if is_long else "large")
    left, right = figure.add_gridspec(
        1, 2, width_ratios=(1.25, 1.0), wspace=0.2, left=0.07, right=0.98, top=0.91, bottom=0.08
    )
    above, below = right.subgridspec(2, 1, height_ratios=(3.4, 1.0), hspace=0.24)
    axes = figure.add_subplot(left)
    for number, outline in enumerate(ellipses):
        label = None if number else "95 % ellipses"
        axes.plot(*outline.T, color=BLUE, linewidth=0.8, alpha=0.7, label=label)
    drawn = [(pairs and pairs[1], BLUE, "Noisy odom"), (perfect, ORANGE, "Perfect odom")]
    drawn = [(path, colour, name) for path, colour, name in drawn if path is not None]
    _draw_paths(axes, drawn)
    rows = above.subgridspec(3, 1, hspace=0.12)
    _draw_coordinates([figure.add_subplot(row) for row in rows], drawn)
    axes = figure.add_subplot(below)
    gridded(axes, xlabel="distance travelled (m)", ylabel="error (m)")
    if pairs is not None:
        error = path_error(*pairs)
        axes.plot(error.travelled, error.error, color=VERMILION, linewidth=1.4)
        axes.set_ylim(bottom=0.0)
    return figure


def _draw_paths(axes: Axes, drawn: Sequence[tuple[Trajectory, str, str]]) -> None:
    plan_axes(axes, xlabel="x Distance (m)", ylabel="y Distance (m)")
    for path, colour, name in drawn:
        x, y = path.poses[:, 0], path.poses[:, 1]
        axes.plot(x, y, color=colour, linewidth=1.6, label=name)
        axes.plot(x[-1], y[-1], "s", color=colour, markeredgecolor=BLACK, markersize=7)
    if drawn:
        x, y, _ = drawn[-1][0].poses[0]
        axes.plot(x, y, "o", color=GREEN, markeredgecolor=BLACK, label="start")
        axes.plot([], [], "s", color="white", markeredgecolor=BLACK, label="ends")
        axes.legend(loc="center")


def _draw_coordinates(rows: list[Axes], drawn: Sequence[tuple[Trajectory, str, str]]) -> None:
    for path, colour, _ in drawn:
        x, y, yaw = path.poses.T
        for axes, values in zip(rows, (x, y, np.degrees(np.unwrap(yaw)))):
            axes.plot(path.stamps, values, color=colour, linewidth=1.2)
    for axes, label in zip(rows, ("x (m)", "y (m)", "heading (°)")):
        gridded(axes, ylabel=label)
    for axes in rows[:-1]:
        axes.tick_params(labelbottom=False)
    rows[-1].set_xlabel("simulated time (s)")


class FleetReport(Report):
    """The perfect and the noisy path of each robot, in a folder of its own.

    `seeds` are those of the robots' noise, by their names, which are also their namespaces.
    """

    def __init__(self, folder: Path, seeds: Mapping[str, int]):
        super().__init__(folder)
        self._seeds = seeds
        self.robots = {name: SquaresReport(folder / name, name) for name in seeds}
        for paths in self.robots.values():
            self.topics.update(paths.topics)

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
        robots = [
            {"name": name, "seed": self._seeds[name], **paths.measured()}
            for name, paths in self.robots.items()
        ]
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


def fleet_summary(robots: Sequence[Summary]) -> Summary:
    """Return the entries of the robots, and the root mean square and the largest of each error.

    Those are None if a robot has no error.
    """
    values = {}
    for name in FLEET_ERRORS:
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
