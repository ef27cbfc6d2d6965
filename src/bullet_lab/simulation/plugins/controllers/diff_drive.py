"""diff_drive_controller: a robot on wheels at its left and right, driven by velocities."""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass
from typing import Any, Deque, Dict, Mapping, Optional, Tuple

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins.controllers.controller import (
    VELOCITY,
    Adjustable,
    Controller,
    ControllerSetup,
)
from bullet_lab.simulation.plugins.controllers.description import DescribedJoint
from bullet_lab.simulation.plugins.controllers.parameters import ControlError, ControlParameters
from bullet_lab.simulation.plugins.mobile_base import STANDSTILL
from bullet_lab.simulation.plugins.plugin import Input, Output
from bullet_lab.simulation.plugins.samples import (
    OdometrySample,
    PlanarCommand,
    TransformSample,
    VelocitySample,
    is_sound,
)
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning

LOG = logging.getLogger(__name__)
# What dynamic_reconfigure lets them be, in ros_controllers.
MULTIPLIERS = (0.5, 1.5)
RATES = (0.0, 2000.0)
# Updates that the speed is a mean of; a longer window would be memory for nothing.
LONGEST_WINDOW = 10_000


@dataclass(frozen=True)
class SpeedLimiter:
    """Limits of a speed, its change, and the change of that, per s, s² and s³; None for none."""

    velocity: Optional[Tuple[float, float]] = None
    acceleration: Optional[Tuple[float, float]] = None
    jerk: Optional[Tuple[float, float]] = None

    @classmethod
    def of(cls, parameters: ControlParameters) -> SpeedLimiter:
        """Read has_…_limits, max_… and min_…, which is -max_… by default."""

        def limits(kind: str) -> Optional[Tuple[float, float]]:
            most = parameters.number(f"max_{kind}", 0.0)
            least = parameters.number(f"min_{kind}", -most)
            if not parameters.boolean(f"has_{kind}_limits", False):
                return None
            if least > most:
                raise ControlError(
                    f"{parameters.where}/max_{kind} is {most:g}: "
                    f"it must be at least min_{kind}, {least:g}"
                )
            return least, most

        return cls(limits("velocity"), limits("acceleration"), limits("jerk"))

    def limited(self, speed: float, last: float, before: float, seconds: float) -> float:
        """Return what is left of a speed after those of the last two times, `seconds` apart."""
        if self.jerk is not None:
            jolt = _clamp(speed - last - (last - before), self.jerk, 2.0 * seconds * seconds)
            speed = last + (last - before) + jolt
        if self.acceleration is not None:
            speed = last + _clamp(speed - last, self.acceleration, seconds)
        return speed if self.velocity is None else _clamp(speed, self.velocity)


def _clamp(value: float, ends: Tuple[float, float], scale: float = 1.0) -> float:
    return min(max(value, ends[0] * scale), ends[1] * scale)


class WheelOdometry:
    """Where wheels have brought a robot, and how fast: means of the last `window` updates."""

    def __init__(self, separation: float, window: int, left: float, right: float):
        # Ways at the rim instead of angles: the sides may have different radii.
        self._reckoning = DeadReckoning(separation, 1.0)
        self._speeds: Deque[Tuple[float, float]] = deque(maxlen=window)
        self.restart(left, right)

    def restart(self, left: float, right: float) -> None:
        """Be at the origin, with the rims at these ways (m)."""
        self._reckoning.restart(left, right)
        self.forget_speeds()

    def resume(self, left: float, right: float) -> None:
        """Take new ways (m) of the rims for the present pose: nothing was driven."""
        self._reckoning.resume(left, right)

    def adjust(self, separation: float, left: float, right: float) -> None:
        """Go on with another separation (m), and so ways (m) of the rims."""
        self._reckoning.separation = separation
        self.resume(left, right)

    def forget_speeds(self) -> None:
        """Take no part of what was into the speed."""
        self._speeds.clear()
        self.velocity = STANDSTILL

    def advance(self, left: float, right: float, seconds: float) -> None:
        """Take new ways (m) of the rims, `seconds` after the last."""
        driven, turned = self._reckoning.advance(left, right)
        self._speeds.append((driven / seconds, turned / seconds))
        ahead, turning = (sum(speeds) / len(self._speeds) for speeds in zip(*self._speeds))
        self.velocity = PlanarCommand(vx=ahead, wz=turning)

    def pose(self) -> Pose:
        """Return the pose in the frame of the odometry."""
        x, y, yaw = self._reckoning.pose
        return Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw))


