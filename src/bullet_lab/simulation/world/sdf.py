"""Reading worlds and models from SDF, the format of Gazebo, with the `<state>` of saved worlds."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Container, Iterator, List, Optional, Tuple, Union
from xml.etree.ElementTree import Element, SubElement

from bullet_lab.simulation.world.description import (
    WHITE,
    Attenuation,
    Collision,
    Colour,
    Cone,
    Inertia,
    Light,
    Link,
    Model,
    PluginTag,
    Visual,
    World,
)
from bullet_lab.simulation.world.frames import Frames
from bullet_lab.simulation.world.gazebo_tags import plugins_in, report_unknown
from bullet_lab.simulation.world.inertia import INERTIA_KEYS, inertia_at
from bullet_lab.simulation.world.report import leaving_out
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf_state import read_states
from bullet_lab.simulation.world.sdf_structure import (
    merged,
    model_frames,
    places,
    read_joint,
    scoped,
)
from bullet_lab.simulation.world.sdf_tag import NEWEST, Document, SdfError, version_of
from bullet_lab.simulation.world.sdf_tag import SdfTag as _Tag
from bullet_lab.simulation.world.shapes import SHAPES, Shape
from bullet_lab.simulation.world.soundness import first_of_each
from bullet_lab.simulation.world.urdf import read_urdf
from bullet_lab.simulation.world.xml import XmlError, parse_text, read_text

LOG = logging.getLogger(__name__)

# Gazebo's colour for a shape without a material.
DEFAULT_COLOUR: Colour = (0.7, 0.7, 0.7, 1.0)
# Models may include models; a chain deeper than this is a circle.
DEEPEST_INCLUDE = 10

# What a world is made of, and a document holds.
PARTS = ("model", "light", "include")
Part = Union[Model, Light]


def read_world_file(path: Path, finder: Optional[ResourceFinder] = None) -> World:
    """Read a world from an SDF file.

    As in Gazebo, what makes no sense in it is named and left out, and the rest is read.

    Raises:
        XmlError: not XML, or no world; the message says what and where.
    """
    root = parse_text(read_text(path), str(path))
    element = root.find("world") if root.tag == "sdf" else None
    if element is None:
        raise SdfError(f"{path}: no <sdf> with a <world>")
    document = Document((finder or ResourceFinder()).beside(path), version_of(root))
    report_unknown(root, str(path), document.report)
    return _world(_Tag(element, str(path), document))


def read_description(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Return the model that a text describes, SDF or URDF; `source` names it in messages.

    Raises:
        LabError: neither, or no model that could exist; the message says what and where.
    """
    root = parse_text(text, source)
    if root.tag == "robot":
        return read_urdf(text, source, finder)
    if root.tag == "sdf":
        return read_model_text(text, source, finder)
    raise XmlError(f"{source}: the root element is <{root.tag}>, neither <sdf> nor <robot>")


