"""The report of the job `robot`: which parts are simulated, what it publishes, how it drives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from bullet_lab.core.figures import BLUE, ORANGE, new_figure, plan_axes
from bullet_lab.core.files import NANOSECONDS, PathSeries, replace_file
from bullet_lab.core.se2 import PlanarPose, between
from bullet_lab.reports import Figures, Reading, Report, Summary

# Names of the two paths.
TRUTH = "truth"
ODOMETRY = "odometry"
TABLE = "robot.md"
# A robot that has driven less than this share of the target has not moved.
LEAST_MOTION = 0.05
# The share of the target that a robot must reach by the truth. Wheels that slip in a turn lose a
# tenth (docs/contact_model.md); half as much again is allowed.
DONE = 0.85
# The share of a turn down to which slipping wheels may explain the rest. Robots that skid have a
# wheel_separation_multiplier of up to 1.9.
SLIPPING = 0.5
# A part of the drive ends at this many times the target by the truth, whatever odometry reports.
FARTHEST = 1.5
# It also ends where the robot has gone this share of the target the other way.
BACKWARDS = 0.25
# Drives that cannot turn on the spot.
STEERED = (
    "libgazebo_ros_tricycle_drive.so",
    "ackermann_steering_controller/AckermannSteeringController",
    "steer_drive_controller/SteerDriveController",
    "four_wheel_steering_controller/FourWheelSteeringController",
)
# How many links that were touched a line names.
MOST_NAMES = 3
# Relative deviation of a topic's rate that is allowed.
RATE_TOLERANCE = 0.05
# A rate needs at least this many messages.
FEWEST = 3


@dataclass(frozen=True)
class Robot:
    """The parts and topics of a robot.

    Attributes:
        plugins: of its model, with the fields of bullet_lab/PluginDescription.
        controllers: that are loaded, with the fields of controller_manager_msgs/ControllerState.
        drive: topic of its velocity commands; empty if it has none.
        odometry: topic of its odometry; empty if it has none.
        said: warnings of the simulation about it.
        choice: names of all models that can be driven.
    """

    name: str
    links: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    plugins: tuple[Any, ...] = ()
    controllers: tuple[Any, ...] = ()
    drive: str = ""
    odometry: str = ""
    said: tuple[str, ...] = ()
    choice: tuple[str, ...] = ()

    def is_steered(self) -> bool:
        """Return whether it drives curves by a front wheel, and cannot turn on the spot."""
        kinds = {*(p.filename for p in self.plugins), *(c.type for c in self.controllers)}
        return not kinds.isdisjoint(STEERED)


@dataclass
class Count:
    """The messages on a topic: their type, declared rate (Hz, 0 for none), and stamps (ns)."""

    kind: str
    declared: float
    messages: int = 0
    first: int = 0
    last: int = 0

    def note(self, stamp: int) -> None:
        """Count a message."""
        self.first = self.first if self.messages else stamp
        self.messages += 1
        self.last = stamp

    def rate(self) -> float | None:
        """Return the rate in Hz of simulated time; None if there are too few messages."""
        span = self.last - self.first
        if self.messages < FEWEST or span <= 0:
            return None
        return (self.messages - 1) * NANOSECONDS / span

    def is_off(self) -> bool:
        """Return whether the rate is not the declared one."""
        seen, declared = self.rate(), self.declared
        return bool(seen and declared) and abs(seen / declared - 1.0) > RATE_TOLERANCE

    def figures(self) -> Summary:
        """Return the topic's entry in summary.json."""
        seen = self.rate()
        return {
            "type": self.kind,
            "declared_hz": self.declared or None,
            "seen_hz": seen and round(seen, 3),
            "messages": self.messages,
        }


