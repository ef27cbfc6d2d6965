"""What drives to goals come down to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.numerics.angles import wrap
from bullet_lab.numerics.trajectory import Trajectory

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
