"""What holds an SDF model together: frames, nested models and joints."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, Iterable, Mapping, Sequence, Tuple

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.world.description import (
    SEPARATOR,
    WORLD_LINK,
    Joint,
    Link,
    Model,
)
from bullet_lab.simulation.world.frames import MODEL_FRAME, Frames
from bullet_lab.simulation.world.sdf_tag import SdfError, SdfTag
from bullet_lab.simulation.world.soundness import with_sound_inertias
from bullet_lab.simulation.world.tree import lump_fixed_joints, rooted

JOINT_KINDS = ("fixed", "revolute", "continuous", "prismatic", "ball")
NO_BOUND = 1e16
# Before version 1.5, axes were given in the model's frame.
AXES_IN_JOINTS = (1, 5)
# Before version 1.7, a frame moved with the one that its pose was given in.
FRAMES_ATTACHED = (1, 7)

# A nested model with all names scoped, and the frame that it is placed in.
Nested = Tuple[Model, str]
Place = Tuple[str, Pose]


def scoped(model: Model, held: bool) -> Model:
    """Return a nested model with its name before those of all that is in it.

    One that is static in a model that is not is anchored, each of its links for itself.
    """
    prefix = model.name + SEPARATOR

    def named(name: str) -> str:
        return name if name == WORLD_LINK else prefix + name

    apart = model.static and not held
    links = (replace(link, name=named(link.name), anchored=apart) for link in model.links)
    joints = (
        replace(j, name=named(j.name), parent=named(j.parent), child=named(j.child))
        for j in (() if apart else model.joints)
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
    """Return the frames of a model: of its links, of its <frame>s, of what is nested, of joints."""
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
) -> Dict[str, Place]:
    """Return the links that a model's <frame>s and nested models move with, and poses in them."""
    names = [element.get("name", "") for element in tag.element.findall("frame")]
    found = {}
    for model, _ in nested:
        found.update(model.frames)
        names.append(model.name)
    known = {link.name for link in links}
    for name in names:
        carrier = frames.carrier(name)
        if links and name not in known:
            found[name] = frames.place(name, carrier if carrier in known else links[0].name)
    return found


def read_joint(tag: SdfTag, frames: Frames, links: Mapping[str, Link], model: str) -> Joint:
    """Return a joint; raises SdfError where an end is missing."""
    parent, child = (_end(tag, tag.text(end), frames, links, model) for end in ("parent", "child"))
    at = {WORLD_LINK: Pose(), **{name: link.pose for name, link in links.items()}}
    said = [k for k in ("lower", "upper", "effort", "velocity") if tag.text(f"axis/limit/{k}")]
    limits = {key: tag.bound(f"axis/limit/{key}") for key in said}
    # Where the joint is in its child.
    place = at[child].inverse() * frames.pose(tag.base() or child) * tag.pose()
    if not tag.base() and child == tag.text("child"):
        place = tag.pose()
    return Joint(
        tag.name,
        _kind(tag),
        parent,
        child,
        at[parent].inverse() * at[child],
        _axis(tag, frames, place, at[child]),
        # Bounds as far as SDF's own defaults are none.
        {key: value for key, value in limits.items() if abs(value) < NO_BOUND},
        tag.number("axis/dynamics/damping", 0.0),
        tag.number("axis/dynamics/friction", 0.0),
        place.position,
    )


def _kind(tag: SdfTag) -> str:
    kind = tag.element.get("type", "")
    if kind in JOINT_KINDS:
        return kind
    tag.document.report(f"{tag.source}: type '{kind}' is not simulated; it holds its links fixed")
    return "fixed"


def _end(tag: SdfTag, name: str, frames: Frames, links: Mapping[str, Link], model: str) -> str:
    """Return the link at an end of a joint, which may be named by a frame or the whole way."""
    if name == WORLD_LINK:
        return name
    own = model + SEPARATOR
    for said in (name, name[len(own) :] if name.startswith(own) else name):
        found = said if said in links else frames.carrier(said)
        if found in links:
            return found
    raise SdfError(f"{tag.source}: names no link '{name}'")


def _axis(tag: SdfTag, frames: Frames, place: Pose, child: Pose) -> Vector:
    """Return the axis in the child's frame; `place` is the joint's in the child."""
    axis = tag.direction("axis/xyz", "0 0 1")
    xyz = tag.element.find("axis/xyz")
    base = "" if xyz is None else xyz.get("expressed_in", "")
    if tag.document.version < AXES_IN_JOINTS or tag.boolean("axis/use_parent_model_frame", False):
        base = base or MODEL_FRAME
    if base:
        return child.inverse().rotate(frames.pose(base).rotate(axis))
    return place.rotate(axis) if place.quaternion != Pose().quaternion else axis


def merged(model: Model, source: str) -> Model:
    """Return a whole model as trees of joints, with what is fixed merged; raises SdfError."""
    if not model.links:
        raise SdfError(f"{source}: there is no link")
    links, joints = rooted(model.links, model.joints, source)
    found = lump_fixed_joints(replace(model, links=links, joints=joints, frames={}))
    frames = {}
    for name, (link, pose) in model.frames.items():
        # A place in a link is one in the link that has remained of it.
        keeper, offset = found.frames.get(link, (link, Pose()))
        frames[name] = (keeper, offset * pose)
    return with_sound_inertias(replace(found, frames={**frames, **found.frames}), source)
