"""Robots on driven wheels: differential drive, skid steer with four wheels, and tricycles.

libgazebo_ros_diff_drive.so, libgazebo_ros_skid_steer_drive.so and libgazebo_ros_tricycle_drive.so.
"""

from __future__ import annotations

import logging
import math
from typing import Sequence, Tuple

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.drive import clip
from bullet_lab.simulation.physics.bodies import Body, JointState
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.physics.surfaces import GRAVITY
from bullet_lab.simulation.plugins import Mount, PluginError
from bullet_lab.simulation.plugins.mobile_base import (
    POSE_VARIANCES,
    UNKNOWN,
    MobileBase,
    along,
    mass_of,
    upright,
)
from bullet_lab.simulation.plugins.samples import (
    STANDSTILL,
    JointSample,
    PlanarCommand,
    TransformSample,
)
from bullet_lab.simulation.world.description import Joint, Link

LOG = logging.getLogger(__name__)

# A wheel below this speed (rad/s) counts as stopped. The solver's residual is about 3e-4 rad/s.
STANDING = 0.01
# A rim at this distance (m/s) from its wanted speed, or nearer, gets that speed at once.
NEAR = 0.01
# How fast hard wheels creep in Gazebo, whose solver does not converge, as fitted to 92 robots; see
# `docs/contact_model.md`. As a share of g·dt, at the rim speed below and friction at its limit:
CREEP = 1.9
# The same for each time that the body has the mass of its wheels.
CREEP_BY_MASS = 0.4
# m/s, and the exponent of the rim speed.
CREEP_SPEED, CREEP_EXPONENT = 0.1, 0.7
# Wheels with less than this share of the friction that they can have do not creep.
CREEP_SHARE = 0.4
# Effort (N m) that turns the fork of a tricycle to its angle at once.
STRONGEST = 1e6
# Of the left and the right wheels.
Pair = Tuple[float, float]
WHEEL_JOINTS = ("continuous", "revolute")


class Wheel:
    """A joint that is driven at a speed, with limited torque (N m).

    A wheel that was commanded to stop and has stopped is held at its angle and sticks to the
    floor, like a brake: with speed control alone the robot creeps at 0.04 mm/s, and with friction
    alone at 0.02 mm/s, because the engine solves both to a tolerance. A push beyond the torque or
    friction still moves the wheel; it is held again where it stops.
    """

    def __init__(self, body: Body, joint: str, torque: float):
        self.joint = joint
        self._body = body
        self._torque = torque
        self.stop()

    def state(self) -> JointState:
        """Return angle, speed and torque."""
        return self._body.joint_state(self.joint)

    @property
    def angle(self) -> float:
        """The angle in rad."""
        return self.state().position

    def stop(self) -> None:
        """Drive at speed 0, at once."""
        self._speed = 0.0
        self._release()

    def follow(self, speed: float) -> None:
        """Drive at a speed in rad/s."""
        self._speed = speed
        if speed != 0.0 or abs(self.state().velocity) > STANDING:
            self._release()
        elif not self._held:
            self._held = True
            self._body.set_sticking(self.joint, True)
            self._body.hold_joint(self.joint, self.angle, self._torque)

    def keep(self, speed: float) -> None:
        """Drive at a speed in rad/s that nobody else changes; for each step."""
        # A motor keeps its speed, but at 0 the wheel must check whether to hold its joint.
        if speed == 0.0 or speed != self._speed:
            self.follow(speed)

    def _release(self) -> None:
        self._held = False
        self._body.set_sticking(self.joint, False)
        self._body.drive_joint(self.joint, self._speed, self._torque)


