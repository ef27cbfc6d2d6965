"""Counts what a robot runs into, as the simulation knows it."""

from __future__ import annotations

from collections import Counter
from typing import FrozenSet, Set

from bullet_lab.msg import TouchedModels
from bullet_lab.ros.publishers import BatchPublisher
from bullet_lab.ros.stamps import set_time
from bullet_lab.simulation.description import Model, Plane
from bullet_lab.simulation.simulation import Simulation

TOPIC = "/bullet_lab/touched"
# Hz of looking: a robot that drives into a wall pushes against it for much longer.
LOOK_RATE = 100.0
SEND_RATE = 10.0


class TouchCounter:
    """Watches one model while somebody listens, and says what it has touched beside the floor.

    Args:
        simulation: that the model is in.
        name: of the model.
        publisher: of `TOPIC`.
    """

    def __init__(self, simulation: Simulation, name: str, publisher: BatchPublisher):
        self._simulation = simulation
        self._name = name
        self._publisher = publisher
        self._floors = frozenset(m.name for m in simulation.world.models if _is_floor(m))
        self._touching: FrozenSet[str] = frozenset()
        self._counts: Counter = Counter()
        self._last_step = 0
        simulation.every(LOOK_RATE, self._look)
        simulation.every(SEND_RATE, self._send)

    def _look(self, step: int) -> None:
        if not self._publisher.has_connections() or self._name not in self._simulation.models:
            return
        if step < self._last_step:
            self._touching = frozenset()
            self._counts.clear()
        self._last_step = step
        touching: Set[str] = set(self._simulation.contacts(self._name)) - self._floors
        self._counts.update(touching - self._touching)
        self._touching = frozenset(touching)

    def _send(self, step: int) -> None:
        if self._publisher.has_connections():
            models = sorted(self._counts)
            message = TouchedModels(models=models, touches=[self._counts[m] for m in models])
            set_time(message.header.stamp, step)
            self._publisher.publish(message)


def _is_floor(model: Model) -> bool:
    shapes = [collision.geometry for link in model.links for collision in link.collisions]
    return any(isinstance(shape, Plane) for shape in shapes)
