"""Reading worlds and models from SDF, the format of Gazebo."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, Optional, Set, Tuple, Union
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    WHITE,
    Attenuation,
    Box,
    Collision,
    Colour,
    Cone,
    Cylinder,
    Geometry,
    Inertia,
    Joint,
    Light,
    Link,
    Mesh,
    Model,
    Plane,
    Plugin,
    Sphere,
    Visual,
    World,
)
from bullet_lab.simulation.world.gazebo_materials import gazebo_colour
from bullet_lab.simulation.world.inertia import check_inertia, matrix_from_elements
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.sdf_state import read_states
from bullet_lab.simulation.world.sdf_unknown import report_unknown
from bullet_lab.simulation.world.tree import check_forest, lump_fixed_joints
from bullet_lab.simulation.world.xml import (
    XmlError,
    boolean,
    child_text,
    direction,
    friction,
    mesh_scale,
    number,
    numbers,
    parse_text,
    plugins_in,
    read_text,
    sizes,
)

LOG = logging.getLogger(__name__)

SIMULATED_JOINTS = ("fixed", "revolute", "prismatic")
NO_BOUND = 1e16
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
    report_unknown(root, context.source, context.reported)
    return _world(element, context)


def read_model_text(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Read one model from SDF text; raises as `read_world_file`."""
    context = _Context(source, finder or ResourceFinder())
    root = parse_text(text, source)
    models = [part for part in _parts_of_sdf(root, context) if isinstance(part, Model)]
    if len(models) != 1:
        raise SdfError(f"{source}: {len(models)} models where one is wanted")
    return models[0]


@dataclass(frozen=True)
class _Context:
    """Where an element comes from: for messages, and to find the files that it names.

    `static` is what an <include> says about all models in it, if it says anything; `reported`
    is what the user was told of that is not simulated.
    """

    source: str
    finder: ResourceFinder
    depth: int = 0
    static: Optional[bool] = None
    reported: Set[str] = field(default_factory=set)

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
    state = element.find("state")
    return World(
        element.get("name", "default"),
        models,
        tuple(part for part in parts if isinstance(part, Light)),
        numbers(gravity, 3, f"{context.source}: gravity"),
        _colour(scene, "ambient", (0.4, 0.4, 0.4, 1.0), context),
        _colour(scene, "background", (0.7, 0.7, 0.7, 1.0), context),
        boolean(child_text(scene, "shadows", "true"), f"{context.source}: <shadows>"),
        {} if state is None else read_states(state, models, context.source),
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
    report_unknown(root, context.source, context.reported)
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
    inner = replace(
        context,
        source=str(path),
        finder=context.finder.beside(path),
        depth=context.depth + 1,
        static=static,
    )
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
    frames = _frames(element, by_name, inner)
    plugins = _plugins(element, frames)
    model = lump_fixed_joints(Model(name, links, joints, plugins, _pose(element, inner), static))
    placed = {key: _lumped(place, model) for key, place in frames.items()}
    return replace(model, frames={**placed, **model.frames})


def _frames(element: Element, links: dict, context: _Context) -> Dict[str, Tuple[str, Pose]]:
    """Return link and pose in it for each frame of a model that is given in a link's frame."""
    frames = {}
    for child in element.findall("frame"):
        pose = child.find("pose")
        link = "" if pose is None else pose.get("frame", "")
        name = child.get("name", "")
        if link not in links or not name or name in links:
            LOG.warning("%s: frame '%s' is in no link and skipped", context.source, name)
            continue
        values = numbers(pose.text, 6, f"{context.source}: frame '{name}'")
        frames[name] = (link, Pose.from_rpy(values[:3], values[3:]))
    return frames


def _lumped(place: Tuple[str, Pose], model: Model) -> Tuple[str, Pose]:
    """Return a place in a link as one in the link that has remained of it."""
    link, pose = place
    keeper, offset = model.frames.get(link, (link, Pose()))
    return keeper, offset * pose


def _plugins(element: Element, frames: Mapping[str, Tuple[str, Pose]]) -> Tuple[Plugin, ...]:
    found = list(plugins_in(element))
    for link in element.findall("link"):
        for plugin in plugins_in(link, link.get("name", "")):
            pose = None if plugin.sensor is None else plugin.sensor.find("pose")
            frame = "" if pose is None else pose.get("frame", "")
            found.append(replace(plugin, link=frame) if frame in frames else plugin)
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
            colour = _visual_colour(child, geometry, inner)
            said = child_text(child, "cast_shadows", "true")
            casts = boolean(said, f"{inner.source}: <cast_shadows>")
            name_of = child.get("name", "")
            visuals.append(Visual(geometry, _pose(child, inner), colour, name_of, casts))
    collisions: List[Collision] = []
    for child in element.findall("collision"):
        geometry = _geometry(child, inner)
        if geometry is not None:
            mu = child_text(child, "surface/friction/ode/mu", "1")
            mu = friction(mu, f"{inner.source}: <mu>")
            called, spring = child.get("name", ""), _spring(child, inner)
            collisions.append(Collision(geometry, _pose(child, inner), mu, called, *spring))
    inertia = None if static else _inertia(element.find("inertial"), inner)
    said = child_text(element, "self_collide", "false")
    touchy = boolean(said, f"{inner.source}: <self_collide>")
    return Link(name, _pose(element, inner), inertia, tuple(visuals), tuple(collisions), touchy)


def _spring(collision: Element, context: _Context) -> Tuple[Optional[float], ...]:
    """Return stiffness and damping of a shape's contacts, None for what is not said."""
    texts = {key: child_text(collision, f"surface/contact/ode/{key}") for key in ("kp", "kd")}
    return tuple(
        friction(text, f"{context.source}: <{key}>") if text else None
        for key, text in texts.items()
    )


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
        *(
            number(child_text(element, f"axis/dynamics/{tag}", "0"), f"{inner.source}: <{tag}>")
            for tag in ("damping", "friction")
        ),
    )


