"""The recorder: a node's work that runs any report of `bullet_lab.reports`.

It subscribes to what the report names, refuses and counts what cannot be used, has rows written
as they come, renews the pictures while it runs, and ends where the report says that all is in.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Protocol, Tuple

import rospy
from matplotlib.figure import Figure
from std_msgs.msg import Time

from bullet_lab.core.figures import save
from bullet_lab.core.files import FileError, write_json
from bullet_lab.core.parameters import mapping, number, text
from bullet_lab.errors import LabError
from bullet_lab.reports import Report
from bullet_lab.ros.node.lock_step import join_when, time_held_at
from bullet_lab.ros.node.node import NodeError, Refusals, wait_until
from bullet_lab.ros.node.publishers import subscriber
from bullet_lab.ros.record.readings import Reader, reader_of

# Wall seconds that messages may take after the end has been announced.
PATIENCE = 5.0
POLL_SECONDS = 0.02
# Simulated time of an errand's goal: between two ticks of the server, which has seen the one
# before.
GOAL_TIME = rospy.Time(0, 525_000_000)
# Wall seconds for the server to take the goal.
ACCEPTANCE = 30.0


def about(*kinds: type) -> Any:
    """Declare ~about, with parameters of these dataclasses as they stand in a launch file."""
    return mapping("what else summary.json shall say", *kinds)


@dataclass(frozen=True)
class RecordParameters:
    """Private parameters of every node that records."""

    out: str = text("results", "folder for the files")
    about: Mapping[str, Any] = about()


@dataclass(frozen=True)
class TimedParameters(RecordParameters):
    """Private parameters of a node that records up to a time."""

    until: str = text("", "topic (std_msgs/Time) that ends it; empty: Ctrl-C does")
    plot_period: float = number(10.0, "wall seconds between two versions of the picture", above=0.0)


class Stopwatch:
    """How long a recording took in wall time, from its first message to its last."""

    def __init__(self):
        self._first: Optional[float] = None
        self._last = 0.0

    def note(self) -> None:
        """Note that a message came."""
        self._last = time.monotonic()
        if self._first is None:
            self._first = self._last

    def figures(self, sim_seconds: float) -> Mapping[str, Any]:
        """Return the times for summary.json; the factor is null where no time has passed."""
        wall = 0.0 if self._first is None else self._last - self._first
        factor = sim_seconds / wall if wall > 0.0 else None
        return {"sim_time_s": sim_seconds, "wall_time_s": wall, "real_time_factor": factor}


class View(Protocol):
    """What shows in RViz what is recorded."""

    def append(self, topic: str, message: Any) -> None:
        """Add a message that was recorded."""

    def forget(self, namespace: str) -> None:
        """Begin anew with the topics of a namespace."""


@dataclass(frozen=True)
class Errand:
    """Where a robot is sent before its way is recorded.

    Attributes:
        server: name of the node that takes the goal.
        is_connected: returns whether it is there.
        send: sends the goal.
        is_taken: returns whether the server has taken it.
    """

    server: str
    is_connected: Callable[[], bool]
    send: Callable[[], None]
    is_taken: Callable[[], bool]


class Recorder:
    """Records until all is in, or until ROS shuts down, and leaves everything behind.

    Args:
        report: what is recorded.
        parameters: of the node.
        topics: what is waited for, in the log.
        view: shows what is recorded.
        errand: is run first, if there is one.
    """

    def __init__(
        self,
        report: Report,
        parameters: RecordParameters,
        topics: str,
        view: Optional[View] = None,
        errand: Optional[Errand] = None,
    ):
        self._report, self._parameters, self._topics = report, parameters, topics
        self._view, self._errand = view, errand
        self._lock = threading.Lock()
        self._refusals = Refusals()
        self._stopwatch = Stopwatch()
        self._failure: Optional[FileError] = None
        self._finished = False
        report.about = parameters.about
        report.begins_anew = self._begin_anew
        self._end: Optional[rospy.Subscriber] = None
        self._period = math.inf
        if isinstance(parameters, TimedParameters):
            self._period = parameters.plot_period
            if parameters.until:
                self._end = rospy.Subscriber(parameters.until, Time, self._receive_end)
        self._subscribers: List[rospy.Subscriber] = [
            self._listen(topic, kind) for topic, kind in report.topics.items()
        ]

    def run(self) -> None:
        """Record, and write everything.

        Raises:
            NodeError: the errand was not taken, or did not come to its goal.
            FileError: what came could not be written.
        """
        complete = False
        try:
            self._begin()
            complete = self._wait()
        finally:
            summary = self._finish(complete)
            failed, line = self._report.has_failed(summary), self._report.line(summary)
            if not failed:
                rospy.loginfo("%s", line)
        if failed:
            raise NodeError(line)

    # Beginning and end

    def _begin(self) -> None:
        if self._errand is not None:
            self._run_errand(self._errand)
        else:
            join_when(self._is_connected, self._topics)

    def _run_errand(self, errand: Errand) -> None:
        wait_until(lambda: self._is_connected() and errand.is_connected(), self._topics)
        # In lock step, time stands until the server has the goal: it is taken up at its next tick.
        with time_held_at(GOAL_TIME):
            errand.send()
            deadline = time.monotonic() + ACCEPTANCE
            while not errand.is_taken():
                if rospy.is_shutdown():
                    raise rospy.ROSInterruptException("shutdown")
                if time.monotonic() > deadline:
                    raise NodeError(f"{errand.server} has not taken the goal for {ACCEPTANCE:g} s")
                time.sleep(POLL_SECONDS)

    def _is_connected(self) -> bool:
        return all(one.get_num_connections() > 0 for one in self._subscribers)

    def _wait(self) -> bool:
        """Return whether all is in."""
        until, announced, drawn = None, 0.0, time.monotonic()
        while not rospy.is_shutdown():
            with self._lock:
                if self._failure is not None:
                    raise self._failure
                if self._report.is_complete():
                    return True
                known = self._report.until
            now = time.monotonic()
            if known != until:
                until, announced = known, now
            if until is not None and now - announced > PATIENCE:
                rospy.logwarn("the end was announced and nothing more comes: some may be missing")
                return True
            if now - drawn >= self._period:
                self._renew()
                drawn = time.monotonic()
            time.sleep(POLL_SECONDS)
        return False

    def _finish(self, complete: bool) -> Mapping[str, Any]:
        for one in self._subscribers:
            one.unregister()
        with self._lock:
            # A message may be on its way in still.
            self._finished = True
            self._report.finish(self._report.until if complete else None)
            summary, figures = self._contents(finished=complete)
        # The numbers first: whoever shuts down may be in a hurry.
        save_summary(self._report, summary)
        save_figures(self._report, figures)
        return summary

    # What comes in

    def _listen(self, topic: str, kind: str) -> rospy.Subscriber:
        message_type, read = reader_of(kind)
        return subscriber(topic, message_type, partial(self._receive, topic, read))

    def _receive(self, topic: str, read: Reader, message: Any) -> None:
        with self._lock:
            if self._finished or self._failure is not None:
                return
            try:
                recorded = self._report.take(topic, read(message))
            except FileError as error:
                self._failure = error
            except LabError as error:
                self._refusals.refuse(topic, str(error))
            else:
                if recorded:
                    self._stopwatch.note()
                    if self._view is not None:
                        self._view.append(topic, message)

    def _receive_end(self, message: Time) -> None:
        with self._lock:
            self._report.until = message.data.to_nsec()

    def _begin_anew(self, namespace: str, old: Path) -> None:
        rospy.loginfo("time was set back: what was recorded before is in %s", old)
        self._stopwatch = Stopwatch()
        if self._view is not None:
            self._view.forget(namespace)

    # What is left behind

    def _renew(self) -> None:
        try:
            with self._lock:
                summary, figures = self._contents(finished=False)
            # Who sees the summary finds the pictures of it.
            save_figures(self._report, figures)
            save_summary(self._report, summary)
        except (FileError, OSError) as error:
            rospy.logerr_throttle(10.0, f"cannot write: {error}")

    def _contents(self, finished: bool) -> Tuple[Dict[str, Any], Dict[str, Figure]]:
        """Return summary and figures, which are drawn later, without the lock: it takes long."""
        times = self._stopwatch.figures(self._report.seconds())
        run = {**times, "refused_messages": self._refusals.total}
        summary = self._report.summary(finished, run)
        return summary, self._report.figures(summary)


def save_summary(report: Report, summary: Mapping[str, Any]) -> None:
    """Write summary.json; raises FileError."""
    write_json(report.folder / "summary.json", {**report.about, **summary})


def save_figures(report: Report, figures: Mapping[str, Figure]) -> None:
    """Write the pictures; raises FileError."""
    for name, figure in figures.items():
        save(figure, report.folder / name)
