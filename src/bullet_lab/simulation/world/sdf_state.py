"""Reading the `<state>` of a saved world: where the parts of models are and how they move."""

from __future__ import annotations

import logging
import math
from typing import Dict, Iterable, Mapping
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose, Vector, add, cross
from bullet_lab.simulation.world.description import FrameState, Joint, Model, ModelState
from bullet_lab.simulation.world.xml import child_text, number, numbers

LOG = logging.getLogger(__name__)

STANDSTILL = "0 0 0 0 0 0"


def read_states(element: Element, models: Iterable[Model], source: str) -> Mapping[str, ModelState]:
    """Return the states of models by their names.

    Args:
        element: a `<state>`.
        models: those of the world; what is said of others is passed over.
        source: names the document in messages.

    Raises:
        XmlError: a number cannot be read.
    """
    known = {model.name: model for model in models}
    states: Dict[str, ModelState] = {}
    for child in element.findall("model"):
        name = child.get("name", "")
        where = f"{source}: state of model '{name}'"
        if name not in known:
            LOG.warning("%s: there is no such model", where)
        else:
            states[name] = _model_state(child, known[name], where)
    return states


def _model_state(element: Element, model: Model, source: str) -> ModelState:
    present = model.links_by_name()
    links = {
        child.get("name", ""): _frame_state(child, f"{source}: link '{child.get('name', '')}'")
        for child in element.findall("link")
        if child.get("name", "") in present
    }
    positions = {
        child.get("name", ""): number(child_text(child, "angle", "0"), f"{source}: <angle>")
        for child in element.findall("joint")
    }
    joints = {
        joint.name: (positions.get(joint.name, _position(joint, links)), _rate(joint, links))
        for joint in model.joints
    }
    return ModelState(_pose(element, source), links, joints)


def _frame_state(element: Element, source: str) -> FrameState:
    values = numbers(child_text(element, "velocity", STANDSTILL), 6, f"{source}: <velocity>")
    return FrameState(_pose(element, source), values[:3], values[3:])


def _pose(element: Element, source: str) -> Pose:
    values = numbers(child_text(element, "pose", STANDSTILL), 6, f"{source}: <pose>")
    return Pose.from_rpy(values[:3], values[3:])


def _position(joint: Joint, links: Mapping[str, FrameState]) -> float:
    """Return where a joint stands (rad or m), from where the links at its ends do."""
    if joint.parent not in links or joint.child not in links:
        return 0.0
    moved = (links[joint.parent].pose * joint.pose).inverse() * links[joint.child].pose
    if joint.kind == "prismatic":
        return _along(joint.axis, moved.position, (0.0, 0.0, 0.0))
    x, y, z, w = moved.quaternion
    half = math.atan2(_along(joint.axis, (x, y, z), (0.0, 0.0, 0.0)), w)
    return math.remainder(2.0 * half, math.tau)


def _rate(joint: Joint, links: Mapping[str, FrameState]) -> float:
    """Return how fast a joint moves (rad/s or m/s), from how the links at its ends do."""
    if joint.parent not in links or joint.child not in links:
        return 0.0
    parent, child = links[joint.parent], links[joint.child]
    axis = child.pose.rotate(joint.axis)
    if joint.kind == "prismatic":
        arm = tuple(a - b for a, b in zip(child.pose.position, parent.pose.position))
        carried = add(parent.linear, cross(parent.angular, arm))
        return _along(axis, child.linear, carried)
    return _along(axis, child.angular, parent.angular)


def _along(axis: Vector, moving: Vector, still: Vector) -> float:
    return sum(a * (m - s) for a, m, s in zip(axis, moving, still))