def read_spawned(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Part:
    """Return what is to be spawned by a text: a model, as `read_description` has it, or a light.

    As in Gazebo, the pose of a model that an <include> in a <world> names does not count.

    Raises:
        LabError: as `read_description`.
    """
    root = parse_text(text, source)
    if root.tag != "sdf":
        return read_description(text, source, finder)
    light = root.find("light") if root.find("model") is None else None
    if light is not None:
        return _light(_root_tag(root, source, finder).below(light))
    for include in root.iterfind("world/include"):
        if include.find("pose") is None:
            SubElement(include, "pose").text = "0 0 0 0 0 0"
    return _first_model(_root_tag(root, source, finder))


def read_model_text(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Read one model from SDF text; raises as `read_world_file`.

    As in Gazebo, it may stand in a <world>, and what comes after it does not count.
    """
    return _first_model(_root_tag(parse_text(text, source), source, finder))


def _root_tag(root: Element, source: str, finder: Optional[ResourceFinder]) -> _Tag:
    return _checked_root(_Tag(root, source, Document(finder or ResourceFinder(), version_of(root))))


def _first_model(tag: _Tag) -> Model:
    world, source = tag.element.find("world"), tag.source
    held = [*tag.element, *(() if world is None else world)]
    parts = [_resolved(child, tag) for child in held if child.tag in PARTS]
    models = [part for part in parts if part.element.tag == "model"]
    if not models:
        raise SdfError(f"{source}: 0 models where one is wanted")
    if len(models) > 1:
        LOG.warning("%s: %d models where one is wanted; the first counts", source, len(models))
    return merged(_model(models[0]), models[0].source)


def _world(tag: _Tag) -> World:
    found = _whole_parts(tag)
    frames = Frames(tag.source)
    for frame in map(tag.below, tag.element.findall("frame")):
        frames.add(frame.name, frame.pose(), frame.base() or frame.element.get("attached_to", ""))
    for part, base in found:
        frames.add(part.name, part.pose, base)
    parts = [replace(part, pose=frames.pose(base) * part.pose) for part, base in found]
    models = first_of_each((part for part in parts if isinstance(part, Model)), "model", tag.source)
    state = tag.element.find("state")
    return World(
        tag.element.get("name", "default"),
        models,
        tuple(part for part in parts if isinstance(part, Light)),
        # Before version 1.6 it stood in <physics>.
        tag.numbers("gravity" if tag.text("gravity") else "physics/gravity", 3, "0 0 -9.8"),
        tag.colour("scene/ambient", World.ambient),
        tag.colour("scene/background", World.background),
        tag.boolean("scene/shadows", True),
        {} if state is None else read_states(state, models, tag.source),
    )


def _whole_parts(tag: _Tag) -> List[Tuple[Part, str]]:
    """Return models and lights, with the frame that each is placed in; odd ones are left out."""
    found = []
    for child in tag.element:
        with leaving_out(tag.document.report):
            if child.tag in PARTS:
                inner = _resolved(child, tag)
                found.append((_part(inner), inner.base()))
    return found


def _part(tag: _Tag) -> Part:
    return _light(tag) if tag.element.tag == "light" else merged(_model(tag), tag.source)


def _resolved(child: Element, tag: _Tag) -> _Tag:
    """Return a <model> or <light> in a document, or what an <include> there stands for."""
    if child.tag == "light":
        return tag.below(child)
    return (
        tag.named(child)
        if child.tag == "model"
        else _included(_Tag(child, tag.source, tag.document))
    )


def _included(tag: _Tag) -> _Tag:
    """Return the model or light that an <include> names, with what the <include> changes."""
    if tag.document.depth >= DEEPEST_INCLUDE:
        raise SdfError(f"{tag.source}: models include each other in a circle")
    if not tag.text("uri"):
        raise SdfError(f"{tag.source}: an <include> without <uri>")
    where = f"{tag.source}: <include>"
    path = _model_file(_Tag(tag.element, where, tag.document).find(tag.text("uri")))
    root = parse_text(read_text(path), str(path))
    finder, depth = tag.document.finder.beside(path), tag.document.depth + 1
    document = replace(tag.document, finder=finder, version=version_of(root), depth=depth)
    outer = _checked_root(_Tag(root, str(path), document))
    first = next((child for child in root if child.tag in PARTS), None)
    if first is None:
        raise SdfError(f"{where}: {path}: neither a <model> nor a <light>")
    found = _resolved(first, outer)
    for change in tag.element:
        old = found.element.find(change.tag)
        if change.tag in ("pose", "static") and old is not None:
            found.element.remove(old)
        if change.tag in ("pose", "static", "plugin"):
            found.element.append(change)
    found.element.set("name", tag.text("name", found.name))
    return _Tag(found.element, found.source, found.document)


def _checked_root(root: _Tag) -> _Tag:
    if root.element.tag != "sdf":
        raise SdfError(f"{root.source}: the root element is <{root.element.tag}>, not <sdf>")
    report_unknown(root.element, root.source, root.document.report)
    return root


def _model_file(found: Path) -> Path:
    """Return the SDF file of a model folder, as its model.config says."""
    if os.path.isfile(found):
        return found
    config = found / "model.config"
    if not os.path.isfile(config):
        return found / "model.sdf"
    listed = parse_text(read_text(config), str(config)).findall("sdf")
    if not listed:
        raise SdfError(f"{config}: names no <sdf> file")
    # As Gazebo does, the newest that it can read; of files that are all newer, the first.
    known = [element for element in listed if version_of(element) <= NEWEST]
    best = max(known, key=version_of, default=listed[0])
    return ResourceFinder(found).find((best.text or "").strip())


def _model(tag: _Tag, held: bool = False) -> Model:
    """Return a model as it stands in a document: joints lead anywhere, and nothing is merged.

    What is `held` is in a static one. What is in nested models is named `model::name`.
    """
    static = held or tag.boolean("static", False)
    nested = [(scoped(part, static), base) for part, base in _nested(tag, static)]
    links, joints = _named(tag, "link"), _named(tag, "joint")
    frames = model_frames(tag, links, joints, nested)
    made = [_link(_Tag(t.element, t.source, t.document, frames, t.name), static) for t in links]
    made += [link for model, _ in nested for link in model.links]
    made = [replace(link, pose=frames.pose(link.name)) for link in made]
    by_name = {link.name: link for link in made}
    found = [joint for model, _ in nested for joint in model.joints]
    for joint in joints:
        with leaving_out(tag.document.report):
            found.append(read_joint(joint, frames, by_name, tag.name))
    where = places(tag, frames, made, nested)
    plugins = _plugins(tag.element, {*where, *by_name})
    plugins += tuple(plugin for model, _ in nested for plugin in model.plugins)
    return Model(tag.name, tuple(made), tuple(found), plugins, tag.pose(), static, where)


def _nested(tag: _Tag, held: bool) -> List[Tuple[Model, str]]:
    """Return the models in a model, and the frames that they are placed in."""
    found: List[Tuple[Model, str]] = []
    for child in tag.element:
        with leaving_out(tag.document.report):
            if child.tag in ("model", "include"):
                inner = _resolved(child, tag)
                if inner.element.tag == "model":
                    found.append((_model(inner, held), inner.base()))
    names = first_of_each([model for model, _ in found], "model", tag.source)
    return [(model, base) for model, base in found if any(model is one for one in names)]


def _named(tag: _Tag, kind: str) -> Tuple[_Tag, ...]:
    """Return the links or joints of a model, each with a name of its own."""
    found = []
    for element in tag.element.findall(kind):
        with leaving_out(tag.document.report):
            found.append(tag.named(element))
    return first_of_each(found, kind, tag.source)


def _plugins(element: Element, frames: Container[str]) -> Tuple[PluginTag, ...]:
    found = list(plugins_in(element))
    for link in element.findall("link"):
        for plugin in plugins_in(link, link.get("name", "")):
            pose = None if plugin.sensor is None else plugin.sensor.find("pose")
            frame = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
            found.append(replace(plugin, link=frame) if frame in frames else plugin)
    return tuple(found)


def _link(tag: _Tag, static: bool) -> Link:
    return Link(
        tag.name,
        inertia=None if static else _inertia(tag),
        visuals=tuple(_shapes(tag, "visual", _visual)),
        collisions=tuple(_shapes(tag, "collision", _collision)),
        self_collide=tag.boolean("self_collide", False),
        gravity=tag.boolean("gravity", True),
    )


def _shapes(link: _Tag, kind: str, read: Callable[[_Tag, Shape], Any]) -> Iterator[Any]:
    """Yield the visuals or collisions of a link, those that are simulated and make sense."""
    for element in link.element.findall(kind):
        holder, where = element.find("geometry"), f"{link.source}: <{kind}>"
        with leaving_out(link.document.report):
            if holder is None or not len(holder):
                raise SdfError(f"{where} without a geometry")
            shape = holder[0]
            if shape.tag in SHAPES:
                geometry = SHAPES[shape.tag].read(_Tag(shape, where, link.document))
                tag = _Tag(element, link.source, link.document, link.frames, link.inside)
                yield read(tag, geometry)
            elif shape.tag != "empty":
                LOG.warning("%s: geometry <%s> is not simulated", where, shape.tag)


def _visual(tag: _Tag, geometry: Shape) -> Visual:
    default = WHITE if geometry.has_own_colours else DEFAULT_COLOUR
    where = f"{tag.source}: visual '{tag.element.get('name', '')}'"
    element, document = tag.element.find("material"), tag.document
    colour, look = document.materials.of_element(element, where, document.finder, default)
    colour = (*colour[:3], colour[3] * (1.0 - tag.number("transparency", 0.0)))
    casts = tag.boolean("cast_shadows", True)
    return Visual(geometry, tag.pose(), colour, tag.name, casts, look)


def _collision(tag: _Tag, geometry: Shape) -> Collision:
    friction, contact = "surface/friction/ode", "surface/contact/ode"
    mu, mu2, fdir1 = tag.friction(f"{friction}/mu", 1.0), f"{friction}/mu2", f"{friction}/fdir1"
    # Stiffness and damping of its contacts, and a second friction: None for what is not said.
    paths = (f"{contact}/kp", f"{contact}/kd")
    spring = [tag.coefficient(path, 0.0) if tag.text(path) else None for path in paths]
    across = tag.friction(mu2, 1.0) if tag.text(mu2) else None
    direction = tag.direction(fdir1, "") if any(tag.numbers(fdir1, 3, "0 0 0")) else None
    return Collision(geometry, tag.pose(), mu, tag.name, *spring, across, direction)


def _inertia(link: _Tag) -> Inertia:
    # What SDF leaves out weighs 1 kg and has unit moments: the format's own defaults.
    element = link.element.find("inertial")
    element = Element("inertial") if element is None else element
    tag = _Tag(element, link.source, link.document, link.frames, link.inside)
    pose = tag.pose()
    elements = [
        tag.number(f"inertia/{key}", default)
        for key, default in zip(INERTIA_KEYS, (1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
    ]
    return inertia_at(pose, tag.positive("mass", 1.0), elements)


def _light(tag: _Tag) -> Light:
    kind = tag.element.get("type", "")
    if kind not in ("point", "directional", "spot"):
        raise SdfError(f"{tag.source}: type '{kind}' is not point, directional or spot")
    fading = {
        key: tag.coefficient(f"attenuation/{key}", getattr(Attenuation, key))
        for key in ("range", "constant", "linear", "quadratic")
    }
    inner = tag.number("spot/inner_angle", Cone.inner)
    outer = tag.number("spot/outer_angle", Cone.outer)
    falloff = tag.number("spot/falloff", Cone.falloff)
    if not 0.0 <= inner <= outer <= 2.0 * math.pi or falloff < 0.0:
        raise SdfError(f"{tag.source}: <spot> is no cone: {inner:g}, {outer:g}, {falloff:g}")
    return Light(
        tag.element.get("name", "light"),
        kind,
        tag.pose(),
        tag.colour("diffuse", WHITE),
        tag.direction("direction", "0 0 -1"),
        tag.boolean("cast_shadows", False),
        Attenuation(**fading),
        Cone(inner, outer, falloff),
    )
