"""Controllers of bases that stand on steered wheels, all of them driven.

steered_wheel_base_controller and four_wheel_steering_controller. Vectors on the floor are complex
numbers: ahead, and to the left as imaginary part.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import Sequence

from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.diff_drive import DiffDriveController, wheel_radius
from bullet_lab.simulation.plugins.controllers.joints import (
    EFFORT,
    INTERFACES,
    POSITION,
    VELOCITY,
    JointHandle,
    Pid,
)
from bullet_lab.simulation.plugins.samples import STANDSTILL, OdometrySample, PlanarCommand

# four_wheel_steering_controller does not move at a smaller speed ahead, in m/s.
STANDING = 0.001
# A timeout (s) that never passes.
NEVER = 1e9


class SteeredWheel:
    """A driven wheel with a radius (m) on a steered fork, whose `place` in the robot is in m.

    The joint `fork` steers it counter-clockwise, and `axle` drives it. A fork that takes no angles
    and an axle that takes no speeds need `gains` of PIDs.
    """

    def __init__(
        self, fork: JointHandle, axle: JointHandle, radius: float, gains: ControlParameters
    ):
        self.fork, self.axle, self._radius = fork, axle, radius
        self.place = _place(fork)
        # From the fork to the wheel, to the left.
        self._offset = (_place(axle) - self.place).imag
        self._angle, self._rolled = fork.position, axle.position
        self._steering = None if fork.interface == POSITION else Pid(gains.below(fork.name))
        self._driving = None if axle.interface == VELOCITY else Pid(gains.below(axle.name))

    def roll(self) -> tuple[complex, complex]:
        """Return where the wheel is in the robot, and how far it has rolled since the last time."""
        ahead = cmath.rect(1.0, self.fork.position)
        way = self._radius * (self.axle.position - self._rolled)
        self._rolled = self.axle.position
        return self.place + 1j * self._offset * ahead, way * ahead

    def follow(self, velocity: complex, turn: float, seconds: float) -> None:
        """Let the fork move at a velocity (m/s) while the robot turns (rad/s).

        The fork points there, or half turns away if that is nearer; with an odd number of them,
        the wheel rolls backwards. Without a velocity, it keeps its angle.
        """
        self._angle = cmath.phase(velocity) if velocity else self._angle
        position, limits = self.fork.position, self.fork.limits
        turns = round((position - self._angle) / math.pi)
        target = self._angle + math.pi * turns
        turns += (target < limits.lower) - (target > limits.upper)
        target = self._angle + math.pi * turns
        speed = -abs(velocity) if turns % 2 else abs(velocity)
        rate = (speed - turn * self._offset) / self._radius
        for joint, pid, wanted, error in (
            (self.fork, self._steering, target, target - position),
            (self.axle, self._driving, rate, rate - self.axle.velocity),
        ):
            joint.command = wanted if pid is None else pid.command(error, seconds)


def _place(joint: JointHandle) -> complex:
    """Return where a joint is in its robot, in m, with all joints at 0."""
    links = (one for one in joint.body.bullet_links if one.joint)
    x, y, _ = next(one.link.pose for one in links if one.joint.name == joint.name).position
    return complex(x, y)


class SteeredWheels(DiffDriveController):
    """Points all wheels along the circles on which they move, and reports odometry.

    The odometry is the motion of the rigid body that fits the wheels' ways best.
    """

    directions = ("vx", "vy", "wz")
    separation = 1.0

    def set_wheels(
        self,
        given: ControlParameters,
        forks: Sequence[str],
        axles: Sequence[str],
        radii: Sequence[float],
    ) -> None:
        """Set the wheels by the names of forks and axles, and their radii; raises ControlError."""
        if not all(0.0 < radius < math.inf for radius in radii):
            raise ControlError("the sizes of the wheels have to be positive")
        pairs = (self.find_joints(forks, *INTERFACES), self.find_joints(axles, VELOCITY, EFFORT))
        self.joints = sum(pairs, ())
        gains = given.below("pid_gains")
        self._wheels = [SteeredWheel(*parts, gains) for parts in zip(*pairs, radii)]
        if len({wheel.place for wheel in self._wheels}) < 2:
            raise ControlError("the wheels are all in one place")

    def distances(self) -> tuple[float, float]:
        """Let the odometry go on from where the wheels are now."""
        for wheel in self._wheels:
            wheel.roll()
        return 0.0, 0.0

    def moved(self, seconds: float) -> tuple[float, float, float]:
        places, ways = zip(*(wheel.roll() for wheel in self._wheels))
        middle, mean = sum(places) / len(places), sum(ways) / len(ways)
        arms = [place - middle for place in places]
        moments = sum((arm.conjugate() * way).imag for arm, way in zip(arms, ways))
        turned = moments / sum(abs(arm) ** 2 for arm in arms)
        way = mean - 1j * turned * middle
        self._reckoning.move(way.real, way.imag, turned)
        return way.real, way.imag, turned

    def command_joints(self, command: PlanarCommand, seconds: float) -> None:
        for wheel in self._wheels:
            velocity = complex(command.vx, command.vy) + 1j * command.wz * wheel.place
            wheel.follow(velocity, command.wz, seconds)


class SteeredWheelBase(SteeredWheels):
    """Drives in any direction, on two wheels or more; for steered_wheel_base_controller.

    Its topics are /cmd_vel and /odom, as of youBot's copy, and those in its own namespace.
    """

    kinds = {"steered_wheel_base_controller/SteeredWheelBaseController": VELOCITY}

    def configure(self, given: ControlParameters) -> None:
        timeout = given.get("cmd_vel_timeout", 0.5)
        usual = {
            "wheels": given.value("wheels"),
            "pid_gains": given.value("pid_gains"),
            "wheel_diameter_scale": given.get("wheel_diameter_scale", 1.0),
            "cmd_vel_timeout": timeout if timeout > 0.0 else NEVER,
            "publish_rate": given.get("odometry_publishing_frequency", 30.0),
            "odom_frame_id": given.get("odometry_frame", "odom"),
            "base_frame_id": given.get("base_frame", "base_link"),
            "pose_covariance_diagonal": [0] * 6,
            "twist_covariance_diagonal": [0] * 6,
        }
        super().configure(ControlParameters(usual, given.where))
        self._limiters = Limiter(given, "linear"), Limiter(given, "yaw")
        self.input("/cmd_vel", PlanarCommand, self.command)
        shared = self.output("/odom", OdometrySample)
        self.odometry.connect(shared.send, lambda: shared.wanted)

    def find_wheels(self, given: ControlParameters) -> None:
        listed = given.value("wheels")
        if not isinstance(listed, list) or len(listed) < 2:
            raise ControlError(f"{given.where}/wheels has to be a list of two wheels or more")
        wheels = [ControlParameters(one, f"{given.where}/wheels") for one in listed]
        joints = ([one.get(f"{key}_joint", "") for one in wheels] for key in ("steering", "axle"))
        scale = 0.5 * given.get("wheel_diameter_scale")
        self.set_wheels(given, *joints, [scale * one.get("diameter", 0.0) for one in wheels])

    def limited(self, asked: PlanarCommand, seconds: float) -> PlanarCommand:
        linear, angular = self._limiters
        wanted, last = (complex(one.vx, one.vy) for one in (asked, self._last))
        way = linear.limited(wanted, last, seconds)
        turn = angular.limited(complex(asked.wz), complex(self._last.wz), seconds)
        return PlanarCommand(way.real, way.imag, turn.real)


class Limiter:
    """Limits of a vector (m/s, or rad/s as real part), and of its growing and shrinking."""

    def __init__(self, given: ControlParameters, kind: str):
        self._speed = given.get(f"{kind}_speed_limit", 1.0)
        self._growth = given.get(f"{kind}_acceleration_limit", 1.0)
        # As in the original, 0 is no limit here.
        self._shrinking = given.get(f"{kind}_deceleration_limit", -1.0) or -1.0

    def limited(self, wanted: complex, last: complex, seconds: float) -> complex:
        """Return a velocity within the limits, `seconds` after the last one."""
        change = _shortened(wanted, self._speed) - last
        shrinks = (change * last.conjugate()).real < 0.0
        most = (self._shrinking if shrinks else self._growth) * seconds
        reached = last + _shortened(change, most)
        # It stands before it goes the other way.
        return 0j if shrinks and (reached * last.conjugate()).real < 0.0 else reached


def _shortened(vector: complex, most: float) -> complex:
    """Return a vector with a length of at most `most`, if that is not negative."""
    return vector * (most / abs(vector)) if 0.0 <= most < abs(vector) else vector


class FourWheelSteering(SteeredWheels):
    """Drives ahead and turns with four wheels, two in front and two at the rear.

    Its parameters are those of ros_controllers, but for the distances, which are the URDF's. As
    there, it cannot turn on the spot. It drives sideways, too, as AgileX's copy for Ranger does.
    """

    kinds = {"four_wheel_steering_controller/FourWheelSteeringController": VELOCITY}

    def find_wheels(self, given: ControlParameters) -> None:
        forks, axles = (
            (*given.required_names(f"front_{what}"), *given.required_names(f"rear_{what}"))
            for what in ("steering", "wheel")
        )
        if (len(forks), len(axles)) != (4, 4):
            raise ControlError("it needs two joints in each of front_wheel … rear_steering")
        (first,) = self.find_joints(axles[:1])
        radius = wheel_radius(given, first.described)
        self.set_wheels(given, forks, axles, [radius] * 4)

    def limited(self, asked: PlanarCommand, seconds: float) -> PlanarCommand:
        return replace(super().limited(asked, seconds), vy=asked.vy)

    def command_joints(self, command: PlanarCommand, seconds: float) -> None:
        stands = abs(command.vx) <= STANDING
        super().command_joints(STANDSTILL if stands else command, seconds)
