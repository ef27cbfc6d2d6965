"""Joints of ros_control: as a URDF describes them, and as simulated hardware; and PIDs."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Mapping
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Vector
from bullet_lab.simulation.physics.bodies import Body
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.wheel_drives import Wheel
from bullet_lab.simulation.world.description import LIMITS
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.tags import Document
from bullet_lab.simulation.world.urdf import UrdfTag
from bullet_lab.simulation.world.xml import XmlError, parse_text

LOG = logging.getLogger(__name__)

PREFIX = "hardware_interface/"
POSITION = "PositionJointInterface"
VELOCITY = "VelocityJointInterface"
EFFORT = "EffortJointInterface"
INTERFACES = (POSITION, VELOCITY, EFFORT)
SOFT_LIMITS = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")
# The fields of `JointLimits` that parameters change, by their kinds.
LIMIT_PARAMETERS = {
    "velocity": {"velocity": "max_velocity"},
    "acceleration": {"acceleration": "max_acceleration"},
    "effort": {"effort": "max_effort"},
    "position": {"lower": "min_position", "upper": "max_position"},
}
# Tags of shapes that have a radius.
ROUND = ("cylinder", "sphere")
# Effort (N m or N) of a motor without limit.
STRONGEST = 1e6
# Share of its distance that a position-controlled joint moves in one step: all, as in Gazebo.
AT_ONCE = 1.0


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint's commands, in rad or m, per s and s², and N m or N; inf for none.

    The last four are those of URDF's `<safety_controller>`, which slows a joint down; gains in 1/s
    and N m s, None without one.
    """

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    acceleration: float = math.inf
    effort: float = math.inf
    soft_lower_limit: float = 0.0
    soft_upper_limit: float = 0.0
    k_position: float | None = None
    k_velocity: float | None = None

    def changed_by(self, given: ControlParameters) -> JointLimits:
        """Return the limits with those of joint_limits/<joint>: has_…_limits, max_… and min_…."""
        changed = {}
        for kind, names in LIMIT_PARAMETERS.items():
            limits = {field: given.get(name) for field, name in names.items()}
            switch = given.value(f"has_{kind}_limits")
            if switch is False:
                changed.update({field: getattr(JointLimits, field) for field in limits})
            elif switch is True and None not in limits.values():
                changed.update(limits)
        return replace(self, **changed)


@dataclass(frozen=True)
class DescribedJoint:
    """A joint of the URDF; `kind` is URDF's type, `interface` that of its transmission.

    `origin` is its place in its parent link in m. `radius` is that of the wheel below it in m: of
    the first collision of its child link; None if that is neither a cylinder nor a sphere.
    """

    name: str
    kind: str
    origin: Vector = (0.0, 0.0, 0.0)
    limits: JointLimits = JointLimits()
    radius: float | None = None
    interface: str = ""

    def error(self, position: float, target: float) -> float:
        """Return the distance (rad or m) to a target: the shortest one that the limits allow."""
        if self.kind not in ("revolute", "continuous"):
            return target - position
        near = math.remainder(target - position, math.tau)
        for distance in (near, near - math.copysign(math.tau, near)):
            if self.limits.lower <= position + distance <= self.limits.upper:
                return distance
        return near

    def within_limits(self, target: float) -> float:
        """Return the nearest position within the described limits."""
        return _between(target, self.limits.lower, self.limits.upper)


def described_joints(
    urdf: str, source: str, interfaces: Mapping[str, str] | None = None
) -> dict[str, DescribedJoint]:
    """Return the joints that have a transmission in the text of a URDF, by name; raises XmlError.

    As in Gazebo, an invalid transmission is ignored with a warning. With `interfaces` by
    names of joints, those joints are returned instead.
    """
    robot = UrdfTag(parse_text(urdf, source), source, Document(ResourceFinder()))
    links, joints = (map(robot.below, robot.element.findall(tag)) for tag in ("link", "joint"))
    radii = {link.name: _radius(link) for link in links}
    known = {joint.name: _joint(joint, radii) for joint in joints}
    found = dict(interfaces or {})
    for element in () if interfaces else robot.element.findall("transmission"):
        where = f"{source}: transmission '{element.get('name', '')}'"
        try:
            name, interface = _transmission(element)
        except XmlError as error:
            LOG.warning("%s %s, and is left out", where, error)
            continue
        if name in found:
            LOG.warning("%s: joint '%s' has a transmission already; ignored", where, name)
            continue
        found[name] = interface
    return {
        name: replace(known.get(name, DescribedJoint(name, "")), interface=interface)
        for name, interface in found.items()
    }


