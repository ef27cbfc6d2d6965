"""A running world that services read and change, and topics about it.

The topics have the shapes of the world as markers, odometry frames and the contacts of robots.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Callable, Mapping

import numpy as np
import rospy
from geometry_msgs.msg import Transform, TransformStamped, Vector3
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.msg import TouchedModels
from bullet_lab.ros.bridge.stepper import Stepper, StepperError
from bullet_lab.ros.bridge.topics import DeviceTopics, TopicError
from bullet_lab.ros.messages.conversions import deleted_markers, world_markers
from bullet_lab.ros.messages.poses import pose_message, set_time
from bullet_lab.ros.node.lock_step import BatchPublisher, Publisher
from bullet_lab.ros.node.node import TF_PREFIX, search_parameter
from bullet_lab.simulation.plugins import NAMESPACE
from bullet_lab.simulation.plugins.mobile_base import MobileBase
from bullet_lab.simulation.simulation import ModelInstance, Simulation
from bullet_lab.simulation.world.description import Model, Plane

MARKERS = "/bullet_lab/world"
# Number and poses of the markers of a model without any.
NOT_DRAWN: tuple[int, list] = (0, [])
# Hz in simulated time, and at most in wall time, of checks whether models have moved.
MARKERS_RATE = 10.0
FRAMES = "/tf_static"
# Within the namespace of the robot.
TOUCHED = "/bullet_lab/touched"
# Hz of checks; a robot that drives into a wall pushes against it for much longer than 10 ms.
TOUCH_RATE = 100.0
# Hz of messages.
TOUCHED_RATE = 10.0


class RunningWorld:
    """A running simulation that services read and change.

    Attributes:
        stepper: advances it.
        topics: of its devices.
        simulation: for the stepper's thread only.
        registrar: registers services in a thread of its own, in turn: the simulation does not
            wait for the master.
        changed: called in that thread after a model was added, removed or moved by a service or
            a reset, with its name; with an empty name after a reset of all models.
    """

    def __init__(self, stepper: Stepper, topics: DeviceTopics):
        self.stepper, self.topics = stepper, topics
        self.simulation: Simulation = stepper.simulation
        self.registrar = ThreadPoolExecutor(1)
        self.changed: list[Callable[[str], None]] = []

    @property
    def models(self) -> Mapping[str, ModelInstance]:
        """Return the models by name, for the stepper's thread only."""
        return self.simulation.models

    def do(self, action: Callable[[], Any]) -> Any:
        """Run an action in the stepper's thread between two steps; return what it returns."""
        return self.stepper.do(action)

    def add(self, model: Model, *place: Any) -> ModelInstance:
        """Add a model as `Simulation.add` does, and connect its topics; raises LabError."""
        instance = self.simulation.add(model, *place)
        try:
            self.connect(instance)
        except (LabError, ValueError, rospy.ROSException) as error:
            self.simulation.remove(instance.name)
            raise TopicError(f"cannot connect its topics: {error}") from error
        return instance

    def connect(self, instance: ModelInstance) -> None:
        """Connect the topics of a model; raises TopicError."""
        self.topics.connect(instance.plugins, f"model '{instance.name}'")

    def notify(self, name: str) -> None:
        """Call all listeners after a model was changed, or all models with an empty name."""
        for listener in self.changed:
            listener(name)

    def follow(self, begin: Callable[[ModelInstance], Callable[[], Any]]) -> None:
        """Call `begin` with each model, now and when it is added.

        What it returns is called when the model is removed.
        """
        ends: dict[str, Callable[[], Any]] = {}

        def update(_name: str) -> None:
            for name in ends.keys() - self.models.keys():
                ends.pop(name)()
            for name in [name for name in self.models if name not in ends]:
                ends[name] = begin(self.models[name])

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


class PresentState(rospy.SubscribeListener):
    """Sends the present state of the world, as `message` returns it, to each new subscriber."""

    def __init__(self, world: RunningWorld, message: Callable[[], Any]):
        super().__init__()
        self._world, self._message = world, message

    def peer_subscribe(
        self, _topic: str, _publish: Callable[[Any], None], peer_publish: Callable[[Any], None]
    ) -> None:
        """Send the message; called by rospy."""
        # In the thread of the simulation, which writes all other messages to this subscriber.
        # While the bridge shuts down, nothing is sent.
        with contextlib.suppress(StepperError, rospy.ROSException):
            self._world.do(lambda: peer_publish(self._message()))


