"""Reading worlds and models from SDF, the format of Gazebo."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Iterator, List, Optional, Tuple, Union
from xml.etree.ElementTree import Element

from bullet_lab.simulation.description import (
    Box,
    Collision,
    Colour,
    Cylinder,
    Geometry,
    Inertia,
    Joint,
    Light,
    Link,
    Mesh,
    Model,
    Plane,
    Sphere,
    Visual,
    World,
)
from bullet_lab.simulation.inertia import check_inertia, matrix_from_elements
from bullet_lab.simulation.lumping import lump_fixed_joints
from bullet_lab.simulation.plugin_tags import plugins_in
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.tree import check_forest
from bullet_lab.simulation.xml_input import (
    XmlError,
    boolean,
    child_text,
    direction,
    friction,
    mesh_scale,
    number,
    numbers,
    parse_text,
    read_text,
    sizes,
)

LOG = logging.getLogger(__name__)

SIMULATED_JOINTS = ("fixed", "revolute", "prismatic")
# Gazebo's colour for a shape without a material.
DEFAULT_COLOUR: Colour = (0.7, 0.7, 0.7, 1.0)
# Models may include models; a chain deeper than this is a circle.
DEEPEST_INCLUDE = 10


class SdfError(XmlError):
    """A text is well-formed XML and yet no world or model."""


def read_world_file(path: Path, finder: Optional[ResourceFinder] = None) -> World:
    """Read a world from an SDF file.

    Raises:
        XmlError: not XML, or no world; the message says what and where.
        ResourceError: an included model or a mesh cannot be found or must not be read.
    """
    context = _Context(str(path), (finder or ResourceFinder()).beside(path))
    root = parse_text(read_text(path), str(path))
    element = root.find("world") if root.tag == "sdf" else None
    if element is None:
        raise SdfError(f"{path}: no <sdf> with a <world>")
    return _world(element, context)


def read_model_text(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Read one model from SDF text; raises as `read_world_file`."""
    context = _Context(source, finder or ResourceFinder())
    models = [m for m in _parts_of_sdf(parse_text(text, source), context) if isinstance(m, Model)]
    if len(models) != 1:
        raise SdfError(f"{source}: {len(models)} models where one is wanted")
    return models[0]


@dataclass(frozen=True)
class _Context:
    """Where an element comes from: for messages, and to find the files that it names.

    `static` is what an <include> says about all models in it, if it says anything.
    """

    source: str
    finder: ResourceFinder
    depth: int = 0
    static: Optional[bool] = None

    def find(self, uri: str, where: str) -> Path:
        try:
            return self.finder.find(uri)
        except ResourceError as error:
            raise ResourceError(f"{where}: {error}") from error

    def within(self, place: str) -> _Context:
        return replace(self, source=f"{self.source}: {place}")


Part = Union[Model, Light]


def _world(element: Element, context: _Context) -> World:
    parts = list(_parts(element, context))
    models = tuple(part for part in parts if isinstance(part, Model))
    _refuse_repeated_names(models, context)
    gravity = child_text(element, "gravity", "0 0 -9.8")
    scene = element.find("scene")
    scene = Element("scene") if scene is None else scene
    return World(
        element.get("name", "default"),
        models,
        tuple(part for part in parts if isinstance(part, Light)),
        numbers(gravity, 3, f"{context.source}: gravity"),
        _colour(scene, "ambient", (0.4, 0.4, 0.4, 1.0), context),
        _colour(scene, "background", (0.7, 0.7, 0.7, 1.0), context),
    )


def _refuse_repeated_names(models: Tuple[Model, ...], context: _Context) -> None:
    seen = set()
    for model in models:
        if model.name in seen:
            raise SdfError(f"{context.source}: model '{model.name}' appears twice")
        seen.add(model.name)


def _parts(element: Element, context: _Context) -> Iterator[Part]:
    """Yield the models and lights of a <world> or an <sdf>, includes resolved."""
    for child in element:
        if child.tag == "model":
            yield _model(child, context)
        elif child.tag == "light":
            yield _light(child, context)
        elif child.tag == "include":
            yield from _include(child, context)


def _parts_of_sdf(root: Element, context: _Context) -> Iterator[Part]:
    if root.tag != "sdf":
        raise SdfError(f"{context.source}: the root element is <{root.tag}>, not <sdf>")
    return _parts(root, context)


