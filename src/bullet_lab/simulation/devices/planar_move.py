"""libgazebo_ros_planar_move.so: a body that is pushed over the floor at a given velocity."""

from __future__ import annotations

import math
from typing import Optional

from bullet_lab.simulation.devices.device import (
    Device,
    DeviceError,
    Input,
    Mount,
    Output,
    device,
)
from bullet_lab.simulation.physics import STEP_SECONDS
from bullet_lab.simulation.pose import Pose, yaw_of
from bullet_lab.simulation.samples import OdometrySample, PlanarCommand, TransformSample
from bullet_lab.simulation.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.simulation.support_patch import PUBLISHED_RADIUS, SupportPatch

STANDSTILL = PlanarCommand()
# As in Gazebo: x and y are known, what the robot cannot do is not.
POSE_VARIANCES = (1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3)


@device("libgazebo_ros_planar_move.so")
class PlanarMove(Device):
    """Moves the robot as commanded and reports where it is.

    Before each step the body gets the last commanded velocity, turned by its yaw and less what
    floor friction takes away (`SupportPatch`); it neither rolls, pitches nor rises by itself.
    The command stays until the next one, or until `cmdTimeout` seconds have passed.

    Tags: commandTopic, odometryTopic, odometryFrame, robotBaseFrame, odometryRate, cmdTimeout
    and robotNamespace as in Gazebo; of this simulation: supportRadius, the effective radius in
    metres of the patch that the robot stands on.
    """

    acts = True

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._body = mount.body
        self._frame = mount.text("odometryFrame", "odom")
        self._base_frame = mount.text("robotBaseFrame", "base_footprint")
        self._timeout = _timeout_steps(mount.number("cmdTimeout", -1.0))
        self._patch = _support_patch(mount)
        self._gravity = mount.gravity
        self._turned = self._body.turned_inertia
        self.odometry = Output(mount.topic(mount.text("odometryTopic", "odom")), OdometrySample)
        self.transform = Output("/tf", TransformSample)
        self.outputs = (self.odometry, self.transform)
        command = mount.topic(mount.text("commandTopic", "cmd_vel"))
        self.inputs = (Input(command, PlanarCommand, self.command),)
        self.schedule = Schedule(mount.number("odometryRate", 20.0))
        self._body.remove_sliding_friction()
        self._step = 0
        self.reset(0)

    def command(self, command: PlanarCommand) -> None:
        """Take over a velocity; it acts from the next step on.

        Raises:
            DeviceError: NaN or infinite; the command before stays in force.
        """
        if not all(map(math.isfinite, (command.vx, command.vy, command.wz))):
            raise DeviceError(f"the velocity {command} is not finite")
        self._expires = None if self._timeout is None else self._step + self._timeout
        self._command = command

    def before_step(self, step: int) -> None:
        """Set the velocity for the coming step."""
        self._step = step
        command = self._command
        if self._expires is not None and step >= self._expires:
            command = STANDSTILL
        # The floor has carried what the step before did not turn into a fall: the body was sent
        # off without vertical velocity, so this is Newton's law, and no contact need be asked.
        (_, _, rise), _ = self._body.velocity()
        load = self._patch.mass * max(0.0, self._gravity + rise / STEP_SECONDS)
        vx, vy, wz = self._patch.slow_down(
            command.vx, command.vy, command.wz, load, STEP_SECONDS
        )
        yaw = self._yaw()
        cosine, sine = math.cos(yaw), math.sin(yaw)
        self._body.set_velocity(
            (cosine * vx - sine * vy, sine * vx + cosine * vy, 0.0), (0.0, 0.0, wz)
        )

    def produce(self, step: int) -> None:
        """Send the odometry and its transform."""
        pose = self._body.pose()
        velocity = self._velocity_since(step, pose)
        self._last_step, self._last_pose = step, pose
        x, y, _ = pose.position
        self.odometry.send(
            OdometrySample(
                step,
                self._frame,
                self._base_frame,
                Pose((x, y, 0.0), pose.quaternion),
                velocity,
                POSE_VARIANCES,
            )
        )
        self.transform.send(TransformSample(step, self._frame, self._base_frame, pose))

    def reset(self, step: int) -> None:
        """Forget the command and where the robot was."""
        self._command = STANDSTILL
        self._expires: Optional[int] = None
        self._last_step = step
        self._last_pose = self._body.pose()

    def _yaw(self) -> float:
        pose = self._body.pose() if self._turned else self._body.com_pose()
        return yaw_of(pose.quaternion)

    def _velocity_since(self, step: int, pose: Pose) -> PlanarCommand:
        """Return the mean velocity since the last sample, in the robot's present frame."""
        dt = (step - self._last_step) / STEPS_PER_SECOND
        if dt <= 0.0:
            return STANDSTILL
        yaw = pose.yaw
        dx = pose.position[0] - self._last_pose.position[0]
        dy = pose.position[1] - self._last_pose.position[1]
        turned = math.remainder(yaw - self._last_pose.yaw, math.tau)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return PlanarCommand(
            (cosine * dx + sine * dy) / dt, (cosine * dy - sine * dx) / dt, turned / dt
        )


def _timeout_steps(seconds: float) -> Optional[int]:
    return None if seconds < 0.0 else round(seconds * STEPS_PER_SECOND)


def _support_patch(mount: Mount) -> SupportPatch:
    """Return the patch of the robot's root link, with the friction of its lowest shape."""
    root = mount.model.root_links()[0]
    masses = [link.inertia.mass for link in mount.model.links if link.inertia is not None]
    radius = mount.number("supportRadius", PUBLISHED_RADIUS)
    if radius < 0.0:
        raise DeviceError(f"{mount.where('supportRadius')}: {radius:g} m is negative")
    if root.inertia is None or mount.model.static:
        raise DeviceError(f"model '{mount.model.name}': planar_move on what cannot move")
    friction = min((c.friction for c in root.collisions), default=1.0)
    return SupportPatch(friction, radius, sum(masses), float(root.inertia.matrix[2, 2]))
