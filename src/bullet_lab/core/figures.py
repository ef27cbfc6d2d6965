"""Helpers of all figures: colours, canvas, saving, and floor plans."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Iterable, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
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
# m; the second one is that of meshes/beacon.dae.
MARKER_SIDE = 0.2
BEACON_RADIUS = 0.25

Outline = Sequence[Tuple[float, float]]


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches; it needs no window system."""
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    # Without the software's version, equal figures are equal files.
    replace_file(path, lambda part: figure.savefig(part, format="png", metadata={"Software": ""}))


def plan_axes(axes: Axes, **more: str) -> None:
    """Prepare axes for a view from above, in m and to scale; `more` is passed to `Axes.set`."""
    axes.set(**{"xlabel": "x (m)", "ylabel": "y (m)", **more})
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)


def show_around(axes: Axes, points: Sequence[Sequence[Sequence[float]]], margin: float) -> None:
    """Limit axes to some arrays of points (m), with shape (n, 2), and a margin (m) around them."""
    if len(points):
        joined = np.concatenate(points)
        left, bottom = joined.min(axis=0) - margin
        right, top = joined.max(axis=0) + margin
        axes.set(xlim=(left, right), ylim=(bottom, top))


def draw_plan(axes: Axes, outlines: Iterable[Outline], dock: Sequence[float]) -> None:
    """Draw walls, the marker and the dock's axis to scale.

    Args:
        axes: to draw on; x and y are the world's, in metres.
        outlines: of all obstacles.
        dock: x, y (m) and yaw (rad) of the floor below the marker's face.
    """
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    for outline in outlines:
        axes.add_patch(Polygon(outline, facecolor="#d5d5d5", edgecolor=GREY, linewidth=0.8))
    x, y, yaw = dock
    cosine, sine = math.cos(yaw), math.sin(yaw)
    axis = [(x, y), (x - 5.0 * cosine, y - 5.0 * sine)]
    axes.plot(*zip(*axis), color=GREY, linewidth=0.8, linestyle=(0, (8, 4)), zorder=0.5)
    half = 0.5 * MARKER_SIDE
    marker = [(x - half * sine, y + half * cosine), (x + half * sine, y - half * cosine)]
    axes.plot(*zip(*marker), color=BLACK, linewidth=3.0, solid_capstyle="butt", label="marker")