def _joint(tag: UrdfTag, radii: Mapping[str, float | None]) -> DescribedJoint:
    kind, limits = tag.text("type"), {}
    if tag.element.find("limit") is not None:
        if tag.element.find("safety_controller") is not None:
            limits = {key: tag.number(f"safety_controller/{key}") for key in SOFT_LIMITS}
        limits.update({key: tag.bound(f"limit/{key}") for key in LIMITS})
        if kind == "continuous":
            limits.update(lower=-math.inf, upper=math.inf)
    radius = radii.get(tag.text("child/link"))
    return DescribedJoint(tag.name, kind, tag.pose().position, JointLimits(**limits), radius)


def _radius(link: UrdfTag) -> float | None:
    """Return the radius (m) of the first collision, if it is a cylinder or a sphere."""
    shape = link.element.find("collision[1]/geometry/*")
    is_round = shape is not None and shape.tag in ROUND
    return link.other(shape).sizes("radius", 1)[0] if is_round else None


def _transmission(element: Element) -> tuple[str, str]:
    """Return the name of the joint and its interface; raises XmlError with what is wrong."""
    for is_missing, what in (
        (not element.get("name"), "name"),
        (not (element.findtext("type") or "").strip(), "<type>"),
        (element.find("actuator") is None, "<actuator>"),
    ):
        if is_missing:
            raise XmlError(f"has no {what}")
    joints = element.findall("joint")
    if len(joints) != 1 or not joints[0].get("name"):
        raise XmlError(f"has {len(joints) or 'no'} joints; it needs one, with a name")
    joint = joints[0].get("name", "")
    texts = ((child.text or "").strip() for child in joints[0].findall("hardwareInterface"))
    # As in Gazebo, the first counts; robots older than ROS Indigo have no prefix.
    interface = next(filter(None, texts), "")
    if not interface:
        raise XmlError(f"has no <hardwareInterface> in its joint '{joint}'")
    name = interface[len(PREFIX) :] if interface.startswith(PREFIX) else interface
    if name not in INTERFACES:
        known = ", ".join(PREFIX + one for one in INTERFACES)
        raise XmlError(f"has the interface '{interface}'; known are {known}")
    return joint, name


class Pid:
    """A PID loop with the gains, clamps and anti-windup of control_toolbox.

    Parameters: p, i, d, i_clamp (or i_clamp_min, i_clamp_max) and antiwindup. With `antiwindup` the
    integral itself is kept so small that its contribution is within the clamps, else only its
    contribution. Raises ControlError without p.
    """

    def __init__(self, parameters: ControlParameters):
        self.p = parameters.get("p")
        if self.p is None:
            raise ControlError(f"{parameters.where}/p is missing")
        self.i, self.d = parameters.get("i", 0.0), parameters.get("d", 0.0)
        clamp = parameters.get("i_clamp", 0.0)
        self.i_min = -abs(parameters.get("i_clamp_min", clamp))
        self.i_max = abs(parameters.get("i_clamp_max", clamp))
        self.antiwindup = parameters.get("antiwindup", False)
        self.reset()

    def reset(self) -> None:
        """Forget the errors so far."""
        self._integral = 0.0
        # As in control_toolbox, the loop starts at error 0, so its first step has a derivative.
        self._last = 0.0

    def command(self, error: float, seconds: float, slope: float | None = None) -> float:
        """Return the command for an error, `seconds` after the last one; 0 if it is not finite.

        `slope` is the error's, if it is known.
        """
        if seconds <= 0.0 or not math.isfinite(error):
            return 0.0
        slope = (error - self._last) / seconds if slope is None else slope
        self._last = error
        self._integral += seconds * error
        if self.antiwindup and self.i:
            low, high = sorted((self.i_min / self.i, self.i_max / self.i))
            self._integral = _between(self._integral, low, high)
        contribution = self.i * self._integral
        if not self.antiwindup:
            contribution = _between(contribution, self.i_min, self.i_max)
        return self.p * error + contribution + self.d * slope


@dataclass(eq=False)
class JointHandle(ABC):
    """A joint: the state that controllers read, and the `command` that they write.

    Positions are in rad or m, velocities per s, efforts in N m or N. The command is of the kind
    of the `interface`. With a `pid`, efforts bring the joint to its commanded position or
    velocity, by the gains of gazebo_ros_control.
    """

    body: Body
    described: DescribedJoint
    limits: JointLimits
    pid: Pid | None = None

    def __post_init__(self) -> None:
        self.name = self.described.name
        self.command = 0.0
        # The effort that was applied last: the engine reports those of its motors alone.
        self._applied = 0.0
        self.read()

    def read(self) -> None:
        """Read the joint's state."""
        state = self.body.joint_state(self.name)
        self.position = state.position
        self.velocity = state.velocity
        by_motor = self.interface != EFFORT and self.pid is None
        self.effort = state.effort if by_motor else self._applied

    @abstractmethod
    def write(self, stopped: bool) -> None:
        """Act on the coming step; `stopped` is the emergency stop."""

    def placed(self) -> None:
        """Handle that the robot was placed somewhere else."""

    def _apply(self, effort: float) -> None:
        self._applied = _between(effort, -self.limits.effort, self.limits.effort)
        if self._applied:
            self.body.exert(self.name, self._applied)

    def _speed_limits(self, position: float) -> tuple[float, float]:
        """Return the least and the greatest velocity that the limits allow at a position."""
        limits, most = self.limits, self.limits.velocity
        if limits.k_position is None or not math.isfinite(limits.upper):
            return -most, most
        ends = (limits.soft_lower_limit, limits.soft_upper_limit)
        return tuple(_between(-limits.k_position * (position - end), -most, most) for end in ends)


