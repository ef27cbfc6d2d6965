"""The report of the job `dock`: the true path of one docking, its errors, and two figures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple, Sequence, Tuple

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy import ndarray

from bullet_lab.core import figures, se2
from bullet_lab.core.figures import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, Outline
from bullet_lab.core.files import NANOSECONDS
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.docking.database import (
    DOCKED,
    ERRORS,
    INACCURATE,
    Dock,
    docking_errors,
    judge,
    largest_errors,
)
from bullet_lab.docking.types import HALF_WIDTH, DockingError, DockingResult
from bullet_lab.reports import DriveReport, Figures, Reading, Summary, earliest

# ns that are recorded after the end, while the robot should stand.
REST = NANOSECONDS // 2
# px; the camera's pictures are kept in this width, and so many of them.
PICTURE_WIDTH = 320
PICTURES = 8
UNFINISHED = DockingResult(DockingError.UNKNOWN, "the docking was not finished")
STATES = {
    "searching": PURPLE,
    "staging": BLUE,
    "measuring": GREEN,
    "approaching": ORANGE,
    "retreating": VERMILION,
    "docked": BLACK,
}
"""Colours of the states of docking."""

# m around all that is drawn.
MARGIN = 0.6

StateChange = Tuple[float, str]
"""The time (s) at which a state began, and its name."""


class Station(NamedTuple):
    """The surroundings of a docking.

    Attributes:
        outlines: of all objects, in m.
        dock: true pose (m, m, rad) of the floor below the marker's face.
        camera_ahead: m, of the camera from the robot's middle.
        entry: the dock in the database, with the rough pose that the robot gets.
    """

    outlines: Sequence[Outline]
    dock: PlanarPose
    camera_ahead: float
    entry: Dock


class DockReport(DriveReport):
    """The true path, in truth.tum, pictures of the camera, and the outcome.

    `sent` is set when the goal was sent, from which on pictures are kept; `result` is that of the
    action, None before its end.
    """

    def __init__(self, folder: Path, station: Station):
        super().__init__(folder)
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
        self.result: DockingResult | None = None
        self._frames = EvenSample(PICTURES)
        self._states: list[StateChange] = []
        self._touched: Reading | None = None

    def take(self, topic: str, reading: Reading) -> bool:
        if topic == "aruco/image_annotated":
            # An earlier picture may come before or after the goal is sent, by chance.
            is_over = self.until is not None and reading.stamp > self.until - REST
            if self.sent and reading.stamp > self.BEGINNING and not is_over:
                self._frames.add((reading.seconds, _small(reading.detail)))
        elif topic == "bullet_lab/touched":
            # Contacts after the end do not count.
            if None in (self.until, self._touched) or self._touched.stamp < self.until:
                self._touched = reading
        elif topic == "dock/feedback":
            if not self._states or self._states[-1][1] != reading.detail:
                self._states.append((reading.seconds, reading.detail))
        elif topic == "dock/finished":
            self.until = reading.stamp + REST
        else:
            return super().take(topic, reading)
        return False

    def newest(self) -> int | None:
        return earliest((self.truth.last, self._touched and self._touched.stamp))

    def is_complete(self) -> bool:
        return self.result is not None and super().is_complete()

    def summary(self, finished: bool, run: Summary) -> Summary:
        result, dock = self.result or UNFINISHED, self._station.entry
        touches = self._touched.detail if self._touched else {}
        contacts = sum(touches.values())
        errors = self._errors()
        verdict = judge(result.error, errors, dock.tolerance, contacts)
        learned = result.calibration and result.calibration._asdict()
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
            "calibration": learned and {name: one._asdict() for name, one in learned.items()},
            "images": self._frames.seen,
            **run,
        }

    def _errors(self) -> dict[str, float]:
        """Return the errors at the end, by the truth; NaN without a pose."""
        truth, station = self.truth.path(), self._station
        if truth is None:
            return dict.fromkeys(ERRORS, math.nan)
        return docking_errors(
            truth.poses[-1], station.dock, station.camera_ahead, station.entry.docked_distance
        )

    def figures(self, summary: Summary) -> Figures:
        plans = [one.detail for one in self.readings["dock/plan"] if one.detail]
        drawn = self.truth.path(), self._states, plans[-1] if plans else ()
        path = docking_figure(*drawn, self._station, self.line(summary))
        frames = [(at, self._state_at(at), picture) for at, picture in self._frames.chosen()]
        strip = {"camera.png": strip_figure(frames)} if frames else {}
        return {"path.png": path, **strip}

    def line(self, summary: Summary) -> str:
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

    def has_failed(self, summary: Summary) -> bool:
        return summary["finished"] and not summary["docked"]

    def _state_at(self, seconds: float) -> str:
        before = [name for at, name in self._states if at <= seconds]
        return before[-1] if before else "at rest"


def _small(picture: ndarray) -> ndarray:
    """Return a picture (h, w, 3) in BGR as a small one in RGB."""
    height = round(PICTURE_WIDTH * picture.shape[0] / picture.shape[1])
    coloured = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    return cv2.resize(coloured, (PICTURE_WIDTH, height), interpolation=cv2.INTER_AREA)


class EvenSample:
    """Keeps `count` of many items, spread evenly, and the last one; `seen` is their number."""

    def __init__(self, count: int):
        self._count = count
        self._kept: list[Any] = []
        self._last: Any = None
        self._stride = 1
        self.seen = 0

    def add(self, item: Any) -> None:
        """Take the next item."""
        if self.seen % self._stride == 0:
            self._kept.append(item)
            if len(self._kept) > 4 * self._count:
                self._kept = self._kept[::2]
                self._stride *= 2
        self.seen += 1
        self._last = item

    def chosen(self) -> list[Any]:
        """Return `count` items, or all if there are fewer; the last is the last one seen."""
        items = list(self._kept)
        if items and items[-1] is not self._last:
            items.append(self._last)
        if len(items) <= self._count:
            return items
        picked = np.linspace(0, len(items) - 1, self._count).round().astype(int)
        return [items[index] for index in picked]


def docking_figure(
    truth: Trajectory | None,
    states: Sequence[StateChange],
    plan: Sequence[tuple[float, float]],
    station: Station,
    title: str,
) -> Figure:
    """Draw the true path over the plan of the station, in the colours of the states.

    Args:
        truth: the path; None for none.
        states: of docking, by the names in `STATES`.
        plan: points (m) of the last planned path; may be empty.
        station: with the dock, where it is and where the robot takes it to be.
        title: of the figure.
    """
    figure = figures.new_figure(9.0, 6.6, title)
    axes = figure.add_axes((0.08, 0.09, 0.89, 0.81))
    shown = [np.asarray(outline, dtype=float) for outline in station.outlines]
    figures.draw_plan(axes, shown, station.dock)
    (x, y, yaw), half = station.entry.pose, 0.5 * figures.MARKER_SIDE
    across = np.array([-half, half])
    rough = (x - across * math.sin(yaw), y + across * math.cos(yaw))
    axes.plot(*rough, color=PURPLE, linewidth=2.0, linestyle=":", label="marker in the database")
    if plan:
        axes.plot(*np.transpose(plan), color=GREY, linewidth=2.4, alpha=0.6, label="plan")
    if truth is not None:
        _draw_path(axes, truth, states)
        _draw_robot(axes, truth.poses[0], GREEN, "start")
        _draw_robot(axes, truth.poses[-1], VERMILION, "end")
        shown.append(truth.poses[:, :2])
    figures.show_around(axes, shown, MARGIN)
    axes.set_adjustable("datalim")
    axes.legend(loc="best", fontsize="small")
    return figure


def _draw_path(axes: Axes, truth: Trajectory, states: Sequence[StateChange]) -> None:
    """Draw each stretch of the path in the colour of its state."""
    names = ["at rest", *(name for _, name in states)]
    begins = np.searchsorted(truth.stamps, [seconds for seconds, _ in states])
    edges = [0, *begins, len(truth) - 1]
    shown = set()
    for begin, end, name in zip(edges, edges[1:], names):
        if end > begin:
            label = None if name in shown else name
            shown.add(name)
            x, y = truth.poses[begin : end + 1, :2].T
            axes.plot(x, y, color=STATES.get(name, GREY), linewidth=1.8, label=label)


def _draw_robot(axes: Axes, pose: Sequence[float], colour: str, label: str) -> None:
    """Draw the outline of the robot and a line from its middle to the front."""
    square = HALF_WIDTH * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0)])
    *corners, front = se2.compose(pose, np.insert(square, 2, 0.0, axis=1))[:, :2]
    outline = Polygon(corners, fill=False, edgecolor=colour, linewidth=1.6, label=label, zorder=3)
    axes.add_patch(outline)
    axes.plot(*zip(pose[:2], front), color=colour, linewidth=1.6, zorder=3)


def strip_figure(frames: Sequence[tuple[float, str, ndarray]]) -> Figure:
    """Draw pictures of the camera in a row or two, each with its time and the state.

    Args:
        frames: at least one; each is a time (s), a state, and a picture, (h, w, 3) uint8 RGB.
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
