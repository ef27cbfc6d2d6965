"""Reading worlds and models from SDF, the format of Gazebo, with the `<state>` of saved worlds."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Dict, Iterator, Mapping, Optional, Tuple, Union
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
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
    plugins_in,
    report_unknown,
)
from bullet_lab.simulation.world.inertia import INERTIA_KEYS, inertia_at
from bullet_lab.simulation.world.materials import MaterialLibrary
from bullet_lab.simulation.world.report import ReportOnce
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.shapes import SHAPES, Shape, ShapeTag
from bullet_lab.simulation.world.tree import check_forest, lump_fixed_joints, refuse_repeats
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

Part = Union[Model, Light]
Place = Tuple[str, Pose]


class SdfError(XmlError):
    """A text is well-formed XML and yet no world or model."""


def read_world_file(path: Path, finder: Optional[ResourceFinder] = None) -> World:
    """Read a world from an SDF file.

    Raises:
        XmlError: not XML, or no world; the message says what and where.
        ResourceError: an included model or a mesh cannot be found or must not be read.
    """
    root = parse_text(read_text(path), str(path))
    element = root.find("world") if root.tag == "sdf" else None
    if element is None:
        raise SdfError(f"{path}: no <sdf> with a <world>")
    document = _Document((finder or ResourceFinder()).beside(path))
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


def read_model_text(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Read one model from SDF text; raises as `read_world_file`."""
    root = _Tag(parse_text(text, source), source, _Document(finder or ResourceFinder()))
    models = [part for part in _parts_of_sdf(root) if isinstance(part, Model)]
    if len(models) != 1:
        raise SdfError(f"{source}: {len(models)} models where one is wanted")
    return models[0]


@dataclass(frozen=True)
class _Document:
    """What an element stands in.

    `static` is what an <include> says about all models in it, if it says anything; `report`
    tells the user what is not simulated; `materials` are all that were read so far.
    """

    finder: ResourceFinder
    depth: int = 0
    static: Optional[bool] = None
    report: ReportOnce = field(default_factory=ReportOnce)
    materials: MaterialLibrary = field(default_factory=MaterialLibrary)


class _Tag(ElementReader, ShapeTag):
    """An element and the document that it stands in."""

    def __init__(self, element: Element, source: str, document: _Document):
        super().__init__(element, source)
        self.document = document
        self.name = element.get("name", "")

    def below(self, element: Element) -> _Tag:
        """Return an element in it, which messages name."""
        source = f"{self.source}: {element.tag} '{element.get('name', '')}'"
        return _Tag(element, source, self.document)

    def named(self, element: Element) -> _Tag:
        if not element.get("name"):
            raise SdfError(f"{self.source}: a <{element.tag}> without a name")
        return self.below(element)

    def pose(self) -> Pose:
        found = self.element.find("pose")
        if found is not None and (found.get("frame") or found.get("relative_to")):
            raise SdfError(f"{self.source}: a <pose> relative to another frame is not read")
        return super().pose()

    def colour(self, key: str, default: Colour) -> Colour:
        text = self.text(key)
        # Alpha may be left out.
        padded = text if len(text.split()) != 3 else f"{text} 1"
        return numbers(padded, 4, self.where(key)) if text else default

    def uri(self) -> str:
        uri = self.text("uri")
        if not uri:
            raise SdfError(f"{self.source}: a <mesh> without <uri>")
        if self.element.find("submesh") is not None:
            LOG.warning("%s: <submesh> is not read, the whole mesh is used", self.source)
        return uri

    def find(self, uri: str) -> Path:
        try:
            return self.document.finder.find(uri)
        except ResourceError as error:
            raise ResourceError(f"{self.source}: {error}") from error


def _world(tag: _Tag) -> World:
    parts = list(_parts(tag))
    models = tuple(part for part in parts if isinstance(part, Model))
    refuse_repeats((model.name for model in models), "model", tag.source, SdfError)
    state = tag.element.find("state")
    return World(
        tag.element.get("name", "default"),
        models,
        tuple(part for part in parts if isinstance(part, Light)),
        numbers(tag.text("gravity", "0 0 -9.8"), 3, f"{tag.source}: gravity"),
        tag.colour("scene/ambient", World.ambient),
        tag.colour("scene/background", World.background),
        tag.boolean("scene/shadows", True),
        {} if state is None else _states(state, models, tag.source),
    )


