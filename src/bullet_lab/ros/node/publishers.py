"""Publishers, subscribers and queues, which know by themselves whether a node is in lock step."""

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

# Wall seconds between two looks at a queue that is full.
ROOM_CHECK_SECONDS = 0.001
# Wall seconds between two looks for listeners that have gone without a word.
LISTENERS_CHECK_SECONDS = 0.5
# Messages of a queue, and wall seconds that one may take which is due, in lock step.
MOST_WAITING, LATEST = 1000, 10.0
SHUTDOWN_CHECK_SECONDS = 0.2
# In the header of a publisher's connection: wall seconds after which the bridge takes a command of
# its to be over.
COMMAND_TIMEOUT = "command_timeout"
_MILLISECOND = 1_000_000

T = TypeVar("T")


class Publisher(rospy.Publisher):
    """A publisher that falls silent, and raises nothing, once the node is shutting down.

    Without a `queue_size` it writes to its subscribers at once and drops nothing.
    """

    def __init__(self, *args: Any, **kwds: Any):
        with warnings.catch_warnings():
            # rospy takes a missing queue size for an oversight.
            warnings.simplefilter("ignore", SyntaxWarning)
            super().__init__(*args, **kwds)

    def has_connections(self) -> bool:
        """Return whether anybody listens."""
        return self.impl is not None and self.impl.has_connections()

    def publish(self, *args: Any, **kwds: Any) -> None:
        """Publish a message."""
        try:
            super().publish(*args, **kwds)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise


class BatchPublisher(Publisher):
    """Collects messages and writes them to each subscriber in one go.

    At a hundred times real time, waking the subscribers for each message costs more than the
    physics between two of them. For one thread only.
    """

    def __init__(self, *args: Any, **kwds: Any):
        super().__init__(*args, **kwds)
        self._batch = BytesIO()

    def publish(self, message: genpy.Message) -> None:
        """Put a message into the batch; it may be changed afterwards."""
        if self.has_connections():
            self.impl.seq += 1
            serialize_message(self._batch, self.impl.seq, message)

    def flush(self, lossless: bool = False) -> None:
        """Write what has come together.

        If `lossless`, full queues of subscribers are waited for, which would lose messages.
        """
        data = self._batch.getvalue()
        if not data:
            return
        self._batch.seek(0)
        self._batch.truncate()
        # Once the node shuts down there is neither implementation nor anybody to write to.
        connections = () if self.impl is None else self.impl.connections
        for connection in connections:
            if lossless:
                await_room(connection, self.impl.queue_size)
            try:
                connection.write_data(data)
            except (OSError, ValueError, rospy.exceptions.ROSInternalException):
                # The subscriber is gone; rospy forgets the connection when it is closed.
                connection.close()


def await_room(connection: Any, size: Optional[int]) -> None:
    """Wait until the queue of one of rospy's connections, if it has one, has room for a message."""
    # The queue is no part of rospy's interface: without it, there is nothing to wait for.
    while size and len(getattr(connection, "_queue", ())) >= size:
        if connection.done or rospy.is_shutdown():
            return
        time.sleep(ROOM_CHECK_SECONDS)


