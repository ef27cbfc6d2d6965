"""A simulation that runs on ROS: the topics of its devices, and changes by services."""

from __future__ import annotations

import contextlib
import threading
import xmlrpc.client
from collections import Counter
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Set, Union

import rosgraph
import rosgraph.names
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.commands import Arrival, CommandCounter, RouteFinder
from bullet_lab.ros.bridge.stepper import Stepper, StepperError
from bullet_lab.ros.messages.conversions import INPUT_CONVERTERS, OUTPUT_CONVERTERS
from bullet_lab.ros.node.node import (
    MASTER_ERRORS,
    TF_PREFIX,
    NodeError,
    Refusals,
    search_parameter,
)
from bullet_lab.ros.node.publishers import COMMAND_TIMEOUT, BatchPublisher
from bullet_lab.simulation.plugins import NAMESPACE, Input, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.controllers.controller import Controller
from bullet_lab.simulation.plugins.samples import STANDSTILL, PlanarCommand
from bullet_lab.simulation.simulation import ModelInstance, Simulation
from bullet_lab.simulation.world.description import Model

# Messages that wait for a slow subscriber while time follows the wall clock.
QUEUE_SIZE = 100
CALLER = "/bullet_lab"
# Wall seconds within which a node that is alive answers.
ANSWER_SECONDS = 5.0

# Anything with outputs and inputs.
Device = Union[Plugin, Controller]


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
        self._refusals = Refusals()
        self._publishers: Dict[str, BatchPublisher] = {}
        self._users: Counter = Counter()
        self._inputs: Dict[str, List[Input]] = {}
        self._subscribers: Dict[str, rospy.Subscriber] = {}
        self._timeouts: Dict[Arrival, threading.Timer] = {}
        self.commands = CommandCounter(RouteFinder(self._subscribers).find)

    def publisher(self, topic: str, kind: type) -> BatchPublisher:
        """Return the publisher on a topic.

        At full speed no message is lost: the simulation waits for slow subscribers. Tied to the
        wall clock, it does not wait, as Gazebo does not. `flush` follows changes of the speed.
        """
        publisher = self._publishers.get(topic)
        if publisher is None:
            size = None if self._stepper.pace.free else QUEUE_SIZE
            publisher = BatchPublisher(topic, kind, queue_size=size, tcp_nodelay=True)
            self._publishers[topic] = publisher
        self._users[topic] += 1
        return publisher

    def flush(self) -> None:
        """Send the messages of the last steps."""
        lossless = self._stepper.lossless
        for publisher in self._publishers.values():
            publisher.flush(lossless)

    def connect(self, instance: ModelInstance) -> None:
        """Connect all plugins of a model; raises TopicError."""
        self.connect_devices(instance.plugins, f"model '{instance.name}'")

    def connect_devices(self, devices: Sequence[Device], owner: str) -> None:
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

    def disconnect_devices(self, devices: Sequence[Device]) -> None:
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

    def release(self, topic: str) -> None:
        """Release the publisher on a topic; it is closed when all its users have released it."""
        self._users[topic] -= 1
        if not self._users[topic]:
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

        def execute(command: Any) -> None:
            self._stepper.do_now(lambda: self._command(topic, inputs, command))

        def receive(message: Any) -> None:
            command, header = converter.convert(message), message._connection_header
            arrival = Arrival(topic, header["callerid"])
            # Before the command, or the earlier timeout could stop the robot after it.
            timeout = self._timeouts.pop(arrival, None)
            if timeout is not None:
                timeout.cancel()
            execute(command)
            if COMMAND_TIMEOUT in header and entry.kind is PlanarCommand and command != STANDSTILL:
                self._begin_timeout(arrival, header, lambda: execute(STANDSTILL))

        self.subscribe(topic, converter.message_kind, receive)

    def _begin_timeout(self, arrival: Arrival, header: Any, stop: Callable[[], None]) -> None:
        """Stop a robot if no further command arrives within the timeout of its publisher."""

        def end() -> None:
            with contextlib.suppress(StepperError):
                stop()
            rospy.logwarn(
                "%s: no command from %s for %s s; robot stopped",
                arrival.topic,
                arrival.sender,
                header[COMMAND_TIMEOUT],
            )

        with contextlib.suppress(ValueError, OverflowError):
            timeout = threading.Timer(float(header[COMMAND_TIMEOUT]), end)
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


class RunningWorld:
    """A running simulation that services read and change.

    Attributes:
        stepper: advances it.
        topics: of its devices.
        simulation: for the stepper's thread only.
        changed: called in that thread after a model was added, removed or moved by a service or
            a reset, with its name; with an empty name after a reset of all models.
    """

    def __init__(self, stepper: Stepper, topics: DeviceTopics):
        self.stepper, self.topics = stepper, topics
        self.simulation: Simulation = stepper.simulation
        self.changed: List[Callable[[str], None]] = []

    @property
    def models(self) -> Mapping[str, ModelInstance]:
        """Return the models by name, for the stepper's thread only."""
        return self.simulation.models

    def do(self, action: Callable[[], Any]) -> Any:
        """Run an action in the stepper's thread between two steps; return what it returns."""
        return self.stepper.do(action)

    def notify(self, name: str) -> None:
        """Call all listeners after a model was changed, or all models with an empty name."""
        for listener in self.changed:
            listener(name)

    def follow(self, begin: Callable[[ModelInstance], None], end: Callable[[str], None]) -> None:
        """Call `begin` with each model, now and when it is added, and `end` when it is removed."""
        known: Set[str] = set()

        def update(_name: str) -> None:
            for name in known - self.models.keys():
                known.remove(name)
                end(name)
            for name in [name for name in self.models if name not in known]:
                known.add(name)
                begin(self.models[name])

        self.changed.append(update)
        update("")


def tf_prefixes(model: Model, namespace: str, name: str = "") -> Callable[[str], str]:
    """Return a function that returns the tf_prefix for the namespace of a model's plugin.

    Plugins without a namespace are in `namespace`; `name` is the model's name in the world, by
    default that in its description. Raises NodeError if no master answers.
    """
    named = (namespace, *(plugin.tags.get(NAMESPACE, "") for plugin in model.plugins))
    spaces = {name or model.name, *(space.strip("/") for space in named)}
    prefixes = {space: search_parameter(TF_PREFIX, space) for space in spaces}
    return lambda space: prefixes.get(space, "")


class _Transport(xmlrpc.client.Transport):
    """Has a timeout, for nodes that do not answer."""

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
    """Raise NodeError if another node publishes /clock and is alive."""
    publishers, _, _ = rosgraph.Master(CALLER).getSystemState()
    for node in dict(publishers).get("/clock", ()):
        if answers(node):
            raise NodeError(
                f"{node} publishes /clock already; a ROS master can have only one simulator"
            )
