"""ackermann_steering_controller: a driven rear wheel, and a front wheel that is steered."""

from __future__ import annotations

import math
from typing import Tuple

from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.diff_drive import DiffDriveController, wheel_radius
from bullet_lab.simulation.plugins.controllers.joints import POSITION, VELOCITY
from bullet_lab.simulation.plugins.samples import PlanarCommand


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

    def configure(self, given: ControlParameters) -> None:
        super().configure(given)
        self.adjustables = ()

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

    def distances(self) -> Tuple[float, float]:
        """Return how far (m) wheels would have rolled whose distance is that of the two."""
        driven = self._rolled * (self._rear.position - self._angle)
        self._angle = self._rear.position
        side = 0.5 * driven * math.tan(self._steering * self._front.position)
        self._rims = (self._rims[0] + driven - side, self._rims[1] + driven + side)
        return self._rims

    def command_joints(self, command: PlanarCommand, _seconds: float) -> None:
        self._rear.command = command.vx / self._radius
        self._front.command = command.wz
