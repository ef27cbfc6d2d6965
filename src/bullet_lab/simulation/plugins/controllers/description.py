"""What ros_control takes from a robot's URDF: its transmissions, and the joints as described."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import Dict, Iterator, Mapping, Optional, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Vector
from bullet_lab.simulation.plugins.controllers.parameters import ControlParameters
from bullet_lab.simulation.world.xml import XmlError, child_text, number, numbers, parse_text

LOG = logging.getLogger(__name__)

PREFIX = "hardware_interface/"
# What a joint can be told, by the name of its hardware interface.
POSITION, VELOCITY, EFFORT = INTERFACES = (
    "PositionJointInterface",
    "VelocityJointInterface",
    "EffortJointInterface",
)
ROLLING = ("cylinder", "sphere")


@dataclass(frozen=True)
class SoftLimits:
    """Where a joint is slowed down: URDF's `<safety_controller>`, gains in 1/s and N m s."""

    lower: float
    upper: float
    k_position: float
    k_velocity: float


@dataclass(frozen=True)
class JointLimits:
    """Limits of what a joint is told, in rad or m, per s and s², and N m or N; inf for none."""

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    acceleration: float = math.inf
    effort: float = math.inf
    soft: Optional[SoftLimits] = None

    def changed_by(self, given: ControlParameters) -> JointLimits:
        """Return the limits with what joint_limits/<joint> says: has_…_limits, max_… and min_…."""
        limits = self
        for kind in ("velocity", "acceleration", "effort"):
            most = given.optional_number(f"max_{kind}")
            switch = given.value(f"has_{kind}_limits")
            if switch is False:
                limits = replace(limits, **{kind: math.inf})
            elif switch is True and most is not None:
                limits = replace(limits, **{kind: most})
        switch = given.value("has_position_limits")
        ends = given.optional_number("min_position"), given.optional_number("max_position")
        if switch is False:
            return replace(limits, lower=-math.inf, upper=math.inf)
        if switch is True and None not in ends:
            return replace(limits, lower=ends[0], upper=ends[1])
        return limits


@dataclass(frozen=True)
class DescribedJoint:
    """A joint as the URDF has it.

    `origin` is its place in its parent link in m, `radius` that of the wheel below it in m, by
    the first collision of its child; None where that is neither cylinder nor sphere.
    """

    name: str
    kind: str
    origin: Vector = (0.0, 0.0, 0.0)
    limits: JointLimits = JointLimits()
    radius: Optional[float] = None

    def error(self, position: float, target: float) -> float:
        """Return how far (rad or m) it is to a target, on the shorter way that limits allow."""
        if self.kind not in ("revolute", "continuous"):
            return target - position
        near = math.remainder(target - position, math.tau)
        if self.kind == "continuous":
            return near
        for way in (near, near - math.copysign(math.tau, near)):
            if self.limits.lower <= position + way <= self.limits.upper:
                return way
        return near

    def within_limits(self, target: float) -> float:
        """Return the nearest position that the described limits allow."""
        if self.kind not in ("revolute", "prismatic"):
            return target
        return min(max(target, self.limits.lower), self.limits.upper)


@dataclass(frozen=True)
class RobotDescription:
    """Joints by name, and the hardware interfaces of those that have a transmission."""

    joints: Mapping[str, DescribedJoint]
    interfaces: Mapping[str, str]

    @classmethod
    def read(cls, urdf: str, source: str) -> RobotDescription:
        """Read the text of a URDF; raises XmlError.

        As in Gazebo, a transmission that makes no sense is named in a warning, and left out.
        """
        robot = parse_text(urdf, source)
        radii = dict(_radii(robot))
        joints = {}
        for element in robot.findall("joint"):
            joint = _joint(element, f"{source}: joint '{element.get('name', '')}'")
            child = element.find("child")
            below = "" if child is None else child.get("link", "")
            joints[joint.name] = replace(joint, radius=radii.get(below))
        return cls(joints, _interfaces(robot, source))


def _joint(element: Element, where: str) -> DescribedJoint:
    kind, limit = element.get("type", ""), element.find("limit")
    limits, safety = JointLimits(), element.find("safety_controller")
    if limit is not None:
        told = {key: _attribute(limit, key, where) for key in limit.attrib}
        ends = ("lower", "upper", "velocity", "effort")
        values = {key: told.get(key, 0.0) for key in ends}
        if kind == "continuous":
            values.update(lower=-math.inf, upper=math.inf)
        limits = JointLimits(**values, soft=None if safety is None else _soft(safety, where))
    origin = element.find("origin")
    text = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
    place = numbers(text, 3, f"{where}: <origin>")
    return DescribedJoint(element.get("name", ""), kind, place, limits)


def _soft(safety: Element, where: str) -> SoftLimits:
    keys = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")
    return SoftLimits(*(_attribute(safety, key, where) for key in keys))


def _attribute(element: Element, key: str, where: str) -> float:
    text = element.get(key, "0")
    # Infinity is no trouble here.
    return math.inf if text.strip() == "inf" else number(text, f"{where}: <{element.tag}> {key}")


def _radii(robot: Element) -> Iterator[Tuple[str, float]]:
    for link in robot.findall("link"):
        for shape in link.findall("collision[1]/geometry/*"):
            if shape.tag in ROLLING:
                where = f"link '{link.get('name', '')}': <{shape.tag}> radius"
                yield link.get("name", ""), number(shape.get("radius"), where)


def _interfaces(robot: Element, source: str) -> Dict[str, str]:
    found: Dict[str, str] = {}
    for element in robot.findall("transmission"):
        where = f"{source}: transmission '{element.get('name', '')}'"
        try:
            joint, interface = _transmission(element)
        except XmlError as error:
            LOG.warning("%s %s, and is left out", where, error)
            continue
        if joint in found:
            LOG.warning("%s: '%s' has one already, which counts", where, joint)
        found.setdefault(joint, interface)
    return found


def _transmission(element: Element) -> Tuple[str, str]:
    """Return the name of the joint and its interface; raises XmlError with what is wrong."""
    if not element.get("name"):
        raise XmlError("has no name")
    if not child_text(element, "type"):
        raise XmlError("has no <type>")
    if element.find("actuator") is None:
        raise XmlError("has no <actuator>")
    joints = element.findall("joint")
    if len(joints) != 1 or not joints[0].get("name"):
        raise XmlError(f"has {len(joints) or 'no'} joints, and one with a name is simulated")
    texts = [(told.text or "").strip() for told in joints[0].findall("hardwareInterface")]
    if not any(texts):
        raise XmlError(f"has no <hardwareInterface> in its joint '{joints[0].get('name')}'")
    # As in Gazebo, the first counts; the prefix is missing in robots of before ROS Indigo.
    interface = next(filter(None, texts))
    name = interface[len(PREFIX) :] if interface.startswith(PREFIX) else interface
    if name not in INTERFACES:
        known = ", ".join(PREFIX + one for one in INTERFACES)
        raise XmlError(f"has the interface '{interface}', which is none of {known}")
    return joints[0].get("name", ""), name
