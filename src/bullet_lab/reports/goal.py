"""The report of the job `goal`: the true path of a robot that drives to goals, and its errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, NamedTuple, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from bullet_lab.core import figures
from bullet_lab.core.figures import BEACON_RADIUS, BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION
from bullet_lab.core.files import NANOSECONDS
from bullet_lab.core.se2 import PlanarPose, hypot, wrap
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.navigation.occupancy import RobotCostmap
from bullet_lab.reports import DriveReport, Figures, Reading, Report, Summary, draw_path

# ns that are recorded after the end, while the robot should stand.
REST = NANOSECONDS
# m; length of the arrows.
ARROW = 0.25
# Edge in m of the boxes that send_goals puts in the way.
BOX = 0.4
# The model that robots stand on.
GROUND = "ground_plane"
# m around the path.
MARGIN = 0.6
Beacon = Tuple[str, float, float]
"""Name, x and y (m)."""


@dataclass
class GoalRecord:
    """One goal (m, m, rad), the times (s) of its start and end, and the outcome."""

    goal: PlanarPose
    begun: float
    ended: float | None = None
    reached: bool = False
    text: str = ""


class GoalAnswer(NamedTuple):
    """What the driver reports about a goal.

    Attributes:
        id: of the goal.
        text: for people.
        rejected: whether the driver never drove to it.
        reached: whether the robot is at the goal.
        over: whether this is the last report about the goal.
    """

    id: str
    text: str
    rejected: bool = False
    reached: bool = False
    over: bool = False


class GoalReport(DriveReport):
    """The true path, in truth.tum, and all goals, of any sender.

    Args:
        folder: for the files.
        tolerance: m around the goals, for the figure.
        stay: whether the recording goes on after the first goal.
        beacons: returns the beacons of the world.
        costmap: of the robot, with the map that it drives on, if there is one.
    """

    def __init__(
        self,
        folder: Path,
        tolerance: float,
        stay: bool,
        beacons: Callable[[], list[Beacon]],
        costmap: RobotCostmap | None = None,
    ):
        super().__init__(folder)
        self._costmap = costmap
        self._tolerance = tolerance
        self._stay = stay
        self._beacons = beacons
        self.topics = {
            **self.topics,
            "drive_to_goal/current_goal": "geometry_msgs/PoseStamped",
            "drive_to_goal/status": "actionlib_msgs/GoalStatus",
            "drive_to_goal/finished": "std_msgs/Time",
        }
        # In the order of the goals.
        self._poses = self.readings["drive_to_goal/current_goal"]
        self._ends = self.readings["drive_to_goal/finished"]
        self._answers: dict[str, GoalAnswer] = {}
        self._refused: list[str] = []

    def take(self, topic: str, reading: Reading) -> bool:
        if topic != "drive_to_goal/status":
            recorded = super().take(topic, reading)
            if self._ends and not self._stay:
                self.until = self._ends[0].stamp + REST
            return recorded
        if reading.detail.rejected:
            # It may have been accepted before, but the robot never drove to it.
            self._answers.pop(reading.detail.id, None)
            self._refused.append(reading.detail.text)
        else:
            self._answers[reading.detail.id] = reading.detail
        return False

    def is_answered(self) -> bool:
        """Return whether the driver has accepted or refused a goal."""
        return bool(self._answers or self._refused)

    def is_complete(self) -> bool:
        # The robot stands after the first goal, or does not drive to it.
        if self._stay or self._refused:
            return not self._stay
        # Pose and last status of the goal come in any order.
        is_over = any(answer.over for answer in [*self._answers.values()][:1])
        return is_over and bool(self._poses) and super().is_complete()

    def summary(self, finished: bool, run: Summary) -> Summary:
        truth = self.truth.path()
        goals = [goal_figures(record, truth) for record in self._records()]
        return {
            "finished": bool(goals) and all(one["seconds"] is not None for one in goals),
            "goals": goals,
            "refused_goals": self._refused,
            "greatest_speed_mps": truth and float(np.max(_speeds(truth), initial=0.0)),
            **run,
        }

    def line(self, summary: Summary) -> str:
        goals = summary["goals"]
        return self._refused[0] if self._refused and not goals else title_of(goals)

    def has_failed(self, summary: Summary) -> bool:
        # The only goal was refused or not reached.
        missed = any(one.ended is not None and not one.reached for one in self._records())
        return not self._stay and (missed or bool(self._refused))

    def _records(self) -> list[GoalRecord]:
        """Return the goals: the k-th id, pose and end belong to the k-th goal."""
        records = []
        for index, (pose, answer) in enumerate(zip(self._poses, self._answers.values())):
            record = GoalRecord(tuple(pose.values), pose.seconds)
            if index < len(self._ends):
                record.ended = self._ends[index].seconds
                record.text = answer.text
                record.reached = answer.reached
            records.append(record)
        return records

    def figures(self, summary: Summary) -> Figures:
        truth, goals = self.truth.path(), self._records()
        figure = figures.new_figure(10.5, 5.6, self.line(summary))
        grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
        figure.subplots_adjust(left=0.07, right=0.98, top=0.9, bottom=0.1, hspace=0.28, wspace=0.2)
        self._draw_path(figure.add_subplot(grid[:, 0]), truth, goals)
        left, speed = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
        figures.gridded(left, ylabel="distance to the goal (m)")
        figures.gridded(speed, xlabel="simulated time (s)", ylabel="speed (m/s)")
        if truth is not None:
            self._draw_distance(left, truth, goals)
            speed.plot(truth.stamps[1:], _speeds(truth), color=ORANGE, linewidth=1.2)
            speed.set_ylim(bottom=0.0)
        return {"path.png": figure}

    def _draw_path(
        self, axes: Axes, truth: Trajectory | None, goals: Sequence[GoalRecord]
    ) -> None:
        figures.plan_axes(axes)
        if self._costmap is not None:
            known, shades = self._costmap.map, {"cmap": "gray", "vmin": 0, "vmax": 255, "zorder": 0}
            axes.imshow(known.levels(), extent=known.extent(), **shades)
        shown = [[record.goal[:2]] for record in goals]
        for name, x, y in self._beacons():
            axes.add_patch(Circle((x, y), BEACON_RADIUS, facecolor="#d5d5d5", edgecolor=GREY))
            axes.annotate(name, (x, y), ha="center", va="center", fontsize=7, annotation_clip=True)
        if truth is not None:
            shown.append(truth.poses[:, :2])
            draw_path(axes, truth.poses, ORANGE, 1.8, start="white", label="true path")
            _arrow(axes, truth.poses[-1], BLACK, "end")
        for number, record in enumerate(goals):
            colour = GREEN if record.reached else VERMILION
            axes.add_patch(Circle(record.goal[:2], self._tolerance, fill=False, edgecolor=colour))
            _arrow(axes, record.goal, colour, f"goal {number + 1}" if len(goals) > 1 else "goal")
        # Beacons far from the path are not shown.
        figures.show_around(axes, shown, MARGIN)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="best")

    def _draw_distance(self, axes: Axes, truth: Trajectory, goals: Sequence[GoalRecord]) -> None:
        for record in goals:
            end = truth.stamps[-1] if record.ended is None else record.ended
            chosen = (truth.stamps >= record.begun) & (truth.stamps <= end + 0.5)
            x, y, _ = truth.poses[chosen].T
            away = hypot(x - record.goal[0], y - record.goal[1])
            axes.plot(truth.stamps[chosen], away, color=BLUE, linewidth=1.2)
        axes.axhline(self._tolerance, **figures.THIN, linestyle="--", label="tolerance")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper right")


class MapDriveReport(GoalReport):
    """The drive to all goals of `send_goals` on a map, `count` of them.

    Contacts are those by the simulator's truth.
    """

    def __init__(self, folder: Path, tolerance: float, count: int, costmap: RobotCostmap):
        super().__init__(folder, tolerance, True, list, costmap)
        self._count = count
        self.topics = {
            **self.topics,
            "bullet_lab/touched": "bullet_lab/TouchedModels",
            "send_goals/boxes": "geometry_msgs/PoseStamped",
            "send_goals/finished": "std_msgs/Time",
        }
        self._boxes = self.readings["send_goals/boxes"]

    def take(self, topic: str, reading: Reading) -> bool:
        if topic == "send_goals/finished":
            self.until = reading.stamp + REST
        return super().take(topic, reading)

    def is_complete(self) -> bool:
        return Report.is_complete(self)

    def summary(self, finished: bool, run: Summary) -> Summary:
        found = super().summary(finished, run)
        for record, entry in zip(self._records(), found["goals"]):
            ends = record.begun, math.inf if record.ended is None else record.ended
            entry["box_in_the_way"] = any(ends[0] - 2.0 < b.seconds < ends[1] for b in self._boxes)
            entry["over_shortest"] = self._over_shortest(record, entry["driven_m"])
        touches = self.readings["bullet_lab/touched"][-1:]
        touched = {k: n for one in touches for k, n in one.detail.items() if k != GROUND}
        return {
            "reached": sum(entry["reached"] for entry in found["goals"]),
            "goals_sent": self._count,
            "contacts": sum(touched.values()),
            "touched": touched,
            "boxes": len(self._boxes),
            **found,
        }

    def _over_shortest(self, record: GoalRecord, driven: float | None) -> float | None:
        """Return the driven way as a share of the shortest on the map; None if unknown."""
        truth = self.truth.path()
        if driven is None or truth is None:
            return None
        start = truth.poses[max(0, np.searchsorted(truth.stamps, record.begun + 1e-9) - 1)]
        way = self._costmap.plan(start, record.goal)
        shortest = sum(math.dist(*ends) for ends in zip(way or (), (way or ())[1:]))
        return driven / shortest if shortest else None

    def line(self, summary: Summary) -> str:
        return (
            f"{summary['reached']} of {self._count} goals reached, {summary['contacts']} contacts, "
            f"{summary['boxes']} unknown boxes"
        )

    def has_failed(self, summary: Summary) -> bool:
        return summary["reached"] < self._count or summary["contacts"] > 0

    def _draw_path(self, axes: Axes, truth: Trajectory | None, goals: Sequence[GoalRecord]) -> None:
        super()._draw_path(axes, truth, goals)
        left, right, low, high = self._costmap.map.extent()
        axes.set(xlim=(left, right), ylim=(low, high))
        for box in self._boxes:
            x, y = box.values[:2]
            corner = (x - 0.5 * BOX, y - 0.5 * BOX)
            axes.add_patch(Rectangle(corner, BOX, BOX, color=BLUE, alpha=0.5))
        for number, record in enumerate(goals):
            axes.annotate(str(number + 1), record.goal[:2], fontsize=8, ha="right", va="bottom")
        axes.get_legend().remove()


def _arrow(axes: Axes, pose: Sequence[float], colour: str, label: str) -> None:
    x, y, yaw = pose
    along, across = [ARROW * math.cos(yaw)], [ARROW * math.sin(yaw)]
    units = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    axes.quiver([x], [y], along, across, **units, width=0.006, color=colour, zorder=3)
    axes.plot(x, y, "s", color=colour, markersize=4, label=label)


def goal_figures(record: GoalRecord, truth: Trajectory | None) -> Summary:
    """Return the entry of a goal in summary.json; `truth` is None without a pose.

    The errors are those of the last pose within a second after the end, when the robot stands.
    """
    x, y, yaw = record.goal
    found = {
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
    # The last pose up to each time; the first pose if there is none.
    first, last, rest = np.maximum(0, np.searchsorted(truth.stamps, times + 1e-9) - 1)
    driven, stood = truth.travelled(), truth.poses[rest]
    found.update(
        distance_m=hypot(x - stood[0], y - stood[1]),
        yaw_error_deg=math.degrees(wrap(float(stood[2]) - yaw)),
        seconds=record.ended - record.begun,
        driven_m=float(driven[last] - driven[first]),
    )
    return found


def _speeds(truth: Trajectory) -> np.ndarray:
    """Return the speeds (m/s) between the poses of a path."""
    return hypot(*np.diff(truth.poses[:, :2], axis=0).T) / np.diff(truth.stamps)


def title_of(goals: Sequence[Summary]) -> str:
    """Return the outcome of the drives in one line, from the `goal_figures` of each."""
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
