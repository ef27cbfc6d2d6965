"""The topics of devices, and the counts of the commands that arrive on them.

Time in lock step advances when all commands that a member has sent have arrived, also those that
come through other nodes, such as relays.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import Counter
from dataclasses import dataclass
from typing import (
    Any,
    Callable,
    Iterable,
    Mapping,
    NamedTuple,
    Sequence,
    Union,
)

import rosgraph
import rosgraph.names
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.stepper import Stepper, StepperError
from bullet_lab.ros.messages.conversions import COMMANDS, Converter
from bullet_lab.ros.node.lock_step import COMMAND_TIMEOUT, BatchPublisher
from bullet_lab.ros.node.node import MASTER_ERRORS, Refusals
from bullet_lab.simulation.plugins import Input, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.controllers.controller import Controller
from bullet_lab.simulation.plugins.samples import STANDSTILL, PlanarCommand

# Messages that wait for a slow subscriber while time follows the wall clock.
QUEUE_SIZE = 100
# Wall seconds to wait for commands.
PATIENCE = 2.0
# Wall seconds after which a relay has passed on what was sent to it before.
SETTLE_SECONDS = 0.05
# Wall seconds between two searches for a route that did not exist.
SEARCH_SECONDS = 1.0

# Anything with outputs and inputs.
Device = Union[Plugin, Controller]


class Arrival(NamedTuple):
    """The connection over which commands arrive: a topic of the bridge and the sending node."""

    topic: str
    sender: str


class Route(NamedTuple):
    """The connection over which a member sends messages: its name, the topic, the receiver."""

    member: str
    topic: str
    receiver: str

    def direct(self) -> Arrival:
        """Return where its messages arrive if the receiver is the bridge."""
        return Arrival(self.topic, self.member)


@dataclass
class _Connection:
    """The state of a member's connection whose messages arrive at the bridge.

    Attributes:
        due: the number of messages that must arrive, by arrival.
        sent: messages that the member has sent so far.
        is_waited_for: false for a relay that has lost messages.
    """

    due: dict[Arrival, int]
    sent: int
    is_waited_for: bool = True


class CommandCounter:
    """Counts commands where they arrive, and waits for those that are under way.

    Through a relay, as many commands have to arrive from it as were sent to it. A relay that
    loses commands, such as a multiplexer that has selected another topic, is not waited for until
    the member joins again.

    Args:
        find_arrivals: returns where messages of a route arrive; empty if they do not.
        changed: condition that is notified of arrivals.
    """

    def __init__(
        self,
        find_arrivals: Callable[[Route], set[Arrival]],
        changed: threading.Condition | None = None,
    ):
        self._find_arrivals = find_arrivals
        self._changed = changed or threading.Condition()
        self._arrived: Counter = Counter()
        self._headers: dict[Arrival, Any] = {}
        self._connections: dict[Route, _Connection] = {}

    def note(self, arrival: Arrival, header: Any = None) -> None:
        """Count a command; the count restarts with the header of a new connection."""
        with self._changed:
            if self._headers.get(arrival) is not header:
                self._headers[arrival] = header
                self._arrived[arrival] = 0
            self._arrived[arrival] += 1
            self._changed.notify_all()

    def heard(self, sent: Mapping[Route, int]) -> set[str]:
        """Return the topics of a member that reach the bridge, and restart their counts.

        Called when the member joins, before it sends commands.

        Args:
            sent: the number of messages that it has sent so far.
        """
        for route in sent:
            self._connections.pop(route, None)
        return {route.topic for route, count in sent.items() if self._connection(route, count)}

    def wait(self, sent: Mapping[Route, int]) -> list[Route]:
        """Wait until the messages of a member have arrived; return the routes that lost some."""
        return [route for route, count in sent.items() if not self._wait_for(route, count)]

    def _wait_for(self, route: Route, count: int) -> bool:
        """Return whether the messages have arrived, or are not waited for."""
        connection = self._connection(route, count)
        if connection is None or not connection.is_waited_for or connection.sent == count:
            return True
        new = count - connection.sent
        connection.sent = count
        with self._changed:
            # More have arrived than were due if some were late.
            due = {a: max(n + new, self._arrived[a]) for a, n in connection.due.items()}
            in_time = self._changed.wait_for(
                lambda: all(self._arrived[arrival] >= number for arrival, number in due.items()),
                PATIENCE,
            )
            connection.due = due if in_time else self._counts(due)
            connection.is_waited_for = in_time or due.keys() == {route.direct()}
            return in_time

    def _counts(self, arrivals: Iterable[Arrival]) -> dict[Arrival, int]:
        return {arrival: self._arrived[arrival] for arrival in arrivals}

    def _connection(self, route: Route, count: int) -> _Connection | None:
        """Return the state of a connection; None if its messages do not reach the bridge."""
        arrivals = self._find_arrivals(route)
        known = self._connections.get(route)
        if known is None or known.due.keys() != arrivals or count < known.sent:
            known = self._connections[route] = self._new_connection(route, count, arrivals)
        return known if arrivals else None

    def _new_connection(self, route: Route, count: int, arrivals: set[Arrival]) -> _Connection:
        direct = route.direct()
        if arrivals == {direct}:
            with self._changed:
                # Messages of an earlier node of the same name do not count.
                self._arrived[direct] = min(self._arrived[direct], count)
            return _Connection({direct: 0}, 0)
        if arrivals:
            time.sleep(SETTLE_SECONDS)
        with self._changed:
            return _Connection(self._counts(arrivals), count)


class RouteFinder:
    """Finds where messages arrive at the bridge that a node sends to another one.

    Besides direct connections, these are routes through nodes that publish the type of message
    that they receive: relays, multiplexers, limiters.

    Args:
        subscribers: of commands, by topic.
    """

    def __init__(self, subscribers: Mapping[str, rospy.Subscriber]):
        self._subscribers = subscribers
        self._lock = threading.Lock()
        # Arrivals, and when they were searched for.
        self._found: dict[Route, tuple[set[Arrival], float]] = {}
        self._inbound: set[Arrival] = set()

    def find(self, route: Route) -> set[Arrival]:
        """Return where messages arrive that a member sends to another node on a topic."""
        if route.receiver == rospy.get_name():
            return {route.direct()} if route.topic in self._subscribers else set()
        # Topics of commands with the nodes that are connected to them.
        inbound = {
            Arrival(topic, connection.callerid_pub)
            for topic, subscriber in list(self._subscribers.items())
            if subscriber.impl is not None
            for connection in subscriber.impl.connections
        }
        with self._lock:
            if inbound != self._inbound:
                self._found.clear()
                self._inbound = inbound
            found, searched = self._found.get(route, (set(), 0.0))
            if not found and time.monotonic() - searched > SEARCH_SECONDS:
                found = _search(route) & inbound
                self._found[route] = (found, time.monotonic())
            return found


def _search(route: Route) -> set[Arrival]:
    """Return the topics that the receiver, and nodes behind it, publish with that type."""
    master = rosgraph.Master(rospy.get_name())
    try:
        published, subscribed, _ = master.getSystemState()
        types = dict(master.getTopicTypes())
    except MASTER_ERRORS:
        return set()
    listeners = dict(subscribed)
    found: set[Arrival] = set()
    visited = {route.member, rospy.get_name()}
    nodes = [route.receiver]
    while nodes:
        node = nodes.pop()
        if node in visited:
            continue
        visited.add(node)
        for onward, senders in published:
            same_type = types.get(onward) == types.get(route.topic)
            if node in senders and onward != route.topic and same_type:
                found.add(Arrival(onward, node))
                nodes.extend(listeners.get(onward, ()))
    return found


class TopicError(LabError):
    """A device has an invalid topic name."""


class DeviceTopics:
    """Publishes the samples of devices, and gives them the commands that arrive.

    Devices share the publisher and the subscriber of a topic, such as /tf. For the thread of the
    simulation, except for the callbacks of rospy.

    Attributes:
        commands: the counts of the commands that have arrived.
    """

    def __init__(self, stepper: Stepper):
        self._stepper = stepper
        stepper.after_steps = self.flush
        self._refusals = Refusals()
        self._publishers: dict[str, BatchPublisher] = {}
        self._users: Counter = Counter()
        self._inputs: dict[str, list[Input]] = {}
        self._subscribers: dict[str, rospy.Subscriber] = {}
        self._timeouts: dict[Arrival, threading.Timer] = {}
        self.commands = CommandCounter(RouteFinder(self._subscribers).find)

    def publisher(self, topic: str, kind: type) -> BatchPublisher:
        """Return the publisher on a topic.

        At full speed no message is lost: the simulation waits for slow subscribers. Tied to the
        wall clock, it does not wait, as Gazebo does not. `flush` follows changes of the speed.
        """
        if topic not in self._publishers:
            size = None if self._stepper.pace.free else QUEUE_SIZE
            made = BatchPublisher(topic, kind, queue_size=size, tcp_nodelay=True)
            self._publishers[topic] = made
        self._users[topic] += 1
        return self._publishers[topic]

    def release(self, topic: str) -> None:
        """Release the publisher on a topic; it is closed when all its users have released it."""
        self._users[topic] -= 1
        if not self._users[topic]:
            publisher = self._publishers.pop(topic)
            publisher.flush()
            publisher.unregister()

    def flush(self) -> None:
        """Send the messages of the last steps."""
        lossless = self._stepper.lossless
        for publisher in self._publishers.values():
            publisher.flush(lossless)

    def connect(self, devices: Sequence[Device], owner: str) -> None:
        """Connect the outputs and inputs of devices; raises TopicError for an invalid name."""
        for device in devices:
            for entry in (*device.outputs, *device.inputs):
                # rospy would register the topic, and nobody could subscribe to it.
                if not entry.topic or not rosgraph.names.is_legal_name(entry.topic):
                    raise TopicError(f"{owner}: invalid topic name '{entry.topic}'")
        for device in devices:
            for output in device.outputs:
                self._connect_output(output)
            for entry in device.inputs:
                self._connect_input(entry)

    def disconnect(self, devices: Sequence[Device]) -> None:
        """Shut down the topics of devices that no other device uses."""
        for device in devices:
            for output in device.outputs:
                self.release(output.topic)
            for entry in device.inputs:
                topic = rospy.resolve_name(entry.topic)
                self._inputs[topic].remove(entry)
                if not self._inputs[topic]:
                    del self._inputs[topic]
                    self._subscribers.pop(topic).unregister()

    def subscribe(
        self,
        topic: str,
        kind: type,
        receive: Callable[[Any], None],
        queue_size: int | None = None,
    ) -> None:
        """Subscribe to a topic, once, whose messages the lock step counts as commands.

        `receive` executes a message; it may raise StepperError when the bridge ends. Without a
        `queue_size`, no message is dropped.
        """
        topic = rospy.resolve_name(topic)

        def receive_and_count(message: Any) -> None:
            header = message._connection_header
            # A message that arrives while the bridge ends is ignored.
            with contextlib.suppress(StepperError):
                receive(message)
                self.commands.note(Arrival(topic, header["callerid"]), header)

        self._subscribers[topic] = rospy.Subscriber(
            topic, kind, receive_and_count, queue_size=queue_size, tcp_nodelay=True
        )

    def _connect_output(self, output: Output) -> None:
        converter = Converter(output.kind)
        publisher = self.publisher(output.topic, converter.message_kind)
        convert, publish = converter.convert, publisher.publish
        output.connect(lambda sample: publish(convert(sample)), publisher.has_connections)

    def _connect_input(self, entry: Input) -> None:
        topic = rospy.resolve_name(entry.topic)
        inputs = self._inputs.setdefault(topic, [])
        inputs.append(entry)
        if len(inputs) > 1:
            return
        message_kind, command_of = COMMANDS[entry.kind]

        def execute(command: Any) -> None:
            self._stepper.do_now(lambda: self._command(topic, inputs, command))

        def receive(message: Any) -> None:
            command, header = command_of(message), message._connection_header
            arrival = Arrival(topic, header["callerid"])
            # Before the command, or the earlier timeout could stop the robot after it.
            timeout = self._timeouts.pop(arrival, None)
            if timeout is not None:
                timeout.cancel()
            execute(command)
            if COMMAND_TIMEOUT in header and entry.kind is PlanarCommand and command != STANDSTILL:
                self._begin_timeout(arrival, header[COMMAND_TIMEOUT], lambda: execute(STANDSTILL))

        self.subscribe(topic, message_kind, receive)

    def _begin_timeout(self, arrival: Arrival, seconds: str, stop: Callable[[], None]) -> None:
        """Stop a robot if no further command arrives within the timeout of its publisher."""

        def end() -> None:
            with contextlib.suppress(StepperError):
                stop()
            line = "%s: no command from %s for %s s; robot stopped"
            rospy.logwarn(line, *arrival, seconds)

        with contextlib.suppress(ValueError, OverflowError):
            timeout = threading.Timer(float(seconds), end)
            timeout.daemon = True
            self._timeouts[arrival] = timeout
            timeout.start()

    def _command(self, topic: str, inputs: Sequence[Input], command: Any) -> None:
        # Without a subscriber, the model was deleted just now.
        subscriber = self._subscribers.get(topic)
        for entry in inputs if subscriber is not None else ():
            try:
                if entry.alone and subscriber.get_num_connections() > 1:
                    raise PluginError("several nodes publish; only one may")
                entry.handle(command)
            except PluginError as error:
                self._refusals.refuse(entry.topic, str(error))
            except Exception as error:
                # A fault in the plugin. Other inputs get the command, and others may follow.
                self._refusals.refuse(entry.topic, f"{type(error).__name__}: {error}")
                logging.getLogger("rospy").info("Traceback", exc_info=True)
