"""Working only while somebody listens."""

from __future__ import annotations

import threading
from typing import Any, Callable, List

import rospy

from bullet_lab.ros.publishers import Publisher, lossless_publisher

# Wall seconds between two looks for listeners that have gone without a word.
_PERIOD = 0.5


class Demand(rospy.SubscribeListener):
    """Publishers of results, and whether anybody listens to one of them.

    Args:
        start: called when there is somebody, from a thread of its own.
        stop: called when there is nobody any more.
        always: whether to work all the same.
    """

    def __init__(self, start: Callable[[], None], stop: Callable[[], None], always: bool = False):
        super().__init__()
        self._start, self._stop = start, stop
        self._always = always
        self._publishers: List[Publisher] = []
        self._wake = threading.Event()
        self.is_there = False

    def publisher(self, topic: str, kind: type, lossless: bool, queue_size: int = 10) -> Publisher:
        """Return a publisher of results."""
        if lossless:
            made = lossless_publisher(topic, kind)
        else:
            made = Publisher(topic, kind, queue_size=queue_size, tcp_nodelay=True)
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
            self._wake.wait(_PERIOD)


def _has_listeners(publisher: Publisher) -> bool:
    """Return whether anybody listens still; rospy itself only notices when it writes."""
    implementation = publisher.impl
    if implementation is None:
        return False
    if implementation.has_connections():
        implementation.check()
    return implementation.has_connections()