class WheelDrive(MobileBase):
    """The base of robots on driven wheels.

    Each update sends the odometry, then sets the wheels' motors to the speeds of the last
    command, v ∓ ω·separation/2 at the rim. The wheels roll, slip or stall by torque and friction.
    A command stays until the next one; as in Gazebo, there is no timeout.

    Subclasses define `_report(step, seconds)`, which sends the odometry, and
    `_rim_speeds(wanted, seconds)`, which returns the speeds (m/s) to set at the left and right
    rims; `seconds` is the time since the last update.

    Attributes:
        size_tags: of the separation and the diameter of the wheels.
        default_separation: in m.
        separation: of the left and right wheels in m, by the tags.
        radii: of the left and right wheels in m, by the tags.
        wheels: the left ones before as many right ones.
    """

    size_tags = ("wheelSeparation", "wheelDiameter")
    default_separation = 0.34
    wheels: tuple[Wheel, ...]

    def __init__(self, mount: Mount):
        mount.require_moving()
        super().__init__(mount)
        self.separation = mount.positive(self.size_tags[0], self.default_separation)
        self.radii = 2 * (0.5 * mount.positive(self.size_tags[1], 0.15),)
        self.schedule = mount.schedule("updateRate", 100.0)

    @property
    def driven(self) -> tuple[str, ...]:
        return tuple(wheel.joint for wheel in self.wheels)

    def produce(self, step: int) -> None:
        seconds = (step - self._last_step) / STEPS_PER_SECOND
        self._last_step = step
        self._report(step, seconds)
        self._drive(seconds)

    def _drive(self, seconds: float) -> None:
        """Set the motors, `seconds` after the last time."""
        speeds = self._rim_speeds(self._command.rims(self.separation), seconds)
        for number, wheel in enumerate(self.wheels):
            side = 2 * number // len(self.wheels)
            wheel.follow(speeds[side] / self.radii[side])

    def placed(self) -> None:
        for wheel in self.wheels:
            wheel.stop()

    def _velocity(self, pose: Pose) -> PlanarCommand:
        """Return the velocity of the body's origin along the heading of a pose."""
        (vx, vy, _), (_, _, wz) = self._body.origin_velocity()
        return PlanarCommand(*along(pose.quaternion, vx, vy), wz)


def wheel_joint(mount: Mount, tag: str, default: str) -> Joint:
    """Return the wheel joint that a tag names; raises PluginError for another joint."""
    name = mount.scoped(mount.text(tag, default))
    joints = {joint.name: joint for joint in mount.model.joints}
    if name not in mount.body.joint_names:
        raise PluginError(f"{mount.where(tag)}: no movable joint '{name}'")
    if joints[name].kind not in WHEEL_JOINTS:
        kind, kinds = joints[name].kind, " or ".join(WHEEL_JOINTS)
        raise PluginError(f"{mount.where(tag)}: joint '{name}' is {kind}; it must be {kinds}")
    return joints[name]


class DeadReckoning:
    """Integrates the rotation of two wheels to a planar pose, by exact arcs.

    Between two readings both wheels are assumed to turn evenly, so that the middle of the axle
    moves on an arc of length s and angle φ; its chord is s·sin(φ/2)/(φ/2) long and points φ/2
    away from the old heading. Slip is not measured.

    >>> reckoning = DeadReckoning(separation=0.5, radius=0.1)
    >>> driven, turned = reckoning.advance(left=5.0, right=5.0)
    >>> driven, turned, reckoning.pose
    (0.5, 0.0, (0.5, 0.0, 0.0))

    Lengths are in m: the `separation` of the wheels' contacts with the floor, and the `radius` of
    both wheels, or of the left one if there is a `right_radius`.
    """

    def __init__(self, separation: float, radius: float, right_radius: float | None = None):
        self.separation = separation
        self._radii = (radius, radius if right_radius is None else right_radius)
        self.restart(0.0, 0.0)

    def restart(self, left: float, right: float) -> None:
        """Start at the origin, with the wheels at these angles (rad)."""
        self._x = self._y = self._yaw = 0.0
        self.resume(left, right)

    def resume(self, left: float, right: float) -> None:
        """Set the wheels' angles (rad) without a change of the pose."""
        self._left, self._right = left, right

    @property
    def pose(self) -> tuple[float, float, float]:
        """Position x, y in m and yaw in rad within [-pi, pi], since the last restart."""
        return self._x, self._y, self._yaw

    def advance(self, left: float, right: float) -> tuple[float, float]:
        """Set new angles (rad); return the distance (m) and turn (rad) since the last ones."""
        left_rim = (left - self._left) * self._radii[0]
        right_rim = (right - self._right) * self._radii[1]
        self.resume(left, right)
        driven, turned = 0.5 * (left_rim + right_rim), (right_rim - left_rim) / self.separation
        half = 0.5 * turned
        chord = driven * math.sin(half) / half if half else driven
        self.move(chord, 0.0, turned)
        return driven, turned

    def move(self, ahead: float, left: float, turned: float) -> None:
        """Move ahead and to the left (m) as half of a turn (rad) points, and turn."""
        cosine, sine = math.cos(self._yaw + 0.5 * turned), math.sin(self._yaw + 0.5 * turned)
        self._x += cosine * ahead - sine * left
        self._y += sine * ahead + cosine * left
        self._yaw = math.remainder(self._yaw + turned, math.tau)


