"""A simulation that runs on ROS: the topics of its devices, and others who ask and change it."""

from __future__ import annotations

import contextlib
import math
import threading
import time
import xmlrpc.client
from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    List,
    Mapping,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

import rosgraph
import rosgraph.names
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.stepper import Stepper, StepperError
from bullet_lab.ros.bridge.timing import Arrival, CommandCounter
from bullet_lab.ros.messages.conversions import INPUT_CONVERTERS, OUTPUT_CONVERTERS
from bullet_lab.ros.node.node import (
    MASTER_ERRORS,
    TF_PREFIX,
    NodeError,
    Refusals,
    search_parameter,
)
from bullet_lab.ros.node.publishers import COMMAND_TIMEOUT, BatchPublisher
from bullet_lab.simulation.plugins import Input, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.controllers.controller import Controller
from bullet_lab.simulation.plugins.mobile_base import STANDSTILL
from bullet_lab.simulation.plugins.plugin import NAMESPACE
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import ModelInstance, Simulation
from bullet_lab.simulation.world.description import Model

# Messages that wait for a slow subscriber while time follows the wall clock.
QUEUE_SIZE = 100
# Wall seconds after which it is looked anew for ways that were not there.
ROUTES_SECONDS = 1.0
CALLER = "/bullet_lab"
# Wall seconds that a node may take to say that it is there.
ANSWER_SECONDS = 5.0


# What has outputs and inputs: a plugin, or a controller of one.
Device = Union[Plugin, Controller]


class TopicError(LabError):
    """A device names a topic that cannot be."""


