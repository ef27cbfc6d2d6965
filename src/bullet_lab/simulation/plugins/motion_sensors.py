"""Sensors of motion: inertial units, the true pose of a link, and the states of joints.

libgazebo_ros_imu.so, libgazebo_ros_imu_sensor.so, libgazebo_ros_p3d.so and
libgazebo_ros_joint_state_publisher.so.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from bullet_lab.core.pose import Pose, Quaternion, Vector, add, cross, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND, WaitingSchedule
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.plugins import Mount, PluginError, Sensor, SensorTag
from bullet_lab.simulation.plugins.samples import ImuSample, JointSample, MotionSample

WORLD_FRAMES = ("world", "/world", "map", "/map")
# Least number of steps over which accelerations are averaged.
AVERAGING = 10
AXES = ("x", "y", "z")
# Elements of `<imu>` that may have noise, in the order of the readings.
QUANTITIES = ("angular_velocity", "linear_acceleration")


def mounting_offset(mount: Mount) -> Pose:
    """Return the pose in the tags xyzOffset (m) and rpyOffset (rad) of a plugin."""
    return Pose.from_rpy(mount.vector("xyzOffset"), mount.vector("rpyOffset"))


def _axis_noise(mount: Mount, tag: SensorTag, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the constant errors of three axes by SDF's `<imu>`, and the deviations of others.

    `quantity` is one of QUANTITIES.
    """
    random = mount.noise(f"/{quantity}").at(0)
    offsets, deviations = [], []
    for path in (f"imu/{quantity}/{axis}/noise" for axis in AXES):
        spread = tag.coefficient(f"{path}/bias_stddev")
        bias = random.normal(tag.number(f"{path}/bias_mean"), spread)
        # As in Gazebo, a bias is as likely to be negative.
        sign = 1.0 if random.random() < 0.5 else -1.0
        offsets.append(tag.number(f"{path}/mean") + sign * bias)
        deviations.append(tag.coefficient(f"{path}/stddev"))
    return np.array(offsets), np.array(deviations)


class InertialUnit(Sensor):
    """The base of the two inertial units.

    It reports the orientation in the world (REP 145), and in the sensor's axes the angular
    velocity and the specific force (+9.8 m/s² along z at rest). With `feels_gravity` false, it
    reports the acceleration instead (0 at rest). Frames have no prefix. gaussianNoise is the
    standard deviation of each component: in rad/s, in m/s², and in rad as a small turn of the
    orientation.

    Bullet's contacts carry a body in small pushes, and each would appear as an acceleration. So
    the acceleration is the mean since the last reading, over 10 ms at least. Readings up to 100 Hz
    then add up to exactly the change of velocity, as those of a strapdown unit do. Faster ones
    overlap, as behind a low-pass filter with its first zero at 100 Hz, which real chips also have.

    Attributes:
        place: of the sensor.
        reference: the quaternion that turns the world's axes into those of the orientation.
        axis_noise: constant errors and deviations by the index of a quantity in QUANTITIES.
    """

    feels_gravity = True
    before_friction = False
    place: AttachedFrame
    reference: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def __init__(self, mount: Mount, frame: str, topic: str):
        super().__init__(mount, topic, ImuSample)
        self._frame = frame
        self._deviation = mount.coefficient("gaussianNoise")
        self.axis_noise: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._step = 0
        # The last steps, each with the velocity then (m/s).
        self._past: deque[tuple[int, Vector]] = deque()

    def produce(self, step: int) -> None:
        self._step = step
        linear, self._angular = self.place.velocity(self.before_friction)
        past = self._past
        past.append((step, linear))
        while len(past) > 2 and step - past[1][0] >= AVERAGING:
            past.popleft()
        since, before = past[0]
        # At the step of a reset, both are the same.
        seconds = max(step - since, 1) / STEPS_PER_SECOND
        self._acceleration = tuple((now - then) / seconds for now, then in zip(linear, before))
        super().produce(step)

    def reset(self, step: int) -> None:
        self._step = step
        self.placed()

    def placed(self) -> None:
        self._past.clear()
        self._past.append((self._step, self.place.velocity(self.before_friction)[0]))

    def measure(self, step: int) -> ImuSample:
        pose = self.place.pose()
        into = pose.inverse()
        acceleration = self._acceleration
        if self.feels_gravity:
            acceleration = subtract(acceleration, self.mount.simulation.world.gravity)
        orientation = (Pose(quaternion=self.reference) * pose).quaternion
        readings = np.array([into.rotate(self._angular), into.rotate(acceleration)])
        variance = self._deviation * self._deviation
        variances = [variance, variance]
        random = self._noise.at(step)
        if self._deviation:
            orientation = _turned(orientation, random.normal(0.0, self._deviation, 3))
            readings += random.normal(0.0, self._deviation, (2, 3))
        for index, (offsets, deviations) in self.axis_noise.items():
            readings[index] += offsets + random.normal(size=3) * deviations
            variances[index] += float(deviations.max()) ** 2
        motion = map(tuple, readings.tolist())
        return ImuSample(step, self._frame, orientation, *motion, variance, *variances)


