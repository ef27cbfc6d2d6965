"""Subscriptions of the view: messages stay bytes; only those that are shown are deserialised."""

from __future__ import annotations

from collections import deque
from typing import Any, Callable

import genpy
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.node.node import Refusals

# Messages that are kept until they are read, if each of them counts.
MAX_WAITING = 2000
# More than a large image has, so that old images do not pile up in the socket.
BUFFER_BYTES = 2**24


class MessageError(LabError):
    """A message does not match its type, or has numbers that are not finite."""


class Subscription:
    """The messages of one topic since the last read.

    Args:
        topic: to subscribe to.
        read: makes an object from the bytes of a message, or raises LabError to refuse it.
        every: whether each message counts, not only the newest one.
        large: whether a message may be larger than rospy's default buffer.
    """

    def __init__(
        self,
        topic: str,
        read: Callable[[bytes], Any],
        every: bool = False,
        large: bool = False,
    ):
        self.topic = topic
        self._read = read
        self._waiting: deque[bytes] = deque(maxlen=MAX_WAITING if every else 1)
        self._refusals = Refusals()
        self._subscriber = rospy.Subscriber(
            topic,
            rospy.AnyMsg,
            lambda message: self._waiting.append(message._buff),
            queue_size=None if every else 1,
            # rospy allocates this much memory for each reception.
            buff_size=BUFFER_BYTES if large else rospy.topics.DEFAULT_BUFF_SIZE,
            tcp_nodelay=True,
        )

    def take(self) -> list[Any]:
        """Return the new messages as `read` makes them, in their order."""
        found = []
        while self._waiting:
            with self._refusals.on(self.topic):
                found.append(self._read(self._waiting.popleft()))
        return found

    def newest(self) -> Any:
        """Return the newest message as `read` makes it; None if there is no new one."""
        return next(iter(self.take()[-1:]), None)

    def close(self) -> None:
        """Unsubscribe."""
        self._subscriber.unregister()


def reader_of(
    message_type: type, convert: Callable[[Any], Any] | None = None
) -> Callable[[bytes], Any]:
    """Return a function from the bytes of a message to the message, or to what `convert` returns.

    The function raises MessageError if the bytes do not match the type.
    """

    def read(data: bytes) -> Any:
        try:
            message = message_type().deserialize(data)
        except genpy.DeserializationError as error:
            raise MessageError(f"the bytes do not match {message_type._type}: {error}") from error
        return message if convert is None else convert(message)

    return read
