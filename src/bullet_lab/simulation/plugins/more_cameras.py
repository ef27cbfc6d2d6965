"""Pairs of cameras, and cameras that take a picture on demand.

libgazebo_ros_multicamera.so, libgazebo_ros_triggered_camera.so and
libgazebo_ros_triggered_multicamera.so.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import replace
from xml.etree.ElementTree import Element

from bullet_lab.core.schedule import Schedule
from bullet_lab.simulation.plugins import Input, Mount
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.plugins.samples import Trigger
from bullet_lab.simulation.world.description import PluginTag

LOG = logging.getLogger(__name__)

# Triggers that wait for their picture; more are dropped.
MOST_REQUESTS = 100


class MultiCamera(Camera):
    """One camera of a `<sensor type="multicamera">`.

    As in Gazebo, it has the namespace left or right below cameraName, by its own name.
    """

    filenames = ("libgazebo_ros_multicamera.so",)

    @classmethod
    def split(cls, tag: PluginTag) -> tuple[PluginTag, ...]:
        if tag.sensor is None or tag.sensor.get("type") != "multicamera":
            return (tag,)
        parts = []
        for camera in tag.sensor.findall("camera"):
            side = next((s for s in ("left", "right") if s in camera.get("name", "")), "")
            if not side:
                what = f"plugin '{tag.name}': camera '{camera.get('name')}' is left out"
                LOG.warning("%s: its name has neither left nor right", what)
                continue
            sensor = Element("sensor", type="camera", name=f"{tag.sensor.get('name', '')}_{side}")
            sensor.extend([one for one in tag.sensor if one.tag in ("update_rate", "pose")])
            sensor.append(camera)
            space = tag.tags.get("cameraName", "")
            tags = {**tag.tags, "cameraName": f"{space}/{side}" if space else side}
            if side == "left":
                # As in Gazebo, the baseline is that of the right camera.
                tags["hackBaseline"] = "0"
            names = {"name": f"{tag.name}_{side}", "tags": tags}
            parts.append(replace(tag, sensor=sensor, element=None, **names))
        return tuple(parts)


class OnDemand(Schedule):
    """Each step, to look for requests: as a rate of messages, none."""

    period = math.inf


class TriggeredCamera(Camera):
    """Takes a picture for each message on its topic of triggers, one in a step."""

    filenames = ("libgazebo_ros_triggered_camera.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self.schedule = OnDemand(0.0)
        topic = self.topic(mount.text("triggerTopicName", "image_trigger"))
        # Filled by other threads.
        self._requests: deque[Trigger] = deque(maxlen=MOST_REQUESTS)
        self.inputs = (Input(topic, Trigger, self._requests.append),)

    def reset(self, step: int) -> None:
        self._requests.clear()

    def set_rate(self, rate: float, step: int) -> None:
        """Do nothing: it has no rate."""

    def produce(self, step: int) -> None:
        if self._requests:
            self._requests.popleft()
            super().produce(step)


class TriggeredMultiCamera(MultiCamera, TriggeredCamera):
    """One camera of a `<sensor type="multicamera">`, with a trigger of its own."""

    filenames = ("libgazebo_ros_triggered_multicamera.so",)
