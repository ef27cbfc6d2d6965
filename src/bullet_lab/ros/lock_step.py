"""Working in step with simulated time, whatever its speed.

A node that drives a robot with `rospy.Rate` is late by a millisecond or so of wall time; at a
hundred times real time that is a tenth of a simulated second, and a square with crooked
corners. A node in lock step holds simulated time back while it works: `LockStepRate.sleep`
lets the bridge go on to the node's next tick, and returns when it is there.
"""

from __future__ import annotations

from typing import Any, Callable, Protocol

import rospy

from bullet_lab.ros.connections import publishers_know_this_node
from bullet_lab.ros.node import NodeError, wait_until
from bullet_lab.ros.publishers import Publisher
from bullet_lab.srv import Advance, AdvanceRequest

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
