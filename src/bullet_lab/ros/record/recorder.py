"""What the recording nodes share: when to end, and how to leave everything behind."""

from __future__ import annotations

import math
import time
from typing import Any, Mapping, Optional, Protocol

import rospy
from std_msgs.msg import Time

from bullet_lab.core.files import FileError
from bullet_lab.ros.node.lock_step import join_when

# Wall seconds that messages may take after the end has been announced.
PATIENCE = 5.0
POLL_SECONDS = 0.02


class EndOfRecording:
    """Knows when a recording is complete.

    Args:
        topic: a std_msgs/Time there says when, in simulated time, the recording ends; with an
            empty name it goes on until ROS shuts down.
    """

    def __init__(self, topic: str):
        self._until: Optional[int] = None
        self._announced = math.inf
        self._subscriber = rospy.Subscriber(topic, Time, self._receive) if topic else None

    @property
    def until(self) -> Optional[int]:
        """The end in ns of simulated time, once it is known."""
        return self._until

    def reached(self, newest: Optional[int]) -> bool:
        """Return whether all is in.

        Args:
            newest: the stamp in ns that every recorded topic has come to; None for nothing yet.
        """
        if self._until is None:
            return False
        if newest is not None and newest >= self._until:
            return True
        if time.monotonic() - self._announced < PATIENCE:
            return False
        rospy.logwarn("the end was announced and nothing more comes: some messages may be missing")
        return True

    def _receive(self, message: Time) -> None:
        self._announced = time.monotonic()
        self._until = message.data.to_nsec()


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


class Recorder(Protocol):
    """What a recording node does."""

    def is_connected(self) -> bool:
        """Return whether every topic has a publisher."""

    def is_complete(self) -> bool:
        """Return whether the announced end has come."""

    def plot_now(self) -> None:
        """Draw what there is so far."""

    def finish(self, complete: bool) -> None:
        """Write everything for the last time."""


def record(recorder: Recorder, period: float, lock_step: bool, topics: str) -> None:
    """Record until all is in, or until ROS shuts down, and leave everything behind.

    Args:
        recorder: what records.
        period: wall seconds between two drawings of what there is.
        lock_step: whether to tell the bridge when all topics are connected.
        topics: what is waited for then, in the log.
    """
    complete = False
    try:
        if lock_step:
            join_when(recorder.is_connected, topics)
        complete = _wait(recorder, period)
    finally:
        recorder.finish(complete)


def _wait(recorder: Recorder, period: float) -> bool:
    """Return whether the recording is complete."""
    last = time.monotonic()
    while not rospy.is_shutdown():
        if recorder.is_complete():
            return True
        if time.monotonic() - last >= period:
            try:
                recorder.plot_now()
            except (FileError, OSError) as error:
                rospy.logerr_throttle(10.0, f"cannot write: {error}")
            last = time.monotonic()
        time.sleep(POLL_SECONDS)
    return False