class DiffDrive(WheelDrive):
    """Drives two wheels as commanded and sends odometry.

    Odometry of the source `world` is the true pose, with z, and the velocity of the base frame's
    origin. Odometry of the source `encoder` is integrated from the wheels' angles, starts at zero
    where the robot starts, and drifts as the wheels slip.

    Unlike in Gazebo, publishTf switches off transforms only, never the odometry. legacyMode, with
    which the plugins of ROS Jade to Lunar swapped the wheels, is ignored, as in Noetic: leftJoint
    is the wheel on the left. Each wheel may have its own diameter, for which Gazebo has no tag.

    Attributes:
        origin: pose of the odometry's frame in the world, before any drift.
    """

    filenames = ("libgazebo_ros_diff_drive.so", "libcreate_diff_drive.so")
    named_by_model = (True, True)
    # Tags of the joints, with their defaults.
    joint_tags = (("leftJoint", "left_joint"), ("rightJoint", "right_joint"))

    def __init__(self, mount: Mount):
        super().__init__(mount)
        if mount.boolean("legacyMode", False):
            reason = "as in ROS Noetic: <leftJoint> is the wheel on the left"
            LOG.warning("%s is ignored, %s", mount.where("legacyMode"), reason)
        self._from_wheels = mount.choice("odometrySource", ("world", "encoder")) == "encoder"
        left, right = (wheel_joint(mount, *names) for names in self.joint_tags)
        if left is right:
            where = mount.where(self.joint_tags[1][0])
            raise PluginError(f"{where}: '{right.name}' is the left one already")
        self._joints: tuple[Joint, ...] = (left, right)
        torque = mount.coefficient("wheelTorque", 5.0)
        self._acceleration = mount.coefficient("wheelAcceleration")
        tags = ("leftWheelDiameter", "rightWheelDiameter")
        self.radii = tuple(
            0.5 * mount.positive(tag, 2.0 * radius) for tag, radius in zip(tags, self.radii)
        )
        self.wheels = tuple(Wheel(self._body, joint.name, torque) for joint in self._joints)
        self._reckoning = DeadReckoning(self.separation, *self.radii)
        on_tf = mount.boolean("publishTf", True)
        base = mount.boolean("publishOdomTF", True) and on_tf
        self.transform = self.output("/tf", TransformSample, base)
        wheels = mount.boolean("publishWheelTF", False) and on_tf
        self.wheel_transforms = self.output("/tf", TransformSample, wheels)
        states = mount.boolean("publishWheelJointState", False)
        self.wheel_states = self.output("joint_states", JointSample, states)

    def assume(self, separation: float, radii: Pair) -> None:
        """Report odometry of the source `encoder` that assumes other wheels; both in m."""
        self.separation, self.radii, self._from_wheels = separation, radii, True
        self._reckoning = DeadReckoning(separation, *radii)
        self._reckoning.resume(*self._angles())

    def reset(self, step: int) -> None:
        self._reckoning.restart(0.0, 0.0)
        self.origin = upright(self._pose()) if self._from_wheels else Pose()
        super().reset(step)

    def placed(self) -> None:
        super().placed()
        self._set_speeds = (0.0, 0.0)
        self._reckoning.resume(*self._angles())

    def _rim_speeds(self, wanted: Pair, seconds: float) -> Pair:
        """Approach the wanted speeds by <wheelAcceleration>, as Gazebo's plugin does.

        Unless one rim is near its wanted speed, the speed that was set last changes by what the
        measured speed lacks. So it overshoots while the wheels lag behind, and a robot that
        stops coasts on until it has come down again.
        """
        rims = [wheel.state().velocity * radius for wheel, radius in zip(self.wheels, self.radii)]
        lacks = [speed - rim for speed, rim in zip(wanted, rims)]
        if self._acceleration == 0.0 or min(map(abs, lacks)) < NEAR:
            return wanted
        most = self._acceleration * seconds
        self._set_speeds = tuple(
            speed + clip(lack, most) for speed, lack in zip(self._set_speeds, lacks)
        )
        return self._set_speeds

    def _angles(self) -> tuple[float, float]:
        return tuple(wheel.angle for wheel in self.wheels[:2])

    def _report(self, step: int, seconds: float) -> None:
        if self._from_wheels:
            driven, turned = self._reckoning.advance(*self._angles())
            pose, velocity = Pose.on_floor(*self._reckoning.pose), STANDSTILL
            if seconds > 0.0:
                velocity = PlanarCommand(vx=driven / seconds, wz=turned / seconds)
        else:
            pose = self._pose()
            velocity = self._velocity(pose)
        self.send_odometry(step, pose, velocity, POSE_VARIANCES, flat=False)
        if self.wheel_transforms.wanted:
            for joint, wheel in zip(self._joints, self.wheels):
                frames = (self.mount.frame(joint.parent), self.mount.frame(joint.child))
                place = _hub_pose(joint, wheel.angle)
                self.wheel_transforms.send(TransformSample(step, *frames, place))
        if self.wheel_states.wanted:
            # The right wheel before the left one, as Gazebo sends them.
            states = ((wheel.joint, wheel.angle) for wheel in self.wheels[::-1])
            self.wheel_states.send(JointSample(step, *zip(*states)))


