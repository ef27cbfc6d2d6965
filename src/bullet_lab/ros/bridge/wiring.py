"""Wires what devices send and take to ROS topics, model by model."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import Any, Dict, List

import rosgraph.names
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.stepper import Stepper, StepperError
from bullet_lab.ros.messages.conversions import INPUT_CONVERTERS, OUTPUT_CONVERTERS
from bullet_lab.ros.node.node import Refusals
from bullet_lab.ros.node.publishers import BatchPublisher, lossless_publisher
from bullet_lab.simulation.plugins import DeviceError, Input, Output
from bullet_lab.simulation.simulation import ModelInstance

# Messages that wait for a slow subscriber while time follows the wall clock.
QUEUE_SIZE = 100


@dataclass
class _Wires:
    """What one model has on ROS."""

    topics: List[str] = field(default_factory=list)
    subscribers: List[rospy.Subscriber] = field(default_factory=list)


class WiringError(LabError):
    """A device names a topic that cannot be."""


class Wiring:
    """Publishes the samples of models' devices and hands them commands.

    Topics that several devices speak on, such as /tf, have one publisher. All methods but those
    that rospy calls belong to the thread that steps the simulation.

    Args:
        stepper: what advances the simulation.
    """

    def __init__(self, stepper: Stepper):
        self._stepper = stepper
        self._refusals = Refusals()
        self._publishers: Dict[str, BatchPublisher] = {}
        self._users: Dict[str, int] = {}
        self._wires: Dict[str, _Wires] = {}

    def publisher(self, topic: str, kind: type) -> BatchPublisher:
        """Return the publisher on a topic, one that fits the pace.

        At full speed nothing may be lost, so the simulation waits for its subscribers. Tied to
        the wall clock it does not wait for anybody, as Gazebo does not. A pace that changes later
        on is followed by `flush`.
        """
        publisher = self._publishers.get(topic)
        if publisher is None:
            if self._stepper.pace.free:
                publisher = lossless_publisher(topic, kind, publisher=BatchPublisher)
            else:
                publisher = BatchPublisher(topic, kind, queue_size=QUEUE_SIZE, tcp_nodelay=True)
            self._publishers[topic] = publisher
        self._users[topic] = self._users.get(topic, 0) + 1
        return publisher

    def flush(self) -> None:
        """Write out what the last steps have brought."""
        lossless = self._stepper.hurried
        for publisher in self._publishers.values():
            publisher.flush(lossless)

    def connect(self, instance: ModelInstance) -> None:
        """Wire all devices of a model; raises WiringError for a topic that cannot be."""
        _check_topics(instance)
        wires = self._wires.setdefault(instance.name, _Wires())
        for device in instance.devices:
            for output in device.outputs:
                self._connect_output(output)
                wires.topics.append(output.topic)
            for entry in device.inputs:
                wires.subscribers.append(self._subscriber(entry))

    def disconnect(self, name: str) -> None:
        """Give up what a model had on ROS; nothing happens where it had nothing."""
        wires = self._wires.pop(name, _Wires())
        for subscriber in wires.subscribers:
            subscriber.unregister()
        for topic in wires.topics:
            self.release(topic)

    def release(self, topic: str) -> None:
        """Give up the publisher on a topic, once all that have asked for it have done so."""
        self._users[topic] -= 1
        if not self._users[topic]:
            del self._users[topic]
            publisher = self._publishers.pop(topic)
            publisher.flush()
            publisher.unregister()

    def _connect_output(self, output: Output) -> None:
        converter = OUTPUT_CONVERTERS[output.kind]()
        publisher = self.publisher(output.topic, converter.message_kind)
        convert, publish = converter.convert, publisher.publish
        output.connect(lambda sample: publish(convert(sample)), publisher.has_connections)

    def _subscriber(self, entry: Input) -> rospy.Subscriber:
        converter = INPUT_CONVERTERS[entry.kind]

        def receive(message: Any) -> None:
            command = converter.convert(message)
            # A command that comes as the bridge ends has nothing left to move.
            with contextlib.suppress(StepperError):
                self._stepper.do_now(lambda: self._command(entry, command))
                self._stepper.note_command(message._connection_header["callerid"])

        return rospy.Subscriber(entry.topic, converter.message_kind, receive, tcp_nodelay=True)

    def _command(self, entry: Input, command: Any) -> None:
        try:
            entry.handle(command)
        except DeviceError as error:
            self._refusals.refuse(entry.topic, str(error))


def _check_topics(instance: ModelInstance) -> None:
    # rospy would register the topic, and nobody could ever listen to it.
    for device in instance.devices:
        for entry in (*device.outputs, *device.inputs):
            if not entry.topic or not rosgraph.names.is_legal_name(entry.topic):
                raise WiringError(f"model '{instance.name}': no topic is called '{entry.topic}'")
