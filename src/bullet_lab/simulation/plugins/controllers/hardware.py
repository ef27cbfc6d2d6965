"""A robot's joints as ros_control's simulated hardware has them: read, told what to do, limited."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from typing import ClassVar, Dict, List, Optional, Tuple, Type

from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.plugins.controllers.description import (
    EFFORT,
    POSITION,
    VELOCITY,
    DescribedJoint,
    JointLimits,
    RobotDescription,
    SoftLimits,
)
from bullet_lab.simulation.plugins.controllers.parameters import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.pid import Pid, PidGains
from bullet_lab.simulation.plugins.wheel_drives import Wheel

LOG = logging.getLogger(__name__)

# N m or N of a motor that no limit holds back.
STRONGEST = 1e6
# What part of its distance a joint is brought in one step: all of it, as Gazebo sets positions.
AT_ONCE = 1.0


class JointHandle(ABC):
    """A joint: what controllers read of it, and the `command` that they write.

    Positions are in rad or m, velocities per s, efforts in N m or N, and so is the command,
    which is of the kind of the `interface`.
    """

    interface: ClassVar[str]

    def __init__(self, body: Body, described: DescribedJoint, limits: JointLimits):
        self.name, self.described, self.limits = described.name, described, limits
        self._body = body
        self.command = 0.0
        self.read()

    def read(self) -> None:
        """Take over where the joint is."""
        state = self._body.joint_state(self.name)
        self.position, self.velocity, self.effort = state.position, state.velocity, state.effort

    @abstractmethod
    def write(self, seconds: float, stopped: bool) -> None:
        """Act on the coming step; `stopped` while the emergency stop is pressed."""

    def placed(self) -> None:
        """Take note that the robot was put somewhere else."""

    def _soft_speeds(self, position: float) -> Tuple[float, float]:
        """Return the least and the greatest speed that the limits allow at a position."""
        most, soft = self.limits.velocity, self.limits.soft
        if soft is None or not math.isfinite(self.limits.upper):
            return -most, most
        return _slowed(soft, position, soft.lower, most), _slowed(soft, position, soft.upper, most)


def _slowed(soft: SoftLimits, position: float, end: float, most: float) -> float:
    return _between(-soft.k_position * (position - end), -most, most)


def _between(value: float, least: float, most: float) -> float:
    return min(max(value, least), most)


class EffortJoint(JointHandle):
    """A joint that is turned or pushed."""

    interface = EFFORT
    _exerted = 0.0

    def read(self) -> None:
        super().read()
        # The engine knows of its motors alone.
        self.effort = self._exerted

    def write(self, seconds: float, stopped: bool) -> None:
        self.command = _between(self.command, *self._bounds())
        self._exert(0.0 if stopped else self.command)

    def _exert(self, effort: float) -> None:
        self._exerted = _between(effort, -self.limits.effort, self.limits.effort)
        if self._exerted:
            self._body.exert(self.name, self._exerted)

    def _bounds(self) -> Tuple[float, float]:
        limits, soft = self.limits, self.limits.soft
        least, most = -limits.effort, limits.effort
        if soft is not None:
            slowest, fastest = self._soft_speeds(self.position)
            return (
                _between(-soft.k_velocity * (self.velocity - slowest), least, most),
                _between(-soft.k_velocity * (self.velocity - fastest), least, most),
            )
        if self.position < limits.lower or self.velocity < -limits.velocity:
            least = 0.0
        if self.position > limits.upper or self.velocity > limits.velocity:
            most = 0.0
        return least, most


class PositionJoint(JointHandle):
    """A joint that is put at a position, as far as its limits of position and speed allow."""

    interface = POSITION

    def __init__(self, body: Body, described: DescribedJoint, limits: JointLimits):
        super().__init__(body, described, limits)
        self._held = self.position
        self.placed()

    def placed(self) -> None:
        self._before: Optional[float] = None

    def write(self, seconds: float, stopped: bool) -> None:
        self._limit(seconds, stopped)
        self._body.hold_joint(self.name, self.command, STRONGEST, AT_ONCE)

    def _limit(self, seconds: float, stopped: bool) -> None:
        if stopped:
            self.command = self._held
        self._held = self.command if stopped else self.position
        before = self.position if self._before is None else self._before
        slowest, fastest = self._soft_speeds(before)
        least = max(before + slowest * seconds, self.limits.lower)
        most = min(before + fastest * seconds, self.limits.upper)
        self.command = self._before = _between(self.command, least, most)


class PositionPidJoint(PositionJoint, EffortJoint):
    """A joint that is turned or pushed towards a position, by gains of gazebo_ros_control."""

    interface = POSITION
    pid: Pid

    def write(self, seconds: float, stopped: bool) -> None:
        self._limit(seconds, stopped)
        error = self.described.error(self.position, self.command)
        self._exert(self.pid.command(error, seconds))


class _SpeedJoint(JointHandle):
    """A joint that is told a speed."""

    interface = VELOCITY
    _before = 0.0

    def _limited(self, seconds: float, stopped: bool) -> float:
        slowest, fastest = self._soft_speeds(self.position)
        if math.isfinite(self.limits.acceleration):
            before = self._before if self.limits.soft is None else self.velocity
            change = self.limits.acceleration * seconds
            slowest, fastest = max(slowest, before - change), min(fastest, before + change)
        self.command = self._before = _between(self.command, slowest, fastest)
        return 0.0 if stopped else self.command


class VelocityJoint(_SpeedJoint):
    """A joint that a motor drives at a speed, with no more than the limit of its effort."""

    def __init__(self, body: Body, described: DescribedJoint, limits: JointLimits):
        super().__init__(body, described, limits)
        self._driven: Optional[float] = None
        self._wheel = Wheel(body, self.name, min(limits.effort, STRONGEST))

    def placed(self) -> None:
        self._driven = None
        self._wheel.stop()

    def write(self, seconds: float, stopped: bool) -> None:
        speed = self._limited(seconds, stopped)
        # A motor keeps its speed; one that is to stand has to be looked after.
        if speed == 0.0 or speed != self._driven:
            self._driven = speed
            self._wheel.follow(speed, seconds)


class VelocityPidJoint(_SpeedJoint, EffortJoint):
    """A joint that is turned or pushed towards a speed, by gains of gazebo_ros_control."""

    pid: Pid

    def write(self, seconds: float, stopped: bool) -> None:
        error = self._limited(seconds, stopped) - self.velocity
        self._exert(self.pid.command(error, seconds))


KINDS: Dict[str, Type[JointHandle]] = {
    kind.interface: kind for kind in (PositionJoint, VelocityJoint, EffortJoint)
}
PID_KINDS: Dict[str, Type[JointHandle]] = {
    kind.interface: kind for kind in (PositionPidJoint, VelocityPidJoint)
}


class RobotHardware:
    """All joints of a robot that have a transmission.

    A transmission on what is no movable joint of the model is named in a warning and left out.

    Args:
        bodies: of the robot.
        description: of the robot.
        parameters: joint_limits/<joint> and gazebo_ros_control/pid_gains/<joint> among them.
    """

    def __init__(
        self, bodies: List[Body], description: RobotDescription, parameters: ControlParameters
    ):
        self.description = description
        self.joints: Dict[str, JointHandle] = {}
        owners = {name: body for body in bodies for name in body.joint_names}
        for name, interface in description.interfaces.items():
            described = description.joints.get(name)
            if described is None or name not in owners:
                where = f"{parameters.where}: a transmission's joint '{name}'"
                LOG.warning("%s is no movable joint of the model, and is left out", where)
                continue
            limits = described.limits.changed_by(parameters.below(f"joint_limits/{name}"))
            gains = parameters.below(f"gazebo_ros_control/pid_gains/{name}")
            pid = interface in PID_KINDS and gains.optional_number("p") is not None
            joint = (PID_KINDS if pid else KINDS)[interface](owners[name], described, limits)
            if pid:
                joint.pid = Pid(PidGains.of(gains))
            self.joints[name] = joint

    def joint(self, name: str, interface: str) -> JointHandle:
        """Return a joint that takes commands of an interface; raises ControlError."""
        found = self.joints.get(name)
        if found is None or found.interface != interface:
            have = ", ".join(j.name for j in self.joints.values() if j.interface == interface)
            raise ControlError(f"no joint '{name}' has a {interface}; those are: {have or 'none'}")
        return found

    def read(self) -> None:
        """Take over where all joints are."""
        for joint in self.joints.values():
            joint.read()

    def write(self, seconds: float, stopped: bool) -> None:
        """Let all joints act on the coming step, `seconds` after the last one."""
        for joint in self.joints.values():
            joint.write(seconds, stopped)

    def placed(self) -> None:
        """Take note that the robot was put somewhere else."""
        for joint in self.joints.values():
            joint.placed()
