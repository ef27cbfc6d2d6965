"""Lasers with several rows of rays, which report points: block_laser and velodyne's."""

from __future__ import annotations

import numpy as np

from bullet_lab.simulation.plugins import Mount, SensorTag
from bullet_lab.simulation.plugins.ray_sensors import RAY_SENSORS, RayScan, RaySensor
from bullet_lab.simulation.plugins.samples import BlockSample, RingsSample

# A point of velodyne's drivers. The rays are of one moment: `time` is 0.
RING_POINT = np.dtype(
    [*((name, "<f4") for name in ("x", "y", "z", "intensity")), ("ring", "<u2"), ("time", "<f4")]
)


class BlockLaser(RaySensor):
    """Reports a point for each ray; one without a hit is at the greatest range, without noise.

    As in Gazebo, the sensor's noise has no effect, and the plugin's is added to each coordinate and
    to the intensity, which is 0 otherwise.
    """

    filenames = ("libgazebo_ros_block_laser.so",)

    def __init__(self, mount: Mount):
        tag = SensorTag(mount, RAY_SENSORS)
        super().__init__(mount, mount.text("topicName", "/world"), BlockSample)
        self._frame = mount.frame(mount.text("frameName", "/world"))
        self._deviation = mount.coefficient("gaussianNoise")
        for without_effect in ("hokuyoMinIntensity", "updateRate"):
            mount.text(without_effect)
        self._scanner = RayScan(mount, tag)
        self.schedule = tag.schedule("update_rate", 0.0)

    def measure(self, step: int) -> BlockSample:
        scan = self._scanner
        distances = np.clip(scan.distances(), scan.least, scan.greatest)
        noise = self._noise.at(step).normal(0.0, self._deviation, (len(distances), 4))
        noise[distances == scan.greatest, :3] = 0.0
        points = distances[:, None] * scan.directions + noise[:, :3]
        return BlockSample(step, self._frame, points, noise[:, 3])


class VelodyneLaser(RaySensor):
    """Reports the points that are hit, column by column, each from the lowest ring upwards.

    With organize_cloud, rays without a point have NaN, and the cloud has a row for each column of
    rays. As in velodyne_simulator, a robotNamespace is the prefix of the frame.
    """

    filenames = ("libgazebo_ros_velodyne_laser.so", "libgazebo_ros_velodyne_gpu_laser.so")

    def __init__(self, mount: Mount):
        tag = SensorTag(mount, RAY_SENSORS)
        super().__init__(mount, mount.text("topicName", "/points"), RingsSample)
        frame, space = mount.text("frameName", "/world"), mount.namespace
        is_prefix = space and not frame.startswith("/")
        self._frame = f"{space}/{frame}" if is_prefix else mount.frame(frame)
        self._scanner = scan = RayScan(mount, tag)
        self._least = max(scan.least, mount.coefficient("min_range"))
        self._greatest = min(scan.greatest, mount.number("max_range", scan.greatest))
        # Without laser_retro, the intensity of all points is 0.
        self._is_blind = mount.number("min_intensity", -1.0) > 0.0
        self._deviation = mount.coefficient("gaussianNoise")
        self._is_organised = mount.boolean("organize_cloud", False)
        self.schedule = tag.schedule("update_rate", 0.0)

    def measure(self, step: int) -> RingsSample:
        random, scan = self._noise.at(step), self._scanner
        distances = scan.measure(random)
        seen = self._are_seen(distances) & (not self._is_blind)
        distances += random.normal(0.0, self._deviation, len(distances))
        seen &= self._are_seen(distances)
        cloud = np.zeros(scan.shape, RING_POINT)
        points = np.where(seen, distances, np.nan)[:, None] * scan.directions
        for axis, name in enumerate("xyz"):
            cloud[name] = points[:, axis].reshape(scan.shape)
        cloud["ring"] = np.arange(scan.shape[0])[:, None]
        seen = seen.reshape(scan.shape)
        cloud["intensity"][~seen] = np.nan
        columns = cloud.T if self._is_organised else cloud.T[seen.T][None]
        return RingsSample(step, self._frame, columns)

    def _are_seen(self, distances: np.ndarray) -> np.ndarray:
        return (self._least < distances) & (distances < self._greatest)
