"""Publishers, subscribers and queues that lose no messages in lock step."""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections import deque
from io import BytesIO
from typing import Any, Callable, Deque, Generic, List, Optional, Tuple, TypeVar

import genpy
import rospy
from rospy.msg import serialize_message

from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.ros.node.lock_step import in_lock_step, member
from bullet_lab.ros.node.node import Refusals

# Wall seconds between two checks of a full queue.
ROOM_CHECK_SECONDS = 0.001
# Wall seconds between two checks for subscribers that have died.
LISTENERS_CHECK_SECONDS = 0.5
# Messages in a MessageQueue.
MOST_WAITING = 1000
# Wall seconds that lock step waits for a message that is due.
LATEST = 10.0
# Wall seconds between two checks for a shutdown.
SHUTDOWN_CHECK_SECONDS = 0.2
# Field in the connection header of a publisher of commands: wall seconds after which the bridge
# stops the robot if no further command arrives.
COMMAND_TIMEOUT = "command_timeout"
_MILLISECOND = 1_000_000

T = TypeVar("T")


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


def await_room(connection: Any, size: Optional[int]) -> None:
    """Wait until the queue of a rospy connection has room for a message."""
    # The queue is not part of rospy's interface and may be missing.
    while size and len(getattr(connection, "_queue", ())) >= size:
        if connection.done or rospy.is_shutdown():
            return
        time.sleep(ROOM_CHECK_SECONDS)


def publisher(
    topic: str, kind: type, queue_size: Optional[int] = None, latch: bool = False
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
    queue_size: Optional[int] = None,
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


class Demand(rospy.SubscribeListener):
    """Publishers of results that are computed only while somebody subscribes.

    A thread calls `start` when the first subscriber comes, or at once if `always`, and `stop`
    when the last one has gone.
    """

    def __init__(self, start: Callable[[], None], stop: Callable[[], None], always: bool = False):
        super().__init__()
        self._start, self._stop = start, stop
        self._always = always
        self._publishers: List[Publisher] = []
        self._wake = threading.Event()
        self.is_there = False

    def publisher(self, topic: str, kind: type, queue_size: int = 10) -> Publisher:
        """Return a publisher of results, see the function `publisher`."""
        made = publisher(topic, kind, queue_size)
        self._publishers.append(made)
        made.impl.add_subscriber_listener(self)
        return made

    def watch(self) -> None:
        """Start the thread that starts and stops the work."""
        threading.Thread(target=self._watch, daemon=True).start()

    def peer_subscribe(self, *_: Any) -> None:
        """Check the subscribers; called by rospy when one has come or gone."""
        self._wake.set()

    peer_unsubscribe = peer_subscribe

    def _watch(self) -> None:
        while not rospy.is_shutdown():
            self._wake.clear()
            wanted = self._always or any(map(_has_listeners, self._publishers))
            if wanted != self.is_there:
                self.is_there = wanted
                (self._start if wanted else self._stop)()
            self._wake.wait(LISTENERS_CHECK_SECONDS)


def _has_listeners(publisher: Publisher) -> bool:
    """Return whether a subscriber is alive; rospy itself checks that only when it writes."""
    if publisher.has_connections():
        publisher.impl.check()
    return publisher.has_connections()


class MessageQueue(Generic[T]):
    """The messages of one topic, in the order of their stamps.

    In lock step it is always open, and waits for the messages that are due.

    Args:
        topic: to subscribe to while open.
        kind: class of the messages, which have a header.
        read: converts a message, or raises LabError to refuse it.
        rate: messages of the bridge per simulated second.

    Attributes:
        trouble: the error of the last message; empty if it was not refused.
    """

    def __init__(self, topic: str, kind: type, read: Callable[[Any], T], rate: float):
        self.topic, self.trouble = topic, ""
        self._kind, self._read, self._rate = kind, read, rate
        self._new = threading.Condition()
        self._waiting: Deque[Tuple[int, T]] = deque(maxlen=MOST_WAITING)
        # ns
        self._newest = 0
        self._patience = LATEST
        self._refusals = Refusals()
        self._subscriber: Optional[rospy.Subscriber] = None
        if in_lock_step():
            self.open()

    def open(self) -> bool:
        """Subscribe; return whether the queue was closed before."""
        if self._subscriber is not None:
            return False
        self.clear()
        self._subscriber = subscriber(self.topic, self._kind, self._receive)
        return True

    def close(self) -> None:
        """Unsubscribe."""
        if self._subscriber is not None and not in_lock_step():
            self._subscriber.unregister()
            self._subscriber = None

    def clear(self) -> None:
        """Remove all messages."""
        with self._new:
            self.trouble = ""
            self._waiting.clear()
            self._newest = 0
            self._patience = LATEST

    def is_connected(self) -> bool:
        """Return whether the topic has a publisher."""
        return self._subscriber is not None and self._subscriber.get_num_connections() > 0

    def take(self, now: rospy.Time) -> List[T]:
        """Remove and return the messages with stamps up to now."""
        taken = []
        with self._new:
            while self._waiting and self._waiting[0][0] <= now.to_nsec():
                taken.append(self._waiting.popleft()[1])
        return taken

    def wait(self, now: rospy.Time) -> None:
        """In lock step, wait in wall time for the messages that are due by now.

        After `LATEST` seconds without a message it does not wait until the next one arrives.
        """
        if not in_lock_step():
            return
        deadline = time.monotonic() + self._patience
        with self._new:
            while self._next_due() <= now.to_nsec():
                if rospy.is_shutdown():
                    raise rospy.ROSInterruptException("shutdown")
                if time.monotonic() >= deadline:
                    self._patience = 0.0
                    return
                self._new.wait(SHUTDOWN_CHECK_SECONDS)

    def _next_due(self) -> int:
        """Return the stamp in ns of the message after the newest: the first step at k / rate."""
        number = math.floor(self._newest * self._rate * 1e-9 + 1e-6) + 1
        return math.ceil(1000.0 * number / self._rate - 1e-6) * _MILLISECOND

    def _receive(self, message: Any) -> None:
        stamp = message.header.stamp.to_nsec()
        items: List[T] = []
        try:
            if stamp < self._newest:
                raise InputError(f"out-of-order stamp {1e-9 * stamp:.9f} s")
            items.append(self._read(message))
            self.trouble = ""
        except LabError as error:
            self.trouble = str(error)
            self._refusals.refuse(self.topic, self.trouble)
        with self._new:
            self._waiting.extend((stamp, item) for item in items)
            self._newest = max(stamp, self._newest)
            self._patience = LATEST
            self._new.notify_all()
