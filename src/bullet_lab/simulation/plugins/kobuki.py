"""libgazebo_ros_kobuki.so: the base of a TurtleBot2, with its sensors."""

from __future__ import annotations

import math
from dataclasses import replace

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins import Mount, Output, SensorTag
from bullet_lab.simulation.plugins.mobile_base import MobileBase
from bullet_lab.simulation.plugins.motion_sensors import InertialUnit
from bullet_lab.simulation.plugins.ray_sensors import RayScan, watched_shapes
from bullet_lab.simulation.plugins.samples import (
    STANDSTILL,
    BumperEvent,
    CliffEvent,
    ImuSample,
    JointSample,
    MotorPower,
    PlanarCommand,
    SwitchesSample,
    TransformSample,
    Trigger,
    WheelDropEvent,
)
from bullet_lab.simulation.plugins.wheel_drives import Wheel, wheel_joint

PREFIX = "mobile_base"
SIDES = ("left", "center", "right")
# Variances of the odometry and of the gyroscope, as the robot's driver has them: 1e6 for unknown.
POSE_VARIANCES = (0.1, 0.1, 1e6, 1e6, 1e6, 0.05)
GYRO_VARIANCES = (1e6, 1e6, 0.05)
# Contacts at these heights (m) above the robot's frame press a bumper.
BUMPER_HEIGHTS = (0.01, 0.13)
# Contacts whose normal is steeper than this (z of the unit normal) press none.
STEEPEST = 0.99
# Half of the angle (rad) of the bumper in the middle; the others reach to the sides.
HALF_BUMPER = math.pi / 6.0
# The reading of a cliff sensor's converter at a distance d (m) is FACTOR · atan2(OFFSET, d).
FACTOR, OFFSET = 76123.0, 0.995


class Gyroscope(InertialUnit):
    """The inertial unit of a Kobuki."""

    def __init__(self, mount: Mount, tag: SensorTag):
        super().__init__(mount, mount.frame("base_link"), f"{PREFIX}/sensors/imu_data")
        self.place = tag.place()

    def measure(self, step: int) -> ImuSample:
        sample = super().measure(step)
        known = dict.fromkeys(("orientation_variance", "angular_velocity_variance"), GYRO_VARIANCES)
        return replace(sample, **known, specific_force_variance=0.0)


class Switches:
    """The switches of one kind, from left to right; a change is sent as an event."""

    def __init__(self, output: Output, count: int):
        self._output = output
        self.states = [False] * count

    def set(self, step: int, number: int, on: bool, reading: int = 0) -> None:
        """Set a switch, at the simulated time `step`."""
        if self.states[number] != on:
            self.states[number] = on
            self._output.send(self._output.kind(step, number, on, reading))

    def total(self) -> int:
        """Return the switches as a sum of powers of two; the rightmost one counts 1."""
        return sum(on << place for place, on in enumerate(reversed(self.states)))


