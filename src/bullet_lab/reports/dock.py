"""One docking: the true path, what it comes down to, and its figures."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from bullet_lab.core import figures
from bullet_lab.core.figures import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, Outline
from bullet_lab.core.files import NANOSECONDS
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.docking.database import Dock
from bullet_lab.docking.types import Calibration, DockingError, DockingResult
from bullet_lab.docking.verdict import (
    DOCKED,
    ERRORS,
    INACCURATE,
    docking_errors,
    judge,
    largest_errors,
)
from bullet_lab.reports import DriveReport, Reading, earliest

# ns that are recorded after the end: a robot that should stand, stands.
REST = NANOSECONDS // 2
PICTURE_WIDTH = 320
UNFINISHED = DockingResult(False, DockingError.UNKNOWN, "the docking was not finished")
STATES = {
    "searching": PURPLE,
    "staging": BLUE,
    "measuring": GREEN,
    "approaching": ORANGE,
    "retreating": VERMILION,
    "docked": BLACK,
}
"""Colours of what the robot is doing."""

# m: of the robot, and around all that is drawn.
HALF_LENGTH, HALF_WIDTH, MARGIN = 0.20, 0.20, 0.6

StateChange = Tuple[float, str]
"""From which second on the robot did what."""


class Station(NamedTuple):
    """Where a robot docks.

    Attributes:
        outlines: of all that stands there, in m.
        dock: true pose (m, m, rad) of the floor below the marker's face.
        camera_ahead: m, of the camera from the robot's middle.
        entry: what the robot is told of the dock: of the database, with a rough pose.
    """

    outlines: Sequence[Outline]
    dock: PlanarPose
    camera_ahead: float
    entry: Dock


class DockReport(DriveReport):
    """The true path, in truth.tum, pictures of the camera, and how it ended.

    What an earlier docking has left in the folder is removed.

    Attributes:
        sent: whether the robot has been sent to its dock: the camera's pictures, of which so
            many are kept, count from then on.
        result: of the action; None before its end.
    """

    def __init__(self, folder: Path, station: Station, pictures: int):
        super().__init__(folder)
        for name in ("path.png", "camera.png", "summary.json"):
            with contextlib.suppress(FileNotFoundError):
                (folder / name).unlink()
        self._station = station
        self.topics = {
            **self.topics,
            "bullet_lab/touched": "bullet_lab/TouchedModels",
            "aruco/image_annotated": "sensor_msgs/Image",
            "dock/feedback": "bullet_lab/DockActionFeedback",
            "dock/plan": "nav_msgs/Path",
            "dock/finished": "std_msgs/Time",
        }
        self.sent = False
        self.result: Optional[DockingResult] = None
        self._frames = Sampler(pictures)
        self._states: List[StateChange] = []
        self._plan: Sequence[Tuple[float, float]] = ()
        self._touched: Optional[Reading] = None

    def take(self, topic: str, reading: Reading) -> bool:
        if topic == "odom":
            return super().take(topic, reading)
        if topic == "aruco/image_annotated":
            # Whether one of before the goal comes before it is sent is a matter of luck.
            is_over = self.until is not None and reading.stamp > self.until - REST
            if self.sent and reading.stamp > self.BEGINNING and not is_over:
                self._frames.add((reading.seconds, _small(reading.detail)))
        elif topic == "bullet_lab/touched":
            # What is touched after the end is no part of the docking.
            if None in (self.until, self._touched) or self._touched.stamp < self.until:
                self._touched = reading
        elif topic == "dock/feedback":
            if not self._states or self._states[-1][1] != reading.detail:
                self._states.append((reading.seconds, reading.detail))
        elif topic == "dock/plan":
            self._plan = reading.detail or self._plan
        else:
            self.until = reading.stamp + REST
        return False

    def newest(self) -> Optional[int]:
        return earliest((self.truth.last, self._touched and self._touched.stamp))

    def is_complete(self) -> bool:
        return self.result is not None and super().is_complete()

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        truth, result = self.truth.path(), self.result or UNFINISHED
        touches: Mapping[str, int] = self._touched.detail if self._touched else {}
        station, errors = self._station, dict.fromkeys(ERRORS, math.nan)
        dock, contacts = station.entry, sum(touches.values())
        if truth is not None:
            where = truth.poses[-1], station.dock, station.camera_ahead
            errors = docking_errors(*where, dock.docked_distance)
        verdict = judge(result.error, errors, dock.tolerance, contacts)
        return {
            "finished": self.until is not None,
            "docked": verdict == DOCKED,
            "result": verdict,
            "error_code": int(result.error),
            "error_name": result.error.name,
            "message": result.message,
            **{name: None if math.isnan(value) else value for name, value in errors.items()},
            "tolerances": largest_errors(dock.tolerance),
            "wall_contacts": contacts,
            "touched": dict(touches),
            "retries": result.retries if self.result else None,
            "calibration": result.calibration and _in_numbers(result.calibration),
            "images": self._frames.seen,
            **run,
        }

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        station, title = self._station, self.line(summary)
        docks = station.dock, station.entry.pose
        path = docking_figure(
            self.truth.path(), self._states, self._plan, station.outlines, docks, title
        )
        frames = [(at, self._state_at(at), picture) for at, picture in self._frames.chosen()]
        return {"path.png": path, **({"camera.png": strip_figure(frames)} if frames else {})}

    def line(self, summary: Mapping[str, Any]) -> str:
        if summary["error_name"] != "NONE":
            return f"not docked: {summary['message']} ({summary['error_name']})"
        trouble = {DOCKED: "", INACCURATE: "not within the dock's tolerance: "}
        return (
            f"{trouble.get(summary['result'], 'not without a contact: ')}"
            f"docked after {summary['sim_time_s']:.1f} s, {summary['retries']} retries, "
            f"{summary['wall_contacts']} wall contacts; off by "
            f"{1000.0 * summary['distance_error_m']:+.1f} mm along the axis, "
            f"{1000.0 * summary['lateral_error_m']:+.1f} mm across, "
            f"{summary['yaw_error_deg']:+.2f} deg"
        )

    def has_failed(self, summary: Mapping[str, Any]) -> bool:
        return summary["finished"] and not summary["docked"]

    def _state_at(self, seconds: float) -> str:
        before = [name for at, name in self._states if at <= seconds]
        return before[-1] if before else "at rest"


def _in_numbers(calibration: Calibration) -> Dict[str, Dict[str, float]]:
    return {name: learned._asdict() for name, learned in vars(calibration).items()}


def _small(picture: np.ndarray) -> np.ndarray:
    """Return a picture (h, w, 3), blue green red, as a small one, red green blue."""
    height = round(PICTURE_WIDTH * picture.shape[0] / picture.shape[1])
    coloured = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    return cv2.resize(coloured, (PICTURE_WIDTH, height), interpolation=cv2.INTER_AREA)


class Sampler:
    """Keeps `count` of many things, spread evenly over their number `seen`, and the last one."""

    def __init__(self, count: int):
        self._count = max(2, count)
        self._kept: List[Any] = []
        self._last: Any = None
        self.seen = 0
        self._stride = 1

    def add(self, thing: Any) -> None:
        """Take the next one."""
        if self.seen % self._stride == 0:
            if len(self._kept) >= 4 * self._count:
                self._kept = self._kept[::2]
                self._stride *= 2
            if self.seen % self._stride == 0:
                self._kept.append(thing)
        self.seen += 1
        self._last = thing

    def chosen(self) -> List[Any]:
        """Return as many as wanted, or all if there are fewer; the last is the last one seen."""
        things = list(self._kept)
        if things and things[-1] is not self._last:
            things.append(self._last)
        if len(things) <= self._count:
            return things
        picked = np.linspace(0, len(things) - 1, self._count).round().astype(int)
        return [things[index] for index in picked]


def docking_figure(
    truth: Optional[Trajectory],
    states: Sequence[StateChange],
    plan: Sequence[Tuple[float, float]],
    outlines: Iterable[Outline],
    docks: Tuple[Sequence[float], Sequence[float]],
    title: str,
) -> Figure:
    """Draw the true path over the plan of the station, in the colours of what was done.

    Args:
        truth: None for nothing yet.
        states: what was done, by the names in `STATES`.
        plan: points (m) of the last plan; may be empty.
        outlines: as of `Station`.
        docks: x, y (m) and yaw (rad) of the dock, in truth and as the robot was told.
        title: above all.
    """
    figure = figures.new_figure(9.0, 6.6)
    axes = figure.add_axes((0.08, 0.09, 0.89, 0.81))
    figure.suptitle(title)
    outlines = [np.asarray(outline, dtype=float) for outline in outlines]
    figures.draw_plan(axes, outlines, docks[0])
    (x, y, yaw), half = docks[1], 0.5 * figures.MARKER_SIDE
    across = np.array([-half, half])
    told = (x - across * math.sin(yaw), y + across * math.cos(yaw))
    axes.plot(*told, color=PURPLE, linewidth=2.0, linestyle=":", label="marker, as told")
    if plan:
        axes.plot(*np.transpose(plan), color=GREY, linewidth=2.4, alpha=0.6, label="plan")
    if truth is not None:
        _draw_path(axes, truth, states)
        _draw_robot(axes, truth.poses[0], GREEN, "start")
        _draw_robot(axes, truth.poses[-1], VERMILION, "end")
    way = [] if truth is None else [truth.poses[:, :2]]
    figures.show_around(axes, [*outlines, *way], MARGIN)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best", fontsize="small")
    return figure


def _draw_path(axes: Axes, truth: Trajectory, states: Sequence[StateChange]) -> None:
    """Draw each stretch in the colour of what was done on it."""
    begins = np.searchsorted(truth.stamps, [seconds for seconds, _ in states])
    edges = [0, *begins, len(truth) - 1]
    shown = set()
    for begin, end, name in zip(edges, edges[1:], ["at rest", *(name for _, name in states)]):
        if end > begin:
            label = None if name in shown else name
            shown.add(name)
            x, y = truth.poses[begin : end + 1, :2].T
            axes.plot(x, y, color=STATES.get(name, GREY), linewidth=1.8, label=label)


def _draw_robot(axes: Axes, pose: Sequence[float], colour: str, label: str) -> None:
    """Draw the outline of the robot with a line ahead."""
    x, y, yaw = pose
    cosine, sine = math.cos(yaw), math.sin(yaw)
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    sides = [(HALF_LENGTH * ahead, HALF_WIDTH * left) for ahead, left in signs]
    corners = [(x + cosine * a - sine * b, y + sine * a + cosine * b) for a, b in sides]
    outline = Polygon(corners, fill=False, edgecolor=colour, linewidth=1.6, label=label, zorder=3)
    axes.add_patch(outline)
    ahead = (x + HALF_LENGTH * cosine, y + HALF_LENGTH * sine)
    axes.plot((x, ahead[0]), (y, ahead[1]), color=colour, linewidth=1.6, zorder=3)


def strip_figure(frames: Sequence[Tuple[float, str, np.ndarray]]) -> Figure:
    """Draw pictures of the camera in a row or two, each with its time and what was done.

    A frame is a time in s, a state, and a picture as (h, w, 3) uint8 RGB; there is one at least.
    """
    columns = min(4, len(frames))
    rows = -(-len(frames) // columns)
    figure = figures.new_figure(3.2 * columns, 2.72 * rows)
    frame = {"left": 0.005, "right": 0.995, "bottom": 0.005, "top": 1.0 - 0.3 / (2.72 * rows)}
    grid = figure.add_gridspec(rows, columns, **frame, wspace=0.02, hspace=0.14)
    for cell, (seconds, state, picture) in zip(grid, frames):
        axes = figure.add_subplot(cell)
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(f"{seconds:.1f} s, {state}", fontsize="small", pad=3.0)
    return figure
