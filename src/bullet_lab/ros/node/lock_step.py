"""Working in step with simulated time, whatever its speed.

A node that drives a robot with `rospy.Rate` is late by a millisecond or so of wall time; at a
hundred times real time that is a tenth of a simulated second, and a square with crooked
corners. A node in lock step holds simulated time back while it works: `Rate.sleep` lets the
bridge go on to the node's next tick, and returns when it is there.

A node is in lock step if its private parameter ~lock_step is true. Publishers, subscribers and
rates of this package see to the rest; what nodes do is the same with and without.
"""

from __future__ import annotations

import contextlib
import functools
import time
import xmlrpc.client
from typing import Callable, Iterator, List, Optional, Sequence, Tuple

import rospy
from geometry_msgs.msg import Twist

from bullet_lab.core import parameters
from bullet_lab.ros.node.node import LOCK_STEP, NodeError, is_ending, wait_until
from bullet_lab.srv import Advance, AdvanceRequest, AdvanceResponse

SERVICE = "/bullet_lab/advance"
WAIT_FOR_BRIDGE_SECONDS = 60.0
# Wall seconds for commands to find their way to the bridge, and between two looks.
WAIT_FOR_ROUTE_SECONDS = 2.0
ROUTE_CHECK_SECONDS = 0.1
END_OF_TIME = rospy.Time(2**31 - 1)
# Wall seconds for a latched message to reach subscribers that are still connecting.
GOODBYE_SECONDS = 0.5
# Directions as of the slave API's getBusInfo.
INBOUND, OUTBOUND = "i", "o"


@functools.lru_cache(maxsize=None)
def in_lock_step() -> bool:
    """Return whether this node is in lock step; raises ParameterError.

    Outside of a node, as in a test, it is not.
    """
    if not rospy.core.is_initialized():
        return False
    entry = parameters.boolean(False, "hold simulated time back while working")
    declaration = parameters.declared(LOCK_STEP, entry)
    return declaration.read(rospy.get_param(f"~{LOCK_STEP}", False), f"~{LOCK_STEP}")


class Member:
    """What the bridge's lock step knows of this process.

    Attributes:
        publishers: whose messages to the bridge are awaited before time goes on.
    """

    def __init__(self):
        self.publishers: List[rospy.Publisher] = []
        self._call: Optional[rospy.ServiceProxy] = None
        self._epoch = 0
        self._now = rospy.Time(0)

    def join(self) -> rospy.Time:
        """Hold simulated time back from now on; return what time it is.

        Returns when commands that are published reach the bridge, be it through a relay. Raises
        ROSInterruptException if ROS or the bridge shuts down, NodeError if there is no bridge.
        """
        try:
            rospy.wait_for_service(SERVICE, WAIT_FOR_BRIDGE_SECONDS)
        except rospy.ROSException as error:
            if is_ending():
                raise rospy.ROSInterruptException(str(error)) from error
            raise NodeError(f"no bridge offers {SERVICE}, which ~lock_step needs") from error
        self._call = rospy.ServiceProxy(SERVICE, Advance, persistent=True)
        deadline = time.monotonic() + WAIT_FOR_ROUTE_SECONDS
        while True:
            heard = self._ask(0, rospy.Time(0)).heard
            commands = [p for p in self.publishers if p.data_class is Twist and p.impl is not None]
            unheard = [p for p in commands if p.resolved_name not in heard]
            if not unheard:
                return self._now
            if time.monotonic() > deadline:
                names = ", ".join(publisher.resolved_name for publisher in unheard)
                rospy.logwarn("nothing leads from %s to the bridge: going on all the same", names)
                return self._now
            # A relay of topic_tools passes nothing on before it knows what it is to pass on.
            for publisher in unheard:
                publisher.publish(Twist())
            rospy.rostime.wallsleep(ROUTE_CHECK_SECONDS)

    def advance(self, until: rospy.Time) -> rospy.Time:
        """Let simulated time go on and wait until it is there; return what time it is.

        It is less where time was set back. Where only the world was reset, time goes on. Errors
        are those of `join`.
        """
        if self._call is None:
            self.join()
        while True:
            epoch, before = self._epoch, self._now
            answer = self._ask(epoch, until)
            if answer.success or answer.epoch == epoch or answer.now < before:
                return answer.now

    def leave(self) -> None:
        """Hold simulated time back no longer."""
        self.advance(END_OF_TIME)

    def _ask(self, epoch: int, until: rospy.Time) -> AdvanceResponse:
        try:
            answer = self._call(AdvanceRequest(rospy.get_name(), epoch, until, *self._sent()))
        except (rospy.ServiceException, rospy.ROSException, OSError) as error:
            if is_ending():
                raise rospy.ROSInterruptException("shutdown") from error
            raise NodeError(f"the bridge does not answer on {SERVICE}: {error}") from error
        self._epoch, self._now = answer.epoch, answer.now
        return answer

    def _sent(self) -> Tuple[Sequence[str], Sequence[str], Sequence[int]]:
        """Return topic, receiver and number of messages of all connections."""
        sent = [
            (publisher.resolved_name, connection.endpoint_id, connection.stat_num_msg)
            for publisher in self.publishers
            if publisher.impl is not None
            for connection in publisher.impl.connections
        ]
        return tuple(zip(*sent)) or ((), (), ())


