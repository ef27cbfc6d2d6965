"""libgazebo_ros_tricycle_drive.so: a front wheel that is driven and steered."""

from __future__ import annotations

import math

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins import Mount
from bullet_lab.simulation.plugins.wheel_drives import DiffDrive, Wheel, wheel_joint

# Effort (N m) that turns the fork to its angle at once.
STRONGEST = 1e6


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

    def produce(self, step: int) -> None:
        seconds = (step - self._last_step) / STEPS_PER_SECOND
        self._last_step = step
        self._report(step, seconds)
        driven, fork = self.wheels[2:]
        wanted, speed = self._command.vx / self._radius, driven.state().velocity
        if self._acceleration > 0.0:
            slows = abs(wanted) < abs(speed)
            most = seconds * (self._deceleration if slows else self._acceleration)
            wanted = speed + max(-most, min(most, wanted - speed))
        driven.follow(wanted)
        angle = max(-0.5 * math.pi, min(0.5 * math.pi, self._command.wz))
        if self._steering_speed == 0.0:
            self._body.hold_joint(fork.joint, angle, STRONGEST, 1.0)
            return
        lack = angle - fork.state().position
        turns = abs(lack) > self._tolerance
        fork.follow(math.copysign(self._steering_speed, lack) if turns else 0.0)