def _parts(tag: _Tag) -> Iterator[Part]:
    """Yield the models and lights of a <world> or an <sdf>, includes resolved."""
    for child in tag.element:
        if child.tag == "model":
            yield _model(tag.named(child))
        elif child.tag == "light":
            yield _light(tag.below(child))
        elif child.tag == "include":
            yield from _include(_Tag(child, tag.source, tag.document))


def _parts_of_sdf(root: _Tag) -> Iterator[Part]:
    if root.element.tag != "sdf":
        raise SdfError(f"{root.source}: the root element is <{root.element.tag}>, not <sdf>")
    report_unknown(root.element, root.source, root.document.report)
    return _parts(root)


def _include(tag: _Tag) -> Iterator[Part]:
    if tag.document.depth >= DEEPEST_INCLUDE:
        raise SdfError(f"{tag.source}: models include each other in a circle")
    if not tag.text("uri"):
        raise SdfError(f"{tag.source}: an <include> without <uri>")
    where = f"{tag.source}: <include>"
    path = _model_file(_Tag(tag.element, where, tag.document).find(tag.text("uri")))
    outer, static = tag.document, tag.document.static
    if tag.text("static"):
        static = tag.boolean("static", False)
    document = replace(
        outer, finder=outer.finder.beside(path), depth=outer.depth + 1, static=static
    )
    for part in _parts_of_sdf(_Tag(parse_text(read_text(path), str(path)), str(path), document)):
        pose = part.pose if tag.element.find("pose") is None else tag.pose()
        yield replace(part, name=tag.text("name", part.name), pose=pose)


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


def _model(tag: _Tag) -> Model:
    element = tag.element
    if element.find("include") is not None or element.find("model") is not None:
        LOG.warning("%s: models inside a model are not read", tag.source)
    static = tag.boolean("static", False)
    static = static if tag.document.static is None else tag.document.static
    links = tuple(_link(tag.named(child), static) for child in element.findall("link"))
    by_name = {link.name: link for link in links}
    joints = tuple(_joint(tag.below(child), by_name) for child in element.findall("joint"))
    check_forest(links, joints, tag.source)
    frames = _frames(tag, by_name)
    plugins, pose = _plugins(element, frames), tag.pose()
    model = lump_fixed_joints(Model(tag.name, links, joints, plugins, pose, static))
    for key, (link, pose) in frames.items():
        # A place in a link is one in the link that has remained of it.
        keeper, offset = model.frames.get(link, (link, Pose()))
        frames[key] = (keeper, offset * pose)
    return replace(model, frames={**frames, **model.frames})


def _frames(tag: _Tag, links: Mapping[str, Link]) -> Dict[str, Place]:
    """Return link and pose in it for each frame of a model that is given in a link's frame."""
    frames = {}
    for child in tag.element.findall("frame"):
        pose = child.find("pose")
        link = "" if pose is None else pose.get("frame", "")
        name = child.get("name", "")
        if link not in links or not name or name in links:
            LOG.warning("%s: frame '%s' is in no link and skipped", tag.source, name)
        else:
            frames[name] = (link, ElementReader(child, f"{tag.source}: frame '{name}'").pose())
    return frames


def _plugins(element: Element, frames: Mapping[str, Place]) -> Tuple[PluginTag, ...]:
    found = list(plugins_in(element))
    for link in element.findall("link"):
        for plugin in plugins_in(link, link.get("name", "")):
            pose = None if plugin.sensor is None else plugin.sensor.find("pose")
            frame = "" if pose is None else pose.get("frame", "")
            found.append(replace(plugin, link=frame) if frame in frames else plugin)
    return tuple(found)


