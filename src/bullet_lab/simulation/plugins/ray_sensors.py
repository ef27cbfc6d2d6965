"""Sensors of surroundings: lasers, sonars as fans of rays, and bumpers.

libgazebo_ros_laser.so, libgazebo_ros_gpu_laser.so, libgazebo_ros_block_laser.so, those of
velodyne_simulator, libgazebo_ros_range.so and libgazebo_ros_bumper.so.
"""

from __future__ import annotations

import logging
import re
from collections import deque
from itertools import chain

import numpy as np

from bullet_lab.core.pose import Vector, cross, subtract
from bullet_lab.simulation.physics.attached_frame import ContactPoint
from bullet_lab.simulation.physics.rays import Fan
from bullet_lab.simulation.plugins import Mount, PluginError, Sensor, SensorTag
from bullet_lab.simulation.plugins.samples import (
    BlockSample,
    ContactsSample,
    LaserSample,
    RangeSample,
    RingsSample,
    ShapeContact,
)
from bullet_lab.simulation.world.urdf import LUMP

LOG = logging.getLogger(__name__)

RAY_SENSORS = ("ray", "gpu_ray")
MOST_RAYS = 100_000
SIMULATED_NOISE = ("gaussian", "none", "")
ALL = slice(None)
# Steps of which a bumper keeps the contacts, as in Gazebo.
LONGEST_MEMORY = 100
# The parts that Gazebo's conversion of URDF adds to a shape's name.
ADDED = re.compile(rf"^.*{LUMP}|_collision(_\d+)?$")
# A point of velodyne's drivers. The rays are of one moment: `time` is 0.
RING_POINT = np.dtype(
    [*((name, "<f4") for name in ("x", "y", "z", "intensity")), ("ring", "<u2"), ("time", "<f4")]
)


class RayScan:
    """Casts the rays of a sensor from its origin.

    As in Gazebo, the robot's own shapes are invisible within the least range, and visible beyond
    it; a shape that contains the origin is always invisible.

    Attributes:
        angles: of the rays about the sensor's z axis in rad: the first, the last, and the
            increment from one to the next, 0 for a single one.
        heights: the same of the angles above the sensor's plane.
        least: least measured distance in m.
        greatest: greatest measured distance in m.
        directions: unit vectors of the rays in the sensor's frame, row by row, (rays, 3).
        shape: numbers of rows, from below, and of columns.
    """

    def __init__(self, mount: Mount, tag: SensorTag):
        self._own = np.array([body.unique_id for body in mount.bodies.values()])
        self.angles, columns = _angles(tag, "ray/scan/horizontal")
        self.heights, rows = _angles(tag, "ray/scan/vertical")
        if columns * rows > MOST_RAYS:
            raise PluginError(f"{tag.where('samples')}: more than {MOST_RAYS} rays")
        self.least = tag.coefficient("ray/range/min")
        self.greatest = tag.coefficient("ray/range/max")
        if self.greatest <= self.least:
            raise PluginError(f"{tag.where('max')}: {self.greatest:g} is not beyond <min>")
        self._mean, self._deviation = _noise(tag)
        yaw, pitch = np.meshgrid(_spread(self.angles, columns), _spread(self.heights, rows))
        self.shape, level = yaw.shape, np.cos(pitch)
        directions = np.stack((level * np.cos(yaw), level * np.sin(yaw), np.sin(pitch)))
        self._axes = directions.reshape(3, -1)
        self.directions = self._axes.T
        self._place = tag.place()
        self._rays = mount.simulation.rays

    def prepare(self) -> None:
        """Let the rays of the next `distances` be cast together with those of other sensors."""
        self._rays.ask(self, self._fan())

    def distances(self) -> np.ndarray:
        """Return exact distances in m, row by row from below, shape (rays,).

        As in REP 117, they are +inf without a hit within the greatest range, and -inf for a hit
        within the least range that is not the robot itself.
        """
        distances, bodies = self._rays.answer(self, self._fan)
        near = distances <= self.least
        if near.any():
            own = near & np.isin(bodies, self._own)
            distances[near] = -np.inf
            if own.any():
                ((distances[own], _),) = self._rays.cast([self._fan(self.least, own)])
        distances[distances >= self.greatest] = np.inf
        return distances

    def _fan(self, nearest: float = 0.0, chosen: slice | np.ndarray = ALL) -> Fan:
        """Return the chosen rays in the world, from a distance (m) on."""
        pose = self._place.pose()
        x, y, z = pose.rotation_matrix().T[:, :, None]
        ahead, left, up = self._axes[:, chosen]
        # Term by term, see `RayScene`.
        ways = x * ahead + y * left + z * up
        return Fan(np.array(pose.position), ways, nearest, self.greatest)

    def measure(self, random: np.random.Generator) -> np.ndarray:
        """Return distances with noise. As in Gazebo, `<resolution>` does not round them."""
        distances = self.distances()
        seen = np.isfinite(distances)
        if self._deviation or self._mean:
            # Drawn for all rays, so that one ray's hit does not change the others' noise.
            noise = random.normal(self._mean, self._deviation, len(distances))
            distances[seen] += noise[seen]
        distances[seen] = np.clip(distances[seen], self.least, self.greatest)
        return distances

    def nearest(self) -> float:
        """Return the least of the exact distances in m, or the least range if that is greater."""
        return max(float(np.min(self.distances())), self.least)

    def limited(self, reading: float) -> float:
        """Return a reading (m) limited to the range."""
        return min(max(reading, self.least), self.greatest)