class DeviceTopics:
    """Publishes the samples of models' devices and hands them commands.

    Topics that several devices speak on, such as /tf, have one publisher, and those that several
    listen to one subscriber. All methods but those that rospy calls belong to the thread that
    steps the simulation.

    Attributes:
        commands: those that have arrived.
    """

    def __init__(self, stepper: Stepper):
        self._stepper = stepper
        self._refusals = Refusals()
        self._publishers: Dict[str, BatchPublisher] = {}
        self._users: Dict[str, int] = {}
        self._instances: Dict[str, ModelInstance] = {}
        self._inputs: Dict[str, List[Input]] = {}
        self._subscribers: Dict[str, rospy.Subscriber] = {}
        self._timeouts: Dict[Arrival, threading.Timer] = {}
        self.commands = CommandCounter(_Routes(self._subscribers).find)

    def publisher(self, topic: str, kind: type) -> BatchPublisher:
        """Return the publisher on a topic, one that fits the pace.

        At full speed nothing may be lost, so the simulation waits for its subscribers. Tied to
        the wall clock it does not wait for anybody, as Gazebo does not. A pace that changes later
        on is followed by `flush`.
        """
        publisher = self._publishers.get(topic)
        if publisher is None:
            size = None if self._stepper.pace.free else QUEUE_SIZE
            publisher = BatchPublisher(topic, kind, queue_size=size, tcp_nodelay=True)
            self._publishers[topic] = publisher
        self._users[topic] = self._users.get(topic, 0) + 1
        return publisher

    def flush(self) -> None:
        """Write out what the last steps have brought."""
        lossless = self._stepper.hurried
        for publisher in self._publishers.values():
            publisher.flush(lossless)

    def connect(self, instance: ModelInstance) -> None:
        """Connect all devices of a model; raises TopicError for a topic that cannot be."""
        self.connect_devices(instance.plugins, f"model '{instance.name}'")
        self._instances[instance.name] = instance

    def disconnect(self, name: str) -> None:
        """Give up what a model had on ROS; nothing happens where it had nothing."""
        instance = self._instances.pop(name, None)
        self.disconnect_devices(() if instance is None else instance.plugins)

    def connect_devices(self, devices: Sequence[Device], owner: str) -> None:
        """Connect what has outputs and inputs; raises TopicError for a topic that cannot be."""
        for device in devices:
            for entry in (*device.outputs, *device.inputs):
                # rospy would register the topic, and nobody could ever listen to it.
                if not entry.topic or not rosgraph.names.is_legal_name(entry.topic):
                    raise TopicError(f"{owner}: no topic is called '{entry.topic}'")
        for device in devices:
            for output in device.outputs:
                self._connect_output(output)
            for entry in device.inputs:
                self._connect_input(entry)

    def disconnect_devices(self, devices: Sequence[Device]) -> None:
        """Give up what they had on ROS."""
        for device in devices:
            for output in device.outputs:
                self.release(output.topic)
            for entry in device.inputs:
                topic = rospy.resolve_name(entry.topic)
                self._inputs[topic].remove(entry)
                if not self._inputs[topic]:
                    del self._inputs[topic]
                    self._subscribers.pop(topic).unregister()

    def release(self, topic: str) -> None:
        """Give up the publisher on a topic, once all that have asked for it have done so."""
        self._users[topic] -= 1
        if not self._users[topic]:
            del self._users[topic]
            publisher = self._publishers.pop(topic)
            publisher.flush()
            publisher.unregister()

    def subscribe(
        self,
        topic: str,
        kind: type,
        receive: Callable[[Any], None],
        queue_size: Optional[int] = None,
    ) -> None:
        """Listen to a topic, once, whose messages the lock step counts as commands.

        `receive` does what one says, or raises StepperError when the bridge ends. Without a
        `queue_size`, none is dropped.
        """
        topic = rospy.resolve_name(topic)

        def receive_and_count(message: Any) -> None:
            header = message._connection_header
            # What comes as the bridge ends has nothing left to move.
            with contextlib.suppress(StepperError):
                receive(message)
                self.commands.note(Arrival(topic, header["callerid"]), header)

        self._subscribers[topic] = rospy.Subscriber(
            topic, kind, receive_and_count, queue_size=queue_size, tcp_nodelay=True
        )

    def _connect_output(self, output: Output) -> None:
        converter = OUTPUT_CONVERTERS[output.kind]()
        publisher = self.publisher(output.topic, converter.message_kind)
        convert, publish = converter.convert, publisher.publish
        output.connect(lambda sample: publish(convert(sample)), publisher.has_connections)

    def _connect_input(self, entry: Input) -> None:
        topic = rospy.resolve_name(entry.topic)
        if topic in self._inputs:
            self._inputs[topic].append(entry)
            return
        inputs = self._inputs[topic] = [entry]
        converter = INPUT_CONVERTERS[entry.kind]

        def obey(command: Any) -> None:
            self._stepper.do_now(lambda: self._command(topic, inputs, command))

        def receive(message: Any) -> None:
            command, header = converter.convert(message), message._connection_header
            arrival = Arrival(topic, header["callerid"])
            # Out of the way before it could stop what this command starts.
            self._end_timeout(arrival)
            obey(command)
            if COMMAND_TIMEOUT in header and entry.kind is PlanarCommand and command != STANDSTILL:
                self._begin_timeout(arrival, header, lambda: obey(STANDSTILL))

        self.subscribe(topic, converter.message_kind, receive)

    def _begin_timeout(self, arrival: Arrival, header: Any, stop: Callable[[], None]) -> None:
        """Stop a robot whose driver promises further commands, and sends none in time."""

        def end() -> None:
            with contextlib.suppress(StepperError):
                stop()
            rospy.logwarn(
                "%s: no command from %s for %s s: stopped",
                arrival.topic,
                arrival.sender,
                header[COMMAND_TIMEOUT],
            )

        with contextlib.suppress(ValueError, OverflowError):
            timeout = threading.Timer(float(header[COMMAND_TIMEOUT]), end)
            timeout.daemon = True
            self._timeouts[arrival] = timeout
            timeout.start()

    def _end_timeout(self, arrival: Arrival) -> None:
        timeout = self._timeouts.pop(arrival, None)
        if timeout is not None:
            timeout.cancel()

    def _command(self, topic: str, inputs: Sequence[Input], command: Any) -> None:
        for entry in inputs:
            try:
                if entry.alone and self._subscribers[topic].get_num_connections() > 1:
                    raise PluginError("several nodes publish, and one may")
                entry.handle(command)
            except PluginError as error:
                self._refusals.refuse(entry.topic, str(error))


