"""Lock step: simulated time waits for nodes while they work, whatever its speed.

A node that drives a robot with `rospy.Rate` is late by a millisecond or so of wall time. At a
hundred times real time that is a tenth of a simulated second, and the corners of a square are
wrong. A node in lock step holds simulated time back while it works: `Rate.sleep` lets the bridge
advance to the node's next tick, and returns when it is reached.

A node is in lock step if its private parameter ~lock_step is true. The publishers, subscribers and
rates of this package do the rest; the code of a node is the same with and without lock step.
"""

from __future__ import annotations

import contextlib
import functools
import time
import xmlrpc.client
from typing import Callable, Iterator, Sequence

import rospy
from geometry_msgs.msg import Twist

from bullet_lab.core import parameters
from bullet_lab.ros.node.node import LOCK_STEP, NodeError, check_running, is_ending, wait_until
from bullet_lab.srv import Advance, AdvanceRequest, AdvanceResponse

SERVICE = "/bullet_lab/advance"
WAIT_FOR_BRIDGE_SECONDS = 60.0
# Wall seconds within which commands must reach the bridge, and between two checks.
WAIT_FOR_ROUTE_SECONDS = 2.0
ROUTE_CHECK_SECONDS = 0.1
END_OF_TIME = rospy.Time(2**31 - 1)
# Wall seconds for a latched message to reach subscribers that are still connecting.
GOODBYE_SECONDS = 0.5
# Directions of connections in the slave API's getBusInfo.
INBOUND = "i"
OUTBOUND = "o"


@functools.lru_cache
def in_lock_step() -> bool:
    """Return whether this node is in lock step; raises ParameterError.

    Outside of a node, as in a test, it returns False.
    """
    if not rospy.core.is_initialized():
        return False
    entry = parameters.boolean(False, "hold simulated time back while working")
    declaration = parameters.declared(LOCK_STEP, entry)
    return declaration.read(rospy.get_param(f"~{LOCK_STEP}", False), f"~{LOCK_STEP}")


