"""Messages of a topic that wait until time has come to their stamps."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from typing import Any, Callable, Deque, Generic, List, Optional, Tuple, TypeVar

import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.ros.node.lock_step import in_lock_step
from bullet_lab.ros.node.node import Refusals
from bullet_lab.ros.node.publishers import subscriber

MOST_WAITING = 1000
# Wall seconds that a message may take which is due, in lock step.
LATEST = 10.0
_POLL_SECONDS = 0.2
_MILLISECOND = 1_000_000

T = TypeVar("T")


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
        self.topic = topic
        self.trouble = ""
        self._kind = kind
        self._read = read
        self._rate = rate
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
                self._new.wait(_POLL_SECONDS)

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
