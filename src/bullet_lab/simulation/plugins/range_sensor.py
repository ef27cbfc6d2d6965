"""libgazebo_ros_range.so: an ultrasonic or infrared distance sensor."""

from __future__ import annotations

import numpy as np

from bullet_lab.core.schedule import Schedule
from bullet_lab.simulation.plugins.device import Device, DeviceError, Mount, Output, device
from bullet_lab.simulation.plugins.ray_scan import RAY_SENSORS, RayScan
from bullet_lab.simulation.plugins.samples import RangeSample
from bullet_lab.simulation.plugins.sensor_tag import SensorTag


@device("libgazebo_ros_range.so")
class RangeSensor(Device):
    """Measures the distance of the nearest thing in a fan of rays.

    Where there is none, it reads the greatest range, without noise, as in Gazebo; something
    nearer than the least range reads as that.

    Tags of the plugin, with Gazebo's defaults: topicName (/range), frameName, radiation
    (ultrasound; anything else is infrared), fov (rad; what the message says, the fan is that of
    the sensor), gaussianNoise (m), updateRate (Hz, 0: as the sensor) and robotNamespace; those
    of the sensor are the laser's.
    """

    def __init__(self, mount: Mount):
        super().__init__(mount)
        tag = SensorTag(mount, RAY_SENSORS)
        self._frame = mount.frame(mount.text("frameName", "/world"))
        self.range = Output(mount.topic(mount.text("topicName", "/range")), RangeSample)
        self.outputs = (self.range,)
        self._infrared = mount.text("radiation", "ultrasound") != "ultrasound"
        self._fov = mount.number("fov", 0.05)
        self._deviation = mount.number("gaussianNoise", 0.0)
        if self._deviation < 0.0:
            raise DeviceError(f"{mount.where('gaussianNoise')}: {self._deviation:g} is negative")
        self._scanner = RayScan(mount, tag)
        self._noise = mount.noise()
        self.schedule = _slower_of(mount.schedule("updateRate", 0.0), tag.schedule())

    def produce(self, step: int) -> None:
        """Send a reading."""
        if not self.range.wanted:
            return
        scanner = self._scanner
        noise = self._noise.at(step).normal(0.0, self._deviation)
        # Infinity stays what it is, and ends as the greatest range.
        reading = max(float(np.min(scanner.distances())), scanner.least) + noise
        reading = min(max(reading, scanner.least), scanner.greatest)
        self.range.send(
            RangeSample(
                step,
                self._frame,
                self._infrared,
                self._fov,
                scanner.least,
                scanner.greatest,
                reading,
            )
        )


def _slower_of(one: Schedule, other: Schedule) -> Schedule:
    """Return the schedule with the longer period: it takes both sensor and plugin to send."""
    return max(one, other, key=lambda schedule: schedule.period)
