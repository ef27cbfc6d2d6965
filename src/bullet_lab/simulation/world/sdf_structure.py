"""Read how the parts of an SDF model are connected: frames, nested models, joints and states."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import Iterable, Iterator, Mapping, Sequence, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
from bullet_lab.simulation.world.description import (
    LIMITS,
    SEPARATOR,
    WORLD_LINK,
    FrameState,
    Joint,
    Link,
    Model,
    ModelState,
)
from bullet_lab.simulation.world.shapes import Shape
from bullet_lab.simulation.world.tags import MODEL_FRAME, Frames, Tag
from bullet_lab.simulation.world.tree import lump_fixed_joints, rooted, with_sound_inertias
from bullet_lab.simulation.world.xml import ElementReader, XmlError

LOG = logging.getLogger(__name__)

JOINT_KINDS = ("fixed", "revolute", "continuous", "prismatic", "ball")
# SDF's default limits mean "none".
NO_BOUND = 1e16
# Before version 1.5, axes were given in the model's frame.
AXES_IN_JOINTS = (1, 5)
# Before version 1.7, a frame moved with the one that its pose was given in.
FRAMES_ATTACHED = (1, 7)
# A nested model with full names, and the frame that its pose is given in.
Nested = Tuple[Model, str]


class SdfTag(Tag):
    """An SDF element."""

    def shape(self, element: Element, where: str) -> Shape | None:  # noqa: D102
        shape = super().shape(element, where)
        if shape is None and element.tag != "empty":
            LOG.warning("%s: geometry <%s> is not simulated", where, element.tag)
        return shape

    def base(self) -> str:
        """Return the frame that its <pose> is given in; empty for the one around it."""
        found = self.element.find("pose")
        return "" if found is None else found.get("relative_to") or found.get("frame") or ""

    def pose(self) -> Pose:  # noqa: D102
        base, pose = self.base(), super().pose()
        frames, inside = self.document.frames, self.document.inside
        if frames is None or base in ("", inside):
            return pose
        return frames.pose(inside).inverse() * frames.pose(base) * pose


def scoped(model: Model, held: bool) -> Model:
    """Return a nested model with its name before the names of its parts.

    `held` means that the outer model is static. A static model in one that is not is anchored,
    each of its links separately.
    """
    prefix = model.name + SEPARATOR

    def named(name: str) -> str:
        return name if name == WORLD_LINK else prefix + name

    anchored = model.static and not held
    links = (replace(link, name=named(link.name), anchored=anchored) for link in model.links)
    joints = (
        replace(j, name=named(j.name), parent=named(j.parent), child=named(j.child))
        for j in (() if anchored else model.joints)
    )
    plugins = (
        replace(p, link=named(p.link) if p.link else "", scope=prefix + p.scope)
        for p in model.plugins
    )
    frames = {named(name): (named(link), pose) for name, (link, pose) in model.frames.items()}
    return replace(
        model, links=tuple(links), joints=tuple(joints), plugins=tuple(plugins), frames=frames
    )


def model_frames(
    tag: SdfTag, links: Iterable[SdfTag], joints: Iterable[SdfTag], nested: Iterable[Nested]
) -> Frames:
    """Return the frames of a model: of links, of <frame>s, of nested models and of joints."""
    frames = Frames(tag.source)
    for link in links:
        frames.add(link.name, link.pose(), link.base())
    for frame in map(tag.below, tag.element.findall("frame")):
        base, attached = frame.base(), frame.element.get("attached_to", "")
        if not attached and tag.document.version < FRAMES_ATTACHED:
            attached = base
        frames.add(frame.name, frame.pose(), base or attached, attached or MODEL_FRAME)
    for model, base in nested:
        carrier = model.links[0].name if model.links else MODEL_FRAME
        frames.add(model.name, model.pose, base, carrier)
        for link in model.links:
            frames.add(link.name, link.pose, model.name)
        for name, (carrier, pose) in model.frames.items():
            frames.add(name, pose, carrier, carrier)
    for joint in joints:
        child = joint.text("child")
        frames.add(joint.name, joint.pose(), joint.base() or child, child)
    return frames


def places(
    tag: SdfTag, frames: Frames, links: Sequence[Link], nested: Iterable[Nested]
) -> dict[str, tuple[str, Pose]]:
    """Return the link that each <frame> and nested model moves with, and its pose there."""
    names = [element.get("name", "") for element in tag.element.findall("frame")]
    found: dict[str, tuple[str, Pose]] = {}
    for model, _ in nested:
        found.update(model.frames)
        names.append(model.name)
    known = {link.name for link in links}
    for name in names:
        if links and name not in known:
            carrier = frames.carrier(name)
            carrier = carrier if carrier in known else links[0].name
            found[name] = (carrier, frames.pose(carrier).inverse() * frames.pose(name))
    return found


def read_joint(tag: SdfTag, frames: Frames, links: Mapping[str, Link], model: str) -> Joint:
    """Return a joint; raise XmlError if one of its links is missing."""
    parent, child = (_end(tag, tag.text(end), frames, links, model) for end in ("parent", "child"))
    at = {WORLD_LINK: Pose(), **{name: link.pose for name, link in links.items()}}
    paths = {key: f"axis/limit/{key}" for key in LIMITS}
    limits = {key: tag.bound(path) for key, path in paths.items() if tag.text(path)}
    # The pose of the joint in its child.
    place = at[child].inverse() * frames.pose(tag.base() or child) * tag.pose()
    if not tag.base() and child == tag.text("child"):
        place = tag.pose()
    kind = tag.element.get("type", "")
    if kind not in JOINT_KINDS:
        what = f"type '{kind}' is not simulated; its links are fixed to each other"
        tag.document.report(f"{tag.source}: {what}")
        kind = "fixed"
    return Joint(
        tag.name,
        kind,
        parent,
        child,
        at[parent].inverse() * at[child],
        _axis(tag, frames, place, at[child]),
        {key: value for key, value in limits.items() if abs(value) < NO_BOUND},
        tag.number("axis/dynamics/damping", 0.0),
        tag.number("axis/dynamics/friction", 0.0),
        place.position,
    )


def _end(tag: SdfTag, name: str, frames: Frames, links: Mapping[str, Link], model: str) -> str:
    """Return the link at an end of a joint, which may be given by a frame or a full name."""
    if name == WORLD_LINK:
        return name
    prefix = model + SEPARATOR
    for candidate in (name, name[len(prefix) :] if name.startswith(prefix) else name):
        found = candidate if candidate in links else frames.carrier(candidate)
        if found in links:
            return found
    raise XmlError(f"{tag.source}: has an unknown link '{name}'")


def _axis(tag: SdfTag, frames: Frames, place: Pose, child: Pose) -> Vector:
    """Return the axis in the child's frame; `place` is the pose of the joint in the child."""
    axis = tag.direction("axis/xyz", "0 0 1")
    xyz = tag.element.find("axis/xyz")
    base = "" if xyz is None else xyz.get("expressed_in", "")
    if tag.document.version < AXES_IN_JOINTS or tag.boolean("axis/use_parent_model_frame", False):
        base = base or MODEL_FRAME
    if base:
        return child.inverse().rotate(frames.pose(base).rotate(axis))
    return place.rotate(axis) if place.quaternion != Pose().quaternion else axis


