"""Somebody's robot: what of it acts, what it sends, and how it drives a metre and a turn."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLUE, ORANGE, new_figure, plan_axes
from bullet_lab.core.files import NANOSECONDS, PathSeries, replace_file
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.reports import Reading, Report

TRUTH, ODOMETRY = "truth", "odometry"
TABLE = "robot.md"
# A robot that has come less far than this share of what was asked for has not moved.
STANDING = 0.05
# The share of what was asked for that a robot must have come, really. Wheels that slip as they turn
# lose a tenth (docs/contact_model.md); half as much again is allowed.
DONE = 0.85
# Names in a line.
MOST_NAMES = 3
# Of the rate that a topic is to have.
RATE_TOLERANCE = 0.05
# Messages, before a rate is made of them.
FEWEST = 3


class PluginRow(NamedTuple):
    """A `<plugin>`: its topics, its rate in Hz (0: none of its own), the tags that do nothing.

    `refused` are the controllers, with their types, that it could not load.
    """

    name: str
    filename: str
    link: str
    acts: bool
    rate: float
    inputs: Tuple[str, ...]
    outputs: Tuple[str, ...]
    tags_not_simulated: Tuple[str, ...]
    refused: Tuple[str, ...] = ()


class Controller(NamedTuple):
    """A controller of ros_control."""

    name: str
    kind: str
    state: str


@dataclass(frozen=True)
class Robot:
    """What a robot is made of; `drive` and `odometry` are topics, empty where it has none.

    `said` is what the simulation has warned of, `choice` the names of all that could be driven.
    """

    name: str
    links: Tuple[str, ...] = ()
    joints: Tuple[str, ...] = ()
    plugins: Tuple[PluginRow, ...] = ()
    controllers: Tuple[Controller, ...] = ()
    drive: str = ""
    odometry: str = ""
    said: Tuple[str, ...] = ()
    choice: Tuple[str, ...] = ()


class Count:
    """Messages on a topic: how many, and the stamps in ns of the first and the last."""

    def __init__(self, kind: str, rate: float):
        self.kind, self.declared = kind, rate
        self.messages, self._first, self._last = 0, 0, 0

    def note(self, stamp: int) -> None:
        """Count a message."""
        if not self.messages:
            self._first = stamp
        self.messages, self._last = self.messages + 1, stamp

    def rate(self) -> Optional[float]:
        """Return the rate in Hz of simulated time; None of too few."""
        span = self._last - self._first
        enough = self.messages >= FEWEST and span > 0
        return (self.messages - 1) * NANOSECONDS / span if enough else None

    def figures(self) -> Dict[str, Any]:
        """Return what summary.json says of it."""
        seen = self.rate()
        return {
            "type": self.kind,
            "declared_hz": self.declared or None,
            "seen_hz": None if seen is None else round(seen, 3),
            "messages": self.messages,
        }


def declared_rates(rows: Sequence[PluginRow]) -> Dict[str, float]:
    """Return the rate (Hz) of each topic: those of all that speak on it, 0 if one has none."""
    shares: Dict[str, List[float]] = {}
    for row in rows:
        for topic in row.outputs:
            shares.setdefault(topic, []).append(row.rate)
    return {topic: sum(rates) if all(rates) else 0.0 for topic, rates in shares.items()}


class Way:
    """How far a robot has come since it was first seen: m along and across its first heading."""

    def __init__(self):
        self._start: Optional[PlanarPose] = None
        self._last: PlanarPose = (0.0, 0.0, 0.0)
        self.turned = 0.0
        """rad, whole turns counted."""

    def add(self, pose: PlanarPose) -> None:
        """Go on to a pose (m, m, rad)."""
        if self._start is None:
            self._start = self._last = pose
        self.turned += math.remainder(pose[2] - self._last[2], math.tau)
        self._last = pose

    def ahead_and_aside(self) -> Tuple[float, float]:
        """Return how far it has come, m."""
        if self._start is None:
            return 0.0, 0.0
        dx, dy = (b - a for a, b in zip(self._start[:2], self._last[:2]))
        cosine, sine = math.cos(self._start[2]), math.sin(self._start[2])
        return cosine * dx + sine * dy, cosine * dy - sine * dx

    def figures(self) -> Optional[Dict[str, float]]:
        """Return what summary.json says of it."""
        if self._start is None:
            return None
        ahead, aside = self.ahead_and_aside()
        return {"ahead_m": ahead, "aside_m": aside, "turned_deg": math.degrees(self.turned)}


@dataclass(frozen=True)
class Leg:
    """A part of the drive: what was asked for, what odometry and truth say, and how long it took.

    Attributes:
        name: what is driven, such as "metre".
        quantity: the figure of `Way.figures` that it is about.
        asked: that much of it.
        seconds: simulated.
        late: whether it was given up because it took too long.
        touched: model::link, what it touched from the side.
        causes: what is known of why it stands.
    """

    name: str
    quantity: str
    asked: float
    odometry: Optional[Mapping[str, float]]
    truth: Mapping[str, float]
    seconds: float
    late: bool = False
    touched: Tuple[str, ...] = ()
    causes: Tuple[str, ...] = ()

    def has_failed(self) -> bool:
        """Return whether the robot did not do what it was asked, by the truth.

        One that is slow to brake comes too far, and its odometry says so.
        """
        share, error = self.truth[self.quantity] / self.asked, self.error()
        is_off = error is not None and error > 100.0 * (1.0 - DONE)
        return self.late or share < DONE or (is_off and share > 2.0 - DONE)

    def reasons(self) -> List[str]:
        """Return what is known of why the robot did not do what it was asked."""
        verb = "turned" if self.quantity == "turned_deg" else "drove"
        backwards = [f"{verb} the other way"] if self.truth[self.quantity] < 0.0 else []
        found = backwards if self.has_moved() else list(self.causes)
        if self.touched:
            found.append(f"touches {', '.join(self.touched[:MOST_NAMES])}")
        if self.late:
            found.append(f"out of time after {self.seconds:.0f} s")
        return found if self.has_failed() else []

    def has_moved(self) -> bool:
        """Return whether the robot has really moved."""
        return abs(self.truth[self.quantity]) >= STANDING * abs(self.asked)

    def error(self) -> Optional[float]:
        """Return by how many percent of the truth the odometry is off; None without either."""
        if self.odometry is None or not self.has_moved():
            return None
        true = self.truth[self.quantity]
        if self.quantity == "turned_deg":
            return 100.0 * abs(self.odometry[self.quantity] - true) / abs(true)
        parts = ("ahead_m", "aside_m")
        return 100.0 * math.hypot(*(self.odometry[p] - self.truth[p] for p in parts)) / abs(true)

    def figures(self) -> Dict[str, Any]:
        """Return what summary.json says of it."""
        return {
            "asked": self.asked,
            "odometry": self.odometry,
            "truth": self.truth,
            "moved": self.has_moved(),
            "failed": self.has_failed(),
            "reasons": self.reasons(),
            "odometry_error_percent": self.error(),
            "seconds": self.seconds,
        }

    def line(self) -> str:
        """Return it in a few words."""
        unit = "m" if self.quantity == "ahead_m" else "°"
        true, reasons = self.truth[self.quantity], ", ".join(self.reasons())
        why = f": {reasons}" if reasons else ""
        if not self.has_moved():
            return f"{self.name}: it does not move ({true:.3f} {unit} of {self.asked:g}){why}"
        said = "nothing came from its odometry"
        if self.odometry is not None:
            said = f"its odometry says {self.odometry[self.quantity]:.3f} {unit}"
            said += f" ({self.error():.2f} % off)"
        beside = "" if unit == "°" else f", turned by {self.truth['turned_deg']:.2f}° on the way"
        come = f"{true:.2f} of {self.asked:g}" if self.has_failed() else f"{true:.3f}"
        return f"{self.name}: {come} {unit}{why}{beside}; {said}"


class RobotReport(Report):
    """The table robot.md, truth.tum, odom.tum, robot.png and summary.json of one robot.

    Attributes:
        robot: what it is made of.
        counts: messages by topic.
        legs: of the drive.
        picture: of the robot, (h, w, 3) uint8, blue green red.
        seen: the first picture of each of its cameras, likewise, by topic.
        tilt_deg: how far from upright it was in the end.
        not_started: nodes of its launch file that could not start or died.
        pauses: how often its odometry paused.

    Args:
        kinds: types of its topics.
        others: plugins of other models, which may speak on the same topics.
    """

    def __init__(
        self, folder: Path, robot: Robot, kinds: Mapping[str, str], others: Sequence[PluginRow] = ()
    ):
        super().__init__(folder)
        self.robot = robot
        rates = declared_rates((*robot.plugins, *others))
        self.counts = {topic: Count(kind, rates.get(topic, 0.0)) for topic, kind in kinds.items()}
        self.series = {
            TRUTH: PathSeries(folder / "truth.tum"),
            ODOMETRY: PathSeries(folder / "odom.tum"),
        }
        self.legs: List[Leg] = []
        self.picture: Optional[np.ndarray] = None
        self.seen: Dict[str, np.ndarray] = {}
        self.tilt_deg = 0.0
        self.not_started: List[str] = []
        self.pauses = 0

    def take(self, topic: str, reading: Reading) -> bool:
        """Take a pose of `TRUTH` or `ODOMETRY`."""
        series = self.series[topic]
        if series.last is not None and reading.stamp <= series.last:
            return False
        series.add(reading.stamp, reading.values)
        return True

    def finish(self, until: Optional[int] = None) -> None:
        super().finish(until)
        replace_file(self.folder / TABLE, lambda part: part.write_text(self.table()))

    def left_out(self) -> List[str]:
        """Return the plugins that do nothing, and the controllers that were refused."""
        plugins = self.robot.plugins
        idle = [f"{row.name} ({row.filename})" for row in plugins if not row.acts]
        return idle + [controller for row in plugins for controller in row.refused]

    def silent(self) -> List[str]:
        """Return the topics with a rate that nothing came on."""
        return [t for t, count in self.counts.items() if count.declared and not count.messages]

    def off_rate(self) -> List[str]:
        """Return the topics whose rate was not the declared one."""
        pairs = [(t, c.declared, c.rate()) for t, c in self.counts.items()]
        return [
            topic
            for topic, declared, seen in pairs
            if declared and seen is not None and abs(seen / declared - 1.0) > RATE_TOLERANCE
        ]

    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        robot = asdict(self.robot)
        robot["plugins"] = [row._asdict() for row in self.robot.plugins]
        robot["controllers"] = [row._asdict() for row in self.robot.controllers]
        return {
            "finished": finished,
            "robot": robot,
            "left_out": self.left_out(),
            "not_started": self.not_started,
            "topics": {topic: count.figures() for topic, count in self.counts.items()},
            "silent": self.silent(),
            "off_rate": self.off_rate(),
            "drive": {leg.name: leg.figures() for leg in self.legs},
            "odometry_pauses": self.pauses,
            "tilt_deg": self.tilt_deg,
            "sim_time_s": self.seconds(),
            **run,
        }

    def line(self, summary: Mapping[str, Any]) -> str:
        if not self.robot.drive:
            left_out = f"; left out: {', '.join(self.left_out())}" if self.left_out() else ""
            shown = "listens to no velocities: it is shown, not driven"
            return f"'{self.robot.name}' {shown}{left_out}"
        return "; ".join(leg.line() for leg in self.legs) or "it was not driven"

    def has_failed(self, summary: Mapping[str, Any]) -> bool:
        return any(leg.has_failed() for leg in self.legs)

    def table(self) -> str:
        """Return what acts and what does not, in Markdown."""
        return "\n".join(_lines(self)) + "\n"

    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        pictures = [(f"{self.robot.name}", self.picture)] if self.picture is not None else []
        pictures += list(self.seen.items())[:2]
        figure = new_figure(5.6 * (len(pictures) + 1), 5.0)
        panels = figure.subplots(1, len(pictures) + 1, squeeze=False)[0]
        for axes, (title, picture) in zip(panels, pictures):
            axes.imshow(picture[:, :, ::-1])
            axes.set_title(title, fontsize=9)
            axes.axis("off")
        self._draw_path(panels[-1])
        figure.tight_layout()
        return {"robot.png": figure}

    def _draw_path(self, axes: Axes) -> None:
        plan_axes(axes, title="a metre and a turn")
        for name, colour, width in ((TRUTH, ORANGE, 3.0), (ODOMETRY, BLUE, 1.2)):
            _, rows = self.series[name].table()
            if len(rows):
                # Odometry begins at its own zero: it is laid on the start of the truth.
                axes.plot(*_from_the_start(rows), color=colour, linewidth=width, label=name)
        if axes.lines:
            axes.legend(loc="best")


def _from_the_start(rows: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return x and y (m) of a path as seen from its first pose."""
    x, y, yaw = rows[0]
    dx, dy = rows[:, 0] - x, rows[:, 1] - y
    return math.cos(yaw) * dx + math.sin(yaw) * dy, math.cos(yaw) * dy - math.sin(yaw) * dx