def declared_rates(rows: Sequence[Any]) -> dict[str, float]:
    """Return the rate (Hz) of each topic: the sum of its plugins', 0 if one of them has none."""
    shares: dict[str, list[float]] = {}
    for row in rows:
        for topic in row.outputs:
            shares.setdefault(topic, []).append(row.rate)
    return {topic: sum(rates) if all(rates) else 0.0 for topic, rates in shares.items()}


def displacement(poses: Sequence[PlanarPose]) -> dict[str, float] | None:
    """Return how far a robot has moved along and across its first heading, and how far it turned.

    Whole turns are counted. None without a pose.
    """
    if not poses:
        return None
    ahead, aside, _ = between(poses[0], poses[-1]).tolist()
    yaws = np.unwrap([yaw for _, _, yaw in poses])
    turned = math.degrees(yaws[-1] - yaws[0])
    return {"ahead_m": ahead, "aside_m": aside, "turned_deg": turned}


@dataclass
class Leg:
    """A part of the drive, with the poses (m, m, rad) that odometry and truth report.

    Attributes:
        quantity: the figure of `displacement` that has the target.
        target: m or degrees.
        seconds: simulated.
        late: whether it was aborted because it took too long.
        touched: model::link of what the robot has touched from the side.
        causes: known reasons why it stands.
    """

    name: str
    quantity: str
    target: float
    odometry: list[PlanarPose] = field(default_factory=list)
    truth: list[PlanarPose] = field(default_factory=list)
    seconds: float = 0.0
    late: bool = False
    touched: Sequence[str] = ()
    causes: Sequence[str] = ()

    def is_done(self, odometry_pauses: bool) -> bool:
        """Return whether the odometry, or the truth while that pauses, has reached the target.

        It is also done if the robot goes much too far, or the other way.
        """
        reported = None if odometry_pauses else displacement(self.odometry)
        share = displacement(self.truth)[self.quantity] / self.target
        is_there = (reported[self.quantity] / self.target if reported else share) >= 1.0
        return is_there or not -BACKWARDS < share < FARTHEST

    def has_moved(self) -> bool:
        """Return whether the robot has moved, by the truth."""
        return abs(displacement(self.truth)[self.quantity]) >= LEAST_MOTION * self.target

    def figures(self) -> Summary:
        """Return the part's entry in summary.json.

        The robot fails if it misses the target by the truth, unless its wheels slip: in a turn in
        which it is free, and its odometry has the target. A robot that brakes slowly goes too far,
        and its odometry reports that.
        """
        odometry, truth = displacement(self.odometry), displacement(self.truth)
        share, error = truth[self.quantity] / self.target, None
        is_turn = self.quantity == "turned_deg"
        if odometry and self.has_moved():
            names = ("turned_deg",) if is_turn else ("ahead_m", "aside_m")
            off = math.hypot(*(odometry[name] - truth[name] for name in names))
            error = 100.0 * off / abs(truth[self.quantity])
        arrives = odometry and odometry[self.quantity] >= self.target
        is_free_turn = is_turn and not self.late and not self.touched
        slips = bool(is_free_turn and arrives) and SLIPPING <= share < DONE
        goes_too_far = share > 2.0 - DONE and (error or 0.0) > 100.0 * (1.0 - DONE)
        failed = self.late or goes_too_far or (share < DONE and not slips)
        reasons = ["wheels slip"] if slips else list(self._reasons(share)) if failed else []
        return {
            "asked": self.target,
            "odometry": odometry,
            "truth": truth,
            "moved": self.has_moved(),
            "failed": failed,
            "reasons": reasons,
            "odometry_error_percent": error,
            "seconds": self.seconds,
        }

    def _reasons(self, share: float) -> Iterator[str]:
        """Yield the known reasons why the robot has only reached a share of the target."""
        if not self.has_moved():
            yield from self.causes
        elif share < 0.0:
            yield f"{'turned' if self.quantity == 'turned_deg' else 'drove'} the other way"
        if self.touched:
            yield f"touches {', '.join(self.touched[:MOST_NAMES])}"
        if self.late:
            yield f"out of time after {self.seconds:.0f} s"

    def line(self) -> str:
        """Return the outcome in one line."""
        found, unit = self.figures(), "m" if self.quantity == "ahead_m" else "°"
        odometry, turned = found["odometry"], found["truth"]["turned_deg"]
        true, why = found["truth"][self.quantity], ", ".join(found["reasons"])
        why = f": {why}" if why else ""
        if not found["moved"]:
            return f"{self.name}: it does not move ({true:.3f} {unit} of {self.target:g}){why}"
        reported = "nothing came from its odometry"
        if odometry:
            reported = f"its odometry says {odometry[self.quantity]:.3f} {unit}"
            reported += f" ({found['odometry_error_percent']:.2f} % off)"
        on_the_way = "" if unit == "°" else f", turned by {turned:.2f}° on the way"
        has_missed = found["failed"] or found["reasons"]
        reached = f"{true:.2f} of {self.target:g}" if has_missed else f"{true:.3f}"
        return f"{self.name}: {reached} {unit}{why}{on_the_way}; {reported}"


