"""A robot for ros_control: its parameters, and the joints and transmissions of its URDF."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import Any, Dict, Mapping, Optional, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Vector
from bullet_lab.simulation.plugins import PluginError
from bullet_lab.simulation.world.description import LIMITS
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.tags import Document
from bullet_lab.simulation.world.urdf import UrdfTag
from bullet_lab.simulation.world.xml import XmlError, child_text, parse_text

LOG = logging.getLogger(__name__)

PREFIX = "hardware_interface/"
POSITION = "PositionJointInterface"
VELOCITY = "VelocityJointInterface"
EFFORT = "EffortJointInterface"
INTERFACES = (POSITION, VELOCITY, EFFORT)
# What a parameter of a kind has to be.
EXPECTED = {float: "a finite number", bool: "true or false", str: "a text"}
SOFT_LIMITS = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")
# Tags of shapes that have a radius.
ROUND = ("cylinder", "sphere")


class ControlError(PluginError):
    """A controller that cannot be made, or a request that it refuses."""


class ControlParameters:
    """A tree of parameters below the namespace `where`, read by paths such as "linear/x/max_jerk".

    As in ROS, a value of the wrong type is ignored; a warning names it.
    """

    def __init__(self, tree: Any, where: str):
        self._tree = tree if isinstance(tree, Mapping) else {}
        self.where = where

    def value(self, path: str) -> Any:
        """Return the value at a path, or None."""
        found: Any = self._tree
        for key in path.strip("/").split("/"):
            if not isinstance(found, Mapping) or key not in found:
                return None
            found = found[key]
        return found

    def below(self, path: str) -> ControlParameters:
        """Return the parameters below a path."""
        return ControlParameters(self.value(path), f"{self.where}/{path}")

    def get(self, path: str, default: Any = None) -> Any:
        """Return a value of the default's type: a finite number, true or false, or a text.

        Without a default, it is a number.
        """
        found, kind = self.value(path), float if default is None else type(default)
        is_valid = _is_number(found) if kind is float else isinstance(found, kind)
        return kind(found) if is_valid else self._ignored(path, EXPECTED[kind], default)

    def names(self, path: str) -> Optional[Tuple[str, ...]]:
        """Return a list of names, or None; a text is a list of one name."""
        found = self.value(path)
        if isinstance(found, str):
            return (found,)
        if isinstance(found, list) and all(isinstance(name, str) for name in found):
            return tuple(found)
        return self._ignored(path, "a list of names", None)

    def required_names(self, path: str) -> Tuple[str, ...]:
        """Return a list of names; raises ControlError if there are none."""
        found = self.names(path)
        if not found:
            raise ControlError(f"{self.where}/{path} is missing or empty; it must name joints")
        return found

    def numbers(self, path: str, count: int) -> Tuple[float, ...]:
        """Return a list of `count` finite numbers; raises ControlError without one."""
        found = self.value(path)
        if not isinstance(found, list) or len(found) != count or not all(map(_is_number, found)):
            raise ControlError(f"{self.where}/{path} has to be a list of {count} numbers")
        return tuple(map(float, found))

    def _ignored(self, path: str, expected: str, default: Any) -> Any:
        """Return the default, with a warning if there is an invalid value at a path."""
        found = self.value(path)
        if found is not None:
            LOG.warning("%s/%s: %.80r is not %s; ignored", self.where, path, found, expected)
        return default


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(value)


@dataclass(frozen=True)
class SoftLimits:
    """URDF's `<safety_controller>`, which slows a joint down; gains in 1/s and N m s."""

    lower: float
    upper: float
    k_position: float
    k_velocity: float


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint's commands, in rad or m, per s and s², and N m or N; inf for none."""

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    acceleration: float = math.inf
    effort: float = math.inf
    soft: Optional[SoftLimits] = None

    def changed_by(self, given: ControlParameters) -> JointLimits:
        """Return the limits with those of joint_limits/<joint>: has_…_limits, max_… and min_…."""
        changed: Dict[str, float] = {}
        for kind in ("velocity", "acceleration", "effort"):
            most = given.get(f"max_{kind}")
            switch = given.value(f"has_{kind}_limits")
            if switch is False:
                changed[kind] = math.inf
            elif switch is True and most is not None:
                changed[kind] = most
        switch = given.value("has_position_limits")
        lower, upper = given.get("min_position"), given.get("max_position")
        if switch is False:
            changed.update(lower=-math.inf, upper=math.inf)
        elif switch is True and None not in (lower, upper):
            changed.update(lower=lower, upper=upper)
        return replace(self, **changed)


