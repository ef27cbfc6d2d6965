"""Publishers, subscribers and rates, and lock step: simulated time waits for nodes that work.

A node that drives a robot with `rospy.Rate` is late by a millisecond or so of wall time. At a
hundred times real time that is a tenth of a simulated second, and the corners of a square are
wrong. A node in lock step holds simulated time back while it works: `Rate.sleep` lets the bridge
advance to the node's next tick, and returns when it is reached.

A node is in lock step if its private parameter ~lock_step is true. `publisher`, `subscriber` and
`Rate` do the rest: they lose no message. The code of a node is the same with and without lock step.
"""

from __future__ import annotations

import contextlib
import functools
import time
import warnings
import xmlrpc.client
from io import BytesIO
from typing import Any, Callable, Iterator, Sequence

import genpy
import rosgraph
import rospy
from geometry_msgs.msg import Twist
from rospy.msg import serialize_message

from bullet_lab.core import parameters
from bullet_lab.errors import LabError
from bullet_lab.ros.node.node import (
    LOCK_STEP,
    MASTER_ERRORS,
    NodeError,
    Refusals,
    check_running,
    holds_within,
    is_ending,
    wait_until,
)
from bullet_lab.srv import Advance, AdvanceRequest, AdvanceResponse

SERVICE = "/bullet_lab/advance"
WAIT_FOR_BRIDGE_SECONDS = 60.0
# Wall seconds within which commands must reach the bridge, and between two checks.
WAIT_FOR_ROUTE_SECONDS = 2.0
ROUTE_CHECK_SECONDS = 0.02
END_OF_TIME = rospy.Time(2**31 - 1)
# Wall seconds for a latched message to reach subscribers that are still connecting.
GOODBYE_SECONDS = 0.5
# Wall seconds between two checks of a full queue.
ROOM_CHECK_SECONDS = 0.001
# Field in the connection header of a publisher of commands: wall seconds after which the bridge
# stops the robot if no further command arrives.
COMMAND_TIMEOUT = "command_timeout"
# Directions of connections in the slave API's getBusInfo.
INBOUND = "i"
OUTBOUND = "o"
# A publisher without a queue size writes at once; rospy takes that for a mistake.
warnings.filterwarnings("ignore", "The publisher should be created with an explicit", SyntaxWarning)


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


def _bridge_is_there() -> bool:
    try:
        return bool(rosgraph.Master(rospy.get_name()).lookupService(SERVICE))
    except MASTER_ERRORS:
        return False


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
        # rospy would look for it only every 0.3 s.
        is_offered = holds_within(_bridge_is_there, WAIT_FOR_BRIDGE_SECONDS)
        try:
            rospy.wait_for_service(SERVICE, WAIT_FOR_BRIDGE_SECONDS if is_offered else 0.1)
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


class Publisher(rospy.Publisher):
    """A publisher that does nothing, and raises nothing, while the node shuts down.

    Without a `queue_size` it writes to its subscribers at once and drops no message.
    """

    def has_connections(self) -> bool:
        """Return whether anybody subscribes."""
        return self.impl is not None and self.impl.has_connections()

    def publish(self, *args: Any, **kwds: Any) -> None:
        """Publish a message."""
        try:
            super().publish(*args, **kwds)
        except rospy.ROSException:
            if not is_ending():
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
        self._batch = BytesIO()
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

    `receive` is called in the topic's thread, and may raise LabError to refuse a message.
    `buffer_bytes` is larger than a large message, or old messages stay in the socket.
    """
    refusals = Refusals()

    def take(message: Any) -> None:
        # A context takes longer, and messages may be many.
        try:
            receive(message)
        except LabError as error:
            refusals.refuse(topic, str(error))

    size = None if in_lock_step() else queue_size
    return rospy.Subscriber(
        topic, kind, take, queue_size=size, buff_size=buffer_bytes, tcp_nodelay=True
    )


class Rate:
    """Ticks by simulated time, which a node in lock step holds back between the ticks.

    In lock step, it waits for `is_ready` before time starts, and logs `what` that waits for.

    Attributes:
        now: ROS time at the last tick; a reset may have set it back.
    """

    def __init__(self, hz: float, is_ready: Callable[[], bool] | None = None, what: str = ""):
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
