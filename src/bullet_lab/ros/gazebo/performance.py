"""The topic /gazebo/performance_metrics: how fast time goes, and how often sensors measure."""

from __future__ import annotations

import time
from typing import Iterator, Tuple

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import set_time
from bullet_lab.simulation.plugins import Plugin
from bullet_lab.simulation.plugins.camera import Camera

TOPIC = "/gazebo/performance_metrics"
# Hz of looking, in simulated time, and of sending, in wall time.
LOOK_RATE = 100.0
SEND_RATE = 5.0


class Performance:
    """Publishes the metrics while somebody listens."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._publisher = world.topics.publisher(TOPIC, msg.PerformanceMetrics)
        self._last = (time.monotonic(), world.simulation.step)
        world.simulation.every(LOOK_RATE, self._look)

    def _look(self, step: int) -> None:
        then, before = self._last
        now = time.monotonic()
        if now - then < 1.0 / SEND_RATE:
            return
        self._last = (now, step)
        # Time may have been set back.
        if self._publisher.has_connections() and step > before:
            self._send(step, (step - before) / STEPS_PER_SECOND / (now - then))

    def _send(self, step: int, factor: float) -> None:
        message = msg.PerformanceMetrics(real_time_factor=factor)
        set_time(message.header.stamp, step)
        for name, plugin in self._sensors():
            rate = 1.0 / plugin.schedule.period
            drawn = any(output.wanted for output in plugin.outputs)
            pictures = (rate * factor if drawn else 0.0) if isinstance(plugin, Camera) else -1.0
            sensor = msg.SensorPerformanceMetric(name, rate, rate * factor, pictures)
            message.sensors.append(sensor)
        self._publisher.publish(message)

    def _sensors(self) -> Iterator[Tuple[str, Plugin]]:
        """Yield the plugins that stand in a <sensor>, with the sensors' full names."""
        world = self._world.simulation.world.name
        for instance in self._world.models.values():
            for plugin in instance.plugins:
                tag = plugin.mount.plugin
                if tag.sensor is not None and plugin.schedule is not None:
                    link = instance.keeper(tag.link) or instance.model.canonical_link().name
                    yield f"{world}::{instance.name}::{link}::{tag.sensor.get('name', '')}", plugin
