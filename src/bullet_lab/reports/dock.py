"""One docking: what it leaves behind, and its figure."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, Iterable, List, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from bullet_lab.core import se2
from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    Outline,
    draw_plan,
    new_figure,
)
from bullet_lab.core.files import RowFile, make_folder
from bullet_lab.core.trajectory import Trajectory, tum_row
from bullet_lab.errors import LabError

PlanarPose = Tuple[float, float, float]
NANOSECONDS = 1_000_000_000


class DockingRunError(LabError):
    """A pose cannot be recorded."""


class PathRecording:
    """Writes one path as a TUM file while poses come in.

    Args:
        path: of the file; its folder is made if need be.

    Raises:
        FileError: it cannot be written, here and in all that adds to it.
    """

    def __init__(self, path: Path):
        make_folder(path.parent)
        self._file = RowFile(path)
        self._stamps: List[int] = []
        self._poses: List[PlanarPose] = []

    @property
    def last(self) -> Optional[int]:
        """The last stamp in ns, None while there is none."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp: int, pose: PlanarPose) -> None:
        """Record a pose (m, m, rad) at a stamp in ns.

        Raises:
            DockingRunError: not later than the one before.
        """
        if self._stamps and stamp <= self._stamps[-1]:
            raise DockingRunError("time goes back")
        self._stamps.append(stamp)
        self._poses.append(pose)
        self._file.write(tum_row(stamp / NANOSECONDS, *pose))

    def until(self, stamp: Optional[int]) -> Optional[Trajectory]:
        """Return the path up to a stamp in ns, all of it for None; None while there is none."""
        count = sum(stamp is None or one <= stamp for one in self._stamps)
        if not count:
            return None
        seconds = [one / NANOSECONDS for one in self._stamps[:count]]
        return Trajectory(seconds, self._poses[:count])

    def finish(self, stamp: Optional[int]) -> None:
        """Close the file; leave out what came after a stamp in ns, if one is given."""
        kept = [
            tum_row(one / NANOSECONDS, *pose)
            for one, pose in zip(self._stamps, self._poses)
            if stamp is None or one <= stamp
        ]
        self._file.rewrite(kept)


def docking_errors(
    robot: Sequence[float], dock: Sequence[float], camera_ahead: float, docked_distance: float
) -> Dict[str, float]:
    """Return how far a robot is from where it should stand in a dock.

    Args:
        robot: its true pose, m and rad.
        dock: true pose of the floor below the marker's face, in the same frame.
        camera_ahead: m, of the camera from the robot's middle.
        docked_distance: m, from the camera to the marker's face in a docked robot.

    Returns:
        distance_error_m, positive for too far away; lateral_error_m of the robot, to the left;
        yaw_error_deg.
    """
    x, y, yaw = se2.between(np.asarray(dock, dtype=float), np.asarray(robot, dtype=float))
    camera = x + camera_ahead * math.cos(yaw)
    return {
        "distance_error_m": float(-camera - docked_distance),
        "lateral_error_m": float(y),
        "yaw_error_deg": math.degrees(yaw),
    }


class Keepsakes:
    """Keeps some of many things, spread evenly over their number, and the last one.

    Args:
        count: how many there shall be at least, once there were so many.
    """

    def __init__(self, count: int):
        self._count = max(2, count)
        self._kept: List[Any] = []
        self._last: Any = None
        self._seen = 0
        self._stride = 1

    def add(self, thing: Any) -> None:
        """Take the next one."""
        if self._seen % self._stride == 0:
            if len(self._kept) >= 4 * self._count:
                self._kept = self._kept[::2]
                self._stride *= 2
            if self._seen % self._stride == 0:
                self._kept.append(thing)
        self._seen += 1
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
