"""Helpers of all figures: colours, canvas, saving, panels, legends, and floor plans."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Iterable, Sequence, Tuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from bullet_lab.core.files import replace_file

# Okabe and Ito's palette, which colour-blind readers can distinguish. As in figure 1, the noisy
# path is blue and the perfect one orange.
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
BLACK = "#000000"
GREY = "#999999"
DOTS_PER_INCH = 110
# Style of a line that guides the eye.
THIN = {"color": GREY, "linewidth": 0.8}
# m; the second one is that of meshes/beacon.dae.
MARKER_SIDE = 0.2
BEACON_RADIUS = 0.25

Outline = Sequence[Tuple[float, float]]


def new_figure(width: float, height: float, title: str = "") -> Figure:
    """Return an empty figure of a size in inches; it needs no window system."""
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    # Without the software's version, equal figures are equal files.
    replace_file(path, lambda part: figure.savefig(part, format="png", metadata={"Software": ""}))


def panels(
    shape: tuple[int, int],
    size: tuple[float, float],
    title: str = "",
    labels: tuple[str, str] = ("", ""),
    grid: bool = True,
    **more: Any,
) -> tuple[Figure, np.ndarray]:
    """Return a figure and its axes, an array of a shape (rows, columns).

    The size is width and height in inches; the labels are that of x below the last row and that of
    y beside the first column. `more` is as in `Figure.subplots`.
    """
    figure = new_figure(*size, title)
    every = figure.subplots(*shape, squeeze=False, **more)
    for axes in every.flat if grid else ():
        axes.grid(alpha=0.3)
    for axes in every[-1]:
        axes.set_xlabel(labels[0])
    for axes in every[:, 0]:
        axes.set_ylabel(labels[1])
    return figure, every


def legend_below(
    figure: Figure, handles: Sequence[Artist], columns: int = 0, bottom: float = 0.0, **more: Any
) -> None:
    """Add a legend of handles with labels below the panels of a figure.

    With 0 columns it is a single row. The panels are laid out above `bottom`, a share of the
    height, unless it is 0. `more` is as in `Figure.legend`.
    """
    more = {"loc": "lower center", "ncol": columns or len(handles), "frameon": False, **more}
    if handles:
        figure.legend(handles=handles, **more)
    if bottom:
        figure.tight_layout(rect=(0.0, bottom, 1.0, 1.0))


def legend_entry(label: str, **style: Any) -> Line2D:
    """Return an entry for a legend: a line or marker in a style, with a label."""
    return Line2D([], [], label=label, **style)


def labelled(*every: Axes) -> list[Artist]:
    """Return the artists of some axes that have a label, one for each label."""
    handles: dict[str, Artist] = {}
    for axes in every:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    return list(handles.values())


def gridded(axes: Axes, **more: Any) -> None:
    """Draw a grid on axes; `more` is passed to `Axes.set`."""
    axes.set(**more)
    axes.grid(alpha=0.3)


def plan_axes(axes: Axes, **more: Any) -> None:
    """Prepare axes for a view from above, in m and to scale; `more` is passed to `Axes.set`."""
    scale = {"aspect": "equal", "adjustable": "datalim"}
    gridded(axes, **{"xlabel": "x (m)", "ylabel": "y (m)", **scale, **more})


def show_around(axes: Axes, points: Sequence[Sequence[Sequence[float]]], margin: float) -> None:
    """Limit axes to some arrays of points (m), with shape (n, 2), and a margin (m) around them."""
    if len(points):
        joined = np.concatenate(points)
        left, bottom = joined.min(axis=0) - margin
        right, top = joined.max(axis=0) + margin
        axes.set(xlim=(left, right), ylim=(bottom, top))


def draw_plan(axes: Axes, outlines: Iterable[Outline], dock: Sequence[float]) -> None:
    """Draw the outlines of obstacles, the marker and the dock's axis to scale, in the world (m).

    `dock` is x, y (m) and yaw (rad) of the floor below the marker's face.
    """
    plan_axes(axes, adjustable="box")
    for outline in outlines:
        axes.add_patch(Polygon(outline, facecolor="#d5d5d5", edgecolor=GREY, linewidth=0.8))
    x, y, yaw = dock
    cosine, sine = math.cos(yaw), math.sin(yaw)
    axis = [(x, y), (x - 5.0 * cosine, y - 5.0 * sine)]
    axes.plot(*zip(*axis), **THIN, linestyle=(0, (8, 4)), zorder=0.5)
    half = 0.5 * MARKER_SIDE
    marker = [(x - half * sine, y + half * cosine), (x + half * sine, y - half * cosine)]
    axes.plot(*zip(*marker), color=BLACK, linewidth=3.0, solid_capstyle="butt", label="marker")
