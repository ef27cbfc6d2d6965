"""Robots that take velocity commands and send odometry: the base, planar_move and force_based_move.

libgazebo_ros_planar_move.so, libgazebo_ros_force_based_move.so and copies of the latter. The drives
on wheels are in `wheel_drives`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Iterable

from bullet_lab.core.pose import Pose, Quaternion, Vector, heading_of
from bullet_lab.core.schedule import STEPS_PER_SECOND, WaitingSchedule
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins import Device, Mount, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.samples import (
    STANDSTILL,
    Diagonal,
    OdometrySample,
    PlanarCommand,
    TransformSample,
    is_sound,
)
from bullet_lab.simulation.world.description import Link

# Variance of what the odometry does not know, as in Gazebo.
UNKNOWN = 1e12
POSE_VARIANCES = (1e-5, 1e-5, UNKNOWN, UNKNOWN, UNKNOWN, 1e-3)
# Bullet's contact carries a body in small pushes; the load is their mean over about 20 steps.
LOAD_SMOOTHING = 0.05
STEP_SQUARED = STEP_SECONDS * STEP_SECONDS


class OdometrySender(Device):
    """Sends odometry, and its transform if `sends_transforms`; `frames` are the two of both."""

    frames: tuple[str, str]
    odometry: Output
    transform: Output
    sends_transforms = True

    def send_odometry(
        self, step: int, pose: Pose, velocity: PlanarCommand, *variances: Diagonal, flat: bool
    ) -> None:
        """Send a pose as odometry, flat with z = 0, and as transform."""
        if self.odometry.wanted:
            x, y, z = pose.position
            seen = Pose((x, y, 0.0 if flat else z), pose.quaternion)
            self.odometry.send(OdometrySample(step, *self.frames, seen, velocity, *variances))
        if self.sends_transforms and self.transform.wanted:
            self.transform.send(TransformSample(step, *self.frames, pose))


class MobileBase(Plugin, OdometrySender):
    """A robot that takes velocity commands, and sends odometry and its transform.

    Attributes:
        directions: the components of a command that it uses.
        command_topic: the default of their topic.
        base_frame: the default of the robot's frame.
    """

    directions = ("vx", "wz")
    command_topic = "cmd_vel"
    base_frame = "base_footprint"

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._body = mount.body
        root = mount.model.root_links()[0].pose
        self._in_root = None if root == Pose() else root.inverse()
        odom = mount.frame(mount.text("odometryFrame", "odom"))
        self.frames = (odom, mount.frame(mount.text("robotBaseFrame", self.base_frame)))
        self.odometry = self.output(mount.text("odometryTopic", "odom"), OdometrySample)
        topic = mount.text("commandTopic", self.command_topic)
        self.input(topic, PlanarCommand, self.command)

    def command(self, command: PlanarCommand) -> None:
        """Take over a velocity; it acts from the next update on.

        Raises PluginError if it is not finite or too large; the last command stays.
        """
        if not is_sound(*(getattr(command, name) for name in self.directions)):
            raise PluginError(f"the velocity {command} is not finite, or too large")
        self._command = command

    def reset(self, step: int) -> None:
        self._command = STANDSTILL
        self._last_step = step
        self.placed()

    def _pose(self) -> Pose:
        """Return the pose of the model's frame in the world; its first link's may differ."""
        pose = self._body.pose()
        return pose if self._in_root is None else pose * self._in_root


def upright(pose: Pose) -> Pose:
    """Return a pose without roll and pitch."""
    return Pose.from_rpy(pose.position, (0.0, 0.0, pose.yaw))


@dataclass(frozen=True)
class SupportPatch:
    """The contact of a planar_move robot that names a <supportRadius> with the floor.

    It is one round patch (`docs/contact_model.md`), with the ellipsoidal limit surface of Howe and
    Cutkosky (1996, "Practical force-motion models for sliding manipulation"): force F and moment M
    about the vertical satisfy (F/μN)² + (M/μNr)² = 1, with N the load and r the effective radius
    of the patch, and oppose the slip.

    `friction` is Coulomb's coefficient μ, `radius` the effective radius r in m; a disc of radius R
    under even pressure has 2R/3. Mass (kg) and inertia (kg m², about the vertical through the
    centre of mass) are those of the robot.
    """

    friction: float
    radius: float
    mass: float
    inertia: float

    def slow_down(
        self, vx: float, vy: float, wz: float, load: float, dt: float
    ) -> tuple[float, float, float]:
        """Return the velocity (m/s, m/s, rad/s) that friction leaves after a short time `dt` (s).

        The `load` on the floor is in N. Friction brings the robot to rest and never reverses it.

        >>> patch = SupportPatch(friction=1.0, radius=0.01, mass=2.0, inertia=0.1)
        >>> vx, vy, wz = patch.slow_down(0.5, 0.0, 0.0, load=19.6, dt=1e-3)
        >>> round(vx, 9), vy, wz
        (0.4902, 0.0, 0.0)
        """
        spin = self.radius * wz
        slip = math.sqrt(vx * vx + vy * vy + spin * spin)
        if slip == 0.0 or load <= 0.0:
            return vx, vy, wz
        impulse = self.friction * load * dt / slip
        keep_linear = max(0.0, 1.0 - impulse / self.mass)
        keep_angular = max(0.0, 1.0 - impulse * self.radius * self.radius / self.inertia)
        return keep_linear * vx, keep_linear * vy, keep_angular * wz


class PlanarMove(MobileBase):
    """Moves the robot as commanded, and sends its true pose as odometry.

    Before each step the body gets the last commanded velocity, turned by its yaw, without roll,
    pitch and vertical velocity. In the step, the friction of what bears the robot takes some of
    it away. So a robot in the air does not fall but sinks at g·dt, 1 cm/s, as in Gazebo; without
    a floor under it, no friction slows it down. A robot that names a <supportRadius>, unknown to
    Gazebo, has the friction of a `SupportPatch` instead. The command stays until the next one, or
    until `cmdTimeout` seconds have passed.
    """

    filenames = ("libgazebo_ros_planar_move.so",)
    acts = True
    directions = ("vx", "vy", "wz")

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self.transform = self.output("/tf", TransformSample)
        timeout = mount.number("cmdTimeout", -1.0)
        self._timeout = math.inf if timeout < 0.0 else round(timeout * STEPS_PER_SECOND)
        mount.require_moving()
        self._patch = _support_patch(mount)
        if self._patch is not None:
            self._body.remove_sliding_friction()
        self._set_velocity = self._body.set_velocity
        # gazebo_ros_planar_move.cpp:220
        waiting = partial(WaitingSchedule, beyond=True)
        self.schedule = mount.schedule("odometryRate", 20.0, waiting)
        self._body.commanded_velocity = self._commanded_velocity

    def command(self, command: PlanarCommand) -> None:
        """Take over a velocity; it acts from the next step on, until the timeout."""
        super().command(command)
        self._expires = self._now + self._timeout

    def before_step(self, step: int) -> None:
        self._now = step + 1
        command = self._command
        if step >= self._expires:
            command = STANDSTILL
        (_, _, height), quaternion = self._body.last_place
        vx, vy, wz = command.vx, command.vy, command.wz
        if self._patch is not None:
            vx, vy, wz = self._patch.slow_down(vx, vy, wz, self._load_now(height), STEP_SECONDS)
        if self._body.turned_inertia:
            quaternion = self._body.pose().quaternion
        self._set_velocity(*_in_world(vx, vy, wz, quaternion))

    def _load_now(self, height: float) -> float:
        """Return the load (N) on the floor, with the centre of mass at a height (m)."""
        # By Newton's law: the body started the last step without vertical velocity, so the floor
        # has carried what did not become a fall.
        carried = self._patch.mass * (self._pull() + (height - self._height) / STEP_SQUARED)
        self._height = height
        self._load += LOAD_SMOOTHING * (carried - self._load)
        return self._load

    def _pull(self) -> float:
        """Return the downward acceleration (m/s²) by gravity."""
        return -self.mount.simulation.world.gravity[2] * self._body.weight

    def _commanded_velocity(self) -> tuple[Vector, Vector]:
        """Return the velocity that the body gets before friction acts, in the world."""
        command = STANDSTILL if self._now >= self._expires else self._command
        quaternion = self._body.pose().quaternion
        return _in_world(command.vx, command.vy, command.wz, quaternion)

    def produce(self, step: int) -> None:
        pose, before = self._pose(), self._last_pose
        seconds = (step - self._last_step) / STEPS_PER_SECOND
        self._last_step, self._last_pose = step, pose
        velocity = STANDSTILL
        if seconds > 0.0:
            # The mean velocity since the last sample, in the robot's present frame.
            (x, y, yaw), (last_x, last_y, last_yaw) = pose.planar, before.planar
            ahead, left = along(pose.quaternion, x - last_x, y - last_y)
            turned = math.remainder(yaw - last_yaw, math.tau)
            velocity = PlanarCommand(ahead / seconds, left / seconds, turned / seconds)
        self.send_odometry(step, pose, velocity, POSE_VARIANCES, flat=True)

    def reset(self, step: int) -> None:
        self._now, self._expires = step, math.inf
        super().reset(step)

    def placed(self) -> None:
        self._last_pose = self._pose()
        self._height = self._body.com_pose().position[2]
        if self._patch is not None:
            self._load = self._patch.mass * self._pull()


class ForceBasedMove(PlanarMove):
    """Pushes the robot towards the commanded velocity; otherwise as planar_move.

    A force and a torque act on its first link, in proportion to the velocity that is missing. So
    it falls, leans and slides as other bodies do, and its wheels should have no friction. The
    odometry starts at zero where the robot starts.

    Attributes:
        origin: pose of the odometry's frame in the world.
    """

    filenames = (
        "libgazebo_ros_force_based_move.so",
        "libridgeback_ros_force_based_move.so",
        "libnexus_ros_force_based_move.so",
    )

    def __init__(self, mount: Mount):
        super().__init__(mount)
        # N for each m/s ahead and to the left; N m for each rad/s.
        self._ahead = mount.number("x_velocity_p_gain", 1e4)
        self._left = mount.number("y_velocity_p_gain", 1e4)
        self._turn = mount.number("yaw_velocity_p_gain", 100.0)
        self._timeout = STEPS_PER_SECOND * mount.number("cmdVelTimeOut", 1e6)
        if not mount.boolean("publishOdometryTf", True):
            self.outputs = (self.odometry,)
        self._body.commanded_velocity = None
        self._set_velocity = self._push

    def _pose(self) -> Pose:
        """Return the pose in the odometry's frame, on its plane."""
        return Pose.on_floor(*(self.origin.inverse() * super()._pose()).planar)

    def reset(self, step: int) -> None:
        self._last_pose = Pose()
        super().reset(step)

    def placed(self) -> None:
        # The odometry goes on from its last pose.
        self.origin = upright(super()._pose()) * self._last_pose.inverse()
        super().placed()

    def _push(self, linear: Vector, angular: Vector) -> None:
        """Push towards a velocity in the world (m/s, rad/s)."""
        place, (now, spin) = self._body.com_pose(), self._body.velocity()
        ahead, left = along(place.quaternion, linear[0] - now[0], linear[1] - now[1])
        push = (self._ahead * ahead, self._left * left, self._turn * (angular[2] - spin[2]))
        pushes = _in_world(*push, place.quaternion)
        self._body.push(self._body.links[0].name, *pushes, place.position)