def _between(value: float, least: float, most: float) -> float:
    return min(max(value, least), most)


class EffortJoint(JointHandle):
    """A joint that follows efforts."""

    interface = EFFORT

    def write(self, stopped: bool) -> None:
        self.command = _between(self.command, *self._effort_limits())
        self._apply(0.0 if stopped else self.command)

    def _effort_limits(self) -> tuple[float, float]:
        limits = self.limits
        least, most = -limits.effort, limits.effort
        if limits.k_velocity is not None:
            return tuple(
                _between(-limits.k_velocity * (self.velocity - speed), least, most)
                for speed in self._speed_limits(self.position)
            )
        if self.position < limits.lower or self.velocity < -limits.velocity:
            least = 0.0
        if self.position > limits.upper or self.velocity > limits.velocity:
            most = 0.0
        return least, most


class PositionJoint(JointHandle):
    """A joint that follows positions, within its limits of position and velocity.

    `strength` is the greatest effort (N m or N) of its motor.
    """

    interface = POSITION
    strength = STRONGEST

    def __post_init__(self) -> None:
        super().__post_init__()
        # The position during an emergency stop.
        self._held = self.position
        # The last limited command; None after the robot was placed.
        self._before: float | None = None

    def placed(self) -> None:
        self._before = None

    def write(self, stopped: bool) -> None:
        if stopped:
            self.command = self._held
        self._held = self.command if stopped else self.position
        before = self.position if self._before is None else self._before
        slowest, fastest = self._speed_limits(before)
        least = max(before + slowest * STEP_SECONDS, self.limits.lower)
        most = min(before + fastest * STEP_SECONDS, self.limits.upper)
        self.command = self._before = _between(self.command, least, most)
        if self.pid is None:
            self.body.hold_joint(self.name, self.command, self.strength, AT_ONCE)
        else:
            error = self.described.error(self.position, self.command)
            self._apply(self.pid.command(error, STEP_SECONDS))


class VelocityJoint(JointHandle):
    """A joint that follows velocities, by a motor with the limit of its effort."""

    interface = VELOCITY

    def __post_init__(self) -> None:
        super().__post_init__()
        # The last limited command.
        self._before = 0.0
        most = min(self.limits.effort, STRONGEST)
        self._wheel = Wheel(self.body, self.name, most) if self.pid is None else None

    def placed(self) -> None:
        if self._wheel is not None:
            self._wheel.stop()

    def write(self, stopped: bool) -> None:
        slowest, fastest = self._speed_limits(self.position)
        if math.isfinite(self.limits.acceleration):
            before = self._before if self.limits.k_velocity is None else self.velocity
            change = self.limits.acceleration * STEP_SECONDS
            slowest, fastest = max(slowest, before - change), min(fastest, before + change)
        self.command = self._before = _between(self.command, slowest, fastest)
        speed = 0.0 if stopped else self.command
        if self._wheel is None:
            self._apply(self.pid.command(speed - self.velocity, STEP_SECONDS))
        else:
            self._wheel.keep(speed)


KINDS: Mapping[str, type[JointHandle]] = {
    kind.interface: kind for kind in (PositionJoint, VelocityJoint, EffortJoint)
}


def joint_handles(
    bodies: Mapping[str, Body],
    described: Mapping[str, DescribedJoint],
    parameters: ControlParameters,
) -> dict[str, JointHandle]:
    """Return the joints of a robot that have a transmission, by name.

    A transmission of a joint that the model does not have, or that cannot move, is ignored with
    a warning. Parameters: joint_limits/<joint> and gazebo_ros_control/pid_gains/<joint>.
    """
    handles: dict[str, JointHandle] = {}
    owners = {name: body for body in bodies.values() for name in body.joint_names}
    for name, joint in described.items():
        if name not in owners:
            where = f"{parameters.where}: a transmission's joint '{name}'"
            LOG.warning("%s is no movable joint of the model, and is left out", where)
            continue
        limits = joint.limits.changed_by(parameters.below(f"joint_limits/{name}"))
        gains = parameters.below(f"gazebo_ros_control/pid_gains/{name}")
        has_pid = joint.interface != EFFORT and gains.get("p") is not None
        parts = (owners[name], joint, limits, Pid(gains) if has_pid else None)
        handles[name] = KINDS[joint.interface](*parts)
    return handles
