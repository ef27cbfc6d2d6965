"""libgazebo_ros_diff_drive.so: a robot that is driven and steered by two wheels."""

from __future__ import annotations

import logging
import math
from typing import Tuple

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins.device import Device, DeviceError, Input, Mount, Output, device
from bullet_lab.simulation.plugins.samples import (
    JointSample,
    OdometrySample,
    PlanarCommand,
    TransformSample,
)
from bullet_lab.simulation.plugins.wheels import Wheel, at_least, base_motion, wheel_joint
from bullet_lab.simulation.world.description import Joint


class DeadReckoning:
    """Integrates the rotation of two wheels to a planar pose, by exact arcs.

    Between two readings both wheels are taken to turn evenly, so that the middle of the axle
    moves on an arc of length s and angle φ; its chord is s·sin(φ/2)/(φ/2) long and points φ/2
    away from the old heading. What the wheels slip is not noticed.

    Args:
        separation: of the wheels' contacts with the floor, in m.
        radius: of the wheels, in m.
    """

    def __init__(self, separation: float, radius: float):
        self._separation = separation
        self._radius = radius
        self.restart(0.0, 0.0)

    def restart(self, left: float, right: float) -> None:
        """Be at the origin again, with the wheels at these angles (rad)."""
        self._x = self._y = self._yaw = 0.0
        self.resume(left, right)

    def resume(self, left: float, right: float) -> None:
        """Take new angles (rad) of the wheels for the present pose: nothing was driven."""
        self._left, self._right = left, right

    @property
    def pose(self) -> Tuple[float, float, float]:
        """Position x, y in m and yaw in rad within [-pi, pi], from where it was last restarted."""
        return self._x, self._y, self._yaw

    def advance(self, left: float, right: float) -> Tuple[float, float]:
        """Take the wheels' new angles (rad).

        Returns:
            The distance in m driven ahead and the angle in rad turned since the last angles.
        """
        left_way = (left - self._left) * self._radius
        right_way = (right - self._right) * self._radius
        self.resume(left, right)
        driven, turned = 0.5 * (left_way + right_way), (right_way - left_way) / self._separation
        half = 0.5 * turned
        chord = driven * math.sin(half) / half if half else driven
        self._x += chord * math.cos(self._yaw + half)
        self._y += chord * math.sin(self._yaw + half)
        self._yaw = math.remainder(self._yaw + turned, math.tau)
        return driven, turned


LOG = logging.getLogger(__name__)

STANDSTILL = PlanarCommand()
SOURCES = ("world", "encoder")
# As in Gazebo: x and y are known, what the robot cannot do is not.
POSE_VARIANCES = (1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3)