class Member:
    """The membership of this process in the bridge's lock step.

    Attributes:
        publishers: time advances only when the bridge has received their messages.
    """

    def __init__(self):
        self.publishers: list[rospy.Publisher] = []
        self._call: rospy.ServiceProxy | None = None
        self._epoch = 0
        self._now = rospy.Time(0)

    def join(self) -> rospy.Time:
        """Hold simulated time back from now on; return the simulated time.

        Waits until published commands reach the bridge, directly or through a relay. Raises
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
            unheard = [
                publisher
                for publisher in self.publishers
                if publisher.data_class is Twist
                and publisher.impl is not None
                and publisher.resolved_name not in heard
            ]
            if not unheard or time.monotonic() > deadline:
                break
            # A relay of topic_tools connects to the bridge after its first message.
            for publisher in unheard:
                publisher.publish(Twist())
            rospy.rostime.wallsleep(ROUTE_CHECK_SECONDS)
        for publisher in unheard:
            line = "no subscriber connects %s to the bridge; its commands are not counted"
            rospy.logwarn(line, publisher.resolved_name)
        return self._now

    def advance(self, until: rospy.Time) -> rospy.Time:
        """Let simulated time advance, wait until it is reached, and return the simulated time.

        It is less than `until` after a reset of time. A reset of the world alone does not matter.
        Raises the errors of `join`.
        """
        if self._call is None:
            self.join()
        while True:
            epoch, before = self._epoch, self._now
            answer = self._ask(epoch, until)
            if answer.success or answer.epoch == epoch or answer.now < before:
                return answer.now

    def leave(self) -> None:
        """Stop holding simulated time back."""
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

    def _sent(self) -> tuple[Sequence[str], Sequence[str], Sequence[int]]:
        """Return the topics, the receivers and the numbers of messages of all connections."""
        sent = [
            (publisher.resolved_name, connection.endpoint_id, connection.stat_num_msg)
            for publisher in self.publishers
            if publisher.impl is not None
            for connection in publisher.impl.connections
        ]
        return tuple(zip(*sent)) or ((), (), ())


@functools.lru_cache
def member() -> Member:
    """Return the membership of this process."""
    return Member()


class Rate:
    """Ticks by simulated time, which a node in lock step holds back between the ticks.

    Args:
        hz: ticks per simulated second.
        is_ready: in lock step, condition to wait for before time starts.
        what: what that waits for, for the log.

    Attributes:
        now: ROS time at the last tick; a reset may have set it back.
    """

    def __init__(
        self, hz: float, is_ready: Callable[[], bool] | None = None, what: str = ""
    ):
        self._hz = hz
        self._member: Member | None = member() if in_lock_step() else None
        if self._member is None:
            self._rate = rospy.Rate(hz)
            self.now = rospy.Time.now()
            return
        if is_ready is not None:
            wait_until(is_ready, what)
        self.now = self._member.join()

    def sleep(self) -> None:
        """Wait for the next tick; raises ROSInterruptException when ROS shuts down."""
        if self._member is not None:
            self.now = self._member.advance(self.now + rospy.Duration(1.0 / self._hz))
            return
        try:
            self._rate.sleep()
        except rospy.exceptions.ROSTimeMovedBackwardsException:
            self._rate = rospy.Rate(self._hz)
        # Without simulated time, rospy.Rate raises nothing at a shutdown.
        check_running()
        self.now = rospy.Time.now()

    def leave(self) -> None:
        """Let time advance without this node, after its last message."""
        if self._member is not None:
            self._member.leave()
        else:
            rospy.rostime.wallsleep(GOODBYE_SECONDS)



def join_when(is_connected: Callable[[], bool], what: str) -> None:
    """In lock step, hold time until a node that only subscribes is connected.

    The node misses no message, and does not hold time back afterwards. `is_connected` returns
    whether all topics have a publisher; `what` describes that in the log.
    """
    if in_lock_step():
        wait_until(is_connected, what)
        _leave()


@contextlib.contextmanager
def time_held_at(when: rospy.Time) -> Iterator[None]:
    """In lock step, let time advance to a moment and hold it there within the context."""
    if not in_lock_step():
        yield
        return
    member().advance(when)
    yield
    _leave()


def grant(until: rospy.Time) -> None:
    """In lock step, let time advance up to a moment; do nothing if the bridge does not answer."""
    if in_lock_step():
        with contextlib.suppress(NodeError, rospy.ROSInterruptException):
            member().advance(until)


def _leave() -> None:
    wait_until(publishers_know_this_node, "the publishers to connect to this node")
    member().leave()


def publishers_know_this_node(topic: str = "") -> bool:
    """Return whether the publishers on all topics of this node have completed the connection.

    With a topic, by its resolved name: whether any of its publishers has.

    A rospy subscriber counts a connection as soon as it begins to make it. A message that is
    published before the publisher has the connection, too, is lost.
    """
    name = rospy.get_name()
    inbound = {
        (uri, one)
        for uri, direction, one in _connections(rospy.get_node_uri())
        if direction == INBOUND and topic in ("", one)
    }
    outbound = {
        (uri, one)
        for uri in {uri for uri, _ in inbound}
        for subscriber, direction, one in _connections(uri)
        if (subscriber, direction) == (name, OUTBOUND)
    }
    return bool(inbound & outbound) if topic else inbound <= outbound


def _connections(uri: str) -> list[tuple[str, str, str]]:
    """Return other end, direction and topic of a node's connections; none if it is dead."""
    try:
        with xmlrpc.client.ServerProxy(uri) as node:
            code, _, entries = node.getBusInfo(rospy.get_name())
    except (OSError, xmlrpc.client.Error):
        return []
    return [(entry[1], entry[2], entry[4]) for entry in entries] if code == 1 else []