def _angles(tag: SensorTag, path: str) -> tuple[Vector, int]:
    """Return the first and the last angle and their increment in rad, and their number."""
    samples = tag.count(f"{path}/samples", 1, MOST_RAYS)
    resolution = tag.positive(f"{path}/resolution", 1.0)
    # As in Gazebo, there is at least one.
    number = max(1, round(samples * resolution))
    least = tag.number(f"{path}/min_angle")
    greatest = tag.number(f"{path}/max_angle")
    increment = (greatest - least) / (number - 1) if number > 1 else 0.0
    return (least, greatest, increment), number


def _spread(angles: Vector, number: int) -> np.ndarray:
    """Return evenly spaced angles, shape (number,); as in Gazebo, a single one is 0."""
    return np.zeros(1) if number == 1 else np.linspace(*angles[:2], number)


def _noise(tag: SensorTag) -> tuple[float, float]:
    """Return mean and standard deviation of the noise in m."""
    kind = tag.text("ray/noise/type", "")
    if kind not in SIMULATED_NOISE:
        LOG.warning("%s: noise '%s' is not simulated and skipped", tag.where("type"), kind)
    if kind != "gaussian":
        return 0.0, 0.0
    return tag.number("ray/noise/mean"), tag.coefficient("ray/noise/stddev")


class RaySensor(Sensor):
    """A sensor whose rays are cast together with those of others that are due."""

    def __init__(self, mount: Mount, topic: str, kind: type):
        self._tag = SensorTag(mount, RAY_SENSORS)
        super().__init__(mount, mount.text("topicName", topic), kind)
        self._scanner = RayScan(mount, self._tag)

    def prepare(self) -> None:
        if self._output.wanted:
            self._scanner.prepare()


class Laser(RaySensor):
    """Measures distances around itself, all at one moment.

    No ray is cast without a listener. Intensities are 0, as in Gazebo on surfaces without
    laser_retro.
    """

    filenames = ("libgazebo_ros_laser.so", "libgazebo_ros_gpu_laser.so")
    named_by_model = (False, True)

    def __init__(self, mount: Mount):
        super().__init__(mount, "/world", LaserSample)
        self._frame = mount.frame(mount.text("frameName", "/world"))
        self.schedule = self._tag.schedule("update_rate", 0.0)

    def measure(self, step: int) -> LaserSample:
        scanner = self._scanner
        ranges = scanner.measure(self._noise.at(step))
        seen = (*scanner.angles, scanner.least, scanner.greatest)
        return LaserSample(step, self._frame, *seen, ranges, np.zeros(len(ranges)))