def mass_of(links: Iterable[Link]) -> float:
    """Return the mass of links in kg."""
    return sum(link.inertia.mass for link in links if link.inertia is not None)


def along(quaternion: Quaternion, x: float, y: float) -> tuple[float, float]:
    """Return the parts of a vector in the world ahead and to the left of a robot."""
    cosine, sine = heading_of(quaternion)
    return cosine * x + sine * y, cosine * y - sine * x


def _in_world(
    ahead: float, left: float, wz: float, quaternion: Quaternion
) -> tuple[Vector, Vector]:
    """Return velocities or forces of a robot, linear and angular, turned into the world."""
    cosine, sine = heading_of(quaternion)
    return (cosine * ahead - sine * left, sine * ahead + cosine * left, 0.0), (0.0, 0.0, wz)


def _support_patch(mount: Mount) -> SupportPatch | None:
    """Return the patch of a robot that names its radius, with its root link's least friction."""
    root = mount.model.root_links()[0]
    if root.inertia is None:
        raise PluginError(f"{mount.name()}: its first link cannot move")
    if not mount.text("supportRadius", ""):
        return None
    friction = min((c.friction for c in root.collisions), default=1.0)
    radius, mass = mount.coefficient("supportRadius"), mass_of(mount.model.links)
    return SupportPatch(friction, radius, mass, float(root.inertia.matrix[2, 2]))
