"""diff_drive_controller: a robot on left and right wheels, driven by velocities."""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass
from typing import Any, Mapping

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.controller import (
    Controller,
    Setting,
    is_due,
    schedule_of,
)
from bullet_lab.simulation.plugins.controllers.joints import VELOCITY, DescribedJoint
from bullet_lab.simulation.plugins.mobile_base import OdometrySender
from bullet_lab.simulation.plugins.samples import (
    STANDSTILL,
    OdometrySample,
    PlanarCommand,
    TransformSample,
    VelocitySample,
    is_sound,
)
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning

LOG = logging.getLogger(__name__)
# Limits of the multipliers in dynamic_reconfigure, as in ros_controllers.
MULTIPLIERS = (0.5, 1.5)
# Limits of publish_rate in Hz, likewise.
RATES = (0.0, 2000.0)
# Greatest number of updates that the reported velocity is a mean of.
LONGEST_WINDOW = 10_000


@dataclass(frozen=True)
class SpeedLimiter:
    """Limits of a velocity, an acceleration and a jerk; None for no limit."""

    velocity: tuple[float, float] | None = None
    acceleration: tuple[float, float] | None = None
    jerk: tuple[float, float] | None = None

    @classmethod
    def of(cls, parameters: ControlParameters) -> SpeedLimiter:
        """Read has_…_limits, max_… and min_…, which is -max_… by default."""

        def limits(kind: str) -> tuple[float, float] | None:
            most = parameters.get(f"max_{kind}", 0.0)
            least = parameters.get(f"min_{kind}", -most)
            if not parameters.get(f"has_{kind}_limits", False):
                return None
            if least > most:
                what = f"{parameters.where}/max_{kind} is {most:g}"
                raise ControlError(f"{what}: it must be at least min_{kind}, {least:g}")
            return least, most

        return cls(*map(limits, ("velocity", "acceleration", "jerk")))

    def limited(self, speed: float, last: float, before: float, seconds: float) -> float:
        """Return a speed within the limits, given the last two speeds, `seconds` apart."""
        if self.jerk is not None:
            jolt = _clamp(speed - last - (last - before), self.jerk, 2.0 * seconds * seconds)
            speed = last + (last - before) + jolt
        if self.acceleration is not None:
            speed = last + _clamp(speed - last, self.acceleration, seconds)
        return speed if self.velocity is None else _clamp(speed, self.velocity)


def _clamp(value: float, ends: tuple[float, float], scale: float = 1.0) -> float:
    return min(max(value, ends[0] * scale), ends[1] * scale)


