"""All services and topics of Gazebo, and the services and topics that describe the whole world.

The latter are /bullet_lab/save_world, /bullet_lab/describe_models, /gazebo/model_states,
/gazebo/link_states and /gazebo/performance_metrics.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Callable, Iterator

import numpy as np
import rospy
from geometry_msgs.msg import Point
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from bullet_lab.core.files import FileError, place_within, replace_file
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.msg import ModelDescription, PluginDescription
from bullet_lab.ros.bridge.running_world import PresentState, RunningWorld, WorldMarkers
from bullet_lab.ros.gazebo.devices import DeviceServices
from bullet_lab.ros.gazebo.physics import GazeboPhysics
from bullet_lab.ros.gazebo.services import Answer, offer, offer_services, subscribe_to_states
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.images import image_message
from bullet_lab.ros.messages.poses import (
    InputError,
    pose_message,
    set_time,
    time_of,
    twist_message,
)
from bullet_lab.simulation.models import (
    Entity,
    ModelInstance,
    bounds,
    find_model,
    link_entities,
    model_entity,
)
from bullet_lab.simulation.plugins import Plugin
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.simulation import take_picture
from bullet_lab.simulation.video import overview
from bullet_lab.simulation.world.description import PluginTag
from bullet_lab.simulation.world.sdf_writer import world_text
from bullet_lab.srv import DescribeModels, SaveWorld

# Hz of checks in simulated time, and of messages in wall time, of /gazebo/performance_metrics.
PERFORMANCE_CHECK_RATE = 100.0
PERFORMANCE_RATE = 5.0
MOST_WARNINGS = 1000
# z of the normal of the steepest ground that a robot stands on (60°); a wall is steeper.
STEEPEST = 0.5
# m around a model in its picture.
PICTURE_MARGIN = 0.1


class WorldSaver:
    """Offers /bullet_lab/save_world; the simulation is held up only while it is copied.

    The bridge writes in one folder and below only. To save a file elsewhere, a client requests
    the text and writes it itself, as `save_world.py` does.
    """

    def __init__(self, world: RunningWorld, folder: Path):
        self._world = world
        self._folder = folder.expanduser().resolve()
        self._lock = threading.Lock()
        offer("/bullet_lab/save_world", SaveWorld, self._save)

    def _save(self, request: Any) -> Answer:
        start = time.perf_counter()
        if not request.path or "\0" in request.path:
            raise InputError("no file is named")
        try:
            path = self._place(request)
            # One at a time: the file of the later request replaces that of the earlier one.
            with self._lock:
                snapshot = self._world.do(self._world.simulation.snapshot)
                text, notes = world_text(snapshot, path.parent)
                if not request.return_text:
                    replace_file(path, lambda part: part.write_text(text, encoding="utf-8"))
        except (OSError, RuntimeError) as error:
            # pathlib raises them for names that are too long and for circular links.
            raise LabError(error) from error
        return {
            "status_message": "; ".join(notes),
            "path": str(path),
            "text": text if request.return_text else "",
            "models": len(snapshot.models),
            "saved_at": time_of(snapshot.step),
            "seconds": time.perf_counter() - start,
        }

    def _place(self, request: Any) -> Path:
        if request.return_text:
            return self._folder / request.path
        try:
            return place_within(self._folder, request.path)
        except FileError as error:
            hint = "~save_folder is the bridge's; save_world.py writes anywhere"
            raise InputError(f"{error}; {hint}") from error


class _States:
    """Publishes the poses and twists of entities, `rate` times per simulated second.

    A new subscriber receives the present states at once, and all subscribers do when a model was
    added, removed or moved by a service: so the topic is up to date while time is paused, too.
    """

    def __init__(
        self,
        world: RunningWorld,
        topic: str,
        kind: type,
        entities: Callable[[ModelInstance], dict[str, Entity]],
        rate: float,
    ):
        self._world = world
        self._kind = kind
        self._entities = entities
        self._publisher = world.topics.publisher(topic, kind)
        self._publisher.impl.add_subscriber_listener(PresentState(world, self._message))
        world.changed.append(self._changed)
        world.simulation.every(rate, self._publish)

    def _publish(self, _step: int = 0) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(self._message())

    def _changed(self, _name: str) -> None:
        self._publish()
        self._publisher.flush()

    def _message(self) -> Any:
        message = self._kind()
        for instance in self._world.models.values():
            for name, entity in self._entities(instance).items():
                state = entity.state()
                message.name.append(name)
                message.pose.append(pose_message(state.pose))
                message.twist.append(twist_message(state))
        return message


def _model(instance: ModelInstance) -> dict[str, Entity]:
    return {instance.name: model_entity(instance)}


def _links(instance: ModelInstance) -> dict[str, Entity]:
    return {f"{instance.name}::{link.frame.link}": link for link in link_entities(instance)}


class _Performance:
    """Publishes the real-time factor and the update rates of sensors while somebody listens."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._publisher = world.topics.publisher(
            "/gazebo/performance_metrics", msg.PerformanceMetrics
        )
        self._last = (time.monotonic(), world.simulation.step)
        world.simulation.every(PERFORMANCE_CHECK_RATE, self._check)

    def _check(self, step: int) -> None:
        then, before = self._last
        now = time.monotonic()
        if now - then < 1.0 / PERFORMANCE_RATE:
            return
        self._last = (now, step)
        # A reset may have set time back.
        if self._publisher.has_connections() and step > before:
            factor = (step - before) / STEPS_PER_SECOND / (now - then)
            message = msg.PerformanceMetrics(real_time_factor=factor)
            set_time(message.header.stamp, step)
            message.sensors.extend(self._sensors(factor))
            self._publisher.publish(message)

    def _sensors(self, factor: float) -> Iterator[Any]:
        """Yield the rates of all <sensor>s with a plugin, given the real-time factor."""
        world = self._world.simulation.world.name
        for instance in self._world.models.values():
            for plugin in instance.plugins:
                tag = plugin.mount.plugin
                if tag.sensor is None or plugin.schedule is None:
                    continue
                link = instance.frame(tag.link or None).link
                name = f"{world}::{instance.name}::{link}::{tag.sensor.get('name', '')}"
                rate = 1.0 / plugin.schedule.period
                drawn = any(output.wanted for output in plugin.outputs)
                pictures = (rate * factor if drawn else 0.0) if isinstance(plugin, Camera) else -1.0
                yield msg.SensorPerformanceMetric(name, rate, rate * factor, pictures)