def _limits(element: Element, context: _Context) -> dict:
    found = element.find("axis/limit")
    if found is None:
        return {}
    limits = {
        child.tag: number(child.text, f"{context.source}: <{child.tag}>")
        for child in found
        if child.tag in ("lower", "upper", "effort", "velocity")
    }
    # Bounds as far as SDF's own defaults are none.
    return {key: value for key, value in limits.items() if abs(value) < NO_BOUND}


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


def _visual_colour(element: Element, geometry: Geometry, context: _Context) -> Colour:
    material = element.find("material")
    # A mesh may bring colours and pictures of its own, which nothing shall darken.
    colour = WHITE if isinstance(geometry, Mesh) else DEFAULT_COLOUR
    if material is not None:
        named = gazebo_colour(child_text(material, "script/name")) or DEFAULT_COLOUR
        ambient = _colour(material, "ambient", named, context)
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
        _attenuation(element, inner),
        _cone(element, inner),
    )


def _attenuation(light: Element, context: _Context) -> Attenuation:
    values = {}
    for key, default in (("range", 10.0), ("constant", 1.0), ("linear", 0.0), ("quadratic", 0.0)):
        where = f"{context.source}: <{key}>"
        values[key] = number(child_text(light, f"attenuation/{key}", repr(default)), where)
        if values[key] < 0.0:
            raise SdfError(f"{where}: {values[key]:g} is negative")
    return Attenuation(**values)


def _cone(light: Element, context: _Context) -> Cone:
    default = Cone()
    inner, outer, falloff = (
        number(child_text(light, f"spot/{tag}", repr(value)), f"{context.source}: <{tag}>")
        for tag, value in (
            ("inner_angle", default.inner),
            ("outer_angle", default.outer),
            ("falloff", default.falloff),
        )
    )
    if not 0.0 <= inner <= outer <= 2.0 * math.pi or falloff < 0.0:
        raise SdfError(f"{context.source}: <spot> is no cone: {inner:g}, {outer:g}, {falloff:g}")
    return Cone(inner, outer, falloff)


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
