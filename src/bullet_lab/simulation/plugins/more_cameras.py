"""Pairs of cameras, and cameras that take a picture when they are told to.

libgazebo_ros_multicamera.so, libgazebo_ros_triggered_camera.so and
libgazebo_ros_triggered_multicamera.so.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from xml.etree.ElementTree import Element

from bullet_lab.core.schedule import Schedule
from bullet_lab.simulation.plugins import Input, Mount
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.plugins.samples import Trigger
from bullet_lab.simulation.world.description import PluginTag

LOG = logging.getLogger(__name__)
MULTICAMERA = "multicamera"
SIDES = ("left", "right")
# Simulated time never reaches it.
NEVER = 2**62


class MultiCamera(Camera):
    """One of the cameras of a `<sensor type="multicamera">`.

    As in Gazebo, it has the namespace left or right below cameraName if that is in its name.
    """

    filenames = ("libgazebo_ros_multicamera.so",)

    @classmethod
    def split(cls, tag: PluginTag) -> tuple[PluginTag, ...]:
        if tag.sensor is None or tag.sensor.get("type") != MULTICAMERA:
            return (tag,)
        parts = []
        for camera in tag.sensor.findall("camera"):
            name = camera.get("name", "")
            side = next((side for side in SIDES if side in name), None)
            if side is None:
                what = f"plugin '{tag.name}' ({tag.filename}): camera '{name}' is left out"
                LOG.warning("%s: its name has neither left nor right, as Gazebo wants", what)
                continue
            sensor = Element("sensor", type="camera", name=f"{tag.sensor.get('name', '')}_{side}")
            sensor.extend(one for one in tag.sensor if one.tag in ("update_rate", "pose"))
            sensor.append(camera)
            space = "/".join(filter(None, (tag.tags.get("cameraName"), side)))
            tags = {**tag.tags, "cameraName": space}
            if side == "left":
                # As in Gazebo, the baseline is that of the right camera.
                tags["hackBaseline"] = "0"
            name = f"{tag.name}_{side}"
            parts.append(replace(tag, name=name, tags=tags, sensor=sensor, element=None))
        return tuple(parts)


class OnDemand(Schedule):
    """Occurrences in the steps that follow requests, one for each request."""

    period = float("inf")

    def __init__(self) -> None:
        super().__init__(1.0)

    def request(self, step: int) -> None:
        """Ask for one more occurrence after a step."""
        self._requests += 1
        self.next_step = min(self.next_step, step + 1)

    def restart(self, start: int) -> None:
        self._requests, self.next_step = 0, NEVER

    def advance(self) -> None:
        self._requests -= 1
        self.next_step = self.next_step + 1 if self._requests > 0 else NEVER


class TriggeredCamera(Camera):
    """Takes a picture for each message on its topic of triggers."""

    filenames = ("libgazebo_ros_triggered_camera.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self.schedule: OnDemand = OnDemand()
        topic = self.topic(mount.text("triggerTopicName", "image_trigger"))
        self.inputs = (Input(topic, Trigger, self._trigger),)

    def set_rate(self, rate: float, step: int) -> None:
        """Do nothing: it has no rate."""

    def _trigger(self, _: Trigger) -> None:
        self.schedule.request(self.mount.simulation.step)


class TriggeredMultiCamera(MultiCamera, TriggeredCamera):
    """One of the cameras of a `<sensor type="multicamera">`, with a trigger of its own."""

    filenames = ("libgazebo_ros_triggered_multicamera.so",)