@device("libgazebo_ros_diff_drive.so")
class DiffDrive(Device):
    """Turns two wheels as commanded and reports where the robot is.

    At each update the odometry is sent, then the wheels' motors are given the speeds of the
    last command, v ∓ ω·separation/2 at the rim. The physics does the rest: wheels roll, slip
    or stall as torque and friction have it. Commands stay until the next one; there is no
    time-out, as in Gazebo.

    Odometry of the source `world` is the true pose, with z, and the velocity of the base
    frame's origin. That of the source `encoder` is reckoned from the wheels' angles, starts at
    zero where the robot starts, and drifts as the wheels slip.

    Tags as in Gazebo, with its defaults: leftJoint, rightJoint, wheelSeparation, wheelDiameter,
    wheelAcceleration (m/s² at the rim), wheelTorque, updateRate, commandTopic, odometryTopic,
    odometryFrame, robotBaseFrame, odometrySource, publishTf, publishOdomTF, publishWheelTF,
    publishWheelJointState and robotNamespace, which stands before topics and frames.
    Unlike in Gazebo, publishTf only takes away transforms, never the odometry. legacyMode, with
    which the plugins of ROS Jade to Lunar took the left wheel for the right one, is passed over,
    as Noetic's plugin does: leftJoint is the wheel on the left.

    Attributes:
        frame: name of the odometry's frame.
        origin: pose of that frame in the world, before any drift.
    """

    def __init__(self, mount: Mount):
        super().__init__(mount)
        if mount.model.static:
            raise DeviceError(f"model '{mount.model.name}': diff_drive on what cannot move")
        self._body = mount.body
        self.frame = _frame(mount, mount.text("odometryFrame", "odom"))
        self._base_frame = _frame(mount, mount.text("robotBaseFrame", "base_footprint"))
        if mount.boolean("legacyMode", False):
            LOG.warning(
                "%s is passed over, as in ROS Noetic: <leftJoint> is the wheel on the left",
                mount.where("legacyMode"),
            )
        self._from_wheels = _source(mount) == "encoder"
        self._separation = at_least(mount, "wheelSeparation", 0.34)
        self._radius = 0.5 * at_least(mount, "wheelDiameter", 0.15)
        joints = _wheel_joints(mount)
        self._hubs = tuple(_Hub(mount, joint) for joint in joints)
        self._wheels = self._make_wheels(joints)
        self._reckoning = DeadReckoning(self._separation, self._radius)
        self._connect(mount)
        self.schedule = mount.schedule("updateRate", 100.0)
        self.reset(0)

    def command(self, command: PlanarCommand) -> None:
        """Take over a velocity (ahead and turning); it acts from the next update on.

        Raises:
            DeviceError: NaN or infinite; the command before stays in force.
        """
        if not (math.isfinite(command.vx) and math.isfinite(command.wz)):
            raise DeviceError(f"the velocity {command} is not finite")
        self._command = command

    def produce(self, step: int) -> None:
        """Send the odometry, then give the motors their speeds."""
        seconds = (step - self._last_step) / STEPS_PER_SECOND
        self._last_step = step
        self._send_odometry(step, seconds)
        if self.wheel_transforms.wanted:
            self._send_wheel_transforms(step)
        if self.wheel_states.wanted:
            self._send_wheel_states(step)
        side = 0.5 * self._command.wz * self._separation
        left, right = self._wheels
        left.follow((self._command.vx - side) / self._radius, seconds)
        right.follow((self._command.vx + side) / self._radius, seconds)

    def reset(self, step: int) -> None:
        """Forget the command and what was driven."""
        self._command = STANDSTILL
        self._last_step = step
        self._reckoning.restart(0.0, 0.0)
        start = self._body.pose()
        upright = Pose.from_rpy(start.position, (0.0, 0.0, start.yaw))
        self.origin = upright if self._from_wheels else Pose()
        self.placed()

    def placed(self) -> None:
        """Let the wheels start from rest; they did not roll to where the robot is now."""
        for wheel in self._wheels:
            wheel.stop()
        self._reckoning.resume(*self._angles())

    def _make_wheels(self, joints: Tuple[Joint, Joint]) -> Tuple[Wheel, ...]:
        torque = at_least(self.mount, "wheelTorque", 5.0, zero_is_fine=True)
        limit = at_least(self.mount, "wheelAcceleration", 0.0, zero_is_fine=True)
        return tuple(
            Wheel(self._body, joint.name, torque, limit / self._radius) for joint in joints
        )

    def _connect(self, mount: Mount) -> None:
        self.odometry = Output(mount.topic(mount.text("odometryTopic", "odom")), OdometrySample)
        self.transform = Output("/tf", TransformSample)
        self.wheel_transforms = Output("/tf", TransformSample)
        self.wheel_states = Output(mount.topic("joint_states"), JointSample)
        transforms = mount.boolean("publishTf", True)
        switches = (
            (True, self.odometry),
            (mount.boolean("publishOdomTF", True) and transforms, self.transform),
            (mount.boolean("publishWheelTF", False) and transforms, self.wheel_transforms),
            (mount.boolean("publishWheelJointState", False), self.wheel_states),
        )
        self.outputs = tuple(output for switch, output in switches if switch)
        topic = mount.topic(mount.text("commandTopic", "cmd_vel"))
        self.inputs = (Input(topic, PlanarCommand, self.command),)

    def _angles(self) -> Tuple[float, float]:
        left, right = self._wheels
        return left.state().position, right.state().position

    def _send_odometry(self, step: int, seconds: float) -> None:
        if self._from_wheels:
            pose, velocity = self._reckoned(seconds)
        else:
            pose, velocity = base_motion(self._body)
        frames = (self.frame, self._base_frame)
        if self.odometry.wanted:
            self.odometry.send(OdometrySample(step, *frames, pose, velocity, POSE_VARIANCES))
        if self.transform.wanted:
            self.transform.send(TransformSample(step, *frames, pose))

    def _reckoned(self, seconds: float) -> Tuple[Pose, PlanarCommand]:
        """Return the pose by the wheels, and the mean velocity since the last update."""
        driven, turned = self._reckoning.advance(*self._angles())
        x, y, yaw = self._reckoning.pose
        pose = Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw))
        if seconds <= 0.0:
            return pose, STANDSTILL
        return pose, PlanarCommand(vx=driven / seconds, wz=turned / seconds)

    def _send_wheel_transforms(self, step: int) -> None:
        for hub, wheel in zip(self._hubs, self._wheels):
            pose = hub.pose_at(wheel.state().position)
            self.wheel_transforms.send(TransformSample(step, hub.parent, hub.child, pose))

    def _send_wheel_states(self, step: int) -> None:
        states = [wheel.state() for wheel in self._wheels]
        self.wheel_states.send(
            JointSample(
                step,
                tuple(wheel.joint for wheel in self._wheels),
                tuple(state.position for state in states),
                tuple(state.velocity for state in states),
                tuple(state.effort for state in states),
            )
        )


class _Hub:
    """Where a wheel's frame is in that of the link that carries it."""

    def __init__(self, mount: Mount, joint: Joint):
        self.parent = _frame(mount, joint.parent)
        self.child = _frame(mount, joint.child)
        self._joint = joint

    def pose_at(self, angle: float) -> Pose:
        """Return the pose of the wheel turned by an angle (rad) about its axis."""
        sine = math.sin(0.5 * angle)
        turn = tuple(sine * part for part in self._joint.axis)
        return self._joint.pose * Pose(quaternion=(*turn, math.cos(0.5 * angle)))


def _frame(mount: Mount, name: str) -> str:
    """Return a frame's name on TF; robotNamespace stands in for a missing prefix, as in Gazebo."""
    namespace = mount.text("robotNamespace").strip("/")
    if mount.tf_prefix or name.startswith("/") or not namespace:
        return mount.frame(name)
    return f"{namespace}/{name}"


def _source(mount: Mount) -> str:
    source = mount.text("odometrySource", SOURCES[0])
    if source not in SOURCES:
        raise DeviceError(
            f"{mount.where('odometrySource')}: '{source}' is not one of {', '.join(SOURCES)}"
        )
    return source


def _wheel_joints(mount: Mount) -> Tuple[Joint, Joint]:
    left = wheel_joint(mount, "leftJoint", "left_joint")
    right = wheel_joint(mount, "rightJoint", "right_joint")
    if left is right:
        raise DeviceError(f"{mount.where('rightJoint')}: '{right.name}' is the left one already")
    return left, right
