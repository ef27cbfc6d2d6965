"""libgazebo_ros_imu.so and libgazebo_ros_imu_sensor.so: an inertial measurement unit."""

from __future__ import annotations

import math
from collections import deque
from typing import ClassVar, Deque, Optional, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Quaternion, Vector, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.plugins.plugin import Mount, Output, Plugin, SensorTag, slower_of
from bullet_lab.simulation.plugins.samples import ImuSample

# Steps over which accelerations are averaged at least.
AVERAGING = 10
AXES = ("x", "y", "z")


class Accelerometer:
    """Mean acceleration of a point, from its velocities.

    Bullet's contacts carry a body in small pushes, and each would show as m/s². So this is the
    mean since the last reading, over 10 ms at least. Readings up to 100 Hz then add up to exactly
    the change of velocity, as those of a strapdown unit do; faster ones overlap, as if behind a
    low-pass filter with its first zero at 100 Hz, which is about what such chips have.
    """

    def __init__(self) -> None:
        self._past: Deque[Tuple[int, Vector]] = deque()

    def restart(self, step: int, velocity: Vector) -> None:
        """Begin with a velocity in m/s."""
        self._past.clear()
        self._past.append((step, velocity))

    def advance(self, step: int, velocity: Vector) -> Vector:
        """Take the present velocity in m/s and return the mean acceleration in m/s²."""
        past = self._past
        past.append((step, velocity))
        while len(past) > 2 and step - past[1][0] >= AVERAGING:
            past.popleft()
        since, before = past[0]
        seconds = (step - since) / STEPS_PER_SECOND
        if seconds <= 0.0:
            return (0.0, 0.0, 0.0)
        return tuple((now - then) / seconds for now, then in zip(velocity, before))


class AxisNoise:
    """Noise of three axes as SDF's `<imu>` has it: gaussian with a mean, and a constant bias.

    `quantity` is "angular_velocity" or "linear_acceleration".
    """

    def __init__(self, mount: Mount, tag: SensorTag, quantity: str):
        paths = [f"imu/{quantity}/{axis}/noise" for axis in AXES]
        self.deviations = np.array([tag.coefficient(f"{path}/stddev", 0.0) for path in paths])
        random = mount.noise(f"/{quantity}").at(0)
        self._offsets = np.array([self._offset(tag, path, random) for path in paths])

    def draw(self, random: np.random.Generator) -> np.ndarray:
        """Return errors of the three axes."""
        return self._offsets + random.normal(size=3) * self.deviations

    @staticmethod
    def _offset(tag: SensorTag, path: str, random: np.random.Generator) -> float:
        deviation = tag.coefficient(f"{path}/bias_stddev", 0.0)
        bias = random.normal(tag.number(f"{path}/bias_mean", 0.0), deviation)
        # As in Gazebo, a bias is as likely to be negative.
        sign = 1.0 if random.random() < 0.5 else -1.0
        return tag.number(f"{path}/mean", 0.0) + sign * bias


