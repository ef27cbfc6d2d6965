"""What all figures share: colours, canvas, saving, and what stands on a floor."""

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

# Okabe and Ito's palette, which the colour-blind can tell apart; as in figure 1, the noisy path
# is blue and the perfect one orange.
BLUE, ORANGE, GREEN, VERMILION, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"
BLACK, GREY = "#000000", "#999999"
DOTS_PER_INCH = 110


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches; it needs no window system and no pyplot."""
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG; a reader finds the old file or the new one, never a part."""
    # Without the software's version in it, the same figure is the same file.
    replace_file(path, lambda part: figure.savefig(part, format="png", metadata={"Software": ""}))


def plan_axes(axes: Axes, **more: str) -> None:
    """Prepare axes for what is seen from above, in m and to scale; `more` is as of `Axes.set`."""
    axes.set(**{"xlabel": "x (m)", "ylabel": "y (m)", **more})
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)


def show_around(axes: Axes, points: Sequence[Sequence[Sequence[float]]], margin: float) -> None:
    """Limit axes to some arrays of points (m), with shape (n, 2), and a margin (m) around them."""
    if len(points):
        every = np.concatenate(points)
        (left, bottom), (right, top) = every.min(axis=0) - margin, every.max(axis=0) + margin
        axes.set(xlim=(left, right), ylim=(bottom, top))


Outline = Sequence[Tuple[float, float]]

MARKER_SIDE = 0.2


def draw_plan(axes: Axes, outlines: Iterable[Outline], dock: Sequence[float]) -> None:
    """Draw walls, the marker and the dock's axis to scale.

    Args:
        axes: to draw on; x and y are the world's, in metres.
        outlines: of all that stands there.
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
