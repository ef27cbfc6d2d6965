"""Publishers and subscribers that lose no messages in lock step, and the diagnostics of a node."""

from __future__ import annotations

import statistics
import threading
import time
import warnings
from collections import deque
from io import BytesIO
from typing import Any, Callable, Mapping, NamedTuple

import genpy
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rospy.msg import serialize_message

from bullet_lab.ros.node.lock_step import in_lock_step, member

# Wall seconds between two checks of a full queue.
ROOM_CHECK_SECONDS = 0.001
# Wall seconds between two checks for subscribers that have come, gone or died.
LISTENERS_CHECK_SECONDS = 0.05
# Field in the connection header of a publisher of commands: wall seconds after which the bridge
# stops the robot if no further command arrives.
COMMAND_TIMEOUT = "command_timeout"
# Wall seconds between two messages on /diagnostics.
PERIOD = 1.0
# Wall seconds over which rates are counted.
_WINDOW = 2.0


class Publisher(rospy.Publisher):
    """A publisher that does nothing, and raises nothing, while the node shuts down.

    Without a `queue_size` it writes to its subscribers at once and drops no message.
    """

    def __init__(self, *args: Any, **kwds: Any):
        with warnings.catch_warnings():
            # rospy warns about a missing queue size.
            warnings.simplefilter("ignore", SyntaxWarning)
            super().__init__(*args, **kwds)

    def has_connections(self) -> bool:
        """Return whether anybody subscribes."""
        return self.impl is not None and self.impl.has_connections()

    def publish(self, *args: Any, **kwds: Any) -> None:
        """Publish a message."""
        try:
            super().publish(*args, **kwds)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise


class BatchPublisher(Publisher):
    """Collects messages, and sends them to each subscriber in one call.

    At a hundred times real time, waking the subscribers for each message costs more than the
    physics between two messages. Not thread-safe.
    """

    def __init__(self, *args: Any, **kwds: Any):
        super().__init__(*args, **kwds)
        self._batch = BytesIO()

    def publish(self, message: genpy.Message) -> None:
        """Add a message to the batch; it may be changed afterwards."""
        if self.has_connections():
            self.impl.seq += 1
            serialize_message(self._batch, self.impl.seq, message)

    def flush(self, lossless: bool = False) -> None:
        """Send the batch; if `lossless`, wait for full queues instead of dropping messages."""
        data = self._batch.getvalue()
        if not data:
            return
        self._batch.seek(0)
        self._batch.truncate()
        # While the node shuts down, there is no implementation.
        connections = () if self.impl is None else self.impl.connections
        for connection in connections:
            if lossless:
                await_room(connection, self.impl.queue_size)
            try:
                connection.write_data(data)
            except (OSError, ValueError, rospy.exceptions.ROSInternalException):
                # The subscriber is gone; rospy removes a closed connection.
                connection.close()


def await_room(connection: Any, size: int | None) -> None:
    """Wait until the queue of a rospy connection has room for a message."""
    # The queue is not part of rospy's interface and may be missing.
    while size and len(getattr(connection, "_queue", ())) >= size:
        if connection.done or rospy.is_shutdown():
            return
        time.sleep(ROOM_CHECK_SECONDS)


def publisher(
    topic: str, kind: type, queue_size: int | None = None, latch: bool = False
) -> Publisher:
    """Return a publisher of messages that other nodes compute with.

    In lock step it has no queue: a slow subscriber slows the publisher down instead of losing
    messages. (Besides, rospy's queues take twenty times as long, since they pass each message to
    a thread.) Time advances only when the bridge has received the messages that were sent to it.

    For messages that are only displayed, as in RViz, use `Publisher`, which lock step ignores.

    Args:
        topic: its name.
        kind: class of its messages.
        queue_size: without lock step, messages that wait for a slow subscriber before the oldest
            is dropped; None for no queue.
        latch: whether later subscribers receive the last message.
    """
    size = None if in_lock_step() else queue_size
    made = Publisher(topic, kind, queue_size=size, latch=latch, tcp_nodelay=True)
    member().publishers.append(made)
    return made


def subscriber(
    topic: str,
    kind: type,
    receive: Callable[[Any], None],
    queue_size: int | None = None,
    buffer_bytes: int = rospy.topics.DEFAULT_BUFF_SIZE,
) -> rospy.Subscriber:
    """Return a subscriber that drops no message in lock step.

    Args:
        topic: its name.
        kind: class of its messages.
        receive: called with each message, in the topic's thread.
        queue_size: without lock step, messages that wait before the oldest is dropped; None to
            drop none.
        buffer_bytes: larger than a large message, or old messages stay in the socket.
    """
    size = None if in_lock_step() else queue_size
    return rospy.Subscriber(
        topic, kind, receive, queue_size=size, buff_size=buffer_bytes, tcp_nodelay=True
    )


class Demand:
    """Publishers of results that are computed only while somebody subscribes.

    A thread calls `start` when the first subscriber comes, or at once if `always`, and `stop`
    when the last one has gone.
    """

    def __init__(self, start: Callable[[], None], stop: Callable[[], None], always: bool = False):
        self._start, self._stop = start, stop
        self._always = always
        self._publishers: list[Publisher] = []
        self.is_there = False

    def publisher(self, topic: str, kind: type, queue_size: int = 10) -> Publisher:
        """Return a publisher of results, see the function `publisher`."""
        made = publisher(topic, kind, queue_size)
        self._publishers.append(made)
        return made

    def watch(self) -> None:
        """Start the thread that starts and stops the work."""
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while not rospy.is_shutdown():
            wanted = self._always or any(map(_has_listeners, self._publishers))
            if wanted != self.is_there:
                self.is_there = wanted
                (self._start if wanted else self._stop)()
            time.sleep(LISTENERS_CHECK_SECONDS)


def _has_listeners(publisher: Publisher) -> bool:
    """Return whether a subscriber is alive; rospy itself checks that only when it writes."""
    if publisher.has_connections():
        publisher.impl.check()
    return publisher.has_connections()


class Health(NamedTuple):
    """A level of DiagnosticStatus, a message, and values by name."""

    level: int
    message: str
    values: Mapping[str, str] = {}


class Diagnostics:
    """Publishes the health of a node every wall second; a separate thread calls `health`.

    diagnostic_updater measures its period and its rates in ROS time, which passes a hundred times
    as fast at full speed, and not at all while the simulation is paused.
    """

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
        self._done: deque[tuple[float, float]] = deque()
        self.total = 0

    def note(self, seconds: float) -> None:
        """Count a result, `seconds` after its input had arrived."""
        with self._lock:
            self.total += 1
            self._done.append((time.monotonic(), seconds))
            self._forget()

    def figures(self) -> dict[str, str]:
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
