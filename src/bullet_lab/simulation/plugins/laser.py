"""libgazebo_ros_laser.so and libgazebo_ros_gpu_laser.so: a laser scanner."""

from __future__ import annotations

import numpy as np

from bullet_lab.simulation.plugins.device import Device, Mount, Output, device
from bullet_lab.simulation.plugins.ray_scan import RAY_SENSORS, RayScan
from bullet_lab.simulation.plugins.samples import LaserSample
from bullet_lab.simulation.plugins.sensor_tag import SensorTag


@device("libgazebo_ros_laser.so", "libgazebo_ros_gpu_laser.so")
class Laser(Device):
    """Measures distances around itself, all at one moment.

    No ray is cast while nobody listens. The intensities are 0, as those of Gazebo are on
    surfaces without laser_retro.

    Tags of the plugin: topicName, frameName and robotNamespace; of the sensor: pose,
    update_rate (0: every step) and, within ray, scan/horizontal and scan/vertical (samples,
    resolution, min_angle, max_angle), range (min, max, resolution) and noise (gaussian: mean,
    stddev), as in Gazebo.
    """

    def __init__(self, mount: Mount):
        super().__init__(mount)
        tag = SensorTag(mount, RAY_SENSORS)
        self._frame = mount.frame(mount.text("frameName", "/world"))
        self.scan = Output(mount.topic(mount.text("topicName", "/world")), LaserSample)
        self.outputs = (self.scan,)
        self._scanner = RayScan(mount, tag)
        self._noise = mount.noise()
        self.schedule = tag.schedule()

    def produce(self, step: int) -> None:
        """Send a scan."""
        if not self.scan.wanted:
            return
        angles = self._scanner.horizontal
        ranges = self._scanner.measure(self._noise.at(step))
        self.scan.send(
            LaserSample(
                step,
                self._frame,
                angles.least,
                angles.greatest,
                angles.increment,
                self.schedule.period,
                self._scanner.least,
                self._scanner.greatest,
                ranges,
                np.zeros(len(ranges)),
            )
        )
