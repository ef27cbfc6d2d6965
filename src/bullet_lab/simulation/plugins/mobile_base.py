"""The base of plugins that take velocity commands and send odometry."""

from __future__ import annotations

from typing import ClassVar, Tuple

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.plugin import Input, Mount, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.samples import (
    Diagonal,
    OdometrySample,
    PlanarCommand,
    TransformSample,
    is_sound,
)

STANDSTILL = PlanarCommand()
# Variance of what the odometry does not know, as in Gazebo.
UNKNOWN = 1e12
POSE_VARIANCES = (1e-5, 1e-5, UNKNOWN, UNKNOWN, UNKNOWN, 1e-3)


class MobileBase(Plugin):
    """A robot that takes velocity commands, and sends odometry and its transform.

    Attributes:
        directions: the components of a command that it uses.
        frame: name of the odometry's frame.
    """

    directions: ClassVar[Tuple[str, ...]] = ("vx", "wz")

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._body = mount.body
        root = mount.model.root_links()[0].pose
        self._in_root = None if root == Pose() else root.inverse()
        self.frame = mount.frame(mount.text("odometryFrame", "odom"))
        self._base_frame = mount.frame(mount.text("robotBaseFrame", "base_footprint"))
        self.odometry = Output(mount.topic(mount.text("odometryTopic", "odom")), OdometrySample)
        self.transform = Output("/tf", TransformSample)
        topic = mount.topic(mount.text("commandTopic", "cmd_vel"))
        self.inputs = (Input(topic, PlanarCommand, self.command),)

    def command(self, command: PlanarCommand) -> None:
        """Take over a velocity; it acts from the next update on.

        Raises:
            PluginError: not finite or beyond `LARGEST_COMMAND`; the last command stays.
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

    def _send_odometry(
        self, step: int, poses: Tuple[Pose, Pose], velocity: PlanarCommand, *variances: Diagonal
    ) -> None:
        """Send one pose as odometry and one as transform."""
        frames = (self.frame, self._base_frame)
        if self.odometry.wanted:
            self.odometry.send(OdometrySample(step, *frames, poses[0], velocity, *variances))
        if self.transform.wanted:
            self.transform.send(TransformSample(step, *frames, poses[1]))

    @staticmethod
    def _flat(pose: Pose) -> Pose:
        x, y, _ = pose.position
        return Pose((x, y, 0.0), pose.quaternion)
