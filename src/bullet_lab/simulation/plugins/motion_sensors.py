"""Sensors of motion: inertial units, the true pose of a link, and the states of joints.

libgazebo_ros_imu.so, libgazebo_ros_imu_sensor.so, libgazebo_ros_p3d.so and
libgazebo_ros_joint_state_publisher.so.
"""

from __future__ import annotations

import math
from collections import deque
from typing import ClassVar, Deque, Optional, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Quaternion, Vector, add, cross, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.plugins.plugin import (
    Mount,
    Output,
    Plugin,
    PluginError,
    SensorTag,
    slower_of,
)
from bullet_lab.simulation.plugins.samples import ImuSample, JointSample, MotionSample

WORLD_FRAMES = ("world", "/world", "map", "/map")
# Least number of steps over which accelerations are averaged.
AVERAGING = 10
AXES = ("x", "y", "z")


class Accelerometer:
    """Mean acceleration of a point, from its velocities.

    Bullet's contacts carry a body in small pushes, and each would appear as an acceleration. So
    this is the mean since the last reading, over 10 ms at least. Readings up to 100 Hz then add
    up to exactly the change of velocity, as those of a strapdown unit do. Faster ones overlap, as
    behind a low-pass filter with its first zero at 100 Hz, which real chips also have.
    """

    def __init__(self) -> None:
        self._past: Deque[Tuple[int, Vector]] = deque()

    def restart(self, step: int, velocity: Vector) -> None:
        """Start with a velocity in m/s."""
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
    """Noise of three axes by SDF's `<imu>`: gaussian with a mean, and a constant bias.

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
    """The base of the two inertial units.

    It reports the orientation in the world (REP 145), and in the sensor's axes the angular
    velocity and the specific force (+9.8 m/s² along z at rest). With `feels_gravity` false, it
    reports the acceleration instead (0 at rest). Frames have no prefix. gaussianNoise is the
    standard deviation of each component: in rad/s, in m/s², and in rad as a small turn of the
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
    """The plugin of a model, which names its link.

    As in Gazebo it feels no gravity. Gazebo turns rates and accelerations the wrong way round by
    the orientation; here they are in the sensor's axes. The service does nothing.

    Attributes:
        service: name of the service for calibration.
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


class TruePose(Plugin):
    """Reports the true pose and velocity of a link as odometry (p3d).

    As in Gazebo, the velocity is along the axes of frameName, not of the link. xyzOffset and
    rpyOffset move the reported pose within frameName, but not the point whose velocity is
    reported. gaussianNoise, the standard deviation in m/s and rad/s, is on the velocity alone,
    and its square is in both covariances.
    """

    filenames = ("libgazebo_ros_p3d.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        body, topic = mount.required("bodyName"), mount.required("topicName")
        self._child = mount.frame(body)
        self._place = mount.attached(body)
        frame = mount.text("frameName", WORLD_FRAMES[0])
        self._frame = mount.frame(frame)
        self._reference = None if frame in WORLD_FRAMES else mount.attached(frame)
        self._offset = mount.offset()
        self._deviation = mount.coefficient("gaussianNoise", 0.0)
        self._noise = mount.noise()
        self.odometry = Output(mount.topic(topic), MotionSample)
        self.outputs = (self.odometry,)
        self.schedule = mount.schedule("updateRate", 0.0)

    def produce(self, step: int) -> None:
        if not self.odometry.wanted:
            return
        pose, linear, angular = self._motion()
        shifted = add(pose.position, self._offset.position)
        moved = Pose(shifted, (self._offset * pose).quaternion)
        if self._deviation:
            errors = self._noise.at(step).normal(0.0, self._deviation, 6).tolist()
            linear, angular = add(linear, errors[:3]), add(angular, errors[3:])
        frames, variance = (self._frame, self._child), self._deviation * self._deviation
        self.odometry.send(MotionSample(step, *frames, moved, linear, angular, variance))

    def _motion(self) -> Tuple[Pose, Vector, Vector]:
        """Return pose, linear and angular velocity in the frame of reference."""
        pose, (linear, angular) = self._place.pose(), self._place.velocity()
        if self._reference is None:
            return pose, linear, angular
        frame, (base, spin) = self._reference.pose(), self._reference.velocity()
        # The velocity of the frame of reference at the place of the link: base + spin x arm.
        carried = add(base, cross(spin, subtract(pose.position, frame.position)))
        into = Pose(quaternion=frame.inverse().quaternion)
        moves = (into.rotate(subtract(linear, carried)), into.rotate(subtract(angular, spin)))
        return (frame.inverse() * pose, *moves)


class JointStates(Plugin):
    """Reports positions and velocities of joints."""

    filenames = ("libgazebo_ros_joint_state_publisher.so",)
    named_by_model = (True, True)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._body = mount.body
        known = self._body.joint_names
        listed = [name.strip() for name in mount.text("jointName").split(",")]
        self._names = tuple(name for name in listed if name) or known
        missing = [name for name in self._names if name not in known]
        if missing:
            raise PluginError(f"{mount.where('jointName')}: no movable joint '{missing[0]}'")
        self.states = Output(mount.topic("joint_states"), JointSample)
        self.outputs = (self.states,)
        self.schedule = mount.schedule("updateRate", 100.0)

    def produce(self, step: int) -> None:
        if not self._names or not self.states.wanted:
            return
        states = [self._body.joint_state(name) for name in self._names]
        positions, velocities = zip(*((state.position, state.velocity) for state in states))
        # Without efforts, as in Gazebo.
        self.states.send(JointSample(step, self._names, positions, velocities))