def merged(model: Model, source: str) -> Model:
    """Return a model as trees of joints, with links on fixed joints merged; raise XmlError."""
    if not model.links:
        raise XmlError(f"{source}: there is no link")
    links, joints = rooted(model.links, model.joints, source)
    found = lump_fixed_joints(replace(model, links=links, joints=joints))
    return with_sound_inertias(found, source)


def read_states(element: Element, models: Iterable[Model], source: str) -> dict[str, ModelState]:
    """Return the states of a world's models in a saved `<state>`, by their names."""
    known = {model.name: model for model in models}
    states: dict[str, ModelState] = {}
    for child in element.findall("model"):
        name = child.get("name", "")
        where = f"{source}: state of model '{name}'"
        if name not in known:
            LOG.warning("%s: unknown model", where)
            continue
        try:
            states[name] = _model_state(child, known[name], where)
        except XmlError as error:
            LOG.warning("%s; the model keeps its initial state", error)
    return states


def _model_state(element: Element, model: Model, source: str) -> ModelState:
    present = model.links_by_name()
    links: dict[str, FrameState] = {}
    for name, child in _in_state(element, "link"):
        if name in present:
            tag = ElementReader(child, f"{source}: link '{name}'")
            values = tag.numbers("velocity", 6, "0 0 0 0 0 0")
            links[name] = FrameState(tag.pose(), values[:3], values[3:])
    if WORLD_LINK in present:
        links[WORLD_LINK] = FrameState(model.pose)
    positions = {
        name: ElementReader(child, source).number("angle", 0.0)
        for name, child in _in_state(element, "joint")
    }
    joints = {}
    for joint in model.joints:
        if joint.kind != "ball":
            position, rate = _joint_state(joint, links)
            joints[joint.name] = (positions.get(joint.name, position), rate)
    return ModelState(ElementReader(element, source).pose(), links, joints)


def _in_state(element: Element, tag: str, scope: str = "") -> Iterator[tuple[str, Element]]:
    """Yield the links or joints of a state by their full names, with those of nested models."""
    for child in element.findall(tag):
        yield scope + child.get("name", ""), child
    for nested in element.findall("model"):
        yield from _in_state(nested, tag, f"{scope}{nested.get('name', '')}{SEPARATOR}")


def _joint_state(joint: Joint, links: Mapping[str, FrameState]) -> tuple[float, float]:
    """Return position (rad or m) and velocity of a joint, from the states of its links."""
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


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(one, other))