def _link(tag: _Tag, static: bool) -> Link:
    return Link(
        tag.name,
        tag.pose(),
        None if static else _inertia(tag),
        tuple(_visual(*shape) for shape in _shapes(tag, "visual")),
        tuple(_collision(*shape) for shape in _shapes(tag, "collision")),
        tag.boolean("self_collide", False),
    )


def _shapes(link: _Tag, kind: str) -> Iterator[Tuple[_Tag, Shape]]:
    """Yield the visuals or collisions of a link, with those of their shapes that are simulated."""
    for element in link.element.findall(kind):
        holder, where = element.find("geometry"), f"{link.source}: <{kind}>"
        if holder is None or not len(holder):
            raise SdfError(f"{where} without a geometry")
        shape = holder[0]
        if shape.tag in SHAPES:
            geometry = SHAPES[shape.tag].read(_Tag(shape, where, link.document))
            yield _Tag(element, link.source, link.document), geometry
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
    mu, fdir1 = tag.coefficient(f"{friction}/mu", 1.0), f"{friction}/fdir1"
    # Stiffness and damping of its contacts, and a second friction: None for what is not said.
    paths = (f"{contact}/kp", f"{contact}/kd", f"{friction}/mu2")
    others = [tag.coefficient(path, 0.0) if tag.text(path) else None for path in paths]
    direction = tag.direction(fdir1, "") if any(tag.numbers(fdir1, 3, "0 0 0")) else None
    return Collision(geometry, tag.pose(), mu, tag.name, *others, direction)


def _inertia(link: _Tag) -> Inertia:
    # What SDF leaves out weighs 1 kg and has unit moments: the format's own defaults.
    element = link.element.find("inertial")
    tag = _Tag(Element("inertial") if element is None else element, link.source, link.document)
    pose = tag.pose()
    elements = [
        tag.number(f"inertia/{key}", default)
        for key, default in zip(INERTIA_KEYS, (1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
    ]
    mass = tag.number("mass", 1.0)
    if mass == 0.0:
        raise SdfError(f"{tag.source}: the mass is 0; a thing that never moves is <static>")
    return inertia_at(pose, mass, elements, tag.source)


def _joint(tag: _Tag, links: Mapping[str, Link]) -> Joint:
    kind = tag.element.get("type", "")
    if kind not in SIMULATED_JOINTS:
        raise SdfError(f"{tag.source}: type '{kind}' is not one of {', '.join(SIMULATED_JOINTS)}")
    if tag.pose() != Pose():
        raise SdfError(f"{tag.source}: a joint with a <pose> of its own is not read")
    parent, child = tag.text("parent"), tag.text("child")
    for end in (parent, child):
        if end not in links:
            raise SdfError(f"{tag.source}: names no link '{end}'")
    said = [k for k in ("lower", "upper", "effort", "velocity") if tag.text(f"axis/limit/{k}")]
    limits = {key: tag.number(f"axis/limit/{key}", 0.0) for key in said}
    return Joint(
        tag.name,
        kind,
        parent,
        child,
        links[parent].pose.inverse() * links[child].pose,
        tag.direction("axis/xyz", "0 0 1"),
        # Bounds as far as SDF's own defaults are none.
        {key: value for key, value in limits.items() if abs(value) < NO_BOUND},
        tag.number("axis/dynamics/damping", 0.0),
        tag.number("axis/dynamics/friction", 0.0),
    )


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


def _states(element: Element, models: Tuple[Model, ...], source: str) -> Dict[str, ModelState]:
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
    links: Dict[str, FrameState] = {}
    for child in element.findall("link"):
        name = child.get("name", "")
        if name in present:
            tags = ElementReader(child, f"{source}: link '{name}'")
            values = tags.numbers("velocity", 6, "0 0 0 0 0 0")
            links[name] = FrameState(tags.pose(), values[:3], values[3:])
    positions = {
        child.get("name", ""): number(child_text(child, "angle", "0"), f"{source}: <angle>")
        for child in element.findall("joint")
    }
    joints = {}
    for joint in model.joints:
        position, rate = _joint_state(joint, links)
        joints[joint.name] = (positions.get(joint.name, position), rate)
    return ModelState(ElementReader(element, source).pose(), links, joints)


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