class Kobuki(MobileBase):
    """Drives two wheels until a timeout, and reports odometry, bumpers, cliffs and wheel drops.

    Odometry has distances of the wheels, and headings of the gyroscope, as the real robot's.
    """

    filenames = ("libgazebo_ros_kobuki.so",)
    command_topic = f"{PREFIX}/commands/velocity"
    acts = True

    def __init__(self, mount: Mount):
        mount.require_moving()
        super().__init__(mount)
        sizes = (mount.sizes(tag, 1)[0] for tag in ("wheel_separation", "wheel_diameter", "torque"))
        self._separation, diameter, torque = sizes
        self._radius = 0.5 * diameter
        (timeout,) = mount.numbers("velocity_command_timeout", 1)
        self._timeout = round(timeout * STEPS_PER_SECOND)
        tags = ("left_wheel_joint_name", "right_wheel_joint_name")
        joints = [wheel_joint(mount, tag, "").name for tag in tags]
        self._wheels = [Wheel(self._body, joint, torque) for joint in joints]
        self.transform = self.output("/tf", TransformSample, mount.boolean("publish_tf", False))
        self._joint_states = self.output("joint_states", JointSample)
        self._core = self.output(f"{PREFIX}/sensors/core", SwitchesSample)
        self.input(f"{PREFIX}/commands/motor_power", MotorPower, self._switch_motors)
        self.input(f"{PREFIX}/commands/reset_odometry", Trigger, self._zero)
        self._find_sensors()
        self.outputs += self._gyroscope.outputs
        self.schedule = mount.schedule("update_rate", 0.0)

    def _find_sensors(self) -> None:
        mount = self.mount
        imu = mount.sensor("imu_name", "imu")
        self._gyroscope = Gyroscope(mount, imu)
        self._sensing = imu.schedule("update_rate", 0.0)
        (self._threshold,) = mount.numbers("cliff_detection_threshold", 1)
        cliffs = [mount.sensor(f"cliff_sensor_{side}_name", "ray") for side in SIDES]
        self._cliff_rays = [RayScan(mount, tag) for tag in cliffs]
        bumper = mount.sensor("bumper_name", "contact")
        link = bumper.place().link
        self._bumper_links = self._body.link_indices(link)
        self._watched = watched_shapes(mount, bumper, link)
        tags = [f"wheel_drop_{side}_sensor_name" for side in ("left", "right")]
        # Descriptions before October 2023 have no such sensors.
        given = tags if any(map(mount.text, tags)) else []
        treads = [mount.sensor(tag, "contact").place().link for tag in given]
        # The number of the wheel by PyBullet's index of each of its links.
        self._tread_links = {
            index: n for n, link in enumerate(treads) for index in self._body.link_indices(link)
        }
        events = f"{PREFIX}/events"
        self._bumpers = Switches(self.output(f"{events}/bumper", BumperEvent), len(SIDES))
        self._cliffs = Switches(self.output(f"{events}/cliff", CliffEvent), len(SIDES))
        self._drops = Switches(self.output(f"{events}/wheel_drop", WheelDropEvent), len(treads))

    def command(self, command: PlanarCommand) -> None:
        super().command(command)
        self._commanded_at = self._now

    def _switch_motors(self, power: MotorPower) -> None:
        self._has_power = power.on

    def _zero(self, _command: Trigger) -> None:
        self._x = self._y = self._yaw = 0.0

    def reset(self, step: int) -> None:
        self._now = self._commanded_at = step
        self._has_power = True
        self._zero(Trigger())
        self._sensing.restart(step)
        self._turn_rate = 0.0
        self._gyroscope.reset(step)
        self._pressed, self._standing = set(), set()
        super().reset(step)

    def placed(self) -> None:
        self._angles = [wheel.angle for wheel in self._wheels]
        self._gyroscope.placed()
        for wheel in self._wheels:
            wheel.stop()

    def before_step(self, step: int) -> None:
        self._now = step
        if step - self._commanded_at > self._timeout or not self._has_power:
            self._command = STANDSTILL
        for wheel, speed in zip(self._wheels, self._command.rims(self._separation)):
            wheel.keep(speed / self._radius)
        # What touched something in the step before: wheels and bumpers.
        for _, body, _, link, _, place, _, normal, *_ in self._body.touching_points():
            if link in self._tread_links:
                self._standing.add(self._tread_links[link])
            # What lies below or above presses no bumper.
            elif link in self._bumper_links and abs(normal[2]) < STEEPEST:
                shape = self.mount.simulation.shape_name(body, link, place)
                self._press(shape, place, normal)

    def produce(self, step: int) -> None:
        seconds = (step - self._last_step) / STEPS_PER_SECOND
        self._last_step = step
        frame = self.mount.frame("base_link")
        if self._joint_states.wanted:
            states = ((wheel.joint, wheel.state()) for wheel in self._wheels)
            rows = ((joint, state.position, state.velocity, 0.0) for joint, state in states)
            self._joint_states.send(JointSample(step, *zip(*rows), frame))
        if self._sensing.next_step <= step:
            self._sense(step)
        self._report(step, seconds)
        if self._core.wanted:
            totals = (one.total() for one in (self._bumpers, self._cliffs, self._drops))
            self._core.send(SwitchesSample(step, frame, *totals))

    def _sense(self, step: int) -> None:
        """Read all sensors, and send what has changed."""
        while self._sensing.next_step <= step:
            self._sensing.advance()
        self._gyroscope.produce(step)
        self._turn_rate = self._gyroscope.measure(step).angular_velocity[2]
        for number, rays in enumerate(self._cliff_rays):
            distance = float(rays.distances()[0])
            # The field of the message has 16 bits.
            reading = int(FACTOR * math.atan2(OFFSET, distance)) & 0xFFFF
            self._cliffs.set(step, number, distance >= self._threshold, reading)
        for number in range(len(SIDES)):
            self._bumpers.set(step, number, number in self._pressed)
        for number in range(len(self._drops.states)):
            self._drops.set(step, number, number not in self._standing)
        self._pressed.clear()
        self._standing.clear()

    def _press(self, shape: str, place: Vector, normal: Vector) -> None:
        """Press the bumper at a contact (m, world) of a shape; the normal points to the robot."""
        pose = self._pose()
        ahead, left, _ = pose.inverse().rotate(normal)
        angle = math.atan2(-left, -ahead)
        is_high = BUMPER_HEIGHTS[0] <= place[2] - pose.position[2] <= BUMPER_HEIGHTS[1]
        if shape in self._watched and is_high and abs(angle) <= 3.0 * HALF_BUMPER:
            self._pressed.add(1 if abs(angle) <= HALF_BUMPER else 0 if angle > 0.0 else 2)

    def _report(self, step: int, seconds: float) -> None:
        """Send the odometry, `seconds` after the last time."""
        angles = [wheel.angle for wheel in self._wheels]
        driven = 0.5 * self._radius * sum(new - old for new, old in zip(angles, self._angles))
        self._angles = angles
        self._x += driven * math.cos(self._yaw)
        self._y += driven * math.sin(self._yaw)
        self._yaw = math.remainder(self._yaw + self._turn_rate * seconds, math.tau)
        pose = Pose.on_floor(self._x, self._y, self._yaw)
        speed = driven / seconds if seconds > 0.0 else 0.0
        velocity = PlanarCommand(vx=speed, wz=self._turn_rate)
        self.send_odometry(step, pose, velocity, POSE_VARIANCES, flat=True)
