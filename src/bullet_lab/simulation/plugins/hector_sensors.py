"""Sensors whose errors drift.

libhector_gazebo_ros_imu.so, libhector_gazebo_ros_gps.so and libhector_gazebo_ros_sonar.so.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins import Mount, Plugin
from bullet_lab.simulation.plugins.motion_sensors import InertialUnit, mounting_offset
from bullet_lab.simulation.plugins.ray_sensors import RaySensor
from bullet_lab.simulation.plugins.samples import FixSample, ImuSample, RangeSample, VectorSample

# WGS 84: radius at the equator in m, and the square of the first eccentricity.
EQUATOR = 6378137.0
ECCENTRICITY2 = 0.0066943799901413165
# The step of the generator that draws the first drift; simulated time never reaches it.
FIRST_STEP = 2**63


class DriftingError:
    """The error of a sensor: a reading is value * scale + offset + drift + noise.

    The drift is a first-order Gauss-Markov process with the standard deviation `deviation` and the
    correlation time 1/`frequency`. It depends on the seed, names and the steps of `advance` only.
    All attributes have the shape (axes,).
    """

    def __init__(self, mount: Mount, prefix: str = "", axes: int = 3):
        def read(name: str, default: float = 0.0, least: float = -math.inf) -> np.ndarray:
            key = f"{prefix}{name}" if prefix else name[0].lower() + name[1:]
            # As in `<accelDrift>0.1</accelDrift>`, one number counts for all axes.
            count = 1 if len(mount.text(key, "0").split()) == 1 else axes
            texts, reason = " ".join([repr(default)] * count), "{:g} is negative"
            values = mount.numbers(key, count, texts, lambda v: min(v) < least, reason)
            return np.resize(values, axes)

        self.offset, self.deviation = read("Offset"), read("Drift", least=0.0)
        self.frequency = read("DriftFrequency", 1.0 / 3600.0, 0.0)
        self.noise, self.scale = read("GaussianNoise", least=0.0), read("ScaleError", 1.0)
        self._random = mount.noise(f"/{prefix}Error")

    @property
    def bias(self) -> np.ndarray:
        """The sum of offset and drift."""
        return self.offset + self.drift

    def reset(self, step: int, drift: Vector | None = None) -> None:
        """Start with a drift, or with one that is drawn."""
        drawn = self._random.at(FIRST_STEP).standard_normal(len(self.offset))
        self.drift = self.deviation * drawn if drift is None else np.array(drift)
        self._noise, self._step = 0.0, step

    def advance(self, step: int) -> float:
        """Draw drift and noise at a step; return the time since the last one in s."""
        drift, noise = self._random.at(step).standard_normal((2, len(self.offset)))
        seconds, self._step = (step - self._step) / STEPS_PER_SECOND, step
        kept = np.exp(-self.frequency * seconds)
        self.drift = kept * self.drift + np.sqrt(1.0 - kept * kept) * self.deviation * drift
        self._noise = self.noise * noise
        return seconds

    def read(self, values: Vector) -> Vector:
        """Return values with the present error."""
        return tuple((self.scale * values + self.bias + self._noise).tolist())


class HectorImu(InertialUnit):
    """Measures orientation, angular velocity and specific force with drifting errors.

    As in hector's plugin, the biases of accelerometer and yaw turn the orientation. `service` sets
    the drift of the angular velocity to 0; `space` is the namespace of set_accel_bias and
    set_rate_bias.
    """

    filenames = ("libhector_gazebo_ros_imu.so",)

    def __init__(self, mount: Mount):
        body = mount.text("bodyName") or mount.model.canonical_link().name
        topic = mount.text("topicName", "imu")
        super().__init__(mount, mount.text("frameId", body), topic)
        # The former names of the tags yaw…, which hector's plugin ignores now.
        for key in ("Offset", "Drift", "DriftFrequency", "GaussianNoise"):
            mount.text(f"heading{key}")
        self.accel, self.rate = DriftingError(mount, "accel"), DriftingError(mount, "rate")
        self._yaw = DriftingError(mount, "yaw", 1)
        self._errors = (self.accel, self.rate, self._yaw)
        if self._deviation:
            self.accel.noise[:] = self.rate.noise[:] = self._deviation
            self._deviation = 0.0
        self.place = mount.attached(body, mounting_offset(mount))
        self.space = mount.topic(topic)
        self.service = mount.topic(mount.text("serviceName", f"{topic}/calibrate"))
        self._bias = self.output(mount.text("biasTopicName", f"{topic}/bias"), ImuSample)
        self.schedule = mount.schedule("updateRate", 0.0)

    def reset(self, step: int) -> None:
        super().reset(step)
        for error in self._errors:
            error.reset(step)

    def produce(self, step: int) -> None:
        for error in self._errors:
            error.advance(step)
        if self._bias.wanted:
            biases = (tuple(error.bias.tolist()) for error in (self.rate, self.accel))
            turn = self._turn().quaternion
            self._bias.send(ImuSample(step, self._frame, turn, *biases, 0.0, 0.0, 0.0))
        super().produce(step)

    def measure(self, step: int) -> ImuSample:
        exact, gravity = super().measure(step), math.hypot(*self.mount.simulation.world.gravity)
        tilts = (self.accel.noise[:2] / gravity) ** 2 if gravity else (-1.0, -1.0)
        return replace(
            exact,
            orientation=(self._turn() * Pose(quaternion=exact.orientation)).quaternion,
            angular_velocity=self.rate.read(exact.angular_velocity),
            specific_force=self.accel.read(exact.specific_force),
            orientation_variance=(*tilts, *self._yaw.noise**2),
            angular_velocity_variance=tuple(self.rate.noise**2),
            specific_force_variance=tuple(self.accel.noise**2),
        )

    def _turn(self) -> Pose:
        """Return the error of the orientation, about the world's axes."""
        x, y, _ = Pose(quaternion=self.place.pose().quaternion).rotate(self.accel.bias)
        half = 0.5 / (math.hypot(*self.mount.simulation.world.gravity) or math.inf)
        length, yaw = math.hypot(1.0, half * x, half * y), 0.5 * float(self._yaw.bias[0])
        tilt = Pose(quaternion=(half * y / length, -half * x / length, 0.0, 1.0 / length))
        return Pose(quaternion=(0.0, 0.0, math.sin(yaw), math.cos(yaw))) * tilt