class WorldMarkers:
    """Publishes the shapes of the world as markers on /bullet_lab/world.

    A new subscriber receives all markers, and then those that change: models that are added,
    removed or moved by a service at once, moving models a few times a second. The model `hidden`
    has no markers.
    """

    def __init__(self, world: RunningWorld, frame: str, hidden: str):
        self._world = world
        self._frame = frame
        self._hidden = hidden
        # The number of markers of each model, and the poses of its links.
        self._drawn: dict[str, tuple[int, list]] = {}
        self._checked = 0.0
        world.changed.append(self._changed)
        world.simulation.every(MARKERS_RATE, self._check)
        listener = PresentState(world, lambda: MarkerArray(self._draw(*self._world.models)))
        self._publisher = Publisher(
            MARKERS, MarkerArray, queue_size=100, subscriber_listener=listener
        )

    def _changed(self, name: str) -> None:
        if self._publisher.has_connections():
            names = [name] if name else self._world.models
            self._publisher.publish(self._draw(*names))

    def _draw(self, *names: str) -> list[Marker]:
        """Return the markers of models; for one that was removed, markers that delete them."""
        markers: list[Marker] = []
        for name in names:
            if name == self._hidden:
                continue
            before, count = self._drawn.pop(name, NOT_DRAWN)[0], 0
            if name in self._world.models:
                instance = self._world.models[name]
                shapes = world_markers(instance, self._frame)
                count = len(shapes)
                self._drawn[name] = (count, _link_poses(instance))
                markers += shapes
            # A new model of the same name may have fewer shapes.
            markers += deleted_markers(name, range(count, before), self._frame)
        return markers

    def _check(self, _step: int) -> None:
        """Publish the markers of models that have moved."""
        now = time.monotonic()
        if not self._publisher.has_connections() or now - self._checked < 1.0 / MARKERS_RATE:
            return
        self._checked = now
        moved = [
            name
            for name, instance in self._world.models.items()
            if not instance.model.static
            and self._drawn.get(name, NOT_DRAWN)[1] != _link_poses(instance)
        ]
        markers = self._draw(*moved)
        if markers:
            self._publisher.publish(markers)


def _link_poses(instance: ModelInstance) -> list:
    """Return the poses of the visible links, rounded to 0.1 mm."""
    poses = (instance.frame(link.name).pose() for link in instance.model.links if link.visuals)
    return [np.round((*pose.position, *pose.quaternion), 4).tolist() for pose in poses]


class OdometryFrames:
    """Publishes the poses of all odometry frames in the world on /tf_static.

    Warns if two robots have the same odometry frame: on TF, each would be where the other is.
    Without a name for the world's frame, nothing is published.
    """

    def __init__(self, world: RunningWorld, frame: str):
        self._world = world
        self._frame = frame
        # Names of robots with the names and poses of their frames.
        self._frames: list[tuple[str, str, Pose]] = []
        # Frames that were warned about.
        self._shared: set[str] = set()
        # The latched message holds all frames: a later subscriber receives no other.
        self._publisher = Publisher(FRAMES, TFMessage, queue_size=10, latch=True) if frame else None
        world.changed.append(self._changed)
        self._changed("")

    def _changed(self, _name: str) -> None:
        """Publish the frames if they have changed with a model."""
        frames = [
            (name, device.frames[0], getattr(device, "origin", Pose()))
            for name, instance in self._world.models.items()
            for device in instance.plugins
            if isinstance(device, MobileBase)
        ]
        if frames != self._frames:
            self._frames = frames
            self._warn()
            self._publish()

    def _warn(self) -> None:
        """Warn about frames that two robots share, once for each frame."""
        owners: dict[str, str] = {}
        for model, frame, _ in self._frames:
            first = owners.setdefault(frame, model)
            if first != model and frame not in self._shared:
                self._shared.add(frame)
                line = "the frame '%s' belongs to '%s' and '%s': give each robot a tf_prefix in "
                rospy.logwarn(f"{line}its namespace", frame, first, model)

    def _publish(self) -> None:
        if self._publisher is None:
            return
        message = TFMessage()
        for frame, pose in sorted({frame: pose for _, frame, pose in self._frames}.items()):
            if frame != self._frame:
                rotation = pose_message(pose).orientation
                transform = TransformStamped(transform=Transform(Vector3(*pose.position), rotation))
                transform.header.frame_id, transform.child_frame_id = self._frame, frame
                message.transforms.append(transform)
        self._publisher.publish(message)


@dataclass
class _Touches:
    """The models that a robot touches now, and how often it has touched which so far."""

    publisher: BatchPublisher
    touching: frozenset[str] = frozenset()
    counts: Counter = field(default_factory=Counter)


class TouchCounter:
    """Counts the models, except for the floor, that robots touch while somebody subscribes.

    A robot is a model with inputs. It has the topic /bullet_lab/touched in its namespace.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._floors = frozenset(
            model.name
            for model in world.simulation.world.models
            for link in model.links
            if any(isinstance(shape.geometry, Plane) for shape in link.collisions)
        )
        self._robots: dict[str, _Touches] = {}
        self._last_step = 0
        world.simulation.every(TOUCH_RATE, self._check)
        world.simulation.every(TOUCHED_RATE, self._send)
        world.follow(self._begin)

    def _begin(self, instance: ModelInstance) -> Callable[[], None]:
        topics, ends = self._world.topics, contextlib.ExitStack()
        devices = [device for device in instance.plugins if device.inputs]
        if devices:
            namespace = devices[0].mount.namespace
            topic = f"/{namespace}{TOUCHED}" if namespace else TOUCHED
            self._robots[instance.name] = _Touches(topics.publisher(topic, TouchedModels))
            ends.callback(topics.release, topic)
            ends.callback(self._robots.pop, instance.name)
        return ends.close

    def _check(self, step: int) -> None:
        was_reset = step < self._last_step
        self._last_step = step
        for name, robot in self._robots.items():
            if not robot.publisher.has_connections():
                continue
            if was_reset:
                robot.touching = frozenset()
                robot.counts.clear()
            touching = frozenset(self._world.simulation.contacts(name)) - self._floors
            robot.counts.update(touching - robot.touching)
            robot.touching = touching

    def _send(self, step: int) -> None:
        for name, robot in self._robots.items():
            if robot.publisher.has_connections():
                models = sorted(robot.counts)
                touches = [robot.counts[model] for model in models]
                message = TouchedModels(robot=name, models=models, touches=touches)
                set_time(message.header.stamp, step)
                robot.publisher.publish(message)