def _hub_pose(joint: Joint, angle: float) -> Pose:
    """Return the pose of a wheel turned by an angle (rad) in the link that carries it."""
    sine = math.sin(0.5 * angle)
    turn = tuple(sine * part for part in joint.axis)
    return joint.pose * Pose(quaternion=(*turn, math.cos(0.5 * angle)))


class SkidSteer(WheelDrive):
    """Drives the wheels of each side as commanded and sends odometry.

    To turn, the wheels must slip sideways, so the robot turns less than commanded. Hard wheels also
    creep, as in Gazebo (`docs/contact_model.md`), unless friction is by Coulomb's law. The odometry
    is the true pose (z is 0 in it, not in the transform).
    """

    filenames = ("libgazebo_ros_skid_steer_drive.so",)

    default_separation = 0.4

    def __init__(self, mount: Mount):
        super().__init__(mount)
        torque = mount.coefficient("torque", 5.0)
        joints = [
            wheel_joint(mount, f"{side}{end}Joint", f"{side}_{end.lower()}_joint")
            for side in ("left", "right")
            for end in ("Front", "Rear")
        ]
        if len({joint.name for joint in joints}) < len(joints):
            where = mount.where("rightRearJoint")
            raise PluginError(f"{where}: the four joints must be different, but one is named twice")
        self.wheels = tuple(Wheel(self._body, joint.name, torque) for joint in joints)
        self._creep, self._most_friction = 0.0, 0.0
        if not mount.simulation.world.coulomb:
            links = mount.model.links_by_name()
            self._find_creep([links[joint.child] for joint in joints])
        x, y = (mount.coefficient(f"covariance_{axis}", 1e-4) for axis in "xy")
        yaw = mount.coefficient("covariance_yaw", 1e-2)
        self._variances = (x, y, UNKNOWN, UNKNOWN, UNKNOWN, yaw)
        self.transform = self.output("/tf", TransformSample, mount.boolean("broadcastTF", False))

    def _find_creep(self, wheels: Sequence[Link]) -> None:
        """Set the creep (m/s) and the largest friction of a side (N), unless a wheel is soft."""
        shapes = [shape for wheel in wheels for shape in wheel.collisions]
        soft = any(s.stiffness is not None or s.damping is not None for s in shapes)
        if soft or not shapes:
            return
        mass = mass_of(self._body.links)
        by_mass = CREEP_BY_MASS * (mass / mass_of(wheels) - 1.0)
        self._creep = (CREEP + by_mass) * GRAVITY * STEP_SECONDS
        self._most_friction = 0.5 * mass * GRAVITY * min(shape.friction for shape in shapes)

    def _rim_speeds(self, wanted: Pair, _seconds: float) -> Pair:
        if not self._most_friction:
            return wanted
        sides = (self.wheels[:2], self.wheels[2:])
        return tuple(map(self._rim_speed, wanted, sides, self.radii))

    def _rim_speed(self, wanted: float, wheels: tuple[Wheel, ...], radius: float) -> float:
        """Return the wanted speed of a side's rim less its creep (m/s)."""
        friction = sum(wheel.state().effort for wheel in wheels) / radius
        share = min(1.0, abs(friction) / self._most_friction)
        slip = max(0.0, share - CREEP_SHARE) / (1.0 - CREEP_SHARE)
        creep = self._creep * (abs(wanted) / CREEP_SPEED) ** CREEP_EXPONENT * slip
        return wanted - math.copysign(creep, friction)

    def _report(self, step: int, seconds: float) -> None:
        pose = self._pose()
        variances = (self._variances, self._variances)
        self.send_odometry(step, pose, self._velocity(pose), *variances, flat=True)