class BlockLaser(RaySensor):
    """Reports a point for each ray; one without a hit is at the greatest range, without noise.

    As in Gazebo, the sensor's noise has no effect, and the plugin's is added to each coordinate and
    to the intensity, which is 0 otherwise.
    """

    filenames = ("libgazebo_ros_block_laser.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount, "/world", BlockSample)
        self._frame = mount.frame(mount.text("frameName", "/world"))
        self._deviation = mount.coefficient("gaussianNoise")
        for without_effect in ("hokuyoMinIntensity", "updateRate"):
            mount.text(without_effect)
        self.schedule = self._tag.schedule("update_rate", 0.0)

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
        super().__init__(mount, "/points", RingsSample)
        frame, space = mount.text("frameName", "/world"), mount.namespace
        is_prefix = space and not frame.startswith("/")
        self._frame = f"{space}/{frame}" if is_prefix else mount.frame(frame)
        least, greatest = self._scanner.least, self._scanner.greatest
        self._least = max(least, mount.coefficient("min_range"))
        self._greatest = min(greatest, mount.number("max_range", greatest))
        # Without laser_retro, the intensity of all points is 0.
        self._is_blind = mount.number("min_intensity", -1.0) > 0.0
        self._deviation = mount.coefficient("gaussianNoise")
        self._is_organised = mount.boolean("organize_cloud", False)
        self.schedule = self._tag.schedule("update_rate", 0.0)

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


class RangeSensor(RaySensor):
    """Measures the distance of the nearest hit in a fan of rays.

    As in Gazebo, it reads the greatest range, without noise, if there is no hit. A hit nearer
    than the least range reads as the least range.
    """

    filenames = ("libgazebo_ros_range.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount, "/range", RangeSample)
        frame = mount.frame(mount.text("frameName", "/world"))
        infrared = mount.text("radiation", "ultrasound") != "ultrasound"
        self._kind = (frame, infrared, mount.number("fov", 0.05))
        self._deviation = mount.coefficient("gaussianNoise")
        self.schedule = self._tag.slower("updateRate", 0.0)

    def measure(self, step: int) -> RangeSample:
        scan, noise = self._scanner, self._noise.at(step).normal(0.0, self._deviation)
        # Infinity stays infinite with noise, and is then limited to the greatest range.
        reading = scan.limited(scan.nearest() + noise)
        return RangeSample(step, *self._kind, scan.least, scan.greatest, reading)


class Bumper(Sensor):
    """Reports the contacts of its link's shapes, with their forces.

    Samples come at the sensor's rate, also without contacts. As in Gazebo, one has the contacts of
    each step since the last sample, of LONGEST_MEMORY steps at most, in the world's axes whatever
    frameName says. Contacts are kept only while the sensor has a listener.
    """

    filenames = ("libgazebo_ros_bumper.so",)
    acts = True

    def __init__(self, mount: Mount):
        tag = SensorTag(mount, ("contact",))
        self._place = tag.place()
        self._watched = watched_shapes(mount, tag, self._place.link)
        self._frame = mount.frame(mount.text("frameName", "/world"))
        super().__init__(mount, mount.text("bumperTopicName", "bumper_states"), ContactsSample)
        self.schedule = tag.schedule("update_rate", 0.0)
        self._steps: deque[list[ShapeContact]] = deque(maxlen=LONGEST_MEMORY)

    def before_step(self, step: int) -> None:
        if self._keeps and step > self._last_step:
            self._steps.append(self._contacts(step))

    def produce(self, step: int) -> None:
        super().produce(step)
        self.reset(step)
        self._keeps = self._output.wanted

    def reset(self, step: int) -> None:
        self._steps.clear()
        self._keeps, self._last_step = False, step

    def measure(self, step: int) -> ContactsSample:
        self._steps.append(self._contacts(step))
        return ContactsSample(step, self._frame, tuple(chain.from_iterable(self._steps)))

    def _contacts(self, step: int) -> list[ShapeContact]:
        """Return the contacts of the step that has just been made."""
        # The contact points by the names of the two shapes, the own one first.
        pairs: dict[tuple[str, str], list[ContactPoint]] = {}
        name = self.mount.simulation.shape_name
        for point in self._place.contact_points():
            first = name(*point.own, point.place)
            if first in self._watched:
                second = name(*point.other, point.place_on_other)
                pairs.setdefault((first, second), []).append(point)
        centre = self._place.centre_of_mass()

        def row(point: ContactPoint) -> tuple:
            torque = cross(subtract(point.place, centre), point.force)
            return point.force, torque, point.place, point.normal, point.depth

        return [ShapeContact(step, *n, *zip(*map(row, points))) for n, points in pairs.items()]


def watched_shapes(mount: Mount, tag: SensorTag, link: str) -> tuple[str, ...]:
    """Return the full names of the shapes that the sensor watches; raises PluginError."""
    known = [shape.name for shape in mount.model.links_by_name()[link].collisions]
    wanted = [(element.text or "").strip() for element in tag.element.findall("contact/collision")]
    chosen: list[str] = []
    for name in wanted:
        if name in known:
            chosen.append(name)
            continue
        # Gazebo's versions differ in what they add to the name of a shape of a URDF.
        found = [one for one in known if ADDED.sub("", one) == ADDED.sub("", name)]
        where, shapes = tag.where("collision"), ", ".join(found or known) or "none"
        what = f"{where}: link '{link}' has no shape '{name}'; its shapes: {shapes}"
        if not found:
            raise PluginError(what)
        LOG.warning("%s; these are watched, Gazebo would report no contact", what)
        chosen += found
    return tuple(f"{mount.model.name}::{link}::{name}" for name in chosen or known)
