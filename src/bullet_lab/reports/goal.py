"""Drives to goals: what they come down to, and their figure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from bullet_lab.core.angles import wrap
from bullet_lab.core.figures import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION, new_figure
from bullet_lab.core.trajectory import Trajectory

PlanarPose = Tuple[float, float, float]


@dataclass
class GoalRecord:
    """One goal and what became of it.

    Attributes:
        goal: m, m, rad.
        begun: s.
        ended: s; None while it is driven to.
        reached: whether the driver says so.
        text: what else it says.
    """

    goal: PlanarPose
    begun: float
    ended: Optional[float] = None
    reached: bool = False
    text: str = ""


def goal_figures(record: GoalRecord, truth: Optional[Trajectory]) -> Dict[str, Any]:
    """Return what summary.json says of a goal.

    Args:
        record: of the goal.
        truth: the true path; None for nothing known. Where the robot stood at the end is its
            last pose before the next second is over, when it has come to rest.
    """
    x, y, yaw = record.goal
    figures: Dict[str, Any] = {
        "x_m": x,
        "y_m": y,
        "yaw_deg": math.degrees(yaw),
        "reached": record.reached,
        "message": record.text or "not finished",
        "distance_m": None,
        "yaw_error_deg": None,
        "seconds": None,
        "driven_m": None,
    }
    if truth is None or record.ended is None:
        return figures
    last = _index_at(truth, record.ended)
    rest = _index_at(truth, record.ended + 1.0)
    first = _index_at(truth, record.begun)
    driven = truth.travelled()
    stood = truth.poses[rest]
    figures.update(
        distance_m=float(math.hypot(x - stood[0], y - stood[1])),
        yaw_error_deg=math.degrees(wrap(float(stood[2]) - yaw)),
        seconds=record.ended - record.begun,
        driven_m=float(driven[last] - driven[first]),
    )
    return figures


def greatest_speed(truth: Trajectory) -> float:
    """Return the greatest speed (m/s) between two poses of a path; 0 for a single one."""
    if len(truth) < 2:
        return 0.0
    steps = np.diff(truth.poses[:, :2], axis=0)
    return float(np.max(np.hypot(*steps.T) / np.diff(truth.stamps)))


def _index_at(truth: Trajectory, seconds: float) -> int:
    """Return the last pose up to a time, the first one if there is none."""
    return max(0, int(np.searchsorted(truth.stamps, seconds + 1e-9)) - 1)


def title_of(figures: Sequence[Dict[str, Any]]) -> str:
    """Return in a line how the drives ended."""
    if not figures:
        return "no goal was given"
    last, count = figures[-1], sum(one["reached"] for one in figures)
    if len(figures) > 1:
        return f"{count} of {len(figures)} goals reached"
    if not last["reached"] or last["distance_m"] is None:
        return f"the goal was not reached: {last['message']}"
    return (
        f"at the goal after {last['seconds']:.1f} s and {last['driven_m']:.2f} m: "
        f"{100.0 * last['distance_m']:.1f} cm and {last['yaw_error_deg']:+.1f} degrees off"
    )


ARROW = 0.25
BEACON_RADIUS = 0.25
# m around the way that the picture shows.
MARGIN = 0.6


def goal_figure(
    truth: Optional[Trajectory],
    goals: Sequence[GoalRecord],
    beacons: Sequence[Tuple[str, float, float]],
    tolerance: float,
    title: str,
) -> Figure:
    """Draw the way.

    Args:
        truth: the true path; None for nothing yet.
        goals: that were given.
        beacons: name, x and y (m) of what stands there.
        tolerance: m from the goals that the robot may stop.
        title: above all.
    """
    figure = new_figure(10.5, 5.6)
    figure.suptitle(title)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
    figure.subplots_adjust(left=0.07, right=0.98, top=0.9, bottom=0.1, hspace=0.28, wspace=0.2)
    _draw_way(figure.add_subplot(grid[:, 0]), truth, goals, beacons, tolerance)
    left, speed = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    left.set(ylabel="distance to the goal (m)")
    speed.set(xlabel="simulated time (s)", ylabel="speed (m/s)")
    for axes in (left, speed):
        axes.grid(alpha=0.3)
    if truth is not None:
        _draw_distance(left, truth, goals, tolerance)
        steps = np.hypot(*np.diff(truth.poses[:, :2], axis=0).T) / np.diff(truth.stamps)
        speed.plot(truth.stamps[1:], steps, color=ORANGE, linewidth=1.2)
        speed.set_ylim(bottom=0.0)
    return figure


def _draw_way(
    axes: Axes,
    truth: Optional[Trajectory],
    goals: Sequence[GoalRecord],
    beacons: Sequence[Tuple[str, float, float]],
    tolerance: float,
) -> None:
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    for name, x, y in beacons:
        axes.add_patch(Circle((x, y), BEACON_RADIUS, facecolor="#d5d5d5", edgecolor=GREY))
        axes.annotate(name, (x, y), ha="center", va="center", fontsize=7, annotation_clip=True)
    if truth is not None:
        x, y = truth.poses[:, 0], truth.poses[:, 1]
        axes.plot(x, y, color=ORANGE, linewidth=1.8, label="true path")
        axes.plot(x[0], y[0], "o", color="white", markeredgecolor=BLACK, label="start")
        _arrow(axes, truth.poses[-1], BLACK, "end")
    for number, record in enumerate(goals):
        colour = GREEN if record.reached else VERMILION
        axes.add_patch(Circle(record.goal[:2], tolerance, fill=False, edgecolor=colour))
        _arrow(axes, record.goal, colour, f"goal {number + 1}" if len(goals) > 1 else "goal")
    _set_limits(axes, [] if truth is None else truth.poses, [one.goal for one in goals])
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")


def _set_limits(axes: Axes, *paths: Sequence[Sequence[float]]) -> None:
    """Leave out what stands far from the way."""
    points = np.array([point[:2] for path in paths for point in path])
    if len(points):
        (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
        axes.set(xlim=(left - MARGIN, right + MARGIN), ylim=(bottom - MARGIN, top + MARGIN))


def _arrow(axes: Axes, pose: Sequence[float], colour: str, label: str) -> None:
    x, y, yaw = pose
    axes.quiver(
        [x],
        [y],
        [ARROW * math.cos(yaw)],
        [ARROW * math.sin(yaw)],
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.006,
        color=colour,
        zorder=3,
    )
    axes.plot(x, y, "s", color=colour, markersize=4, label=label)


def _draw_distance(
    axes: Axes, truth: Trajectory, goals: Sequence[GoalRecord], tolerance: float
) -> None:
    for record in goals:
        end = truth.stamps[-1] if record.ended is None else record.ended
        chosen = (truth.stamps >= record.begun) & (truth.stamps <= end + 0.5)
        x, y = truth.poses[chosen, 0], truth.poses[chosen, 1]
        away = np.hypot(x - record.goal[0], y - record.goal[1])
        axes.plot(truth.stamps[chosen], away, color=BLUE, linewidth=1.2)
    axes.axhline(tolerance, color=GREY, linewidth=0.8, linestyle="--", label="tolerance")
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="upper right")
