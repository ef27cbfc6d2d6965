"""Plans: what stands in a world, and robots in it, from above."""

from __future__ import annotations

import math
from typing import Iterable, Sequence, Tuple

from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from bullet_lab.plotting.style import BLACK, GREY

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