class Warnings(logging.Handler):
    """Keeps the library's warnings from now on in `lines`, each once."""

    def __init__(self):
        super().__init__(logging.WARNING)
        self.lines: list[str] = []
        logging.getLogger("bullet_lab").addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Add the message of a record, called by the library's logger."""
        line = record.getMessage()
        if line not in self.lines and len(self.lines) < MOST_WARNINGS:
            self.lines.append(line)


def describe_models(world: RunningWorld, warnings: Warnings, request: Any) -> Answer:
    """Answer which plugins and tags of models are simulated, with the warnings so far."""
    models, name = world.models, request.model_name

    def describe() -> list[ModelDescription]:
        chosen = [find_model(models, name)] if name else models.values()
        return [_description(world, instance) for instance in chosen]

    answer = {"said": warnings.lines, "models": world.do(describe)}
    if request.with_picture:
        answer["picture"] = world.do(lambda: _picture(world, find_model(models, name)))
    return answer


def _picture(world: RunningWorld, instance: ModelInstance) -> Image:
    """Draw a model; walls of a narrow room, between it and the eye, are left out."""
    least, greatest = map(np.array, bounds(instance))
    view = overview(least - PICTURE_MARGIN, greatest + PICTURE_MARGIN)
    view = replace(view, near=0.5 * math.dist(view.eye, view.target))
    return image_message(Header(), take_picture(world.simulation, view, samples=4), "rgb8")


def _description(world: RunningWorld, instance: ModelInstance) -> ModelDescription:
    model = instance.model
    least, greatest = bounds(instance)
    acting = {id(plugin.mount.plugin): plugin for plugin in instance.plugins}
    touches = list(world.simulation.touches(model.name))
    return ModelDescription(
        name=model.name,
        is_static=model.static,
        of_world_file=any(one.name == model.name for one in world.simulation.world.models),
        links=[link.name for link in model.own_links()],
        joints=[joint.name for joint in model.joints],
        plugins=[
            _described_plugin(tag, acting.get(id(tag)))
            for tag in model.plugins
            if not tag.is_bare_sensor
        ],
        least=Point(*least),
        greatest=Point(*greatest),
        stands_on=sorted({own for own, _, _, up in touches if up > STEEPEST}),
        touches=sorted({f"{m}::{link}" for _, m, link, up in touches if up <= STEEPEST}),
    )


def _described_plugin(tag: PluginTag, plugin: Plugin | None) -> PluginDescription:
    """Describe a `<plugin>` tag, and the plugin that simulates it, if one does."""
    described = PluginDescription(name=tag.name, filename=tag.filename, link=tag.link)
    if plugin is not None:
        described.acts = True
        described.rate = 0.0 if plugin.schedule is None else 1.0 / plugin.schedule.period
        described.inputs = [rospy.resolve_name(entry.topic) for entry in plugin.inputs]
        topics = dict.fromkeys(entry.topic for entry in plugin.outputs)
        described.outputs = [rospy.resolve_name(topic) for topic in topics]
        described.tags_not_simulated = plugin.mount.unread_tags()
        described.refused = tuple(plugin.refused.values())
    return described


def offer_all(
    world: RunningWorld,
    frame: str,
    hidden: str,
    states_rate: float,
    folder: Path,
    warnings: Warnings,
) -> None:
    """Offer Gazebo's services and topics on a running world, and the markers of its shapes.

    Args:
        world: that they are about.
        frame: of the markers in RViz.
        hidden: name of the model without markers, which RViz shows as a robot.
        states_rate: messages on /gazebo/model_states and link_states per simulated second.
        folder: in which worlds are saved.
        warnings: of the world and its models so far and from now on.
    """
    subscribe_to_states(world)
    WorldMarkers(world, frame, hidden)
    _States(world, "/gazebo/model_states", msg.ModelStates, _model, states_rate)
    _States(world, "/gazebo/link_states", msg.LinkStates, _links, states_rate)
    _Performance(world)
    offer_services(world)
    GazeboPhysics(world)
    WorldSaver(world, folder)
    DeviceServices(world)
    offer("/bullet_lab/describe_models", DescribeModels, partial(describe_models, world, warnings))
