"""libgazebo_ros_skid_steer_drive.so: a robot on four wheels that steers as a tank does."""

from __future__ import annotations

import math
from typing import List

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.physics import use_friction_pyramid
from bullet_lab.simulation.plugins.device import Device, DeviceError, Input, Mount, Output, device
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand, TransformSample
from bullet_lab.simulation.plugins.wheels import Wheel, at_least, base_motion, wheel_joint

STANDSTILL = PlanarCommand()
LEFT = (("leftFrontJoint", "left_front_joint"), ("leftRearJoint", "left_rear_joint"))
RIGHT = (("rightFrontJoint", "right_front_joint"), ("rightRearJoint", "right_rear_joint"))
UNKNOWN = 1e12


@device("libgazebo_ros_skid_steer_drive.so")
class SkidSteer(Device):
    """Turns the wheels of each side as commanded and reports where the robot is.

    The wheels get the speeds v ∓ ω·separation/2 at the rim. To turn, they must slip sideways, so
    the robot turns less than commanded; how much less is up to the friction, which is that of
    ODE's pyramid in a world with such a robot. Commands stay until the next one, as in Gazebo.
    The odometry is the true pose (z is 0 in it, not in the transform).

    Tags as in Gazebo, with its defaults: leftFrontJoint, rightFrontJoint, leftRearJoint,
    rightRearJoint, wheelSeparation (0.4 m), wheelDiameter (0.15 m), torque (5 N m), updateRate
    (100 Hz), commandTopic, odometryTopic, odometryFrame, robotBaseFrame, broadcastTF (false),
    covariance_x, covariance_y (1e-4), covariance_yaw (1e-2) and robotNamespace.
    """

    def __init__(self, mount: Mount):
        super().__init__(mount)
        if mount.model.static:
            raise DeviceError(f"model '{mount.model.name}': skid_steer_drive on what cannot move")
        self._body = mount.body
        use_friction_pyramid(self._body)
        self.frame = mount.frame(mount.text("odometryFrame", "odom"))
        self._base_frame = mount.frame(mount.text("robotBaseFrame", "base_footprint"))
        self._separation = at_least(mount, "wheelSeparation", 0.4)
        self._radius = 0.5 * at_least(mount, "wheelDiameter", 0.15)
        torque = at_least(mount, "torque", 5.0, zero_is_fine=True)
        names = [wheel_joint(mount, *tag).name for tag in LEFT + RIGHT]
        if len(set(names)) < len(names):
            raise DeviceError(f"{mount.where('rightRearJoint')}: a joint is named twice")
        self._wheels: List[Wheel] = [Wheel(self._body, name, torque) for name in names]
        self._variances = _variances(mount)
        self.odometry = Output(mount.topic(mount.text("odometryTopic", "odom")), OdometrySample)
        self.transform = Output("/tf", TransformSample)
        transforms = (self.transform,) if mount.boolean("broadcastTF", False) else ()
        self.outputs = (self.odometry, *transforms)
        topic = mount.topic(mount.text("commandTopic", "cmd_vel"))
        self.inputs = (Input(topic, PlanarCommand, self.command),)
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
        self._send_odometry(step)
        side = 0.5 * self._command.wz * self._separation
        left, right = self._command.vx - side, self._command.vx + side
        for wheel, speed in zip(self._wheels, (left, left, right, right)):
            wheel.follow(speed / self._radius, seconds)

    def reset(self, step: int) -> None:
        """Forget the command."""
        self._command = STANDSTILL
        self._last_step = step
        self.placed()

    def placed(self) -> None:
        """Let the wheels start from rest."""
        for wheel in self._wheels:
            wheel.stop()

    def _send_odometry(self, step: int) -> None:
        pose, velocity = base_motion(self._body)
        frames = (self.frame, self._base_frame)
        if self.odometry.wanted:
            x, y, _ = pose.position
            flat = Pose((x, y, 0.0), pose.quaternion)
            variances = (self._variances, self._variances)
            self.odometry.send(OdometrySample(step, *frames, flat, velocity, *variances))
        if self.transform.wanted:
            self.transform.send(TransformSample(step, *frames, pose))


def _variances(mount: Mount) -> tuple:
    x = at_least(mount, "covariance_x", 1e-4, zero_is_fine=True)
    y = at_least(mount, "covariance_y", 1e-4, zero_is_fine=True)
    yaw = at_least(mount, "covariance_yaw", 1e-2, zero_is_fine=True)
    return (x, y, UNKNOWN, UNKNOWN, UNKNOWN, yaw)