def publisher(
    topic: str, kind: type, queue_size: Optional[int] = None, latch: bool = False
) -> Publisher:
    """Return a publisher of what somebody computes with.

    In lock step it has no queue: a subscriber that falls behind slows the publisher down instead
    of losing messages, which is what a simulation at full speed needs. (Besides, it takes a
    twentieth of the time of rospy's queues, which hand each message to a thread.) The bridge has
    got what was sent to it before time goes on.

    What is only looked at, as in RViz, has a plain `Publisher`, which nobody waits for.

    Args:
        topic: its name.
        kind: class of its messages.
        queue_size: out of lock step, messages that wait for a slow subscriber before the oldest
            is dropped; None for no queue.
        latch: whether to keep the last message for those who subscribe later.
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
    """Return a subscriber to what somebody computes with; in lock step it drops nothing.

    Args:
        topic: its name.
        kind: class of its messages.
        receive: is called with each of them, in a thread of the topic's own.
        queue_size: out of lock step, messages that wait before the oldest is dropped; None to
            drop nothing.
        buffer_bytes: more than a large message has, lest old ones pile up in the socket.
    """
    size = None if in_lock_step() else queue_size
    return rospy.Subscriber(
        topic, kind, receive, queue_size=size, buff_size=buffer_bytes, tcp_nodelay=True
    )


class Demand(rospy.SubscribeListener):
    """Publishers of results, and whether anybody listens to one of them.

    A thread calls `start` when there is somebody, or `always`, and `stop` when nobody is left.
    """

    def __init__(self, start: Callable[[], None], stop: Callable[[], None], always: bool = False):
        super().__init__()
        self._start, self._stop = start, stop
        self._always = always
        self._publishers: List[Publisher] = []
        self._wake = threading.Event()
        self.is_there = False

    def publisher(self, topic: str, kind: type, queue_size: int = 10) -> Publisher:
        """Return a publisher of results, as of `publisher`."""
        made = publisher(topic, kind, queue_size)
        self._publishers.append(made)
        made.impl.add_subscriber_listener(self)
        return made

    def watch(self) -> None:
        """Start and stop the work from now on."""
        threading.Thread(target=self._watch, daemon=True).start()

    def peer_subscribe(self, *_: Any) -> None:
        """Note that somebody has come."""
        self._wake.set()

    def peer_unsubscribe(self, *_: Any) -> None:
        """Note that somebody has gone."""
        self._wake.set()

    def _watch(self) -> None:
        while not rospy.is_shutdown():
            self._wake.clear()
            wanted = self._always or any(map(_has_listeners, self._publishers))
            if wanted != self.is_there:
                self.is_there = wanted
                (self._start if wanted else self._stop)()
            self._wake.wait(LISTENERS_CHECK_SECONDS)


def _has_listeners(publisher: Publisher) -> bool:
    """Return whether anybody listens still; rospy itself only notices when it writes."""
    if publisher.has_connections():
        publisher.impl.check()
    return publisher.has_connections()


class MessageQueue(Generic[T]):
    """The messages of one topic, to be taken in the order of their stamps as time goes on.

    In lock step it is open from the beginning to the end, since what is due is waited for.

    Args:
        topic: to listen to while open.
        kind: class of the messages, which have a header.
        read: makes something useful of a message, or raises LabError to refuse it.
        rate: messages per simulated second, at the steps where the bridge sends them.

    Attributes:
        trouble: why the last message was refused; empty if it was not.
    """

    def __init__(self, topic: str, kind: type, read: Callable[[Any], T], rate: float):
        self.topic, self.trouble = topic, ""
        self._kind, self._read, self._rate = kind, read, rate
        self._new = threading.Condition()
        self._waiting: Deque[Tuple[int, T]] = deque(maxlen=MOST_WAITING)
        self._newest: Optional[int] = None
        self._patience = LATEST
        self._refusals = Refusals()
        self._subscriber: Optional[rospy.Subscriber] = None
        if in_lock_step():
            self.open()

    def open(self) -> bool:
        """Listen from now on; return whether it was closed."""
        if self._subscriber is not None:
            return False
        self.clear()
        self._subscriber = subscriber(self.topic, self._kind, self._receive)
        return True

    def close(self) -> None:
        """Listen no longer."""
        if self._subscriber is not None and not in_lock_step():
            self._subscriber.unregister()
            self._subscriber = None

    def clear(self) -> None:
        """Forget what has come."""
        with self._new:
            self.trouble = ""
            self._waiting.clear()
            self._newest = None
            self._patience = LATEST

    def is_connected(self) -> bool:
        """Return whether somebody publishes."""
        return self._subscriber is not None and self._subscriber.get_num_connections() > 0

    def take(self, now: rospy.Time) -> List[T]:
        """Take what is stamped up to now."""
        taken = []
        with self._new:
            while self._waiting and self._waiting[0][0] <= now.to_nsec():
                taken.append(self._waiting.popleft()[1])
        return taken

    def wait(self, now: rospy.Time) -> None:
        """In lock step, wait in wall time for what is due by now: time stands meanwhile.

        What is late by `LATEST` is waited for no longer, until something comes again.
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
        """Return the stamp in ns of the message after the newest: the first step at k/rate."""
        newest = 0 if self._newest is None else self._newest
        number = math.floor(newest * self._rate * 1e-9 + 1e-6) + 1
        return math.ceil(1000.0 * number / self._rate - 1e-6) * _MILLISECOND

    def _receive(self, message: Any) -> None:
        stamp = message.header.stamp.to_nsec()
        try:
            if self._newest is not None and stamp < self._newest:
                raise InputError("a stamp before that of the message before")
            item = self._read(message)
        except LabError as error:
            self.trouble = str(error)
            self._refusals.refuse(self.topic, self.trouble)
            self._note(stamp)
            return
        self.trouble = ""
        self._note(stamp, item)

    def _note(self, stamp: int, *items: T) -> None:
        with self._new:
            self._waiting.extend((stamp, item) for item in items)
            self._newest = max(stamp, self._newest or 0)
            self._patience = LATEST
            self._new.notify_all()
