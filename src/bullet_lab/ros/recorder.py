"""What the recording nodes share: when to end, and how to leave everything behind."""

from __future__ import annotations

import math
import time
from typing import Any, Callable, Mapping, Optional

import rospy
from std_msgs.msg import Time

from bullet_lab.recording.files import FileError

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


def record_until(done: Callable[[], bool], now_and_then: Callable[[], None], period: float) -> bool:
    """Wait until a recording is done or ROS shuts down; return whether it is done.

    Args:
        done: says whether it is.
        now_and_then: called every `period` wall seconds, to draw what there is so far.
        period: in s.
    """
    last = time.monotonic()
    while not rospy.is_shutdown():
        if done():
            return True
        if time.monotonic() - last >= period:
            try:
                now_and_then()
            except (FileError, OSError) as error:
                rospy.logerr_throttle(10.0, "cannot write: %s", error)
            last = time.monotonic()
        time.sleep(POLL_SECONDS)
    return False