class Imu(InertialUnit):
    """The plugin of a model, which names its link.

    As in Gazebo it feels no gravity, and measures before friction acts in a step: of a planar_move
    robot it tells the commanded velocity. Gazebo turns rates and accelerations the wrong way round
    by the orientation; here they are in the sensor's axes. The service does nothing.

    Attributes:
        service: name of the service for calibration.
    """

    filenames = ("libgazebo_ros_imu.so",)
    feels_gravity = False
    before_friction = True

    def __init__(self, mount: Mount):
        body = mount.required("bodyName")
        frame = mount.text("frameName", body)
        super().__init__(mount, frame, mount.text("topicName", "/default_imu"))
        self.service = mount.topic(mount.text("serviceName", "/default_imu"))
        self.place = mount.attached(body, mounting_offset(mount))
        self.schedule = mount.schedule("updateRate", 0.0, WaitingSchedule)


class ImuSensor(InertialUnit):
    """The plugin of an `<sensor type="imu">`."""

    filenames = ("libgazebo_ros_imu_sensor.so",)
    named_by_model = (True, False)

    def __init__(self, mount: Mount):
        tag = SensorTag(mount, ("imu",))
        frame = mount.required("frameName")
        super().__init__(mount, frame, mount.text("topicName", "imu_data"))
        self.place = tag.place(mounting_offset(mount))
        if mount.boolean("initialOrientationAsReference", False):
            self.reference = self.place.pose().inverse().quaternion
        self.schedule = tag.slower("updateRateHZ", 1.0)
        for index, quantity in enumerate(QUANTITIES):
            if tag.element.find(f"imu/{quantity}") is not None:
                self.axis_noise[index] = _axis_noise(mount, tag, quantity)


def _turned(quaternion: Quaternion, turn: np.ndarray) -> Quaternion:
    """Return an orientation turned by a rotation vector (rad) in its own frame."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return quaternion
    x, y, z = (math.sin(0.5 * angle) / angle * turn).tolist()
    small = Pose(quaternion=(x, y, z, math.cos(0.5 * angle)))
    return (Pose(quaternion=quaternion) * small).quaternion


class TruePose(Sensor):
    """Reports the true pose and velocity of a link as odometry (p3d).

    As in Gazebo, the velocity is along the axes of frameName, not of the link, and that before
    friction acts in a step: of a planar_move robot, the commanded one. xyzOffset and
    rpyOffset move the reported pose within frameName, but not the point whose velocity is
    reported. gaussianNoise, the standard deviation in m/s and rad/s, is on the velocity alone,
    and its square is in both covariances.
    """

    filenames = ("libgazebo_ros_p3d.so",)

    def __init__(self, mount: Mount):
        body, topic = mount.required("bodyName"), mount.required("topicName")
        super().__init__(mount, topic, MotionSample)
        self._place = mount.attached(body)
        frame = mount.text("frameName", WORLD_FRAMES[0])
        self._frames = (mount.frame(frame), mount.frame(body))
        self._reference = None if frame in WORLD_FRAMES else mount.attached(frame)
        self._offset = mounting_offset(mount)
        self._deviation = mount.coefficient("gaussianNoise")
        self.schedule = mount.schedule("updateRate", 0.0, WaitingSchedule)

    def measure(self, step: int) -> MotionSample:
        pose, (linear, angular) = self._place.pose(), self._place.velocity(before_friction=True)
        if self._reference is not None:
            frame = self._reference.pose()
            base, spin = self._reference.velocity(before_friction=True)
            # The velocity of the frame at the place of the link: base + spin x arm.
            carried = add(base, cross(spin, subtract(pose.position, frame.position)))
            into = frame.inverse()
            linear = into.rotate(subtract(linear, carried))
            angular = into.rotate(subtract(angular, spin))
            pose = into * pose
        shifted = add(pose.position, self._offset.position)
        moved = Pose(shifted, (self._offset * pose).quaternion)
        if self._deviation:
            errors = self._noise.at(step).normal(0.0, self._deviation, 6).tolist()
            linear, angular = add(linear, errors[:3]), add(angular, errors[3:])
        variance = self._deviation * self._deviation
        return MotionSample(step, *self._frames, moved, linear, angular, variance)


class JointStatePublisher(Sensor):
    """Reports positions and velocities of joints."""

    filenames = ("libgazebo_ros_joint_state_publisher.so",)
    named_by_model = (True, True)

    def __init__(self, mount: Mount):
        super().__init__(mount, "joint_states", JointSample)
        self._body = mount.body
        known = self._body.joint_names
        listed = [name.strip() for name in mount.text("jointName").split(",")]
        self._names = tuple(filter(None, listed)) or known
        for name in self._names:
            if name not in known:
                raise PluginError(f"{mount.where('jointName')}: no movable joint '{name}'")
        self.schedule = mount.schedule("updateRate", 100.0)

    def produce(self, step: int) -> None:
        if self._names:
            super().produce(step)

    def measure(self, step: int) -> JointSample:
        states = map(self._body.joint_state, self._names)
        # Without efforts, as in Gazebo.
        turns = zip(*((state.position, state.velocity) for state in states))
        return JointSample(step, self._names, *turns)