class _Routes:
    """Where messages arrive at the bridge that a node sends to another one.

    Beside the straight way, that is through nodes that publish what has the type of what they
    hear: relays, multiplexers, limiters. The subscribers are those to commands, by topic.
    """

    def __init__(self, subscribers: Mapping[str, rospy.Subscriber]):
        self._subscribers = subscribers
        self._lock = threading.Lock()
        self._known: Dict[Tuple[str, str, str], FrozenSet[Arrival]] = {}
        self._known_for: FrozenSet[Arrival] = frozenset()
        self._looked = -math.inf

    def find(self, member: str, topic: str, receiver: str) -> FrozenSet[Arrival]:
        """Return where arrives what a node sends to another on a topic."""
        if receiver == rospy.get_name():
            return frozenset({Arrival(topic, member)} if topic in self._subscribers else ())
        # Which nodes are connected to which topics of commands.
        inbound = frozenset(
            Arrival(topic, connection.callerid_pub)
            for topic, subscriber in list(self._subscribers.items())
            if subscriber.impl is not None
            for connection in subscriber.impl.connections
        )
        with self._lock:
            if inbound != self._known_for:
                self._known.clear()
                self._known_for = inbound
            if time.monotonic() - self._looked > ROUTES_SECONDS:
                self._looked = time.monotonic()
                self._known = {key: found for key, found in self._known.items() if found}
            key = (member, topic, receiver)
            if key not in self._known:
                self._known[key] = self._search(*key) & inbound
            return self._known[key]

    def _search(self, member: str, topic: str, receiver: str) -> Set[Arrival]:
        master = rosgraph.Master(rospy.get_name())
        try:
            published, subscribed, _ = master.getSystemState()
            kinds = dict(master.getTopicTypes())
        except MASTER_ERRORS:
            return set()
        listeners = dict(subscribed)
        found: Set[Arrival] = set()
        seen, nodes = {member, rospy.get_name()}, [receiver]
        while nodes:
            node = nodes.pop()
            if node in seen:
                continue
            seen.add(node)
            for onward in (name for name, senders in published if node in senders):
                if onward != topic and kinds.get(onward) == kinds.get(topic):
                    found.add(Arrival(onward, node))
                    nodes.extend(listeners.get(onward, ()))
        return found


class RunningWorld:
    """A simulation that runs while services ask about it.

    Attributes:
        stepper: what advances it.
        topics: of its devices.
        simulation: for the thread that steps it.
        models: by name, likewise.
        changed: called, in that thread, after a model was added, taken away or put elsewhere,
            with its name; empty where many were.
    """

    def __init__(self, stepper: Stepper, topics: DeviceTopics):
        self.stepper, self.topics = stepper, topics
        self.simulation: Simulation = stepper.simulation
        self.changed: List[Callable[[str], None]] = []

    @property
    def models(self) -> Mapping[str, ModelInstance]:  # noqa: D102
        return self.simulation.models

    def do(self, action: Callable[[], Any]) -> Any:
        """Have something done between two steps; return what it returns."""
        return self.stepper.do(action)

    def change(self, action: Callable[[], str]) -> None:
        """Have something changed between two steps, and tell those who show the world.

        The action returns the name of the model that it has changed; empty for many.
        """

        def change() -> None:
            name = action()
            for listener in self.changed:
                listener(name)

        self.do(change)


def tf_prefixes(model: Model, namespace: str, name: str = "") -> Callable[[str], str]:
    """Return what gives the tf_prefix for the namespace of each of a model's plugins.

    Those that name none are in `namespace`; `name` is the model's in the world, its own if empty.
    Raises NodeError where no master answers.
    """
    told = (namespace, *(plugin.tags.get(NAMESPACE, "") for plugin in model.plugins))
    spaces = {name or model.name, *(space.strip("/") for space in told)}
    prefixes = {space: search_parameter(TF_PREFIX, space) for space in spaces}
    return lambda space: prefixes.get(space, "")


class _Transport(xmlrpc.client.Transport):
    """Does not wait for ever for a node that hangs."""

    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = ANSWER_SECONDS
        return connection


def answers(node: str) -> bool:
    """Return whether a node is registered with the master and alive."""
    try:
        uri = rosgraph.Master(CALLER).lookupNode(node)
        with xmlrpc.client.ServerProxy(uri, transport=_Transport()) as proxy:
            proxy.getPid(CALLER)
    except MASTER_ERRORS:
        return False
    return True


def refuse_second_simulator() -> None:
    """Raise NodeError if a living node publishes /clock already: nobody else may give the time."""
    publishers, _, _ = rosgraph.Master(CALLER).getSystemState()
    for node in dict(publishers).get("/clock", ()):
        if answers(node):
            raise NodeError(
                f"{node} publishes /clock already: one simulator is enough for a ROS master"
            )