class DiffDriveController(Controller, OdometrySender):
    """Drives the wheels of each side as commanded, within limits, and reports odometry.

    Its parameters are those of ros_controllers. The robot stops if no command has come for
    cmd_vel_timeout.

    Attributes:
        separation: of the left and right wheels in m, with the multiplier.
        radii: of the left and right wheels in m, with the multipliers.
    """

    kinds = {"diff_drive_controller/DiffDriveController": VELOCITY}
    # The components of a command that it uses.
    directions = ("vx", "wz")

    def configure(self, given: ControlParameters) -> None:
        self._multipliers: dict[str, float] = {}
        self.find_wheels(given)
        self._linear_limits = SpeedLimiter.of(given.below("linear/x"))
        self._angular_limits = SpeedLimiter.of(given.below("angular/z"))
        self._timeout = given.get("cmd_vel_timeout", 0.5)
        self._open_loop = given.get("open_loop", False)
        self._where, rate = given.where, given.get("publish_rate", 50.0)
        self._schedule = schedule_of(rate, self._where)
        odom = given.get("odom_frame_id", "odom")
        self.frames = (odom, given.get("base_frame_id", "base_link"))
        self._variances = [
            given.numbers(f"{kind}_covariance_diagonal", 6) for kind in ("pose", "twist")
        ]
        window = int(min(max(given.get("velocity_rolling_window_size", 10.0), 1), LONGEST_WINDOW))
        # Velocities of the last updates: ahead, to the left, and angular.
        self._velocities: deque[tuple[float, ...]] = deque(maxlen=window)
        # With distances of the rims instead of angles: the sides may have different radii.
        self._reckoning = DeadReckoning(self.separation, 1.0)
        self.sends_transforms = given.get("enable_odom_tf", True)
        if self._multipliers:
            multipliers = self._multipliers.items()
            self.adjustables = (
                *(Setting(name, value, name, *MULTIPLIERS) for name, value in multipliers),
                Setting("publish_rate", rate, "Hz of the odometry", *RATES),
                Setting("enable_odom_tf", self.sends_transforms, "odometry on /tf"),
            )
        alone = not given.get("allow_multiple_cmd_vel_publishers", True)
        self.input("cmd_vel", PlanarCommand, self.command, alone)
        self.odometry = self.output("odom", OdometrySample)
        self.transform = self.output("/tf", TransformSample)
        tells = given.get("publish_cmd", False)
        self.commanded = self.output("cmd_vel_out", VelocitySample, tells)
        self.reset(0)
        if given.get("publish_wheel_joint_controller_state", False):
            LOG.warning("%s/publish_wheel_joint_controller_state is not simulated", given.where)

    def find_wheels(self, given: ControlParameters) -> None:
        """Find the joints and the geometry of the wheels; raises ControlError."""
        left, right = (given.required_names(f"{side}_wheel") for side in ("left", "right"))
        if len(left) != len(right):
            raise ControlError(f"{len(left)} wheels on the left, {len(right)} on the right")
        self._sides = (self.find_joints(left), self.find_joints(right))
        self.joints = sum(self._sides, ())
        # Values that are no parameters come from the URDF, of the first wheel of each side.
        left, right = (side[0].described for side in self._sides)
        apart = given.get("wheel_separation", math.dist(left.origin, right.origin))
        # Before all multipliers.
        self._measured = apart, wheel_radius(given, left)
        both = given.get("wheel_radius_multiplier")
        radii = (f"{side}_wheel_radius_multiplier" for side in ("left", "right"))
        found = {name: given.get(name, 1.0) if both is None else both for name in radii}
        name = "wheel_separation_multiplier"
        self._set_multipliers({**found, name: given.get(name, 1.0)})

    def command(self, command: PlanarCommand) -> None:
        """Take over a velocity; it acts from the next update on.

        Raises ControlError if it is not finite or too large, or the controller does not run.
        """
        if not self.running:
            raise ControlError(f"controller '{self.name}' is not running")
        if not is_sound(*(getattr(command, name) for name in self.directions)):
            raise ControlError(f"the velocity {command} is not finite, or too large")
        self._asked, self._asked_at = command, None

    def adjust(self, values: Mapping[str, Any], step: int) -> None:
        schedule = schedule_of(min(values["publish_rate"], STEPS_PER_SECOND), self._where)
        self._set_multipliers({name: values[name] for name in self._multipliers})
        self._reckoning.separation = self.separation
        self.placed()
        schedule.restart(step)
        self._schedule = schedule
        self.sends_transforms = values["enable_odom_tf"]

    def starting(self, step: int) -> None:
        self.stopping()
        self._restart(step)

    def _restart(self, step: int) -> None:
        """Report from a step on, and forget the velocities before."""
        self._schedule.restart(step)
        self._velocities.clear()
        self._velocity = STANDSTILL

    def stopping(self) -> None:
        for joint in self.joints:
            joint.command = 0.0

    def placed(self) -> None:
        self._reckoning.resume(*self.distances())

    def reset(self, step: int) -> None:
        # The simulated time of the command; None until the update after it.
        self._asked_at: int | None = 0
        self._asked = self._last = self._before = STANDSTILL
        self._reckoning.restart(*self.distances())
        self._restart(step)

    def update(self, step: int, seconds: float) -> None:
        self._velocities.append(tuple(part / seconds for part in self.moved(seconds)))
        means = (sum(speeds) / len(speeds) for speeds in zip(*self._velocities))
        self._velocity = self._last if self._open_loop else PlanarCommand(*means)
        if is_due(self._schedule, step):
            pose = Pose.on_floor(*self._reckoning.pose)
            self.send_odometry(step, pose, self._velocity, *self._variances, flat=True)
        if self._asked_at is None:
            self._asked_at = step
        late = (step - self._asked_at) / STEPS_PER_SECOND > self._timeout
        command = self.limited(STANDSTILL if late else self._asked, seconds)
        self._before, self._last = self._last, command
        self.command_joints(command, seconds)
        if self.commanded.wanted:
            self.commanded.send(VelocitySample(step, "", command))

    def moved(self, seconds: float) -> tuple[float, float, float]:
        """Update the odometry's pose; return the motion ahead, to the left (m) and the turn."""
        if self._open_loop:
            # The last command counts as driven.
            self._reckoning.resume(0.0, 0.0)
            left, right = (speed * seconds for speed in self._last.rims(self.separation))
        else:
            left, right = self.distances()
        driven, turned = self._reckoning.advance(left, right)
        return driven, 0.0, turned

    def limited(self, asked: PlanarCommand, seconds: float) -> PlanarCommand:
        """Return a velocity within the limits."""
        last, before = self._last, self._before
        return PlanarCommand(
            vx=self._linear_limits.limited(asked.vx, last.vx, before.vx, seconds),
            wz=self._angular_limits.limited(asked.wz, last.wz, before.wz, seconds),
        )

    def command_joints(self, command: PlanarCommand, _seconds: float) -> None:
        """Pass a velocity on to the joints."""
        for side, speed, radius in zip(self._sides, command.rims(self.separation), self.radii):
            for joint in side:
                joint.command = speed / radius

    def distances(self) -> tuple[float, float]:
        """Return how far (m) the wheels of each side have rolled, on average."""
        return tuple(
            radius * sum(joint.position for joint in side) / len(side)
            for radius, side in zip(self.radii, self._sides)
        )

    def _set_multipliers(self, multipliers: dict[str, float]) -> None:
        """Set the multipliers of both radii and of the separation, by name.

        Raises ControlError for invalid ones, and changes nothing then.
        """
        (separation, radius), (left, right, apart) = self._measured, multipliers.values()
        sizes = (apart * separation, left * radius, right * radius)
        if not all(0.0 < size < math.inf for size in sizes):
            raise ControlError("separation and radius of the wheels have to be positive")
        self._multipliers = multipliers
        self.separation, self.radii = sizes[0], sizes[1:]


def wheel_radius(given: ControlParameters, wheel: DescribedJoint) -> float:
    """Return the radius (m) that is a parameter or that of the URDF; raises ControlError."""
    radius = given.get("wheel_radius", wheel.radius)
    if radius is None:
        what = f"the first collision of the wheel on '{wheel.name}'"
        raise ControlError(f"{what} is no cylinder or sphere, and there is no wheel_radius")
    return radius
