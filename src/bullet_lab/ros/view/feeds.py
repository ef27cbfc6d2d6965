"""Topics as the view hears them: as bytes, of which it reads at its own pace what it shows."""

from __future__ import annotations

from collections import deque
from typing import Any, Callable, Deque, List, Optional, TypeVar

import genpy
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.node.node import Refusals
from bullet_lab.ros.view.raw import RawError

# Messages that wait to be read where each of them counts.
MOST_WAITING = 2000
# More than a large image has, lest old ones pile up in the socket.
BUFFER_BYTES = 2**24

T = TypeVar("T")


class Feed:
    """The messages of one topic that have come since the last look.

    Args:
        topic: to listen to.
        read: makes something of the bytes of a message, or raises LabError to refuse it.
        every: whether each message counts; the newest alone, if not.
        large: whether a message may be larger than what is received at once by default.
    """

    def __init__(
        self,
        topic: str,
        read: Callable[[bytes], T],
        every: bool = False,
        large: bool = False,
    ):
        self.topic = topic
        self._read = read
        self._waiting: Deque[bytes] = deque(maxlen=MOST_WAITING if every else 1)
        self._refusals = Refusals()
        self._subscriber = rospy.Subscriber(
            topic,
            rospy.AnyMsg,
            lambda message: self._waiting.append(message._buff),
            queue_size=None if every else 1,
            # As much memory is taken for each reception.
            buff_size=BUFFER_BYTES if large else rospy.topics.DEFAULT_BUFF_SIZE,
            tcp_nodelay=True,
        )

    def take(self) -> List[T]:
        """Return what the messages say that have come, in their order."""
        found = []
        while self._waiting:
            try:
                found.append(self._read(self._waiting.popleft()))
            except LabError as error:
                self._refusals.refuse(self.topic, str(error))
        return found

    def newest(self) -> Optional[T]:
        """Return what the newest message says; None where none has come since the last look."""
        return next(iter(self.take()[-1:]), None)

    def close(self) -> None:
        """Listen no longer."""
        self._subscriber.unregister()


def reader_of(kind: type) -> Callable[[bytes], Any]:
    """Return what makes a message of a class of its bytes."""

    def read(data: bytes) -> Any:
        try:
            return kind().deserialize(data)
        except genpy.DeserializationError as error:
            raise RawError(f"not what its type says: {error}") from error

    return read