def _lines(report: RobotReport) -> Iterator[str]:
    robot, pauses = report.robot, report.pauses
    yield f"# {robot.name}"
    yield ""
    yield f"{len(robot.links)} links: {', '.join(robot.links)}"
    yield ""
    yield f"{len(robot.joints)} joints: {', '.join(robot.joints) or 'none'}"
    yield from _rows(
        ("plugin", "file", "acts", "listens to", "speaks on", "Hz", "tags not simulated"),
        [
            (
                row.name,
                row.filename,
                "yes" if row.acts else "**no**",
                " ".join(row.inputs),
                " ".join(row.outputs),
                f"{row.rate:g}" if row.rate else "",
                " ".join(row.tags_not_simulated),
            )
            for row in robot.plugins
        ],
    )
    refused = [name for row in robot.plugins for name in row.refused]
    yield from _rows(
        ("controller", "type", "state"),
        [*robot.controllers, *((*name[:-1].split(" (", 1), "**refused**") for name in refused)],
    )
    yield from _rows(
        ("topic", "type", "Hz declared", "Hz seen", "messages"),
        [
            (
                topic,
                count.kind,
                f"{count.declared:g}" if count.declared else "",
                "" if count.rate() is None else f"{count.rate():.2f}",
                str(count.messages),
            )
            for topic, count in report.counts.items()
        ],
    )
    yield ""
    if len(robot.choice) > 1:
        yield f"- drives {robot.name} of {', '.join(robot.choice)}: model:=NAME chooses another"
    yield f"- velocities: {robot.drive or 'nothing listens to any'}"
    yield f"- odometry: {robot.odometry or 'none'}" + f" (pauses: {pauses})" * bool(pauses)
    yield from (f"- {leg.line()}" for leg in report.legs)
    for title, lines in (
        ("Could not start, or died:", report.not_started),
        ("What the simulation said of it:", robot.said),
    ):
        if lines:
            yield from ("", title, "", *(f"- {line}" for line in lines))


def _rows(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """A table with columns of even width; nothing without rows."""
    if not rows:
        return
    table = [list(header), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*table)]
    yield ""
    for number, row in enumerate(table):
        yield "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths)) + " |"
        if not number:
            yield "|" + "|".join("-" * (width + 2) for width in widths) + "|"