@dataclass(frozen=True)
class DescribedJoint:
    """A joint of the URDF.

    Attributes:
        name: of the joint.
        kind: URDF's type.
        origin: its place in its parent link, in m.
        limits: of its `<limit>` and `<safety_controller>`.
        radius: of the wheel below it in m: of the first collision of its child link; None if that
            is neither a cylinder nor a sphere.
    """

    name: str
    kind: str
    origin: Vector = (0.0, 0.0, 0.0)
    limits: JointLimits = JointLimits()
    radius: Optional[float] = None

    def error(self, position: float, target: float) -> float:
        """Return the distance (rad or m) to a target: the shortest one that the limits allow."""
        if self.kind not in ("revolute", "continuous"):
            return target - position
        near = math.remainder(target - position, math.tau)
        if self.kind == "continuous":
            return near
        for distance in (near, near - math.copysign(math.tau, near)):
            if self.limits.lower <= position + distance <= self.limits.upper:
                return distance
        return near

    def within_limits(self, target: float) -> float:
        """Return the nearest position within the described limits."""
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

        As in Gazebo, an invalid transmission is ignored with a warning.
        """
        robot = UrdfTag(parse_text(urdf, source), source, Document(ResourceFinder()))
        element = robot.element
        radii = {link.name: _radius(link) for link in map(robot.below, element.findall("link"))}
        joints = [_joint(joint, radii) for joint in map(robot.below, element.findall("joint"))]
        return cls({joint.name: joint for joint in joints}, _interfaces(element, source))


def _joint(tag: UrdfTag, radii: Mapping[str, Optional[float]]) -> DescribedJoint:
    kind, limits = tag.text("type"), JointLimits()
    if tag.element.find("limit") is not None:
        soft = None
        if tag.element.find("safety_controller") is not None:
            soft = SoftLimits(*(tag.number(f"safety_controller/{key}", 0.0) for key in SOFT_LIMITS))
        limits = JointLimits(**{key: tag.bound(f"limit/{key}") for key in LIMITS}, soft=soft)
        if kind == "continuous":
            limits = replace(limits, lower=-math.inf, upper=math.inf)
    radius = radii.get(tag.text("child/link"))
    return DescribedJoint(tag.name, kind, tag.pose().position, limits, radius)


def _radius(link: UrdfTag) -> Optional[float]:
    """Return the radius (m) of the first collision, if it is a cylinder or a sphere."""
    shape = link.element.find("collision[1]/geometry/*")
    is_round = shape is not None and shape.tag in ROUND
    return link.other(shape).sizes("radius", 1)[0] if is_round else None


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
            LOG.warning("%s: joint '%s' has a transmission already; ignored", where, joint)
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
        raise XmlError(f"has {len(joints) or 'no'} joints; it needs one, with a name")
    joint = joints[0].get("name", "")
    texts = [(child.text or "").strip() for child in joints[0].findall("hardwareInterface")]
    if not any(texts):
        raise XmlError(f"has no <hardwareInterface> in its joint '{joint}'")
    # As in Gazebo, the first counts; robots older than ROS Indigo have no prefix.
    interface = next(filter(None, texts))
    name = interface[len(PREFIX) :] if interface.startswith(PREFIX) else interface
    if name not in INTERFACES:
        known = ", ".join(PREFIX + one for one in INTERFACES)
        raise XmlError(f"has the interface '{interface}'; known are {known}")
    return joint, name
