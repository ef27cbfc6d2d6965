"""The state of a node on /diagnostics, once a second of wall time.

diagnostic_updater measures its period and its rates in ROS time, which passes a hundred times as
fast at full speed, and not at all while the simulation is paused.
"""

from __future__ import annotations

import statistics
import threading
import time
from collections import deque
from typing import Callable, Deque, Dict, Mapping, NamedTuple, Tuple

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from bullet_lab.ros.node.publishers import Publisher

# Wall seconds between two messages.
PERIOD = 1.0
# Wall seconds over which rates are counted.
_WINDOW = 2.0


class Health(NamedTuple):
    """A level of DiagnosticStatus, a message, and values by name."""

    level: int
    message: str
    values: Mapping[str, str] = {}


class Diagnostics:
    """Publishes the health of a node; a separate thread calls `health`."""

    def __init__(self, task: str, health: Callable[[], Health]):
        self._name = f"{rospy.get_name().lstrip('/')}: {task}"
        self._health = health
        self._publisher = Publisher("/diagnostics", DiagnosticArray, queue_size=10)

    def start(self) -> None:
        """Start to publish."""
        threading.Thread(target=self._report, daemon=True).start()

    def _report(self) -> None:
        while not rospy.is_shutdown():
            health = self._health()
            values = [KeyValue(key, value) for key, value in health.values.items()]
            status = DiagnosticStatus(health.level, self._name, health.message, "", values)
            message = DiagnosticArray(status=[status])
            message.header.stamp = rospy.Time.now()
            self._publisher.publish(message)
            time.sleep(PERIOD)


class Traffic:
    """Rate and latency of a node's results over the last two seconds of wall time."""

    def __init__(self):
        self._lock = threading.Lock()
        self._done: Deque[Tuple[float, float]] = deque()
        self.total = 0

    def note(self, seconds: float) -> None:
        """Count a result, `seconds` after its input had arrived."""
        with self._lock:
            self.total += 1
            self._done.append((time.monotonic(), seconds))
            self._forget()

    def figures(self) -> Dict[str, str]:
        """Return the number of results, their rate and latency as text."""
        with self._lock:
            self._forget()
            latencies = [seconds for _, seconds in self._done]
        figures = {"frames": str(self.total), "frame rate (Hz)": f"{len(latencies) / _WINDOW:.1f}"}
        if latencies:
            figures["latency median (ms)"] = f"{1e3 * statistics.median(latencies):.1f}"
            figures["latency max (ms)"] = f"{1e3 * max(latencies):.1f}"
        return figures

    @property
    def silence(self) -> float:
        """Wall seconds since the last result, at most two."""
        with self._lock:
            self._forget()
            return time.monotonic() - self._done[-1][0] if self._done else _WINDOW

    def _forget(self) -> None:
        start = time.monotonic() - _WINDOW
        while self._done and self._done[0][0] < start:
            self._done.popleft()
