"""Drives to goals: the true path, what they come down to, and their figure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from bullet_lab.core import figures
from bullet_lab.core.figures import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION
from bullet_lab.core.files import NANOSECONDS
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports import DriveReport, Reading

# ns that are recorded after the end: a robot that should stand, stands.
REST = NANOSECONDS
# m: of an arrow, of a beacon, and around the way that the picture shows.
ARROW, BEACON_RADIUS, MARGIN = 0.25, 0.25, 0.6
Beacon = Tuple[str, float, float]
"""Name, x and y (m)."""


@dataclass
class GoalRecord:
    """One goal (m, m, rad), when (s) it was begun and ended, and what the driver says of it."""

    goal: PlanarPose
    begun: float
    ended: Optional[float] = None
    reached: bool = False
    text: str = ""


class GoalAnswer(NamedTuple):
    """What the driver says of the goal `id`; if it is rejected, the driver does not drive there.

    It is `over` where the driver has nothing more to say of it.
    """

    id: str
    text: str
    rejected: bool = False
    reached: bool = False
    over: bool = False


class GoalReport(DriveReport):
    """The true path, in truth.tum, and the goals, whoever gave them.

    Args:
        folder: where the files go.
        tolerance: m from the goals that the robot may stop, for the picture.
        stay: whether the first goal's end is not that of the recording.
        beacons: returns what stands there.
    """

    def __init__(
        self, folder: Path, tolerance: float, stay: bool, beacons: Callable[[], List[Beacon]]
    ):
        super().__init__(folder)
        self._tolerance, self._stay, self._beacons = tolerance, stay, beacons
        self.topics = {
            **self.topics,
            "drive_to_goal/current_goal": "geometry_msgs/PoseStamped",
            "drive_to_goal/status": "actionlib_msgs/GoalStatus",
            "drive_to_goal/finished": "std_msgs/Time",
        }
        # What the driver says of its goals, in their order.
        self._poses: List[Reading] = []
        self._ends: List[Reading] = []
        self._answers: Dict[str, GoalAnswer] = {}
        self._refused: List[str] = []

    def take(self, topic: str, reading: Reading) -> bool:
        if topic == "odom":
            return super().take(topic, reading)
        if topic == "drive_to_goal/current_goal":
            self._poses.append(reading)
        elif topic == "drive_to_goal/finished":
            self._ends.append(reading)
            if not self._stay:
                self.until = self._ends[0].stamp + REST
        elif reading.detail.rejected:
            # Taken up perhaps, but never driven to.
            self._answers.pop(reading.detail.id, None)
            self._refused.append(reading.detail.text)
        else:
            self._answers[reading.detail.id] = reading.detail
        return False

    def is_answered(self) -> bool:
        """Return whether the driver has taken or refused a goal."""
        return bool(self._answers or self._refused)

    def is_complete(self) -> bool:
        # The robot has come to rest after the first goal, or will not drive.
        return not self._stay and (bool(self._refused) or self._is_told() and super().is_complete())

    def _is_told(self) -> bool:
        """Return whether all topics have told of the first goal, each in its own time."""
        first = next(iter(self._answers.values()), None)
        return bool(self._poses) and first is not None and first.over

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        truth = self.truth.path()
        goals = [goal_figures(record, truth) for record in self._records()]
        return {
            "finished": bool(goals) and all(one["seconds"] is not None for one in goals),
            "goals": goals,
            "refused_goals": self._refused,
            "greatest_speed_mps": None if truth is None else greatest_speed(truth),
            **run,
        }

    def line(self, summary: Mapping[str, Any]) -> str:
        goals = summary["goals"]
        return self._refused[0] if self._refused and not goals else title_of(goals)

    def has_failed(self, summary: Mapping[str, Any]) -> bool:
        # A goal was refused or not reached, where it was to be the only one.
        missed = any(one.ended is not None and not one.reached for one in self._records())
        return not self._stay and (missed or bool(self._refused))

    def _records(self) -> List[GoalRecord]:
        """Return the goals: the k-th id, pose and end belong together, one goal at a time."""
        records = []
        for index, (pose, answer) in enumerate(zip(self._poses, self._answers.values())):
            record = GoalRecord(tuple(pose.values), pose.seconds)
            if index < len(self._ends):
                record.ended, record.text = self._ends[index].seconds, answer.text
                record.reached = answer.reached
            records.append(record)
        return records

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        truth, goals = self.truth.path(), self._records()
        figure = figures.new_figure(10.5, 5.6)
        figure.suptitle(self.line(summary))
        grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
        figure.subplots_adjust(left=0.07, right=0.98, top=0.9, bottom=0.1, hspace=0.28, wspace=0.2)
        self._draw_way(figure.add_subplot(grid[:, 0]), truth, goals)
        left, speed = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
        left.set(ylabel="distance to the goal (m)")
        speed.set(xlabel="simulated time (s)", ylabel="speed (m/s)")
        for axes in (left, speed):
            axes.grid(alpha=0.3)
        if truth is not None:
            self._draw_distance(left, truth, goals)
            speed.plot(truth.stamps[1:], _speeds(truth), color=ORANGE, linewidth=1.2)
            speed.set_ylim(bottom=0.0)
        return {"path.png": figure}

    def _draw_way(
        self, axes: Axes, truth: Optional[Trajectory], goals: Sequence[GoalRecord]
    ) -> None:
        figures.plan_axes(axes)
        for name, x, y in self._beacons():
            axes.add_patch(Circle((x, y), BEACON_RADIUS, facecolor="#d5d5d5", edgecolor=GREY))
            axes.annotate(name, (x, y), ha="center", va="center", fontsize=7, annotation_clip=True)
        if truth is not None:
            x, y = truth.poses[:, 0], truth.poses[:, 1]
            axes.plot(x, y, color=ORANGE, linewidth=1.8, label="true path")
            axes.plot(x[0], y[0], "o", color="white", markeredgecolor=BLACK, label="start")
            _arrow(axes, truth.poses[-1], BLACK, "end")
        for number, record in enumerate(goals):
            colour = GREEN if record.reached else VERMILION
            axes.add_patch(Circle(record.goal[:2], self._tolerance, fill=False, edgecolor=colour))
            _arrow(axes, record.goal, colour, f"goal {number + 1}" if len(goals) > 1 else "goal")
        way = [] if truth is None else [truth.poses[:, :2]]
        # What stands far from the way is left out.
        figures.show_around(axes, [*way, *([one.goal[:2]] for one in goals)], MARGIN)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="best")

    def _draw_distance(self, axes: Axes, truth: Trajectory, goals: Sequence[GoalRecord]) -> None:
        for record in goals:
            end = truth.stamps[-1] if record.ended is None else record.ended
            chosen = (truth.stamps >= record.begun) & (truth.stamps <= end + 0.5)
            x, y = truth.poses[chosen, 0], truth.poses[chosen, 1]
            away = np.hypot(x - record.goal[0], y - record.goal[1])
            axes.plot(truth.stamps[chosen], away, color=BLUE, linewidth=1.2)
        axes.axhline(self._tolerance, color=GREY, linewidth=0.8, linestyle="--", label="tolerance")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper right")


def _arrow(axes: Axes, pose: Sequence[float], colour: str, label: str) -> None:
    x, y, yaw = pose
    along, across = [ARROW * math.cos(yaw)], [ARROW * math.sin(yaw)]
    units = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    axes.quiver([x], [y], along, across, **units, width=0.006, color=colour, zorder=3)
    axes.plot(x, y, "s", color=colour, markersize=4, label=label)


def goal_figures(record: GoalRecord, truth: Optional[Trajectory]) -> Dict[str, Any]:
    """Return what summary.json says of a goal; `truth` is None while nothing is known.

    Where the robot stood at the end is its last pose before the next second is over, when it has
    come to rest.
    """
    x, y, yaw = record.goal
    found: Dict[str, Any] = {
        "x_m": x,
        "y_m": y,
        "yaw_deg": math.degrees(yaw),
        "reached": record.reached,
        "message": record.text or "not finished",
        **dict.fromkeys(("distance_m", "yaw_error_deg", "seconds", "driven_m")),
    }
    if truth is None or record.ended is None:
        return found
    times = np.array([record.begun, record.ended, record.ended + 1.0])
    # The last pose up to each time, the first one if there is none.
    first, last, rest = np.maximum(0, np.searchsorted(truth.stamps, times + 1e-9) - 1)
    driven, stood = truth.travelled(), truth.poses[rest]
    found.update(
        distance_m=float(math.hypot(x - stood[0], y - stood[1])),
        yaw_error_deg=math.degrees(wrap(float(stood[2]) - yaw)),
        seconds=record.ended - record.begun,
        driven_m=float(driven[last] - driven[first]),
    )
    return found


def greatest_speed(truth: Trajectory) -> float:
    """Return the greatest speed (m/s) between two poses of a path; 0 for a single one."""
    return float(np.max(_speeds(truth), initial=0.0))


def _speeds(truth: Trajectory) -> np.ndarray:
    return np.hypot(*np.diff(truth.poses[:, :2], axis=0).T) / np.diff(truth.stamps)


def title_of(goals: Sequence[Dict[str, Any]]) -> str:
    """Return in a line how the drives ended, by `goal_figures` of each."""
    if not goals:
        return "no goal was given"
    last, count = goals[-1], sum(one["reached"] for one in goals)
    if len(goals) > 1:
        return f"{count} of {len(goals)} goals reached"
    if not last["reached"] or last["distance_m"] is None:
        return f"the goal was not reached: {last['message']}"
    return (
        f"at the goal after {last['seconds']:.1f} s and {last['driven_m']:.2f} m: "
        f"{100.0 * last['distance_m']:.1f} cm and {last['yaw_error_deg']:+.1f} degrees off"
    )