def _include(element: Element, context: _Context) -> Iterator[Part]:
    if context.depth >= DEEPEST_INCLUDE:
        raise SdfError(f"{context.source}: models include each other in a circle")
    uri = child_text(element, "uri")
    if not uri:
        raise SdfError(f"{context.source}: an <include> without <uri>")
    path = _model_file(context.find(uri, f"{context.source}: <include>"))
    said = child_text(element, "static")
    static = boolean(said, f"{context.source}: <static>") if said else context.static
    inner = _Context(str(path), context.finder.beside(path), context.depth + 1, static)
    for part in _parts_of_sdf(parse_text(read_text(path), str(path)), inner):
        name = child_text(element, "name", part.name)
        pose = _pose(element, context) if element.find("pose") is not None else part.pose
        yield replace(part, name=name, pose=pose)


def _model_file(found: Path) -> Path:
    """Return the SDF file of a model folder, as its model.config says."""
    if found.is_file():
        return found
    config = found / "model.config"
    if not config.is_file():
        return found / "model.sdf"
    listed = parse_text(read_text(config), str(config)).findall("sdf")
    if not listed:
        raise SdfError(f"{config}: names no <sdf> file")
    newest = max(listed, key=lambda e: number(e.get("version", "0"), f"{config}: version"))
    return ResourceFinder(found).find((newest.text or "").strip())


def _model(element: Element, context: _Context) -> Model:
    name = element.get("name")
    if not name:
        raise SdfError(f"{context.source}: a <model> without a name")
    inner = context.within(f"model '{name}'")
    if element.find("include") is not None or element.find("model") is not None:
        LOG.warning("%s: models inside a model are not read", inner.source)
    static = boolean(child_text(element, "static", "false"), f"{inner.source}: <static>")
    static = static if context.static is None else context.static
    links = tuple(_link(child, static, inner) for child in element.findall("link"))
    by_name = {link.name: link for link in links}
    joints = tuple(_joint(child, by_name, inner) for child in element.findall("joint"))
    check_forest(links, joints, inner.source)
    model = Model(name, links, joints, _plugins(element), _pose(element, inner), static)
    return lump_fixed_joints(model)


def _plugins(element: Element) -> tuple:
    found = list(plugins_in(element))
    for link in element.findall("link"):
        found.extend(plugins_in(link, link.get("name", "")))
    return tuple(found)


def _link(element: Element, static: bool, context: _Context) -> Link:
    name = element.get("name")
    if not name:
        raise SdfError(f"{context.source}: a <link> without a name")
    inner = context.within(f"link '{name}'")
    visuals: List[Visual] = []
    for child in element.findall("visual"):
        geometry = _geometry(child, inner)
        if geometry is not None:
            colour = _visual_colour(child, inner)
            visuals.append(Visual(geometry, _pose(child, inner), colour, child.get("name", "")))
    collisions: List[Collision] = []
    for child in element.findall("collision"):
        geometry = _geometry(child, inner)
        if geometry is not None:
            mu = child_text(child, "surface/friction/ode/mu", "1")
            mu = friction(mu, f"{inner.source}: <mu>")
            collisions.append(Collision(geometry, _pose(child, inner), mu, child.get("name", "")))
    inertia = None if static else _inertia(element.find("inertial"), inner)
    return Link(name, _pose(element, inner), inertia, tuple(visuals), tuple(collisions))


def _inertia(element: Optional[Element], context: _Context) -> Inertia:
    # What SDF leaves out weighs 1 kg and has unit moments: the format's own defaults.
    element = Element("inertial") if element is None else element
    pose = _pose(element, context)
    entries = [
        number(child_text(element, f"inertia/{key}", default), f"{context.source}: <{key}>")
        for key, default in zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "111000")
    ]
    turn = pose.rotation_matrix()
    mass = number(child_text(element, "mass", "1"), f"{context.source}: <mass>")
    if mass == 0.0:
        raise SdfError(f"{context.source}: the mass is 0; a thing that never moves is <static>")
    inertia = Inertia(mass, pose.position, turn @ matrix_from_elements(*entries) @ turn.T)
    check_inertia(inertia, context.source)
    return inertia


