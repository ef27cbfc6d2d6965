"""Sensors of hector_gazebo_plugins, whose errors drift.

libhector_gazebo_ros_imu.so and libhector_gazebo_ros_gps.so.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins import Mount, Plugin
from bullet_lab.simulation.plugins.motion_sensors import InertialUnit, mounting_offset
from bullet_lab.simulation.plugins.samples import FixSample, ImuSample, VectorSample

# WGS 84: radius at the equator in m, and the square of the first eccentricity.
EQUATOR = 6378137.0
ECCENTRICITY2 = 0.0066943799901413165
# hector's former names of the tags yaw…, which it ignores now.
FORMER = tuple(f"heading{key}" for key in ("Offset", "Drift", "DriftFrequency", "GaussianNoise"))
# The step of the generator that draws the first drift; simulated time never reaches it.
FIRST_STEP = 2**63


class DriftingError:
    """The error of a sensor: a reading is value * scale + offset + drift + noise.

    The drift is a first-order Gauss-Markov process with the standard deviation `deviation` and the
    correlation time 1/`frequency`. It depends on the seed, names and the steps of `advance` only.
    All attributes have the shape (axes,); `noise` is a standard deviation, `error` the present sum
    of offset, drift and noise.
    """

    def __init__(self, mount: Mount, prefix: str = "", axes: int = 3):
        def read(name: str, default: float = 0.0, least: float = -math.inf) -> np.ndarray:
            key = f"{prefix}{name}" if prefix else name[0].lower() + name[1:]
            # As in `<accelDrift>0.1</accelDrift>`, one number counts for all axes.
            count = 1 if len(mount.text(key, "0").split()) == 1 else axes
            fallback = " ".join([repr(default)] * count)
            problem = "{:g} is negative"
            values = mount.numbers(key, count, fallback, lambda v: min(v) < least, problem)
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
        self.error, self._step = self.bias, step

    def advance(self, step: int) -> float:
        """Draw the error at a step; return the time since the last one in s."""
        drift, noise = self._random.at(step).standard_normal((2, len(self.offset)))
        seconds, self._step = (step - self._step) / STEPS_PER_SECOND, step
        kept = np.exp(-self.frequency * seconds)
        self.drift = kept * self.drift + np.sqrt(1.0 - kept * kept) * self.deviation * drift
        self.error = self.bias + self.noise * noise
        return seconds

    def read(self, values: Vector) -> Vector:
        """Return values with the present error."""
        return tuple((self.scale * values + self.error).tolist())


class HectorImu(InertialUnit):
    """Measures orientation, angular velocity and specific force with drifting errors.

    As in hector's plugin, the orientation is tilted by the bias of the accelerometer and turned by
    that of the yaw, without noise.

    Attributes:
        space: namespace of the services set_accel_bias and set_rate_bias.
        service: name of the service that sets the drift of the angular velocity to 0.
    """

    filenames = ("libhector_gazebo_ros_imu.so",)

    def __init__(self, mount: Mount):
        body = mount.text("bodyName") or mount.model.canonical_link().name
        topic = mount.text("topicName", "imu")
        super().__init__(mount, mount.text("frameId", body), topic)
        for tag in FORMER:
            mount.text(tag)
        self.accel, self.rate = DriftingError(mount, "accel"), DriftingError(mount, "rate")
        self._yaw = DriftingError(mount, "yaw", 1)
        if self._deviation:
            self.accel.noise[:] = self.rate.noise[:] = self._deviation
        # The base adds no noise of its own.
        self._deviation = 0.0
        self.place = mount.attached(body, mounting_offset(mount))
        self.space = mount.topic(topic)
        self.service = mount.topic(mount.text("serviceName", f"{topic}/calibrate"))
        self._bias = self.output(mount.text("biasTopicName", f"{topic}/bias"), ImuSample)
        self.schedule = mount.schedule("updateRate", 0.0)

    def reset(self, step: int) -> None:
        super().reset(step)
        for error in (self.accel, self.rate, self._yaw):
            error.reset(step)

    def produce(self, step: int) -> None:
        for error in (self.accel, self.rate, self._yaw):
            error.advance(step)
        if self._bias.wanted:
            biases = (tuple(error.bias.tolist()) for error in (self.rate, self.accel))
            turn = self._turn().quaternion
            self._bias.send(ImuSample(step, self._frame, turn, *biases, 0.0, 0.0, 0.0))
        super().produce(step)

    def measure(self, step: int) -> ImuSample:
        exact = super().measure(step)
        rate, accel = self.rate.noise**2, self.accel.noise**2
        gravity = self._gravity()
        tilt = accel[:2] / gravity**2 if gravity else (-1.0, -1.0)
        return replace(
            exact,
            orientation=(self._turn() * Pose(quaternion=exact.orientation)).quaternion,
            angular_velocity=self.rate.read(exact.angular_velocity),
            specific_force=self.accel.read(exact.specific_force),
            orientation_variance=(*tilt, *self._yaw.noise**2),
            angular_velocity_variance=tuple(rate),
            specific_force_variance=tuple(accel),
        )

    def _gravity(self) -> float:
        return math.hypot(*self.mount.simulation.world.gravity)

    def _turn(self) -> Pose:
        """Return the error of the orientation, about the world's axes."""
        x, y, _ = Pose(quaternion=self.place.pose().quaternion).rotate(self.accel.bias)
        half, yaw = 0.5 / (self._gravity() or math.inf), 0.5 * float(self._yaw.bias[0])
        length = math.hypot(1.0, half * x, half * y)
        tilt = Pose(quaternion=(half * y / length, -half * x / length, 0.0, 1.0 / length))
        return Pose(quaternion=(0.0, 0.0, math.sin(yaw), math.cos(yaw))) * tilt