class InertialUnit(Plugin):
    """What the two plugins have in common.

    Reports the orientation in the world (REP 145), the angular velocity and what accelerates in
    the sensor's own axes: the specific force (+9.8 m/s² along z at rest), or what changes the
    velocity (0 at rest) where `feels_gravity` is false. Frames have no prefix. gaussianNoise is
    the deviation of each component: in rad/s, in m/s², and in rad as a small turn of the
    orientation.
    """

    feels_gravity: ClassVar[bool] = True
    place: AttachedFrame
    reference: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def __init__(self, mount: Mount, frame: str, topic: str):
        super().__init__(mount)
        self._frame = frame
        self.imu = Output(mount.topic(topic), ImuSample)
        self.outputs = (self.imu,)
        self._deviation = mount.coefficient("gaussianNoise", 0.0)
        self._noise = mount.noise()
        self._accelerometer = Accelerometer()
        self._rate_noise: Optional[AxisNoise] = None
        self._force_noise: Optional[AxisNoise] = None
        self._step = 0

    def produce(self, step: int) -> None:
        self._step = step
        linear, angular = self.place.velocity()
        acceleration = self._accelerometer.advance(step, linear)
        if not self.imu.wanted:
            return
        pose = self.place.pose()
        into = Pose(quaternion=pose.inverse().quaternion)
        rate = np.array(into.rotate(angular))
        if self.feels_gravity:
            acceleration = subtract(acceleration, self.gravity)
        force = np.array(into.rotate(acceleration))
        orientation = (Pose(quaternion=self.reference) * pose).quaternion
        self.imu.send(self._reading(step, orientation, rate, force))

    def reset(self, step: int) -> None:
        self._step = step
        self.placed()

    def placed(self) -> None:
        self._accelerometer.restart(self._step, self.place.velocity()[0])

    def _reading(
        self, step: int, orientation: Quaternion, rate: np.ndarray, force: np.ndarray
    ) -> ImuSample:
        variance = self._deviation * self._deviation
        rate_variance = force_variance = variance
        random = self._noise.at(step)
        if self._deviation:
            orientation = _turned(orientation, random.normal(0.0, self._deviation, 3))
            rate = rate + random.normal(0.0, self._deviation, 3)
            force = force + random.normal(0.0, self._deviation, 3)
        if self._rate_noise is not None:
            rate = rate + self._rate_noise.draw(random)
            rate_variance += float(self._rate_noise.deviations.max()) ** 2
        if self._force_noise is not None:
            force = force + self._force_noise.draw(random)
            force_variance += float(self._force_noise.deviations.max()) ** 2
        measured = (orientation, tuple(rate.tolist()), tuple(force.tolist()))
        variances = (variance, rate_variance, force_variance)
        return ImuSample(step, self._frame, *measured, *variances)


class Imu(InertialUnit):
    """The plugin of a model, which names the link that it sits on.

    As in Gazebo it feels no gravity. There, rates and accelerations are turned by the orientation
    the wrong way round; here they are what the sensor's axes see. Nothing happens by the service.

    Attributes:
        service: name of that to calibrate it, which it need not be.
    """

    filenames = ("libgazebo_ros_imu.so",)
    feels_gravity = False

    def __init__(self, mount: Mount):
        body = mount.required("bodyName")
        frame = mount.text("frameName", body)
        super().__init__(mount, frame, mount.text("topicName", "/default_imu"))
        self.service = mount.topic(mount.text("serviceName", "/default_imu"))
        self.place = mount.attached(body, mount.offset())
        self.schedule = mount.schedule("updateRate", 0.0)


class ImuSensor(InertialUnit):
    """The plugin of an `<sensor type="imu">`."""

    filenames = ("libgazebo_ros_imu_sensor.so",)
    named_by_model = (True, False)

    def __init__(self, mount: Mount):
        tag = SensorTag(mount, ("imu",))
        frame = mount.required("frameName")
        super().__init__(mount, frame, mount.text("topicName", "imu_data"))
        self.place = tag.place(mount.offset())
        if mount.boolean("initialOrientationAsReference", False):
            self.reference = self.place.pose().inverse().quaternion
        self.schedule = slower_of(mount.schedule("updateRateHZ", 1.0), tag.schedule())
        if tag.has("imu/angular_velocity"):
            self._rate_noise = AxisNoise(mount, tag, "angular_velocity")
        if tag.has("imu/linear_acceleration"):
            self._force_noise = AxisNoise(mount, tag, "linear_acceleration")


def _turned(quaternion: Quaternion, turn: np.ndarray) -> Quaternion:
    """Return an orientation turned by a rotation vector (rad) in its own frame."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return quaternion
    x, y, z = (math.sin(0.5 * angle) / angle * turn).tolist()
    small = Pose(quaternion=(x, y, z, math.cos(0.5 * angle)))
    return (Pose(quaternion=quaternion) * small).quaternion