@functools.lru_cache(maxsize=None)
def member() -> Member:
    """Return the one membership that a process has."""
    return Member()


class Rate:
    """Ticks by simulated time, which a node in lock step holds back between them.

    Args:
        hz: ticks per simulated second.
        is_ready: in lock step, what is waited for before time may begin.
        what: is waited for then, in the log.

    Attributes:
        now: ROS time at the last tick. It may have been set back.
    """

    def __init__(self, hz: float, is_ready: Optional[Callable[[], bool]] = None, what: str = ""):
        self._hz = hz
        self._member: Optional[Member] = self._membership()
        if self._member is None:
            self._rate = rospy.Rate(hz)
            self.now = rospy.Time.now()
            return
        if is_ready is not None:
            wait_until(is_ready, what)
        self.now = self._member.join()

    def _membership(self) -> Optional[Member]:
        return member() if in_lock_step() else None

    def sleep(self) -> None:
        """Wait for the next tick; raises ROSInterruptException when ROS shuts down."""
        if self._member is not None:
            self.now = self._member.advance(self.now + rospy.Duration(1.0 / self._hz))
            return
        try:
            self._rate.sleep()
        except rospy.exceptions.ROSTimeMovedBackwardsException:
            self._rate = rospy.Rate(self._hz)
        # rospy.Rate says nothing of a shutdown where time is the wall clock's.
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")
        self.now = rospy.Time.now()

    def leave(self) -> None:
        """Let the world go on without this node, which has said all that it has to say."""
        if self._member is not None:
            self._member.leave()
        else:
            rospy.rostime.wallsleep(GOODBYE_SECONDS)


rate = Rate


def join_when(is_connected: Callable[[], bool], what: str) -> None:
    """Tell the bridge that a node which only listens is ready, so that it misses no message.

    Without lock step, nothing is waited for. In lock step the node never holds time back later.
    `is_connected` says whether somebody publishes all that it listens to; `what` is for the log.
    """
    if in_lock_step():
        wait_until(is_connected, what)
        _leave()


@contextlib.contextmanager
def time_held_at(when: rospy.Time) -> Iterator[None]:
    """In lock step, let time come to a moment, and stand there while something is done."""
    if not in_lock_step():
        yield
        return
    member().advance(when)
    yield
    _leave()


def _leave() -> None:
    wait_until(publishers_know_this_node, "the publishers to take note of this node")
    member().leave()


def publishers_know_this_node(topic: str = "") -> bool:
    """Return whether the publishers of all that this node listens to have it on their lists.

    Of one topic, by its whole name: whether any of its publishers has.

    A rospy subscriber counts a connection as soon as it begins to make it. What is published
    before the publisher has noted it never comes.
    """
    name, own = rospy.get_name(), _connections(rospy.get_node_uri())
    heard = {(uri, one) for uri, direction, one in own if direction == INBOUND}
    if topic:
        heard = {(uri, one) for uri, one in heard if one == topic}
    sent = {
        (uri, one)
        for uri in {uri for uri, _ in heard}
        for listener, direction, one in _connections(uri)
        if (listener, direction) == (name, OUTBOUND)
    }
    return bool(heard & sent) if topic else heard <= sent


def _connections(uri: str) -> List[Tuple[str, str, str]]:
    """Return other end, direction and topic of a node's connections; none if it is silent."""
    try:
        with xmlrpc.client.ServerProxy(uri) as node:
            code, _, entries = node.getBusInfo(rospy.get_name())
    except (OSError, xmlrpc.client.Error):
        return []
    return [(entry[1], entry[2], entry[4]) for entry in entries] if code == 1 else []


class LockStepRate(Rate):
    """A rate that is in lock step, whatever ~lock_step says; commands go by `publisher`."""

    def __init__(self, hz: float):
        super().__init__(hz)

    def _membership(self) -> Member:
        return member()
