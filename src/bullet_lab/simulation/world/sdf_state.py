"""Reading the `<state>` of a saved world: where the parts of its models are."""

from __future__ import annotations

import logging
import math
from typing import Any, Dict, Iterator, Mapping, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Vector, add, cross, subtract
from bullet_lab.simulation.world.description import (
    SEPARATOR,
    WORLD_LINK,
    FrameState,
    Joint,
    Model,
    ModelState,
)
from bullet_lab.simulation.world.xml import ElementReader, XmlError, child_text, number

LOG = logging.getLogger(__name__)


def read_states(element: Element, models: Tuple[Model, ...], source: str) -> Dict[str, ModelState]:
    """Return what a `<state>` says of a world's models, by their names."""
    known = {model.name: model for model in models}
    states: Dict[str, ModelState] = {}
    for child in element.findall("model"):
        name = child.get("name", "")
        where = f"{source}: state of model '{name}'"
        if name not in known:
            LOG.warning("%s: there is no such model", where)
            continue
        try:
            states[name] = _model_state(child, known[name], where)
        except XmlError as error:
            LOG.warning("%s; the model stands as it is built", error)
    return states


def _model_state(element: Element, model: Model, source: str) -> ModelState:
    present = model.links_by_name()
    links: Dict[str, FrameState] = {}
    for name, child in _named(element, "link"):
        if name in present:
            tags = ElementReader(child, f"{source}: link '{name}'")
            values = tags.numbers("velocity", 6, "0 0 0 0 0 0")
            links[name] = FrameState(tags.pose(), values[:3], values[3:])
    if WORLD_LINK in present:
        links[WORLD_LINK] = FrameState(model.pose)
    positions = {
        name: number(child_text(child, "angle", "0"), f"{source}: <angle>")
        for name, child in _named(element, "joint")
    }
    joints = {}
    for joint in model.joints:
        if joint.kind == "ball":
            continue
        position, rate = _joint_state(joint, links)
        joints[joint.name] = (positions.get(joint.name, position), rate)
    return ModelState(ElementReader(element, source).pose(), links, joints)


def _named(element: Element, tag: str, scope: str = "") -> Iterator[Tuple[str, Element]]:
    """Yield the links or joints of a state by their names, those of nested models as well."""
    for child in element.findall(tag):
        yield scope + child.get("name", ""), child
    for nested in element.findall("model"):
        yield from _named(nested, tag, f"{scope}{nested.get('name', '')}{SEPARATOR}")


def _joint_state(joint: Joint, links: Mapping[str, FrameState]) -> Tuple[float, float]:
    """Return where a joint stands (rad or m) and how fast it moves, from the links at its ends."""
    if joint.parent not in links or joint.child not in links:
        return 0.0, 0.0
    parent, child = links[joint.parent], links[joint.child]
    moved = (parent.pose * joint.pose).inverse() * child.pose
    axis = child.pose.rotate(joint.axis)
    if joint.kind == "prismatic":
        arm = subtract(child.pose.position, parent.pose.position)
        carried = add(parent.linear, cross(parent.angular, arm))
        return _dot(joint.axis, moved.position), _dot(axis, subtract(child.linear, carried))
    *turn, w = moved.quaternion
    angle = math.remainder(2.0 * math.atan2(_dot(joint.axis, turn), w), math.tau)
    return angle, _dot(axis, subtract(child.angular, parent.angular))


def _dot(one: Vector, other: Any) -> float:
    return sum(a * b for a, b in zip(one, other))
