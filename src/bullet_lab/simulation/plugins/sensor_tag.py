"""Reading the `<sensor>` element around a plugin, which URDF and SDF share."""

from __future__ import annotations

from typing import Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.simulation.physics.attached_frame import ORIGIN, AttachedFrame
from bullet_lab.simulation.plugins.device import DeviceError, Mount
from bullet_lab.simulation.world.xml import child_text, number, numbers


class SensorTag:
    """A sensor's element; paths are those of tags below it, such as "ray/range/max".

    Args:
        mount: of the device whose plugin stands in the sensor.
        kinds: types of sensors that it works with.

    Raises:
        DeviceError: the plugin stands in no such sensor.
    """

    def __init__(self, mount: Mount, kinds: Tuple[str, ...]):
        plugin = mount.plugin
        where = f"model '{mount.model.name}': plugin '{plugin.name}'"
        if plugin.sensor is None or plugin.sensor.get("type") not in kinds:
            raise DeviceError(f'{where} ({plugin.filename}) needs a <sensor type="{kinds[0]}">')
        self._mount = mount
        self._element = plugin.sensor
        self._where = f"{where}: <sensor>"

    def has(self, path: str) -> bool:
        """Return whether there is such a tag."""
        return self._element.find(path) is not None

    def elements(self, path: str) -> Tuple[Element, ...]:
        """Return all elements with a path."""
        return tuple(self._element.findall(path))

    def text(self, path: str, default: str = "") -> str:
        """Return what a tag says, or the default."""
        return child_text(self._element, path, default)

    def attribute(self, path: str, name: str) -> str:
        """Return an attribute of a tag; empty without it."""
        element = self._element.find(path)
        return "" if element is None else element.get(name, "")

    def number(self, path: str, default: float) -> float:
        """Return the finite number in a tag; raises XmlError."""
        return number(self.text(path, repr(default)), self.where(path))

    def at_least(self, path: str, default: float, least: float = 0.0) -> float:
        """Return the number in a tag; raises LabError if it is less than `least`."""
        value = self.number(path, default)
        if value < least:
            raise DeviceError(f"{self.where(path)}: {value:g} is less than {least:g}")
        return value

    def count(self, path: str, default: int, most: int) -> int:
        """Return the whole number from 1 to `most` in a tag; raises LabError."""
        value = self.number(path, default)
        if value != int(value) or not 1 <= value <= most:
            raise DeviceError(f"{self.where(path)}: {value:g} is no whole number in 1 … {most}")
        return int(value)

    def pose(self) -> Pose:
        """Return the sensor's pose in its link; raises XmlError."""
        values = numbers(self.text("pose", "0 0 0 0 0 0"), 6, self.where("pose"))
        return Pose.from_rpy(values[:3], values[3:])

    def place(self, offset: Pose = ORIGIN) -> AttachedFrame:
        """Return the sensor's frame, which is fixed to its link; raises LabError.

        Args:
            offset: pose of the wanted frame in the sensor's.
        """
        link = self._mount.plugin.link or self._mount.model.root_links()[0].name
        return self._mount.attached(link, self.pose() * offset)

    def schedule(self) -> Schedule:
        """Return the schedule for the sensor's update_rate (Hz, 0: every step)."""
        rate = self.number("update_rate", 0.0)
        try:
            return Schedule(rate)
        except ScheduleError as error:
            raise DeviceError(f"{self.where('update_rate')}: {error}") from error

    def where(self, path: str) -> str:
        """Name a tag in messages."""
        return f"{self._where}: <{path.rpartition('/')[2]}>"
