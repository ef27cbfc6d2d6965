"""Topics about the world: markers, odometry frames and the contacts of robots."""

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
# Hz in simulated time, and at most in wall time, of checks whether models have moved.
MARKERS_RATE = 10.0
FRAMES = "/tf_static"
# Within the namespace of the robot.
TOUCHED = "/bullet_lab/touched"
# Hz of checks; a robot that drives into a wall pushes against it for much longer than 10 ms.
TOUCH_RATE = 100.0
# Hz of messages.
TOUCHED_RATE = 10.0


class PresentState(rospy.SubscribeListener):
    """Sends the present state of the world to each new subscriber of a topic.

    Args:
        world: the running world.
        message: makes the message with the state.
    """

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

    def __init__(self, world: RunningWorld, frame: str, hidden: str = ""):
        self._world = world
        self._frame = frame
        self._hidden = hidden
        self._counts: Dict[str, int] = {}
        self._poses: Dict[str, list] = {}
        self._checked = 0.0
        world.changed.append(self._changed)
        world.simulation.every(MARKERS_RATE, self._check)
        listener = PresentState(world, self._all)
        self._publisher = Publisher(
            MARKERS, MarkerArray, queue_size=100, subscriber_listener=listener
        )

    def _all(self) -> MarkerArray:
        array = MarkerArray()
        for name in self._world.models:
            array.markers.extend(self._draw(name).markers)
        return array

    def _changed(self, name: str) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(self._draw(name) if name else self._all())

    def _draw(self, name: str) -> MarkerArray:
        """Return the markers of a model; if it was removed, markers that delete them."""
        instance = self._world.models.get(name)
        if name == self._hidden:
            return MarkerArray()
        if instance is None:
            self._poses.pop(name, None)
            return deleted_markers(name, self._counts.pop(name, 0), self._frame)
        array = world_markers([instance], self._frame)
        # A new model of the same name may have fewer shapes.
        before, count = self._counts.get(name, 0), len(array.markers)
        if count < before:
            array.markers.extend(deleted_markers(name, before, self._frame).markers[count:])
        self._counts[name] = count
        self._poses[name] = _link_poses(instance)
        return array

    def _check(self, _step: int) -> None:
        """Publish the markers of models that have moved."""
        now = time.monotonic()
        if not self._publisher.has_connections() or now - self._checked < 1.0 / MARKERS_RATE:
            return
        self._checked = now
        moved = MarkerArray()
        for name, instance in self._world.models.items():
            if not instance.model.static and self._poses.get(name) != _link_poses(instance):
                moved.markers.extend(self._draw(name).markers)
        if moved.markers:
            self._publisher.publish(moved)


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
        self._poses: Dict[str, Dict[str, Pose]] = {}
        # Frames that were warned about.
        self._shared: Set[str] = set()
        # The latched message holds all frames: a later subscriber receives no other.
        self._publisher = Publisher(FRAMES, TFMessage, queue_size=10, latch=True) if frame else None
        world.changed.append(self._changed)
        self._changed("")

    def _changed(self, name: str) -> None:
        """Publish the frames after a change of a model, or of all models with an empty name."""
        before = dict(self._poses)
        for model in [name] if name else {*self._world.models, *self._poses}:
            poses = _frame_poses(self._world.models.get(model))
            if poses:
                self._poses[model] = poses
            else:
                self._poses.pop(model, None)
        if self._poses != before:
            self._warn()
            self._publish()

    def _warn(self) -> None:
        """Warn about frames that two robots share, once for each frame."""
        owners: Dict[str, str] = {}
        for model, poses in self._poses.items():
            for frame in poses:
                first = owners.setdefault(frame, model)
                if first != model and frame not in self._shared:
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
        found = {frame: pose for poses in self._poses.values() for frame, pose in poses.items()}
        message = TFMessage()
        for frame, pose in sorted(found.items()):
            if frame != self._frame:
                rotation = pose_message(pose).orientation
                transform = TransformStamped(transform=Transform(Vector3(*pose.position), rotation))
                transform.header.frame_id, transform.child_frame_id = self._frame, frame
                message.transforms.append(transform)
        self._publisher.publish(message)


def _frame_poses(instance: Optional[ModelInstance]) -> Dict[str, Pose]:
    """Return the poses of a model's odometry frames; empty for a model that was removed."""
    return {
        device.frame: getattr(device, "origin", Pose())
        for device in (() if instance is None else instance.plugins)
        if any(output.kind is OdometrySample for output in device.outputs)
    }


@dataclass
class _Touches:
    """The models that a robot touches now, and how often it has touched which so far."""

    publisher: BatchPublisher
    topic: str
    touching: FrozenSet[str] = frozenset()
    counts: Counter = field(default_factory=Counter)


class TouchCounter:
    """Counts the models, except for the floor, that robots touch while somebody subscribes.

    A robot is a model with inputs. It has the topic /bullet_lab/touched in its namespace.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._floors = frozenset(
            model.name for model in world.simulation.world.models if _is_floor(model)
        )
        self._robots: Dict[str, _Touches] = {}
        self._last_step = 0
        world.simulation.every(TOUCH_RATE, self._check)
        world.simulation.every(TOUCHED_RATE, self._send)
        world.follow(self._begin, self._end)

    def _begin(self, instance: ModelInstance) -> None:
        devices = [device for device in instance.plugins if device.inputs]
        if devices:
            namespace = devices[0].mount.namespace
            topic = f"/{namespace}{TOUCHED}" if namespace else TOUCHED
            publisher = self._world.topics.publisher(topic, TouchedModels)
            self._robots[instance.name] = _Touches(publisher, topic)

    def _end(self, model: str) -> None:
        robot = self._robots.pop(model, None)
        if robot is not None:
            self._world.topics.release(robot.topic)

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


def _is_floor(model: Model) -> bool:
    shapes = [collision.geometry for link in model.links for collision in link.collisions]
    return any(isinstance(shape, Plane) for shape in shapes)
