"""Counts what robots run into, as the simulation knows it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Dict, FrozenSet, Set

from bullet_lab.msg import TouchedModels
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.messages.stamps import set_time
from bullet_lab.ros.node.publishers import BatchPublisher
from bullet_lab.simulation.simulation import ModelInstance
from bullet_lab.simulation.world.description import Model, Plane

# Within the namespace of the robot.
TOPIC = "/bullet_lab/touched"
# Hz of looking: a robot that drives into a wall pushes against it for much longer.
LOOK_RATE = 100.0
SEND_RATE = 10.0


@dataclass
class _Watched:
    """A robot that is watched, and what it has touched so far."""

    publisher: BatchPublisher
    topic: str
    touching: FrozenSet[str] = frozenset()
    counts: Counter = field(default_factory=Counter)


class Touches:
    """Watches the robots that somebody listens to, and says what they touch beside the floor.

    A robot is what takes commands; the topic is /bullet_lab/touched in its namespace.

    Args:
        world: that the robots are in, and come to.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._floors = frozenset(
            model.name for model in world.simulation.world.models if _is_floor(model)
        )
        self._watched: Dict[str, _Watched] = {}
        self._last_step = 0
        world.simulation.every(LOOK_RATE, self._look)
        world.simulation.every(SEND_RATE, self._send)
        world.changed.append(self._changed)
        self._changed("")

    def _changed(self, name: str) -> None:
        """Begin or end to watch a model, or all with an empty name."""
        for model in [name] if name else {*self._world.models, *self._watched}:
            instance = self._world.models.get(model)
            takes_commands = instance is not None and any(d.inputs for d in instance.devices)
            if takes_commands and model not in self._watched:
                topic = f"{_namespace(instance)}{TOPIC}"
                publisher = self._world.wiring.publisher(topic, TouchedModels)
                self._watched[model] = _Watched(publisher, topic)
            elif not takes_commands and model in self._watched:
                self._world.wiring.release(self._watched.pop(model).topic)

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


def _namespace(instance: ModelInstance) -> str:
    """Return the namespace of the first device that takes commands, with its slash, or nothing."""
    first = next(device for device in instance.devices if device.inputs)
    namespace = first.mount.text("robotNamespace").strip("/")
    return f"/{namespace}" if namespace else ""


def _is_floor(model: Model) -> bool:
    shapes = [collision.geometry for link in model.links for collision in link.collisions]
    return any(isinstance(shape, Plane) for shape in shapes)