class RobotReport(Report):
    """The table robot.md, truth.tum, odom.tum, robot.png and summary.json of one robot.

    `kinds` are the types of its topics, on which `others`, plugins of other models, may publish,
    too.

    Attributes:
        counts: of messages, by topic.
        legs: parts of the drive.
        picture: of the robot, (h, w, 3) uint8, BGR.
        seen: the first picture of each of its cameras, likewise, by topic.
        tilt_deg: angle between the robot's z axis and the vertical at the end.
        not_started: nodes of its launch file that could not start or died.
        pauses: how often its odometry paused.
    """

    def __init__(
        self,
        folder: Path,
        robot: Robot,
        kinds: Mapping[str, str],
        others: Sequence[Any] = (),
    ):
        super().__init__(folder)
        self.robot = robot
        rates = declared_rates((*robot.plugins, *others))
        # An event, as of a bumper, comes when something has changed.
        self.counts = {
            topic: Count(kind, 0.0 if kind.endswith("Event") else rates.get(topic, 0.0))
            for topic, kind in kinds.items()
        }
        self.series = {
            TRUTH: PathSeries(folder / "truth.tum"),
            ODOMETRY: PathSeries(folder / "odom.tum"),
        }
        self.legs: list[Leg] = []
        self.picture: np.ndarray | None = None
        self.seen: dict[str, np.ndarray] = {}
        self.tilt_deg = 0.0
        self.not_started: list[str] = []
        self.pauses = 0

    def take(self, topic: str, reading: Reading) -> bool:
        """Record a pose of `TRUTH` or `ODOMETRY`; ignore out-of-order ones."""
        last = self.series[topic].last
        return (last is None or reading.stamp > last) and super().take(topic, reading)

    def finish(self, until: int | None = None) -> None:
        super().finish(until)
        replace_file(self.folder / TABLE, lambda part: part.write_text(self.table()))

    def refused(self) -> list[str]:
        """Return the controllers that could not be loaded, each with its type."""
        return [controller for row in self.robot.plugins for controller in row.refused]

    def left_out(self) -> list[str]:
        """Return the plugins that are not simulated, and the controllers that were refused."""
        idle = [f"{row.name} ({row.filename})" for row in self.robot.plugins if not row.acts]
        return idle + self.refused()

    def summary(self, finished: bool, run: Summary) -> Summary:
        robot, counts = self.robot, self.counts.items()
        parts = {
            "plugins": [{name: getattr(p, name) for name in p.__slots__} for p in robot.plugins],
            "controllers": [
                {"name": one.name, "kind": one.type, "state": one.state}
                for one in robot.controllers
            ],
        }
        return {
            "finished": finished,
            "robot": {**vars(robot), **parts},
            "left_out": self.left_out(),
            "not_started": self.not_started,
            "topics": {topic: count.figures() for topic, count in counts},
            "silent": [topic for topic, one in counts if one.declared and not one.messages],
            "off_rate": [topic for topic, count in counts if count.is_off()],
            "drive": {leg.name: leg.figures() for leg in self.legs},
            "odometry_pauses": self.pauses,
            "tilt_deg": self.tilt_deg,
            "sim_time_s": self.seconds(),
            **run,
        }

    def line(self, summary: Summary) -> str:
        if not self.robot.drive:
            left_out = f"; left out: {', '.join(self.left_out())}" if self.left_out() else ""
            shown = "listens to no velocities: it is shown, not driven"
            return f"'{self.robot.name}' {shown}{left_out}"
        return "; ".join(leg.line() for leg in self.legs) or "it was not driven"

    def has_failed(self, summary: Summary) -> bool:
        return any(leg["failed"] for leg in summary["drive"].values())

    def table(self) -> str:
        """Return robot.md: plugins, controllers, topics, the drive and warnings, in Markdown."""
        robot = self.robot
        plugins = [
            (
                row.name,
                row.filename,
                "yes" if row.acts else "**no**",
                " ".join(row.inputs),
                " ".join(row.outputs),
                _hz(row.rate),
                " ".join(row.tags_not_simulated),
            )
            for row in robot.plugins
        ]
        controllers = [(one.name, one.type, one.state) for one in robot.controllers]
        controllers += [(*name[:-1].split(" (", 1), "**refused**") for name in self.refused()]
        topics = [
            (topic, one.kind, _hz(one.declared), _hz(one.rate(), ".2f"), str(one.messages))
            for topic, one in self.counts.items()
        ]
        header = ("plugin", "file", "acts", "listens to", "speaks on", "Hz", "tags not simulated")
        choice = f"- drives {robot.name} of {', '.join(robot.choice)}: model:=NAME chooses another"
        lines = [
            f"# {robot.name}",
            "",
            f"{len(robot.links)} links: {', '.join(robot.links)}",
            "",
            f"{len(robot.joints)} joints: {', '.join(robot.joints) or 'none'}",
            *_table(header, *plugins),
            *_table(("controller", "type", "state"), *controllers),
            *_table(("topic", "type", "Hz declared", "Hz seen", "messages"), *topics),
            "",
            *([choice] if len(robot.choice) > 1 else ()),
            f"- velocities: {robot.drive or 'nothing listens to any'}",
            f"- odometry: {robot.odometry or 'none'}"
            + (f" (pauses: {self.pauses})" if self.pauses else ""),
            *(f"- {leg.line()}" for leg in self.legs),
            *_bullets("Could not start, or died:", self.not_started),
            *_bullets("What the simulation said of it:", robot.said),
        ]
        return "".join(f"{line}\n" for line in lines)

    def figures(self, summary: Summary) -> Figures:
        pictures = [] if self.picture is None else [(self.robot.name, self.picture)]
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
                # Odometry begins at its own zero, so both are drawn from their first pose.
                x, y, _ = between(rows[0], rows).T
                axes.plot(x, y, color=colour, linewidth=width, label=name)
        if axes.lines:
            axes.legend(loc="best")


def _hz(rate: float | None, form: str = "g") -> str:
    return format(rate, form) if rate else ""


def _table(*table: Sequence[str]) -> list[str]:
    """Return a table with columns of even width, its header first; nothing without other rows."""
    widths = [max(map(len, column)) for column in zip(*table)]
    header, *rows = (
        "|".join(f" {cell:{width}} " for cell, width in zip(row, widths)) for row in table
    )
    rule = "|".join("-" * (width + 2) for width in widths)
    return ["", *(f"|{line}|" for line in (header, rule, *rows))] if rows else []


def _bullets(title: str, lines: Sequence[str]) -> list[str]:
    return ["", title, "", *(f"- {line}" for line in lines)] if lines else []
