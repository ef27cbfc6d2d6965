"""One docking: its path in the station, and what the camera saw on the way."""

from __future__ import annotations

import math
from typing import Iterable, List, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from bullet_lab.numerics.trajectory import Trajectory
from bullet_lab.plotting.floor_plan import Outline, draw_plan
from bullet_lab.plotting.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    new_figure,
)

STATES = {
    "searching": PURPLE,
    "staging": BLUE,
    "measuring": GREEN,
    "approaching": ORANGE,
    "retreating": VERMILION,
    "docked": BLACK,
}
"""Colours of what the robot is doing."""

HALF_LENGTH, HALF_WIDTH = 0.20, 0.20
MARGIN = 0.6

StateChange = Tuple[float, str]
Frame = Tuple[float, str, np.ndarray]


def docking_figure(
    truth: Optional[Trajectory],
    states: Sequence[StateChange],
    plan: Sequence[Tuple[float, float]],
    outlines: Iterable[Outline],
    dock: Sequence[float],
    title: str,
) -> Figure:
    """Draw the true path over the plan of the station, in the colours of what was done.

    Args:
        truth: the robot's true path; None for nothing yet.
        states: from which second on it did what, by the names in `STATES`.
        plan: points (m) of the last plan; may be empty.
        outlines: of all that stands in the world, in m.
        dock: x, y (m) and yaw (rad) of the floor below the marker's face.
        title: above all.
    """
    figure = new_figure(9.0, 6.6)
    axes = figure.add_axes((0.08, 0.09, 0.89, 0.81))
    figure.suptitle(title)
    outlines = [np.asarray(outline, dtype=float) for outline in outlines]
    draw_plan(axes, outlines, dock)
    if plan:
        axes.plot(*np.transpose(plan), color=GREY, linewidth=2.4, alpha=0.6, label="plan")
    if truth is not None:
        _draw_path(axes, truth, states)
        _draw_robot(axes, truth.poses[0], GREEN, "start")
        _draw_robot(axes, truth.poses[-1], VERMILION, "end")
    _set_limits(axes, truth, outlines)
    axes.legend(loc="best", fontsize="small")
    return figure


def strip_figure(frames: Sequence[Frame]) -> Figure:
    """Draw pictures of the camera in a row or two, each with its time and what was done.

    Args:
        frames: time in s, state, and picture as (h, w, 3) uint8 RGB; one at least.
    """
    columns = min(4, len(frames))
    rows = -(-len(frames) // columns)
    figure = new_figure(3.2 * columns, 2.72 * rows)
    grid = figure.add_gridspec(
        rows,
        columns,
        left=0.005,
        right=0.995,
        bottom=0.005,
        top=1.0 - 0.3 / (2.72 * rows),
        wspace=0.02,
        hspace=0.14,
    )
    for cell, (seconds, state, picture) in zip(grid, frames):
        axes = figure.add_subplot(cell)
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(f"{seconds:.1f} s, {state}", fontsize="small", pad=3.0)
    return figure


def _draw_path(axes: Axes, truth: Trajectory, states: Sequence[StateChange]) -> None:
    """Draw each stretch in the colour of what was done on it."""
    shown = set()
    for begin, end, name in _stretches(truth, states):
        label = None if name in shown else name
        shown.add(name)
        x, y = truth.poses[begin : end + 1, :2].T
        axes.plot(x, y, color=STATES.get(name, GREY), linewidth=1.8, label=label)


def _stretches(truth: Trajectory, states: Sequence[StateChange]) -> List[Tuple[int, int, str]]:
    """Return first and last index of each stretch, and its state."""
    changes = [(int(np.searchsorted(truth.stamps, seconds)), name) for seconds, name in states]
    changes = [(0, "at rest"), *changes, (len(truth) - 1, "")]
    return [
        (min(begin, len(truth) - 1), min(end, len(truth) - 1), name)
        for (begin, name), (end, _) in zip(changes, changes[1:])
        if end > begin
    ]


def _draw_robot(axes: Axes, pose: Sequence[float], colour: str, label: str) -> None:
    """Draw the outline of the robot with a line ahead."""
    x, y, yaw = pose
    cosine, sine = math.cos(yaw), math.sin(yaw)
    corners = [
        (x + cosine * a - sine * b, y + sine * a + cosine * b)
        for a, b in (
            (HALF_LENGTH, HALF_WIDTH),
            (-HALF_LENGTH, HALF_WIDTH),
            (-HALF_LENGTH, -HALF_WIDTH),
            (HALF_LENGTH, -HALF_WIDTH),
        )
    ]
    outline = Polygon(corners, fill=False, edgecolor=colour, linewidth=1.6, label=label, zorder=3)
    axes.add_patch(outline)
    ahead = (x + HALF_LENGTH * cosine, y + HALF_LENGTH * sine)
    axes.plot((x, ahead[0]), (y, ahead[1]), color=colour, linewidth=1.6, zorder=3)


def _set_limits(axes: Axes, truth: Optional[Trajectory], outlines: Sequence[np.ndarray]) -> None:
    points = [*outlines]
    if truth is not None:
        points.append(truth.poses[:, :2])
    if not points:
        return
    every = np.concatenate(points)
    low, high = every.min(axis=0) - MARGIN, every.max(axis=0) + MARGIN
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal", adjustable="datalim")
