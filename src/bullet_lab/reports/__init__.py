"""What each job leaves behind: what is recorded, its summary and its figures, without ROS.

A report names the topics that it wants; `bullet_lab.ros.record` runs any of them. A new job's
report is one class here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Mapping, NamedTuple, Optional, Sequence

from matplotlib.figure import Figure

from bullet_lab.core.files import NANOSECONDS, PathSeries, Series, make_folder


class Reading(NamedTuple):
    """What a message says.

    Attributes:
        stamp: ns of simulated time.
        values: numbers for a row; x (m), y (m) and yaw (rad) of a pose.
        detail: what else it says, see the readers in `bullet_lab.ros.record.recorder`.
    """

    stamp: int
    values: Sequence[float] = ()
    detail: Any = None

    @property
    def seconds(self) -> float:
        """The stamp in s, rounded as rospy does."""
        return self.stamp // NANOSECONDS + self.stamp % NANOSECONDS / NANOSECONDS


class Report(ABC):
    """What one job leaves behind in a folder.

    This one keeps a series for each topic, until all have come to the end; a subclass says
    otherwise where need be. Its methods are called by one thread at a time.

    Attributes:
        about: what else summary.json says.
        topics: what is recorded: the type of each topic's messages, such as sensor_msgs/Imu, of
            those that `bullet_lab.ros.record.recorder` knows.
        series: where rows go, by topic.
        until: the time in ns that is recorded up to; None while that is not known.
        begins_anew: called with the namespace of a robot for whom time was set back, and the
            folder that what was recorded before is in now.

    The folder is made if need be. FileError is raised where a file cannot be written, here and in
    all that adds to files.
    """

    def __init__(self, folder: Path):
        self.folder = make_folder(folder)
        self.about: Mapping[str, Any] = {}
        self.topics: Dict[str, str] = {}
        self.series: Dict[str, Series] = {}
        self.until: Optional[int] = None
        self.begins_anew: Callable[[str, Path], None] = lambda namespace, old: None

    def take(self, topic: str, reading: Reading) -> bool:
        """Record what came on a topic, or raise LabError; return whether a row was recorded."""
        self.series[topic].add(reading.stamp, reading.values)
        return True

    def newest(self) -> Optional[int]:
        """Return the stamp in ns that all series have come to; None before that."""
        return earliest(series.last for series in self.series.values())

    def is_complete(self) -> bool:
        """Return whether all has come up to the end."""
        newest = self.newest()
        return None not in (self.until, newest) and newest >= self.until

    def finish(self, until: Optional[int] = None) -> None:
        """Write the files once more, whole; leave out what came after a stamp in ns, if given."""
        for series in self.series.values():
            series.finish(until)

    def seconds(self) -> float:
        """Return the simulated time from the first to the last row of the first series."""
        stamps, _ = next(iter(self.series.values())).table()
        return float(stamps[-1] - stamps[0]) if len(stamps) else 0.0

    @abstractmethod
    def summary(self, finished: bool, run: Mapping[str, Any]) -> Dict[str, Any]:
        """Return what summary.json says after `about`, with times and refusals of the run itself.

        `finished` says whether all came up to the end.
        """

    @abstractmethod
    def figures(self, summary: Mapping[str, Any]) -> Dict[str, Figure]:
        """Return the pictures by the names of their files."""

    def line(self, summary: Mapping[str, Any]) -> str:
        """Return in a line for people what came of it."""
        return f"all of it is in {self.folder}"

    def has_failed(self, summary: Mapping[str, Any]) -> bool:
        """Return whether the line says that the job came to an end, but not to its goal."""
        return False


class DriveReport(Report):
    """The true path of a robot that is sent somewhere, in truth.tum.

    What comes before it is sent, at 0.5 s, is not recorded: somebody may not be connected yet.
    """

    BEGINNING = NANOSECONDS // 2

    def __init__(self, folder: Path):
        super().__init__(folder)
        self.truth = PathSeries(self.folder / "truth.tum")
        self.series = {"odom": self.truth}
        self.topics = {"odom": "nav_msgs/Odometry"}

    def take(self, topic: str, reading: Reading) -> bool:
        return reading.stamp >= self.BEGINNING and super().take(topic, reading)


def earliest(stamps: Iterable[Optional[int]]) -> Optional[int]:
    """Return the least of some stamps; None if one of them is None."""
    found = list(stamps)
    return None if None in found else min(found)
