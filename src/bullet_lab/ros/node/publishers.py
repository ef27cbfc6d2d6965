"""Publishers and subscribers that lose no messages in lock step."""

from __future__ import annotations

import time
import warnings
from io import BytesIO
from typing import Any, Callable

import genpy
import rospy
from rospy.msg import serialize_message

from bullet_lab.ros.node.lock_step import in_lock_step, member

# Wall seconds between two checks of a full queue.
ROOM_CHECK_SECONDS = 0.001
# Field in the connection header of a publisher of commands: wall seconds after which the bridge
# stops the robot if no further command arrives.
COMMAND_TIMEOUT = "command_timeout"


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
