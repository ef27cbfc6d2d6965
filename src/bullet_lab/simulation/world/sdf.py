"""Read worlds and models from SDF, the format of Gazebo."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any, Callable, Collection, Container, Iterable, Tuple, Union
from xml.etree.ElementTree import Element, SubElement

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.world.description import (
    LIMITS,
    NO_LIMIT,
    SEPARATOR,
    WHITE,
    WORLD_LINK,
    Attenuation,
    Collision,
    Colour,
    Cone,
    Joint,
    Light,
    Link,
    Model,
    PluginTag,
    Visual,
    World,
)
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf_writer import SPOT_KEYS, read_states
from bullet_lab.simulation.world.shapes import Mesh, Shape
from bullet_lab.simulation.world.tags import (
    MODEL_FRAME,
    NEWEST,
    Document,
    Frames,
    SdfTag,
    actor_model,
    plugins_in,
    report_unknown,
    version_of,
)
from bullet_lab.simulation.world.tree import (
    first_of_each,
    lump_fixed_joints,
    rooted,
    with_sound_inertias,
)
from bullet_lab.simulation.world.urdf import read_urdf_element
from bullet_lab.simulation.world.xml import XmlError, parse_text, read_text

LOG = logging.getLogger(__name__)

# Gazebo's colour for a shape without a material.
DEFAULT_COLOUR: Colour = (0.7, 0.7, 0.7, 1.0)
# A longer chain of models that include models is a circle.
DEEPEST_INCLUDE = 10
JOINT_KINDS = ("fixed", "revolute", "continuous", "prismatic", "ball")
# Before version 1.5, axes were given in the model's frame.
AXES_IN_JOINTS = (1, 5)
# Before version 1.7, a frame moved with the one that its pose was given in.
FRAMES_ATTACHED = (1, 7)
# A nested model with full names, and the frame that its pose is given in.
Nested = Tuple[Model, str]
# The elements of a world or a document that are read here.
MODELS_AND_LIGHTS = ("model", "light", "include", "actor")
ModelOrLight = Union[Model, Light]


def read_world_file(path: Path) -> World:
    """Read a world from an SDF file.

    As in Gazebo, an invalid part is reported and left out, and the rest is read.

    Raises:
        XmlError: not XML, or no world; the message says what and where.
    """
    root = parse_text(read_text(path), str(path))
    element = root.find("world") if root.tag == "sdf" else None
    if element is None:
        raise XmlError(f"{path}: no <sdf> with a <world>")
    return _world(_root_tag(root, str(path), Document(ResourceFinder(path.parent))).other(element))


def read_spawned(text: str, source: str, folder: Path | None = None) -> ModelOrLight:
    """Return the model or the light in a text, SDF or URDF, that is to be spawned.

    As in Gazebo, a model may be in a <world>, where its pose is ignored if it is included, and only
    the first model is read.

    Args:
        text: of the document.
        source: its name in messages.
        folder: the folder that it belongs to; None for one that came alone.

    Raises:
        LabError: neither, or no possible model; the message says what and where.
    """
    root, document = parse_text(text, source), Document(ResourceFinder(folder))
    if root.tag == "robot":
        return read_urdf_element(root, source, document)
    if root.tag != "sdf":
        raise XmlError(f"{source}: the root element is <{root.tag}>, neither <sdf> nor <robot>")
    light = root.find("light") if root.find("model") is None else None
    if light is None:
        for include in root.iterfind("world/include"):
            if include.find("pose") is None:
                SubElement(include, "pose").text = "0 0 0 0 0 0"
    tag = _root_tag(root, source, document)
    return _first_model(tag) if light is None else _light(tag.below(light))


def _root_tag(root: Element, source: str, document: Document) -> SdfTag:
    """Return the reader of an <sdf>; warn of what is not simulated in it."""
    if root.tag != "sdf":
        raise XmlError(f"{source}: the root element is <{root.tag}>, not <sdf>")
    report_unknown(root, source, document.report)
    return SdfTag(root, source, replace(document, version=version_of(root)))


def _first_model(tag: SdfTag) -> Model:
    children = (*tag.element, *tag.element.iterfind("world[1]/*"))
    parts = [_resolved(child, tag) for child in children if child.tag in MODELS_AND_LIGHTS]
    models = [part for part in parts if part.element.tag == "model"]
    if not models:
        raise XmlError(f"{tag.source}: there is no model")
    if len(models) > 1:
        LOG.warning("%s: %d models; only the first is used", tag.source, len(models))
    return _merged(_model(models[0]), models[0].source)


def _world(tag: SdfTag) -> World:
    found = _parts(tag, MODELS_AND_LIGHTS, _model_or_light)
    frames = Frames(tag.source)
    for frame in map(tag.below, tag.element.findall("frame")):
        frames.add(frame.name, frame.pose(), frame.base() or frame.element.get("attached_to", ""))
    for part, base in found:
        frames.add(part.name, part.pose, base)
    parts = [replace(part, pose=frames.pose(base) * part.pose) for part, base in found]
    models = first_of_each((part for part in parts if isinstance(part, Model)), "model", tag.source)
    return World(
        tag.element.get("name", "default"),
        models,
        tuple(part for part in parts if isinstance(part, Light)),
        # Before version 1.6 it was in <physics>.
        tag.numbers("gravity" if tag.text("gravity") else "physics/gravity", 3, "0 0 -9.8"),
        tag.colour("scene/ambient", World.ambient),
        tag.colour("scene/background", World.background),
        tag.boolean("scene/shadows", True),
        read_states(tag.part("state").element, models, tag.source),
        tag.text("physics/ode/solver/friction_model", "pyramid_model") == "cone_model",
    )


def _model_or_light(tag: SdfTag) -> ModelOrLight:
    return _light(tag) if tag.element.tag == "light" else _merged(_model(tag), tag.source)


def _parts(
    tag: SdfTag, kinds: Container[str], read: Callable[[SdfTag], ModelOrLight]
) -> list[tuple[Any, str]]:
    """Return the valid models and lights in an element, and the frames of their poses."""

    def part(child: Element) -> tuple[ModelOrLight, str] | None:
        inner = _resolved(child, tag)
        return (read(inner), inner.base()) if inner.element.tag in kinds else None

    return tag.document.each(part, (child for child in tag.element if child.tag in kinds))


def _resolved(child: Element, tag: SdfTag) -> SdfTag:
    """Return a <model>, <light> or <actor> in a document, or what an <include> there names."""
    if child.tag == "light":
        return tag.below(child)
    if child.tag == "actor":
        child = actor_model(child)
    return tag.named(child) if child.tag == "model" else _included(tag.other(child))


def _included(tag: SdfTag) -> SdfTag:
    """Return the model or light that an <include> names, with the changes in the <include>."""
    if tag.document.depth >= DEEPEST_INCLUDE:
        raise XmlError(f"{tag.source}: models include each other in a circle")
    if not tag.text("uri"):
        raise XmlError(f"{tag.source}: an <include> without <uri>")
    where = f"{tag.source}: <include>"
    path = _model_file(tag.other(tag.element, where).file(tag.text("uri")))
    root = parse_text(read_text(path), str(path))
    finder, depth = ResourceFinder(path.parent), tag.document.depth + 1
    outer = _root_tag(root, str(path), replace(tag.document, finder=finder, depth=depth))
    first = next((child for child in root if child.tag in MODELS_AND_LIGHTS), None)
    if first is None:
        raise XmlError(f"{where}: {path}: neither a <model> nor a <light>")
    found = _resolved(first, outer)
    for change in tag.element:
        old = found.element.find(change.tag)
        if change.tag in ("pose", "static") and old is not None:
            found.element.remove(old)
        if change.tag in ("pose", "static", "plugin"):
            found.element.append(change)
    found.element.set("name", tag.text("name", found.name))
    return found


def _model_file(found: Path) -> Path:
    """Return the SDF file of a model folder, as its model.config has it."""
    if os.path.isfile(found):
        return found
    config = found / "model.config"
    if not os.path.isfile(config):
        return found / "model.sdf"
    listed = parse_text(read_text(config), str(config)).findall("sdf")
    if not listed:
        raise XmlError(f"{config}: names no <sdf> file")
    # As in Gazebo, the newest known version; if all files are newer, the first.
    known = [element for element in listed if version_of(element) <= NEWEST]
    best = max(known, key=version_of, default=listed[0])
    return ResourceFinder(found).find((best.text or "").strip())


def _model(tag: SdfTag, in_static: bool = False) -> Model:
    """Return a model before joints are sorted and links merged.

    `in_static` means that it is in a static model. Parts of nested models are named `model::name`.
    """
    static = in_static or tag.boolean("static", False)
    nested = _nested(tag, static)
    links, joints = _named(tag, "link"), _named(tag, "joint")
    frames = _model_frames(tag, links, joints, nested)
    made = [_link(link.inside(frames, link.name), static) for link in links]
    made += [link for model, _ in nested for link in model.links]
    made = [replace(link, pose=frames.pose(link.name)) for link in made]
    names = dict.fromkeys(link.name for link in made)
    found = [joint for model, _ in nested for joint in model.joints]
    found += tag.document.each(lambda joint: _joint(joint, frames, names, tag.name), joints)
    where = _places(tag, frames, names, nested)
    plugins = _plugins(tag, {*where, *names})
    plugins += tuple(plugin for model, _ in nested for plugin in model.plugins)
    return Model(tag.name, tuple(made), tuple(found), plugins, tag.pose(), static, where)


def _nested(tag: SdfTag, in_static: bool) -> list[Nested]:
    """Return the models in a model, and the frames that their poses are given in."""
    kinds = ("model", "include")
    found = _parts(tag, kinds, lambda inner: _scoped(_model(inner, in_static), in_static))
    bases = {id(model): base for model, base in found}
    models = first_of_each((model for model, _ in found), "model", tag.source)
    return [(model, bases[id(model)]) for model in models]


def _named(tag: SdfTag, kind: str) -> tuple[SdfTag, ...]:
    """Return the links or joints of a model; those without a unique name are left out."""
    found = tag.document.each(tag.named, tag.element.findall(kind))
    return first_of_each(found, kind, tag.source)


def _plugins(tag: SdfTag, frames: Container[str]) -> tuple[PluginTag, ...]:
    found = list(plugins_in(tag.element))
    for link in tag.element.findall("link"):
        for plugin in plugins_in(link, link.get("name", "")):
            frame = "" if plugin.sensor is None else tag.other(plugin.sensor).base()
            found.append(replace(plugin, link=frame) if frame in frames else plugin)
    return tuple(found)


def _link(tag: SdfTag, static: bool) -> Link:
    inner = tag.part("inertial")
    return Link(
        tag.name,
        # SDF's defaults are 1 kg and moments of 1 kg m².
        inertia=None if static else inner.inertia(inner.positive("mass", 1.0), 1.0),
        visuals=tag.shapes("visual", _visual),
        collisions=tag.shapes("collision", _collision),
        self_collide=tag.boolean("self_collide", False),
        gravity=tag.boolean("gravity", True),
    )


def _visual(tag: SdfTag, geometry: Shape) -> Visual:
    # A default colour would darken the colours and pictures in the file of a mesh.
    default = WHITE if isinstance(geometry, Mesh) else DEFAULT_COLOUR
    material = tag.part("material", f"{tag.source}: visual '{tag.name}'")
    colour, look = tag.document.materials.of_tag(material, tag.document.finder, default)
    colour = (*colour[:3], colour[3] * (1.0 - tag.number("transparency")))
    casts = tag.boolean("cast_shadows", True)
    return Visual(geometry, tag.pose(), colour, tag.name, casts, look)


def _collision(tag: SdfTag, geometry: Shape) -> Collision:
    friction, contact = "surface/friction/ode", "surface/contact/ode"
    mu, mu2 = tag.friction(f"{friction}/mu"), f"{friction}/mu2"
    # Stiffness and damping of its contacts.
    paths = (f"{contact}/kp", f"{contact}/kd")
    spring = [tag.coefficient(path) if tag.text(path) else None for path in paths]
    across = tag.friction(mu2) if tag.text(mu2) else None
    direction = tag.friction_direction(f"{friction}/fdir1")
    return Collision(geometry, tag.pose(), mu, tag.name, *spring, across, direction)


def _light(tag: SdfTag) -> Light:
    kind = tag.element.get("type", "")
    if kind not in ("point", "directional", "spot"):
        raise XmlError(f"{tag.source}: type '{kind}' is not point, directional or spot")
    fades = fields(Attenuation)
    fading = [tag.coefficient(f"attenuation/{one.name}", one.default) for one in fades]
    usual = zip(SPOT_KEYS, astuple(Cone()))
    inner, outer, falloff = (tag.number(f"spot/{key}", default) for key, default in usual)
    if not 0.0 <= inner <= outer <= 2.0 * math.pi or falloff < 0.0:
        raise XmlError(f"{tag.source}: <spot> is no cone: {inner:g}, {outer:g}, {falloff:g}")
    return Light(
        tag.element.get("name", "light"),
        kind,
        tag.pose(),
        tag.colour("diffuse", WHITE),
        tag.direction("direction", "0 0 -1"),
        tag.boolean("cast_shadows", False),
        Attenuation(*fading),
        Cone(inner, outer, falloff),
        tag.colour("specular", Light.specular),
    )


def _scoped(model: Model, in_static: bool) -> Model:
    """Return a nested model with its name before the names of its parts.

    `in_static` means that the outer model is static. A static model in one that is not is anchored,
    each of its links separately.
    """
    prefix = model.name + SEPARATOR

    def named(name: str) -> str:
        return name if name == WORLD_LINK else prefix + name

    anchored = model.static and not in_static
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


def _model_frames(
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


def _places(
    tag: SdfTag, frames: Frames, links: Collection[str], nested: Iterable[Nested]
) -> dict[str, tuple[str, Pose]]:
    """Return the link that each <frame> and nested model moves with, and its pose there."""
    names = [element.get("name", "") for element in tag.element.findall("frame")]
    found: dict[str, tuple[str, Pose]] = {}
    for model, _ in nested:
        found.update(model.frames)
        names.append(model.name)
    for name in names:
        if links and name not in links:
            carrier = frames.carrier(name)
            carrier = carrier if carrier in links else next(iter(links))
            found[name] = (carrier, frames.pose(carrier).inverse() * frames.pose(name))
    return found


def _joint(tag: SdfTag, frames: Frames, links: Collection[str], model: str) -> Joint:
    """Return a joint; raise XmlError if one of its links is missing."""
    parent, child = (_end(tag, tag.text(end), frames, links, model) for end in ("parent", "child"))
    paths = {key: f"axis/limit/{key}" for key in LIMITS}
    limits = {key: tag.bound(path) for key, path in paths.items() if tag.text(path)}
    place = tag.inside(frames, child).pose()
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
        frames.pose(parent).inverse() * frames.pose(child),
        _axis(tag, frames, place, frames.pose(child)),
        {key: value for key, value in limits.items() if abs(value) < NO_LIMIT},
        tag.number("axis/dynamics/damping"),
        tag.number("axis/dynamics/friction"),
        place.position,
    )


def _end(tag: SdfTag, name: str, frames: Frames, links: Collection[str], model: str) -> str:
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
    base = tag.part("axis/xyz").element.get("expressed_in", "")
    if tag.document.version < AXES_IN_JOINTS or tag.boolean("axis/use_parent_model_frame", False):
        base = base or MODEL_FRAME
    if base:
        return child.inverse().rotate(frames.pose(base).rotate(axis))
    return place.rotate(axis) if place.quaternion != Pose().quaternion else axis


def _merged(model: Model, source: str) -> Model:
    """Return a model as trees of joints, with links on fixed joints merged; raise XmlError."""
    if not model.links:
        raise XmlError(f"{source}: there is no link")
    links, joints = rooted(model.links, model.joints, source)
    found = lump_fixed_joints(replace(model, links=links, joints=joints))
    return with_sound_inertias(found, source)
