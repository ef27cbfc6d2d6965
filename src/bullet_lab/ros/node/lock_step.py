"""Working in step with simulated time, whatever its speed.

A node that drives a robot with `rospy.Rate` is late by a millisecond or so of wall time; at a
hundred times real time that is a tenth of a simulated second, and a square with crooked
corners. A node in lock step holds simulated time back while it works: `LockStepRate.sleep`
lets the bridge go on to the node's next tick, and returns when it is there.
"""

from __future__ import annotations

import xmlrpc.client
from collections import defaultdict
from typing import Any, Callable, Dict, Protocol, Set

import rospy

from bullet_lab.ros.node.node import NodeError, wait_until
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.srv import Advance, AdvanceRequest

# Where the slave API's getBusInfo has what.
DESTINATION, DIRECTION, TOPIC = 1, 2, 4
INBOUND, OUTBOUND = "i", "o"


def publishers_know_this_node() -> bool:
    """Return whether the publishers of all that this node listens to have it on their lists.

    A rospy subscriber counts a connection as soon as it begins to make it. What is published
    before the publisher has noted it never comes.
    """
    wanted: Dict[str, Set[str]] = defaultdict(set)
    for entry in _connections(rospy.get_node_uri()):
        if entry[DIRECTION] == INBOUND:
            wanted[entry[DESTINATION]].add(entry[TOPIC])
    return all(topics <= _sent_here(publisher) for publisher, topics in wanted.items())


def _sent_here(publisher: str) -> Set[str]:
    """Return the topics that a node publishes to this one."""
    name = rospy.get_name()
    return {
        entry[TOPIC]
        for entry in _connections(publisher)
        if entry[DIRECTION] == OUTBOUND and entry[DESTINATION] == name
    }


def _connections(uri: str) -> list:
    """Return the connections of a node by its URI; none where it does not answer."""
    try:
        with xmlrpc.client.ServerProxy(uri) as node:
            code, _, entries = node.getBusInfo(rospy.get_name())
    except (OSError, xmlrpc.client.Error):
        return []
    return entries if code == 1 else []


class FreeRate:
    """Stands beside LockStepRate: ticks by ROS time, which may be set back.

    Attributes:
        now: ROS time at the last tick.
    """

    def __init__(self, hz: float):
        self._hz = hz
        self._rate = rospy.Rate(hz)
        self.now = rospy.Time.now()

    def sleep(self) -> None:
        """Wait for the next tick; raises ROSInterruptException when ROS shuts down."""
        try:
            self._rate.sleep()
        except rospy.exceptions.ROSTimeMovedBackwardsException:
            self._rate = rospy.Rate(self._hz)
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")
        self.now = rospy.Time.now()


SERVICE = "/bullet_lab/advance"
WAIT_FOR_BRIDGE_SECONDS = 60.0
END_OF_TIME = rospy.Time(2**31 - 1)


class Rate(Protocol):
    """What rospy.Rate and LockStepRate have in common."""

    def sleep(self) -> None:
        """Wait for the next tick."""


class Counted(Protocol):
    """What knows how many messages have been sent to the bridge."""

    count: int


class LockStep:
    """A node's membership in the bridge's lock step.

    Raises:
        NodeError: there is no bridge that offers it.
    """

    def __init__(self):
        try:
            rospy.wait_for_service(SERVICE, WAIT_FOR_BRIDGE_SECONDS)
        except rospy.ROSException as error:
            if rospy.is_shutdown():
                raise rospy.ROSInterruptException(str(error)) from error
            raise NodeError(f"no bridge offers {SERVICE}, which ~lock_step needs") from error
        self._call = rospy.ServiceProxy(SERVICE, Advance, persistent=True)

    def listen_only(self) -> None:
        """Join as one that never holds time back: "I am ready, do start".

        Waits until all publishers that this node has found will send to it.
        """
        wait_until(publishers_know_this_node, "the publishers to take note of this node")
        self.advance(END_OF_TIME)

    def advance(self, until: rospy.Time, commands: int = 0) -> rospy.Time:
        """Let simulated time go on and wait until it is there; return what time it is.

        Args:
            until: when this node wants to act next.
            commands: how many messages it has sent to the bridge so far; the bridge awaits
                them before it goes on.

        Raises:
            ROSInterruptException: ROS or the bridge shuts down.
            NodeError: the bridge is gone.
        """
        try:
            request = AdvanceRequest(rospy.get_name(), until, commands)
            return self._call(request).now
        except (rospy.ServiceException, rospy.ROSException, OSError) as error:
            if rospy.is_shutdown():
                raise rospy.ROSInterruptException("shutdown") from error
            raise NodeError(f"the bridge does not answer on {SERVICE}: {error}") from error


def join_when(connected: Callable[[], bool], what: str) -> None:
    """Join as a listener once it is connected, so that no message is missed.

    Args:
        connected: says whether it is.
        what: is waited for, in the log.
    """
    wait_until(connected, what)
    LockStep().listen_only()


class CountedPublisher:
    """A publisher that knows how many messages it has sent, written out at once."""

    def __init__(self, publisher: Publisher):
        self._publisher = publisher
        self.count = 0

    def publish(self, message: Any) -> None:
        """Publish a message."""
        self._publisher.publish(message)
        if self.is_connected():
            self.count += 1

    def is_connected(self) -> bool:
        """Return whether anybody listens."""
        return self._publisher.has_connections()


class LockStepRate:
    """Stands in for rospy.Rate, in lock step.

    Args:
        hz: ticks per simulated second.
        commands: the publisher of what the node tells the bridge, or what counts for several.
    """

    def __init__(self, hz: float, commands: Counted):
        self._period = rospy.Duration(1.0 / hz)
        self._commands = commands
        self._lock_step = LockStep()
        # A grant up to time 0 joins, and is reached already.
        self.now = self._lock_step.advance(rospy.Time(0), commands.count)

    def sleep(self) -> None:
        """Wait for the next tick; `now` is the simulated time then."""
        self.now = self._lock_step.advance(self.now + self._period, self._commands.count)

    def leave(self) -> None:
        """Hold simulated time back no longer."""
        self._lock_step.advance(END_OF_TIME, self._commands.count)