def _joint(element: Element, links: dict, context: _Context) -> Joint:
    inner = context.within(f"joint '{element.get('name', '')}'")
    kind = element.get("type", "")
    if kind not in SIMULATED_JOINTS:
        raise SdfError(f"{inner.source}: type '{kind}' is not one of {', '.join(SIMULATED_JOINTS)}")
    if _pose(element, inner) != Pose():
        raise SdfError(f"{inner.source}: a joint with a <pose> of its own is not read")
    parent, child = child_text(element, "parent"), child_text(element, "child")
    for end in (parent, child):
        if end not in links:
            raise SdfError(f"{inner.source}: names no link '{end}'")
    pose = links[parent].pose.inverse() * links[child].pose
    return Joint(
        element.get("name", ""),
        kind,
        parent,
        child,
        pose,
        direction(child_text(element, "axis/xyz", "0 0 1"), f"{inner.source}: <xyz>"),
        _limits(element, inner),
        number(child_text(element, "axis/dynamics/damping", "0"), f"{inner.source}: <damping>"),
    )


def _limits(element: Element, context: _Context) -> dict:
    found = element.find("axis/limit")
    if found is None:
        return {}
    return {
        child.tag: number(child.text, f"{context.source}: <{child.tag}>")
        for child in found
        if child.tag in ("lower", "upper", "effort", "velocity")
    }


def _geometry(element: Element, context: _Context) -> Optional[Geometry]:
    """Return the shape of a visual or collision; None for one that is not simulated."""
    holder = element.find("geometry")
    shape = holder[0] if holder is not None and len(holder) else None
    where = f"{context.source}: <{element.tag}>"
    if shape is None:
        raise SdfError(f"{where} without a geometry")
    if shape.tag == "box":
        return Box(sizes(child_text(shape, "size"), 3, f"{where}: <size>"))
    if shape.tag == "cylinder":
        keys = ("radius", "length")
        return Cylinder(*(sizes(child_text(shape, k), 1, f"{where}: <{k}>")[0] for k in keys))
    if shape.tag == "sphere":
        return Sphere(*sizes(child_text(shape, "radius"), 1, f"{where}: <radius>"))
    if shape.tag == "plane":
        normal = direction(child_text(shape, "normal", "0 0 1"), f"{where}: <normal>")
        return Plane(normal, sizes(child_text(shape, "size", "1 1"), 2, f"{where}: <size>"))
    if shape.tag == "mesh":
        return _mesh(shape, context, where)
    if shape.tag != "empty":
        LOG.warning("%s: geometry <%s> is not simulated", where, shape.tag)
    return None


def _mesh(shape: Element, context: _Context, where: str) -> Mesh:
    uri = child_text(shape, "uri")
    if not uri:
        raise SdfError(f"{where}: a <mesh> without <uri>")
    if shape.find("submesh") is not None:
        LOG.warning("%s: <submesh> is not read, the whole mesh is used", where)
    scale = mesh_scale(child_text(shape, "scale", "1 1 1"), f"{where}: <scale>")
    return Mesh(context.find(uri, where), uri, scale)


def _visual_colour(element: Element, context: _Context) -> Colour:
    material = element.find("material")
    colour = DEFAULT_COLOUR
    if material is not None:
        ambient = _colour(material, "ambient", DEFAULT_COLOUR, context)
        colour = _colour(material, "diffuse", ambient, context)
    transparency = number(child_text(element, "transparency", "0"), f"{context.source}: colour")
    return colour[:3] + (colour[3] * (1.0 - transparency),)


def _light(element: Element, context: _Context) -> Light:
    name = element.get("name", "light")
    inner = context.within(f"light '{name}'")
    kind = element.get("type", "")
    if kind not in ("point", "directional", "spot"):
        raise SdfError(f"{inner.source}: type '{kind}' is not point, directional or spot")
    return Light(
        name,
        kind,
        _pose(element, inner),
        _colour(element, "diffuse", (1.0, 1.0, 1.0, 1.0), inner),
        direction(child_text(element, "direction", "0 0 -1"), f"{inner.source}: <direction>"),
        boolean(child_text(element, "cast_shadows", "false"), f"{inner.source}: <cast_shadows>"),
    )


def _pose(element: Element, context: _Context) -> Pose:
    found = element.find("pose")
    if found is None:
        return Pose()
    if found.get("frame") or found.get("relative_to"):
        raise SdfError(f"{context.source}: a <pose> relative to another frame is not read")
    values = numbers(found.text, 6, f"{context.source}: <pose>")
    return Pose.from_rpy(values[:3], values[3:])


def _colour(element: Element, tag: str, default: Colour, context: _Context) -> Colour:
    text = child_text(element, tag)
    if not text:
        return default
    # Alpha may be left out.
    padded = text if len(text.split()) != 3 else f"{text} 1"
    return numbers(padded, 4, f"{context.source}: <{tag}>")