class Gps(Plugin):
    """Reports latitude, longitude, altitude and velocity on a plane that touches the ellipsoid.

    At a heading of 0 the world's x axis points north. As in hector's plugin, the drift of the
    velocity is integrated into that of the position.
    """

    filenames = ("libhector_gazebo_ros_gps.so",)

    def __init__(self, mount: Mount):
        def within(tag: str, default: float, least: float, most: float) -> float:
            allowed = f"{{:g}} is not within {least:g} … {most:g}"
            values = (tag, 1, repr(default), lambda v: not least <= v[0] <= most, allowed)
            return mount.numbers(*values)[0]

        super().__init__(mount)
        self._place = mount.attached(mount.text("bodyName") or mount.model.canonical_link().name)
        self._frame = mount.text("frameId", "/world")
        self._fix = self.output(mount.text("topicName", "fix"), FixSample)
        name = mount.text("velocityTopicName", "fix_velocity")
        self._velocity = self.output(name, VectorSample)
        self._errors = DriftingError(mount), DriftingError(mount, "velocity")
        latitude = within("referenceLatitude", 49.9, -89.9, 89.9)
        longitude = within("referenceLongitude", 8.9, -180.0, 180.0)
        self._reference = (latitude, longitude, mount.number("referenceAltitude"))
        heading = math.radians(mount.number("referenceHeading"))
        self._into = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, -heading))
        self._status = int(within("status", 0, -1, 2)), int(within("service", 0, 0, 15))
        bend = 1.0 / (1.0 - ECCENTRICITY2 * math.sin(math.radians(latitude)) ** 2)
        across = math.radians(EQUATOR * math.sqrt(bend))
        # Metres per degree to the north and to the west.
        self._north = across * (1.0 - ECCENTRICITY2) * bend
        self._west = -across * math.cos(math.radians(latitude))
        self.schedule = mount.schedule("updateRate", 4.0)

    def reset(self, step: int) -> None:
        for error in self._errors:
            error.reset(step)

    def produce(self, step: int) -> None:
        position, velocity = self._errors
        seconds = position.advance(step)
        velocity.advance(step)
        if self._fix.wanted:
            north, west, up = self._into.rotate(position.read(self._place.pose().position))
            latitude, longitude, altitude = self._reference
            longitude = math.remainder(longitude + west / self._west, 360.0)
            place = (latitude + north / self._north, longitude, altitude + up)
            variances = tuple((position.deviation**2 + position.noise**2).tolist())
            self._fix.send(FixSample(step, self._frame, *self._status, *place, variances))
        if self._velocity.wanted:
            turned = self._into.rotate(velocity.read(self._place.velocity()[0]))
            self._velocity.send(VectorSample(step, self._frame, turned))
        position.drift = position.drift + seconds * velocity.drift


class Sonar(RaySensor):
    """Measures the distance of the nearest hit in a fan of rays.

    As in hector's plugin, it reads the greatest range, without error, if there is no hit.
    """

    filenames = ("libhector_gazebo_ros_sonar.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount, "sonar", RangeSample)
        self._frame = mount.text("frameId", "/sonar_link")
        self._error = DriftingError(mount, axes=1)
        self.schedule = mount.schedule("updateRate", 10.0)

    def reset(self, step: int) -> None:
        self._error.reset(step)

    def produce(self, step: int) -> None:
        self._error.advance(step)
        super().produce(step)

    def measure(self, step: int) -> RangeSample:
        scan = self._scanner
        reading = scan.nearest()
        if reading < scan.greatest:
            (reading,) = self._error.read((reading,))
        span = min(abs(most - least) for least, most, _ in (scan.angles, scan.heights))
        seen = (span, scan.least, scan.greatest, scan.limited(reading))
        return RangeSample(step, self._frame, False, *seen)
