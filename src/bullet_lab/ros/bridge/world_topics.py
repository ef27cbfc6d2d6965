"""What the bridge tells of its world: markers, odometry frames and what robots run into."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, FrozenSet, Optional, Set

import numpy as np
import rospy
from geometry_msgs.msg import Transform, TransformStamped, Vector3
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.pose import Pose
from bullet_lab.msg import TouchedModels
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.messages.poses import pose_message, set_time
from bullet_lab.ros.messages.world import deleted_markers, world_markers
from bullet_lab.ros.node.publishers import BatchPublisher, Publisher
from bullet_lab.simulation.plugins.samples import OdometrySample
from bullet_lab.simulation.simulation import ModelInstance
from bullet_lab.simulation.world.description import Model, Plane

MARKERS = "/bullet_lab/world"
# Hz; looks at the models that may move, per second of simulated and of wall time at most.
MARKERS_RATE = 10.0


class WorldMarkers(rospy.SubscribeListener):
    """Keeps the markers on /bullet_lab/world with the world.

    Whoever subscribes gets all markers, and from then on those that change: models that come, go
    or are put elsewhere at once, models that move a few times a second.

    The model `hidden` is drawn by somebody else.
    """

    def __init__(self, world: RunningWorld, frame: str, hidden: str = ""):
        super().__init__()
        self._world = world
        self._frame = frame
        self._hidden = hidden
        self._counts: Dict[str, int] = {}
        self._places: Dict[str, list] = {}
        self._looked = 0.0
        world.changed.append(self._changed)
        world.simulation.every(MARKERS_RATE, self._look)
        self._publisher = Publisher(MARKERS, MarkerArray, queue_size=100, subscriber_listener=self)

    def peer_subscribe(
        self, _topic: str, _publish: Callable[[Any], None], peer_publish: Callable[[Any], None]
    ) -> None:
        """Draw everything for a new subscriber."""
        # A bridge that ends has nothing more to show.
        with contextlib.suppress(StepperError, rospy.ROSException):
            self._world.do(lambda: peer_publish(self._all()))

    def _all(self) -> MarkerArray:
        array = MarkerArray()
        for name in self._world.models:
            array.markers.extend(self._draw(name).markers)
        return array

    def _changed(self, name: str) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(self._draw(name) if name else self._all())

    def _draw(self, name: str) -> MarkerArray:
        """Return the markers of a model, or what takes them away if it is gone."""
        instance = self._world.models.get(name)
        if name == self._hidden:
            return MarkerArray()
        if instance is None:
            self._places.pop(name, None)
            return deleted_markers(name, self._counts.pop(name, 0), self._frame)
        array = world_markers([instance], self._frame)
        # A successor of the same name may have fewer shapes.
        before, count = self._counts.get(name, 0), len(array.markers)
        if count < before:
            array.markers.extend(deleted_markers(name, before, self._frame).markers[count:])
        self._counts[name] = count
        self._places[name] = _places_of_links(instance)
        return array

    def _look(self, _step: Optional[int] = None) -> None:
        """Draw anew what has moved."""
        now = time.monotonic()
        if not self._publisher.has_connections() or now - self._looked < 1.0 / MARKERS_RATE:
            return
        self._looked = now
        moved = MarkerArray()
        for name, instance in self._world.models.items():
            if not instance.model.static and self._places.get(name) != _places_of_links(instance):
                moved.markers.extend(self._draw(name).markers)
        if moved.markers:
            self._publisher.publish(moved)


def _places_of_links(instance: ModelInstance) -> list:
    """Return where the seen links are, to a tenth of a millimetre or so."""
    poses = (instance.frame(link.name).pose() for link in instance.model.links if link.visuals)
    return [np.round((*pose.position, *pose.quaternion), 4).tolist() for pose in poses]


FRAMES = "/tf_static"


class OdometryFrames:
    """Says on /tf_static how the odometry frames of all robots lie in the world.

    Two robots with one name for their odometry frame are warned about: on TF, each would be
    where the other is. Without a name for the world's frame, nothing is published.
    """

    def __init__(self, world: RunningWorld, frame: str):
        self._world = world
        self._frame = frame
        self._places: Dict[str, Dict[str, Pose]] = {}
        self._shared: Set[str] = set()
        # The last message holds all frames, since subscribers that come later get no other.
        self._publisher = Publisher(FRAMES, TFMessage, queue_size=10, latch=True) if frame else None
        world.changed.append(self._changed)
        self._changed("")

    def _changed(self, name: str) -> None:
        """Say where the frames of a model are, or those of all with an empty name."""
        before = dict(self._places)
        for model in [name] if name else {*self._world.models, *self._places}:
            places = _places_of_frames(self._world.models.get(model))
            if places:
                self._places[model] = places
            else:
                self._places.pop(model, None)
        if self._places != before:
            self._warn(set(self._places) - set(before))
            self._publish()

    def _warn(self, newcomers: Set[str]) -> None:
        """Name the first two robots that claim a frame, once for each frame."""
        owners: Dict[str, str] = {}
        for model, places in self._places.items():
            for frame in places:
                first = owners.setdefault(frame, model)
                if first != model and model in newcomers and frame not in self._shared:
                    self._shared.add(frame)
                    rospy.logwarn(
                        "the frame '%s' belongs to '%s' and '%s': give each robot a tf_prefix in "
                        "its namespace",
                        frame,
                        first,
                        model,
                    )

    def _publish(self) -> None:
        if self._publisher is None:
            return
        found = {frame: pose for places in self._places.values() for frame, pose in places.items()}
        message = TFMessage()
        for frame, pose in sorted(found.items()):
            if frame != self._frame:
                turn = pose_message(pose).orientation
                transform = TransformStamped(transform=Transform(Vector3(*pose.position), turn))
                transform.header.frame_id, transform.child_frame_id = self._frame, frame
                message.transforms.append(transform)
        self._publisher.publish(message)


def _places_of_frames(instance: Optional[ModelInstance]) -> Dict[str, Pose]:
    """Return the odometry frames of a model and where they are; none for a model that is gone."""
    return {
        device.frame: getattr(device, "origin", Pose())
        for device in (() if instance is None else instance.plugins)
        if any(output.kind is OdometrySample for output in device.outputs)
    }


# Within the namespace of the robot.
TOUCHED = "/bullet_lab/touched"
# Hz of looking: a robot that drives into a wall pushes against it for much longer.
TOUCH_RATE = 100.0
TOUCHED_RATE = 10.0


@dataclass
class _Watched:
    """A robot that is watched, and what it has touched so far."""

    publisher: BatchPublisher
    topic: str
    touching: FrozenSet[str] = frozenset()
    counts: Counter = field(default_factory=Counter)


class TouchCounter:
    """Watches the robots that somebody listens to, and says what they touch beside the floor.

    A robot is what takes commands; the topic is /bullet_lab/touched in its namespace.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._floors = frozenset(
            model.name for model in world.simulation.world.models if _is_floor(model)
        )
        self._watched: Dict[str, _Watched] = {}
        self._last_step = 0
        world.simulation.every(TOUCH_RATE, self._look)
        world.simulation.every(TOUCHED_RATE, self._send)
        world.changed.append(self._changed)
        self._changed("")

    def _changed(self, name: str) -> None:
        """Begin or end to watch a model, or all with an empty name."""
        for model in [name] if name else {*self._world.models, *self._watched}:
            instance = self._world.models.get(model)
            devices = [d for d in (instance.plugins if instance else ()) if d.inputs]
            if devices and model not in self._watched:
                namespace = devices[0].mount.namespace
                topic = f"/{namespace}{TOUCHED}" if namespace else TOUCHED
                publisher = self._world.topics.publisher(topic, TouchedModels)
                self._watched[model] = _Watched(publisher, topic)
            elif not devices and model in self._watched:
                self._world.topics.release(self._watched.pop(model).topic)

    def _look(self, step: int) -> None:
        again = step < self._last_step
        self._last_step = step
        for name, robot in self._watched.items():
            if not robot.publisher.has_connections():
                continue
            if again:
                robot.touching = frozenset()
                robot.counts.clear()
            touching: Set[str] = set(self._world.simulation.contacts(name)) - self._floors
            robot.counts.update(touching - robot.touching)
            robot.touching = frozenset(touching)

    def _send(self, step: int) -> None:
        for name, robot in self._watched.items():
            if robot.publisher.has_connections():
                models = sorted(robot.counts)
                touches = [robot.counts[model] for model in models]
                message = TouchedModels(robot=name, models=models, touches=touches)
                set_time(message.header.stamp, step)
                robot.publisher.publish(message)


def _is_floor(model: Model) -> bool:
    shapes = [collision.geometry for link in model.links for collision in link.collisions]
    return any(isinstance(shape, Plane) for shape in shapes)
