"""Cars: ackermann_steering_controller, and the hardware of steer_bot_hardware_gazebo."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Mapping, Sequence

from bullet_lab.simulation.physics.bodies import Body
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.diff_drive import DiffDriveController, wheel_radius
from bullet_lab.simulation.plugins.controllers.joints import (
    POSITION,
    VELOCITY,
    JointHandle,
    JointLimits,
    described_joints,
    joint_handles,
)
from bullet_lab.simulation.plugins.samples import PlanarCommand

STEER_BOT = "steer_bot_hardware_gazebo/SteerBotHardwareGazebo"


class AckermannSteeringController(DiffDriveController):
    """Drives the rear wheel and steers the front one as commanded, and reports odometry.

    As in ros_controllers, `angular.z` of a command is the angle of the front wheel in rad, and so
    are its limits. The odometry is that of the middle of the rear axle.
    """

    kinds = {
        "ackermann_steering_controller/AckermannSteeringController": VELOCITY,
        # Its name before ros_controllers took it over.
        "steer_drive_controller/SteerDriveController": VELOCITY,
    }

    def find_wheels(self, given: ControlParameters) -> None:
        (self._rear,) = self.find_joints([given.get("rear_wheel", "rear_wheel_joint")])
        steer = given.get("front_steer", "front_steer_joint")
        (self._front,) = self.find_joints([steer], POSITION)
        self.joints = (self._rear, self._front)
        rear, front = self._rear.described, self._front.described
        self._radius = wheel_radius(given, rear)
        self._rolled = self._radius * given.get("wheel_radius_multiplier", 1.0)
        length = given.get("wheel_separation_h", abs(rear.origin[0] - front.origin[0]))
        self.separation = length * given.get("wheel_separation_h_multiplier", 1.0)
        self._steering = given.get("steer_pos_multiplier", 1.0)
        if not all(0.0 < size < math.inf for size in (self._rolled, self.separation)):
            raise ControlError("distance and radius of the wheels have to be positive")
        self._angle, self._rims = 0.0, (0.0, 0.0)

    def distances(self) -> tuple[float, float]:
        """Return how far (m) wheels would have rolled whose distance is that of the two."""
        driven = self._rolled * (self._rear.position - self._angle)
        self._angle = self._rear.position
        side = 0.5 * driven * math.tan(self._steering * self._front.position)
        self._rims = (self._rims[0] + driven - side, self._rims[1] + driven + side)
        return self._rims

    def command_joints(self, command: PlanarCommand, _seconds: float) -> None:
        self._rear.command = command.vx / self._radius
        self._front.command = command.wz


@dataclass(eq=False)
class RearWheel(JointHandle):
    """Drives all wheels at the same speed; its state is the mean of the first two's."""

    interface = VELOCITY
    wheels: Sequence[JointHandle] = ()

    def read(self) -> None:
        rear, self.effort = self.wheels[:2], 0.0
        self.position = 0.5 * sum(wheel.position for wheel in rear)
        self.velocity = 0.5 * sum(wheel.velocity for wheel in rear)

    def write(self, stopped: bool) -> None:
        for wheel in self.wheels:
            wheel.command = self.command


@dataclass(eq=False)
class FrontSteer(JointHandle):
    """Steers the forks as Ackermann's linkage does, or alike with a `ratio` of 0."""

    interface = POSITION
    forks: Sequence[JointHandle] = ()
    ratio: float = 0.0

    def read(self) -> None:
        self.position, self.velocity, self.effort = self.command, 0.0, 0.0

    def write(self, stopped: bool) -> None:
        slope = math.tan(self.command)
        # The first one counts as the right one.
        for fork, side in zip(self.forks, (self.ratio, -self.ratio)):
            fork.command = math.atan2(slope, 1.0 + side * slope)


def steer_bot_joints(
    bodies: Mapping[str, Body], urdf: str, source: str, given: ControlParameters
) -> dict[str, JointHandle]:
    """Return the joints of a car by name, the two that stand for the others first.

    As in the original, none has limits. Raises ControlError and XmlError.
    """
    rear, steer = (given.get(name, f"{name}_joint") for name in ("rear_wheel", "front_steer"))
    wheels = given.required_names("virtual_rear_wheels")
    wheels += given.names("virtual_front_wheels") or ()
    forks = given.required_names("virtual_front_steers")
    kinds = {**dict.fromkeys(wheels, VELOCITY), **dict.fromkeys(forks, POSITION)}
    described = described_joints(urdf, source, {rear: VELOCITY, steer: POSITION, **kinds})
    described = {name: replace(one, limits=JointLimits()) for name, one in described.items()}
    first, second = described.pop(rear), described.pop(steer)
    handles = joint_handles(bodies, described, ControlParameters({}, given.where))
    driven, steered = ([handles[n] for n in names if n in handles] for names in (wheels, forks))
    length, width = (given.get(f"wheel_separation_{way}", 1.0) for way in "hw")
    if length <= 0.0:
        raise ControlError(f"{given.where}/wheel_separation_h has to be positive")
    ratio = 0.25 * width / length if given.get("enable_ackermann_link", True) else 0.0
    body = next(iter(bodies.values()))
    return {
        rear: RearWheel(body, first, first.limits, None, driven),
        steer: FrontSteer(body, second, second.limits, None, steered, ratio),
        **handles,
    }
