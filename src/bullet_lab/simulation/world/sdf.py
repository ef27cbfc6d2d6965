"""Reading worlds and models from SDF, the format of Gazebo, with the `<state>` of saved worlds."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Dict, Iterable, Iterator, Mapping, Optional, Tuple, Union
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose, Vector, add, cross
from bullet_lab.simulation.world.description import (
    WHITE,
    Attenuation,
    Collision,
    Colour,
    Cone,
    FrameState,
    Inertia,
    Joint,
    Light,
    Link,
    Model,
    ModelState,
    PluginTag,
    Visual,
    World,
)
from bullet_lab.simulation.world.gazebo_tags import (
    ReportOnce,
    gazebo_colour,
    plugins_in,
    report_unknown,
)
from bullet_lab.simulation.world.inertia import inertia_at
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.shapes import SHAPES, Shape, ShapeTag
from bullet_lab.simulation.world.tree import check_forest, lump_fixed_joints
from bullet_lab.simulation.world.urdf import read_urdf
from bullet_lab.simulation.world.xml import (
    ElementReader,
    XmlError,
    child_text,
    number,
    numbers,
    parse_text,
    read_text,
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
    report_unknown(root, context.source, context.report)
    return _world(element, context)


def read_description(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Return the model that a text describes, SDF or URDF.

    Args:
        text: the description.
        source: names it in messages.
        finder: finds the files that it names.

    Raises:
        LabError: neither, or no model that could exist; the message says what and where.
    """
    root = parse_text(text, source)
    if root.tag == "robot":
        return read_urdf(text, source, finder)
    if root.tag == "sdf":
        return read_model_text(text, source, finder)
    raise XmlError(f"{source}: the root element is <{root.tag}>, neither <sdf> nor <robot>")


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

    `static` is what an <include> says about all models in it, if it says anything; `report`
    tells the user what is not simulated.
    """

    source: str
    finder: ResourceFinder
    depth: int = 0
    static: Optional[bool] = None
    report: ReportOnce = field(default_factory=ReportOnce)

    def find(self, uri: str, where: str) -> Path:
        try:
            return self.finder.find(uri)
        except ResourceError as error:
            raise ResourceError(f"{where}: {error}") from error

    def within(self, element: Element) -> _Context:
        place = f"{element.tag} '{element.get('name', '')}'"
        return replace(self, source=f"{self.source}: {place}")

    def named(self, element: Element) -> _Context:
        if not element.get("name"):
            raise SdfError(f"{self.source}: a <{element.tag}> without a name")
        return self.within(element)

    def tags(self, element: Element) -> ElementReader:
        return ElementReader(element, self.source)


Part = Union[Model, Light]


def _world(element: Element, context: _Context) -> World:
    parts = list(_parts(element, context))
    models = tuple(part for part in parts if isinstance(part, Model))
    _refuse_repeated_names(models, context)
    scene, state = element.find("scene"), element.find("state")
    scene = Element("scene") if scene is None else scene
    return World(
        element.get("name", "default"),
        models,
        tuple(part for part in parts if isinstance(part, Light)),
        numbers(child_text(element, "gravity", "0 0 -9.8"), 3, f"{context.source}: gravity"),
        _colour(scene, "ambient", World.ambient, context),
        _colour(scene, "background", World.background, context),
        context.tags(scene).boolean("shadows", True),
        {} if state is None else _states(state, models, context.source),
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
    report_unknown(root, context.source, context.report)
    return _parts(root, context)


def _include(element: Element, context: _Context) -> Iterator[Part]:
    if context.depth >= DEEPEST_INCLUDE:
        raise SdfError(f"{context.source}: models include each other in a circle")
    uri = child_text(element, "uri")
    if not uri:
        raise SdfError(f"{context.source}: an <include> without <uri>")
    path = _model_file(context.find(uri, f"{context.source}: <include>"))
    static = context.static
    if child_text(element, "static"):
        static = context.tags(element).boolean("static", False)
    finder, depth = context.finder.beside(path), context.depth + 1
    inner = replace(context, source=str(path), finder=finder, depth=depth, static=static)
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
    inner = context.named(element)
    if element.find("include") is not None or element.find("model") is not None:
        LOG.warning("%s: models inside a model are not read", inner.source)
    static = inner.tags(element).boolean("static", False)
    static = static if context.static is None else context.static
    links = tuple(_link(child, static, inner) for child in element.findall("link"))
    by_name = {link.name: link for link in links}
    joints = tuple(_joint(child, by_name, inner) for child in element.findall("joint"))
    check_forest(links, joints, inner.source)
    frames = _frames(element, by_name, inner)
    plugins, pose = _plugins(element, frames), _pose(element, inner)
    model = lump_fixed_joints(Model(element.get("name"), links, joints, plugins, pose, static))
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


def _plugins(element: Element, frames: Mapping[str, Tuple[str, Pose]]) -> Tuple[PluginTag, ...]:
    found = list(plugins_in(element))
    for link in element.findall("link"):
        for plugin in plugins_in(link, link.get("name", "")):
            pose = None if plugin.sensor is None else plugin.sensor.find("pose")
            frame = "" if pose is None else pose.get("frame", "")
            found.append(replace(plugin, link=frame) if frame in frames else plugin)
    return tuple(found)


def _link(element: Element, static: bool, context: _Context) -> Link:
    inner = context.named(element)
    return Link(
        element.get("name"),
        _pose(element, inner),
        None if static else _inertia(element.find("inertial"), inner),
        tuple(_visual(*shape, inner) for shape in _shapes(element, "visual", inner)),
        tuple(_collision(*shape, inner) for shape in _shapes(element, "collision", inner)),
        inner.tags(element).boolean("self_collide", False),
    )


def _shapes(link: Element, tag: str, context: _Context) -> Iterator[Tuple[Element, Shape]]:
    """Yield the visuals or collisions of a link, with those of their shapes that are simulated."""
    for element in link.findall(tag):
        geometry = _geometry(element, context)
        if geometry is not None:
            yield element, geometry


def _visual(element: Element, geometry: Shape, context: _Context) -> Visual:
    colour = _visual_colour(element, geometry, context)
    casts = context.tags(element).boolean("cast_shadows", True)
    return Visual(geometry, _pose(element, context), colour, element.get("name", ""), casts)


def _collision(element: Element, geometry: Shape, context: _Context) -> Collision:
    tags = context.tags(element)
    mu = tags.coefficient("surface/friction/ode/mu", 1.0)
    # Stiffness and damping of its contacts, None for what is not said.
    paths = [f"surface/contact/ode/{key}" for key in ("kp", "kd")]
    spring = [tags.coefficient(path, 0.0) if tags.text(path) else None for path in paths]
    return Collision(geometry, _pose(element, context), mu, element.get("name", ""), *spring)


def _inertia(element: Optional[Element], context: _Context) -> Inertia:
    # What SDF leaves out weighs 1 kg and has unit moments: the format's own defaults.
    element = Element("inertial") if element is None else element
    tags, pose = context.tags(element), _pose(element, context)
    elements = [tags.number(f"inertia/{key}", 1.0) for key in ("ixx", "iyy", "izz")]
    elements += [tags.number(f"inertia/{key}", 0.0) for key in ("ixy", "ixz", "iyz")]
    mass = tags.number("mass", 1.0)
    if mass == 0.0:
        raise SdfError(f"{context.source}: the mass is 0; a thing that never moves is <static>")
    return inertia_at(pose, mass, elements, context.source)


def _joint(element: Element, links: Mapping[str, Link], context: _Context) -> Joint:
    inner = context.within(element)
    kind, tags = element.get("type", ""), inner.tags(element)
    if kind not in SIMULATED_JOINTS:
        raise SdfError(f"{inner.source}: type '{kind}' is not one of {', '.join(SIMULATED_JOINTS)}")
    if _pose(element, inner) != Pose():
        raise SdfError(f"{inner.source}: a joint with a <pose> of its own is not read")
    parent, child = tags.text("parent"), tags.text("child")
    for end in (parent, child):
        if end not in links:
            raise SdfError(f"{inner.source}: names no link '{end}'")
    return Joint(
        element.get("name", ""),
        kind,
        parent,
        child,
        links[parent].pose.inverse() * links[child].pose,
        tags.direction("axis/xyz", "0 0 1"),
        _limits(element.find("axis/limit"), inner),
        tags.number("axis/dynamics/damping", 0.0),
        tags.number("axis/dynamics/friction", 0.0),
    )


def _limits(element: Optional[Element], context: _Context) -> Dict[str, float]:
    limits = {
        child.tag: number(child.text, f"{context.source}: <{child.tag}>")
        for child in (element if element is not None else ())
        if child.tag in ("lower", "upper", "effort", "velocity")
    }
    # Bounds as far as SDF's own defaults are none.
    return {key: value for key, value in limits.items() if abs(value) < NO_BOUND}


def _geometry(element: Element, context: _Context) -> Optional[Shape]:
    """Return the shape of a visual or collision; None for one that is not simulated."""
    holder = element.find("geometry")
    shape = holder[0] if holder is not None and len(holder) else None
    where = f"{context.source}: <{element.tag}>"
    if shape is None:
        raise SdfError(f"{where} without a geometry")
    if shape.tag in SHAPES:
        return SHAPES[shape.tag].read(_ShapeElement(shape, where, context))
    if shape.tag != "empty":
        LOG.warning("%s: geometry <%s> is not simulated", where, shape.tag)
    return None


class _ShapeElement(ElementReader, ShapeTag):
    def __init__(self, element: Element, source: str, context: _Context):
        super().__init__(element, source)
        self._context = context

    def uri(self) -> str:
        uri = self.text("uri")
        if not uri:
            raise SdfError(f"{self.source}: a <mesh> without <uri>")
        if self.element.find("submesh") is not None:
            LOG.warning("%s: <submesh> is not read, the whole mesh is used", self.source)
        return uri

    def find(self, uri: str) -> Path:
        return self._context.find(uri, self.source)


def _visual_colour(element: Element, geometry: Shape, context: _Context) -> Colour:
    material = element.find("material")
    colour = WHITE if geometry.has_own_colours else DEFAULT_COLOUR
    if material is not None:
        named = gazebo_colour(child_text(material, "script/name")) or DEFAULT_COLOUR
        ambient = _colour(material, "ambient", named, context)
        colour = _colour(material, "diffuse", ambient, context)
    transparency = number(child_text(element, "transparency", "0"), f"{context.source}: colour")
    return colour[:3] + (colour[3] * (1.0 - transparency),)


def _light(element: Element, context: _Context) -> Light:
    name = element.get("name", "light")
    inner = replace(context, source=f"{context.source}: light '{name}'")
    kind, tags = element.get("type", ""), inner.tags(element)
    if kind not in ("point", "directional", "spot"):
        raise SdfError(f"{inner.source}: type '{kind}' is not point, directional or spot")
    fading = {
        key: tags.coefficient(f"attenuation/{key}", getattr(Attenuation, key))
        for key in ("range", "constant", "linear", "quadratic")
    }
    return Light(
        name,
        kind,
        _pose(element, inner),
        _colour(element, "diffuse", WHITE, inner),
        tags.direction("direction", "0 0 -1"),
        tags.boolean("cast_shadows", False),
        Attenuation(**fading),
        _cone(tags),
    )


def _cone(light: ElementReader) -> Cone:
    inner = light.number("spot/inner_angle", Cone.inner)
    outer = light.number("spot/outer_angle", Cone.outer)
    falloff = light.number("spot/falloff", Cone.falloff)
    if not 0.0 <= inner <= outer <= 2.0 * math.pi or falloff < 0.0:
        raise SdfError(f"{light.source}: <spot> is no cone: {inner:g}, {outer:g}, {falloff:g}")
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


def _states(element: Element, models: Iterable[Model], source: str) -> Mapping[str, ModelState]:
    """Return what a `<state>` says of a world's models, by their names."""
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
    return ModelState(ElementReader(element, source).pose(), links, joints)


def _frame_state(element: Element, source: str) -> FrameState:
    tags = ElementReader(element, source)
    values = tags.numbers("velocity", 6, "0 0 0 0 0 0")
    return FrameState(tags.pose(), values[:3], values[3:])


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
