"""The reports of the jobs: what is recorded, the summary and the figures, without ROS.

A report names the topics that it records; `bullet_lab.ros.record` runs any report. The report of
a new job is one class here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import defaultdict
from pathlib import Path
from typing import Any, Iterable, Mapping, NamedTuple, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLACK, save
from bullet_lab.core.files import NANOSECONDS, PathSeries, Series, Summary, make_folder, write_json

Figures = Mapping[str, Figure]
"""Figures by the names of their files."""


class Reading(NamedTuple):
    """The content of a message.

    Attributes:
        stamp: ns of simulated time.
        values: numbers for a row; x (m), y (m) and yaw (rad) of a pose.
        detail: further content, see the readers in `bullet_lab.ros.record.recorder`.
    """

    stamp: int
    values: Sequence[float] = ()
    detail: Any = None

    @property
    def seconds(self) -> float:
        """The stamp in s, rounded as rospy does."""
        return self.stamp // NANOSECONDS + self.stamp % NANOSECONDS / NANOSECONDS


class Report(ABC):
    """The files that one job writes into a folder, which is made if need be.

    By default, the recording is complete when all series have reached the end; a subclass may
    override that. The methods are called by one thread at a time.

    Attributes:
        about: first entries of summary.json.
        topics: type of the messages by topic, such as sensor_msgs/Imu; the types are those that
            `bullet_lab.ros.record.recorder` reads.
        series: files of rows, by topic.
        readings: of the topics without a series.
        until: end of the recording in ns; None while it is not known.

    Raises:
        FileError: a file cannot be written; so do the methods that write.
    """

    def __init__(self, folder: Path):
        self.folder = make_folder(folder)
        self.about: Summary = {}
        self.topics: dict[str, str] = {}
        self.series: dict[str, Series] = {}
        self.readings: dict[str, list[Reading]] = defaultdict(list)
        self.until: int | None = None

    def take(self, topic: str, reading: Reading) -> bool:
        """Record a message, or raise LabError; return whether a row was recorded."""
        if topic not in self.series:
            self.readings[topic].append(reading)
            return False
        self.series[topic].add(reading.stamp, reading.values)
        return True

    def newest(self) -> int | None:
        """Return the stamp in ns that all series have reached; None before that."""
        return earliest(series.last for series in self.series.values())

    def is_complete(self) -> bool:
        """Return whether all series have reached the end."""
        newest = self.newest()
        return None not in (self.until, newest) and newest >= self.until

    def finish(self, until: int | None = None) -> None:
        """Write the files once more, without the rows after a stamp in ns, if one is given."""
        for series in self.series.values():
            series.finish(until)

    def seconds(self) -> float:
        """Return the simulated time from the first to the last row of the first series."""
        stamps, _ = next(iter(self.series.values())).table()
        return float(stamps[-1] - stamps[0]) if len(stamps) else 0.0

    @abstractmethod
    def summary(self, finished: bool, run: Summary) -> Summary:
        """Return the entries of summary.json after those of `about`.

        `finished` says whether the recording is complete; `run` has the times and the refused
        messages.
        """

    @abstractmethod
    def figures(self, summary: Summary) -> Figures:
        """Return the figures by their file names."""

    def line(self, summary: Summary) -> str:
        """Return the outcome in one line."""
        return f"results are in {self.folder}"

    def has_failed(self, summary: Summary) -> bool:
        """Return whether the job ended without reaching its goal."""
        return False


class DriveReport(Report):
    """The true path of a robot that is sent to a goal, in truth.tum.

    Nothing is recorded before 0.5 s, when the goal is sent: not all subscribers are connected yet.
    """

    BEGINNING = NANOSECONDS // 2

    def __init__(self, folder: Path):
        super().__init__(folder)
        self.truth = PathSeries(self.folder / "truth.tum")
        self.series = {"odom": self.truth}
        self.topics = {"odom": "nav_msgs/Odometry"}

    def take(self, topic: str, reading: Reading) -> bool:
        is_early = topic == "odom" and reading.stamp < self.BEGINNING
        return not is_early and super().take(topic, reading)


def save_results(
    report: Report,
    summary: Summary,
    figures: Figures,
    summary_first: bool = False,
) -> None:
    """Write the figures and summary.json, at the end or also before; raises FileError."""
    path, content = report.folder / "summary.json", {**report.about, **summary}
    if summary_first:
        write_json(path, content)
    for name, figure in figures.items():
        save(figure, report.folder / name)
    write_json(path, content)


def save_all(report: Report, finished: bool, run: Summary | None = None) -> Summary:
    """Write all files of a report that is not run by a recorder, and return the summary."""
    report.finish()
    summary = report.summary(finished, run or {})
    save_results(report, summary, report.figures(summary))
    return summary


def draw_path(
    axes: Axes,
    poses: np.ndarray,
    colour: str,
    width: float,
    start: str,
    end: str = "",
    label: str | None = None,
) -> None:
    """Draw a path seen from above, poses (m, m, rad) of shape (n, 3), at least one.

    `start` and `end` are the colours of its ends, without an end if that is empty.
    """
    x, y, _ = poses.T
    axes.plot(x, y, color=colour, linewidth=width, label=label)
    axes.plot(x[0], y[0], "o", color=start, markeredgecolor=BLACK, label="start")
    if end:
        axes.plot(x[-1], y[-1], "s", color=end, markeredgecolor=BLACK, label="end")


def earliest(stamps: Iterable[int | None]) -> int | None:
    """Return the smallest stamp; None if one of them is None."""
    found = list(stamps)
    return None if None in found else min(found)