class TricycleDrive(DiffDrive):
    """Drives and steers the front wheel as commanded; the rear wheels measure the odometry.

    `angular.z` of a command is the angle of the fork in rad. Without a <steeringSpeed>, the fork
    takes its angle at once. The odometry is as that of `DiffDrive`.
    """

    filenames = ("libgazebo_ros_tricycle_drive.so",)
    named_by_model = (False, False)
    base_frame = "base_link"
    size_tags = ("encoderWheelSeparation", "encoderWheelDiameter")
    joint_tags = (
        ("encoderWheelLeftJoint", "left_wheel_joint"),
        ("encoderWheelRightJoint", "right_wheel_joint"),
    )
    default_separation = 0.5

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._radius = 0.5 * mount.positive("actuatedWheelDiameter", 0.15)
        self._torque = mount.coefficient("wheelTorque", 5.0)
        self._deceleration = mount.coefficient("wheelDeceleration", self._acceleration)
        self._steering_speed = mount.coefficient("steeringSpeed")
        self._tolerance = mount.coefficient("steeringAngleTolerance", 0.01)
        # Of no use here: the last step to a speed is as large as the others.
        mount.text("wheelSpeedTolerance")
        driven = wheel_joint(mount, "actuatedWheelJoint", "front_wheel_joint")
        fork = wheel_joint(mount, "steeringJoint", "front_steering_joint")
        torques = (0.0, 0.0, self._torque, self._torque)
        self._joints += (driven, fork)
        self.wheels = tuple(
            Wheel(self._body, joint.name, torque) for joint, torque in zip(self._joints, torques)
        )

    def _drive(self, seconds: float) -> None:
        driven, fork = self.wheels[2:]
        wanted, speed = self._command.vx / self._radius, driven.state().velocity
        if self._acceleration > 0.0:
            slows = abs(wanted) < abs(speed)
            most = seconds * (self._deceleration if slows else self._acceleration)
            wanted = speed + clip(wanted - speed, most)
        driven.follow(wanted)
        angle = clip(self._command.wz, 0.5 * math.pi)
        if self._steering_speed == 0.0:
            self._body.hold_joint(fork.joint, angle, STRONGEST, 1.0)
            return
        lack = angle - fork.angle
        turns = abs(lack) > self._tolerance
        fork.follow(math.copysign(self._steering_speed, lack) if turns else 0.0)