class DiffDriveController(Controller):
    """Drives the wheels of each side as commanded, within limits, and reckons where the robot is.

    Its parameters are those of ros_controllers. Its wheels stop when no command has come for
    cmd_vel_timeout.

    Attributes:
        separation: m, of the wheels on both sides, by its parameters.
        radii: m, of the wheels on the left and on the right, likewise.
    """

    kinds = {"diff_drive_controller/DiffDriveController": VELOCITY}

    def __init__(self, setup: ControllerSetup):
        super().__init__(setup)
        given = setup.parameters
        sides = [given.required_names(f"{side}_wheel") for side in ("left", "right")]
        if len(sides[0]) != len(sides[1]):
            raise ControlError(f"{len(sides[0])} wheels on the left, {len(sides[1])} on the right")
        self._left, self._right = (setup.joints(names, VELOCITY) for names in sides)
        self.joints = self._left + self._right
        self._measured = self._geometry(given)
        self._apply(_multipliers(given))
        self._limits = [SpeedLimiter.of(given.below(path)) for path in ("linear/x", "angular/z")]
        self._timeout = given.number("cmd_vel_timeout", 0.5)
        self._open_loop = given.boolean("open_loop", False)
        rate = given.number("publish_rate", 50.0)
        self._schedule = setup.schedule(rate)
        self._frames = (
            given.text("odom_frame_id", "odom"),
            given.text("base_frame_id", "base_link"),
        )
        self._variances = tuple(
            given.numbers(f"{what}_covariance_diagonal", 6) for what in ("pose", "twist")
        )
        window = given.number("velocity_rolling_window_size", 10)
        window = int(min(max(window, 1), LONGEST_WINDOW))
        self._odometry = WheelOdometry(self.separation, window, *self._ways())
        self._sends_transforms = given.boolean("enable_odom_tf", True)
        self.adjustables = (
            *(Adjustable(name, value, name, *MULTIPLIERS) for name, value in self._factors.items()),
            Adjustable("publish_rate", rate, "Hz of the odometry", *RATES),
            Adjustable("enable_odom_tf", self._sends_transforms, "odometry on /tf"),
        )
        alone = not given.boolean("allow_multiple_cmd_vel_publishers", True)
        self.inputs = (Input(setup.topic("cmd_vel"), PlanarCommand, self.command, alone),)
        self.odometry = Output(setup.topic("odom"), OdometrySample)
        self.transform = Output("/tf", TransformSample)
        self.commanded = Output(setup.topic("cmd_vel_out"), VelocitySample)
        self.outputs = (
            self.odometry,
            self.transform,
            *((self.commanded,) if given.boolean("publish_cmd", False) else ()),
        )
        self._forget_commands()
        if given.boolean("publish_wheel_joint_controller_state", False):
            LOG.warning("%s/publish_wheel_joint_controller_state is not simulated", given.where)

    def command(self, command: PlanarCommand) -> None:
        """Take over a velocity; it acts from the next update on.

        Raises:
            ControlError: not finite or beyond `LARGEST_COMMAND`, or the controller does not run.
        """
        self._refuse_unless_running()
        if not is_sound(command.vx, command.wz):
            raise ControlError(f"the velocity {command} is not finite, or out of all proportion")
        # A new list: what comes while an update runs is told from what was there before.
        self._asked = [command]

    def adjust(self, values: Mapping[str, Any], step: int) -> None:
        schedule = self.setup.schedule(min(values["publish_rate"], STEPS_PER_SECOND))
        self._apply({name: values[name] for name in self._factors})
        self._odometry.adjust(self.separation, *self._ways())
        self._schedule = schedule
        self._schedule.restart(step)
        self._sends_transforms = values["enable_odom_tf"]

    def starting(self, step: int) -> None:
        self._brake()
        self._schedule.restart(step)
        self._odometry.forget_speeds()

    def stopping(self) -> None:
        self._brake()

    def placed(self) -> None:
        self._odometry.resume(*self._ways())

    def reset(self, step: int) -> None:
        self._forget_commands()
        self._schedule.restart(step)
        self._odometry.restart(*self._ways())

    def update(self, step: int, seconds: float) -> None:
        self._reckon(seconds)
        if self._schedule.next_step <= step:
            while self._schedule.next_step <= step:
                self._schedule.advance()
            self._report(step)
        command = self._drive(step, seconds)
        if self.commanded.wanted:
            self.commanded.send(VelocitySample(step, "", command))

    def _reckon(self, seconds: float) -> None:
        if not self._open_loop:
            self._odometry.advance(*self._ways(), seconds)
            return
        # What was commanded last counts as driven.
        self._odometry.resume(0.0, 0.0)
        left, right = self._rim_speeds(self._last)
        self._odometry.advance(left * seconds, right * seconds, seconds)
        self._odometry.velocity = self._last

    def _report(self, step: int) -> None:
        pose = self._odometry.pose()
        if self.odometry.wanted:
            velocity = self._odometry.velocity
            self.odometry.send(
                OdometrySample(step, *self._frames, pose, velocity, *self._variances)
            )
        if self._sends_transforms and self.transform.wanted:
            self.transform.send(TransformSample(step, *self._frames, pose))

    def _drive(self, step: int, seconds: float) -> PlanarCommand:
        """Tell the wheels the command, as far as the limits allow; return what is left of it."""
        if self._asked is not self._taken:
            self._taken, self._given = self._asked, step
        late = (step - self._given) / STEPS_PER_SECOND > self._timeout
        asked, last, before = STANDSTILL if late else self._taken[0], self._last, self._before
        linear, angular = self._limits
        command = PlanarCommand(
            vx=linear.limited(asked.vx, last.vx, before.vx, seconds),
            wz=angular.limited(asked.wz, last.wz, before.wz, seconds),
        )
        self._before, self._last = last, command
        for side, speed, radius in zip(
            (self._left, self._right), self._rim_speeds(command), self.radii
        ):
            for joint in side:
                joint.command = speed / radius
        return command

    def _rim_speeds(self, command: PlanarCommand) -> Tuple[float, float]:
        side = 0.5 * command.wz * self.separation
        return command.vx - side, command.vx + side

    def _ways(self) -> Tuple[float, float]:
        """Return how far (m) the wheels of each side have rolled, in the mean."""
        left, right = (
            radius * sum(joint.position for joint in side) / len(side)
            for radius, side in zip(self.radii, (self._left, self._right))
        )
        return left, right

    def _brake(self) -> None:
        for joint in self.joints:
            joint.command = 0.0

    def _forget_commands(self) -> None:
        self._asked = self._taken = [STANDSTILL]
        self._last = self._before = STANDSTILL
        self._given = 0

    def _geometry(self, given: ControlParameters) -> Tuple[float, float]:
        """Return the wheels' separation and radius, in m, before all multipliers.

        What is no parameter is taken from the URDF, of the first wheel of each side.
        """
        left, right = self._left[0].described, self._right[0].described
        separation = given.optional_number("wheel_separation")
        radius = given.optional_number("wheel_radius")
        if separation is None:
            separation = math.dist(left.origin, right.origin)
        return separation, _wheel_radius(left) if radius is None else radius

    def _apply(self, factors: Dict[str, float]) -> None:
        """Take over multipliers; raises ControlError, and changes nothing, for unusable ones."""
        separation, radius = self._measured
        left, right, apart = factors.values()
        sizes = (apart * separation, left * radius, right * radius)
        if not all(0.0 < size < math.inf for size in sizes):
            raise ControlError("separation and radius of the wheels have to be positive")
        self._factors = factors
        self.separation, self.radii = sizes[0], sizes[1:]


def _multipliers(given: ControlParameters) -> Dict[str, float]:
    """Return the multipliers of the left and right radius and of the separation, by their names."""
    both = given.optional_number("wheel_radius_multiplier")
    radii = (f"{side}_wheel_radius_multiplier" for side in ("left", "right"))
    found = {name: given.number(name, 1.0) if both is None else both for name in radii}
    name = "wheel_separation_multiplier"
    return {**found, name: given.number(name, 1.0)}


def _wheel_radius(joint: DescribedJoint) -> float:
    if joint.radius is None:
        what = f"the first collision of the wheel on '{joint.name}'"
        raise ControlError(f"{what} is no cylinder or sphere, and there is no wheel_radius")
    return joint.radius