class Gps(Plugin):
    """Reports latitude, longitude, altitude and velocity on a plane that touches the ellipsoid.

    At a heading of 0 the world's x axis points north. As in hector's plugin, the drift of the
    velocity is integrated into that of the position.
    """

    filenames = ("libhector_gazebo_ros_gps.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._place = mount.attached(mount.text("bodyName") or mount.model.canonical_link().name)
        self._frame = mount.text("frameId", "/world")
        self._fix = self.output(mount.text("topicName", "fix"), FixSample)
        name = mount.text("velocityTopicName", "fix_velocity")
        self._velocity = self.output(name, VectorSample)
        self._errors = DriftingError(mount), DriftingError(mount, "velocity")
        reference = (("Latitude", 49.9, 89.9), ("Longitude", 8.9, 180.0), ("Altitude", 0.0, 1e5))
        self._reference = [_within(mount, f"reference{key}", *rest) for key, *rest in reference]
        heading = math.radians(mount.number("referenceHeading", 0.0))
        self._into = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, -heading))
        status = _within(mount, "status", 0.0, 2.0, -1.0), _within(mount, "service", 0.0, 15.0, 0.0)
        self._status = tuple(map(int, status))
        latitude = math.radians(self._reference[0])
        bend = 1.0 / (1.0 - ECCENTRICITY2 * math.sin(latitude) ** 2)
        across = math.radians(EQUATOR * math.sqrt(bend))
        # Metres per degree to the north and to the west.
        self._north = across * (1.0 - ECCENTRICITY2) * bend
        self._west = -across * math.cos(latitude)
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
            latitude += north / self._north
            longitude = math.remainder(longitude + west / self._west, 360.0)
            variances = tuple((position.deviation**2 + position.noise**2).tolist())
            place = (latitude, longitude, altitude + up)
            self._fix.send(FixSample(step, self._frame, *self._status, *place, variances))
        if self._velocity.wanted:
            turned = self._into.rotate(velocity.read(self._place.velocity()[0]))
            self._velocity.send(VectorSample(step, self._frame, turned))
        position.drift = position.drift + seconds * velocity.drift


def _within(mount: Mount, tag: str, default: float, most: float, least: float = math.nan) -> float:
    """Return a number of a tag from `least`, by default -`most`, to `most`."""
    least = -most if math.isnan(least) else least
    allowed = f"{{:g}} is not within {least:g} … {most:g}"
    return mount.numbers(tag, 1, repr(default), lambda v: not least <= v[0] <= most, allowed)[0]
