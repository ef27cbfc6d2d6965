"""A robot's way past beacons, and how far it was from each."""

from __future__ import annotations

from typing import Mapping, Optional, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from bullet_lab.numerics.trajectory import Trajectory
from bullet_lab.plotting.style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILION,
    new_figure,
)

BEACON_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE)
# Radius of meshes/beacon.dae in m.
BEACON_RADIUS = 0.25


def beacons_figure(
    beacons: Mapping[str, Tuple[float, float]],
    table: Optional[Tuple[Trajectory, np.ndarray, np.ndarray]],
    title: str = "Distances to the beacons",
) -> Figure:
    """Draw the way from above, and measured over true distances against time.

    Args:
        beacons: positions (m, m) by name.
        table: path, measured and true distances as of DistancesRecording; None for nothing yet.
        title: above all.
    """
    figure = new_figure(9.5, 7.0)
    figure.suptitle(title)
    above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": (1.0, 1.8)})
    figure.subplots_adjust(left=0.08, right=0.86, top=0.92, bottom=0.08, hspace=0.26)
    _draw_way(above, beacons, None if table is None else table[0])
    below.set(xlabel="simulated time (s)", ylabel="distance (m)")
    below.grid(alpha=0.3)
    if table is not None:
        _draw_distances(below, beacons, table)
    return figure


def _draw_way(
    axes: Axes, beacons: Mapping[str, Tuple[float, float]], path: Optional[Trajectory]
) -> None:
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    for (name, (x, y)), colour in zip(beacons.items(), _colours(len(beacons))):
        axes.add_patch(Circle((x, y), BEACON_RADIUS, facecolor=colour, edgecolor=BLACK))
        axes.annotate(name, (x, y + 1.2 * BEACON_RADIUS), ha="center", va="bottom")
        # A patch does not count for the limits of the axes.
        axes.plot(x, y, ".", color=colour)
    if path is not None:
        x, y = path.poses[:, 0], path.poses[:, 1]
        axes.plot(x, y, color=BLACK, linewidth=1.4)
        axes.plot(x[0], y[0], "o", color=GREEN, markeredgecolor=BLACK, label="start")
        axes.plot(x[-1], y[-1], "s", color="white", markeredgecolor=BLACK, label="end")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _draw_distances(
    axes: Axes,
    beacons: Mapping[str, Tuple[float, float]],
    table: Tuple[Trajectory, np.ndarray, np.ndarray],
) -> None:
    path, measured, true = table
    for column, (name, colour) in enumerate(zip(beacons, _colours(len(beacons)))):
        axes.plot(path.stamps, true[:, column], color=colour, linewidth=6.0, alpha=0.3)
        axes.plot(path.stamps, measured[:, column], color=colour, linewidth=1.5, label=name)
    axes.plot([], [], color=BLACK, linewidth=6.0, alpha=0.3, label="truth")
    axes.set_ylim(0.0, 1.05 * max(measured.max(), true.max()))
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _colours(count: int) -> list:
    return [BEACON_COLOURS[number % len(BEACON_COLOURS)] for number in range(count)]
