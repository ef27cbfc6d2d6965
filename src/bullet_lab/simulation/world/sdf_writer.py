"""Writing models and worlds as SDF 1.6: what was read of them, wherever it came from.

A running world loads again to the same state: its models stand in the file with their present
poses, and how their links move and where their joints are is in its `<state>`, as in worlds that
Gazebo saves.
"""

from __future__ import annotations

import copy
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Set, Tuple, Union
from xml.etree.ElementTree import Element, SubElement, tostring

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.world.description import (
    Collision,
    Inertia,
    Joint,
    Light,
    Link,
    Mesh,
    Model,
    ModelState,
    PluginTag,
    Snapshot,
    Visual,
    World,
)
from bullet_lab.simulation.world.resources import package_uri
from bullet_lab.simulation.world.shapes import Shape

VERSION = "1.6"
NANOSECONDS = 10**9
INDENT = "  "
# Where a joint that is limited on one side ends on the other, as SDF has it.
FAR = 1e16
NAMESPACE = "robotNamespace"


def world_text(snapshot: Snapshot, folder: Path) -> Tuple[str, List[str]]:
    """Return a world as SDF.

    Args:
        snapshot: the world and where everything is.
        folder: where the file will lie; meshes below it are named by their path from it.

    Returns:
        The text of the file, and notes on what whoever loads it should know.
    """
    sdf = Element("sdf", version=VERSION)
    world = SubElement(sdf, "world", name=snapshot.world.name)
    _add_surroundings(world, snapshot.world)
    writer = ModelWriter(folder)
    for model, state in snapshot.models:
        world.append(writer.element(model, state.pose))
    world.append(_state(snapshot))
    _indent(sdf)
    text = tostring(sdf, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}\n', writer.notes


def _add_text(parent: Element, tag: str, text: Any, **attributes: str) -> Element:
    element = SubElement(parent, tag, attributes)
    element.text = str(text)
    return element


def _add_numbers(
    parent: Element, tag: str, values: Union[float, Iterable[float]], **attributes: str
) -> Element:
    """Add an element that holds numbers, none rounded."""
    several = values if isinstance(values, Iterable) else (values,)
    return _add_text(parent, tag, " ".join(repr(float(v)) for v in several), **attributes)


def _add_each(parent: Element, numbers: Mapping[str, Union[float, Iterable[float]]]) -> None:
    """Add elements that hold numbers, by their tags."""
    for tag, values in numbers.items():
        _add_numbers(parent, tag, values)


def _add_flag(parent: Element, tag: str, value: bool) -> None:
    _add_text(parent, tag, "true" if value else "false")


def _add_pose(parent: Element, pose: Pose, **attributes: str) -> None:
    """Add a pose, in a `frame` if one is given."""
    _add_numbers(parent, "pose", (*pose.position, *pose.rpy()), **attributes)


def _indent(element: Element, level: int = 0) -> None:
    """Put each element that stands in others on a line of its own."""
    if not len(element):
        return
    inner = "\n" + INDENT * (level + 1)
    if not (element.text or "").strip():
        element.text = inner
    for child in element:
        _indent(child, level + 1)
        if not (child.tail or "").strip():
            child.tail = inner
    element[-1].tail = "\n" + INDENT * level


class ModelWriter:
    """Writes the models of one document.

    Args:
        folder: where the document will lie.

    Attributes:
        notes: what whoever reads the document should know.
    """

    def __init__(self, folder: Path):
        self.notes: List[str] = []
        self._folder = folder
        self._uris: Dict[Mesh, str] = {}

    def element(self, model: Model, pose: Pose) -> Element:
        """Return a model as an element.

        Args:
            model: what to write.
            pose: of its frame in the world.
        """
        element = Element("model", name=model.name)
        _add_pose(element, pose)
        _add_flag(element, "static", model.static)
        for name, (link, place) in model.frames.items():
            _add_pose(SubElement(element, "frame", name=name), place, frame=link)
        for link in model.links:
            self._add_link(element, link, model)
        for joint in model.joints:
            _add_joint(element, joint)
        for plugin in model.plugins:
            if plugin.sensor is None:
                element.append(plugin_element(plugin))
        return element

    def _add_link(self, parent: Element, link: Link, model: Model) -> None:
        element = SubElement(parent, "link", name=link.name)
        _add_pose(element, link.pose)
        if link.self_collide:
            _add_flag(element, "self_collide", True)
        if link.inertia is not None:
            _add_inertia(element, link.inertia)
        for name, collision in _named(link.collisions, "collision"):
            child = self._add_shape(element, "collision", name, collision)
            _add_surface(child, collision)
        for name, visual in _named(link.visuals, "visual"):
            child = self._add_shape(element, "visual", name, visual)
            if not visual.casts_shadows:
                _add_flag(child, "cast_shadows", False)
            colour = {"ambient": visual.colour, "diffuse": visual.colour}
            _add_each(SubElement(child, "material"), colour)
        element.extend(_sensors(link, model))

    def _add_shape(
        self, parent: Element, tag: str, name: str, shape: Union[Collision, Visual]
    ) -> Element:
        element = SubElement(parent, tag, name=name)
        _add_pose(element, shape.pose)
        self._add_geometry(SubElement(element, "geometry"), shape.geometry)
        return element

    def _add_geometry(self, parent: Element, shape: Shape) -> None:
        element = SubElement(parent, shape.tag)
        if isinstance(shape, Mesh):
            _add_text(element, "uri", self._uri(shape))
        _add_each(element, shape.measures())

    def _uri(self, mesh: Mesh) -> str:
        if mesh not in self._uris:
            self._uris[mesh] = self._find_uri(mesh)
        return self._uris[mesh]

    def _find_uri(self, mesh: Mesh) -> str:
        """Return how the document can name a mesh file, whatever it was called before."""
        if mesh.uri.startswith(("package://", "model://")):
            return mesh.uri
        path = mesh.path.resolve()
        uri = package_uri(path) or _relative(path, self._folder)
        if not uri:
            uri = path.as_uri()
            self.notes.append(f"{path} lies outside all packages: a world elsewhere cannot use it")
        return uri


def plugin_element(plugin: PluginTag) -> Element:
    """Return a plugin's tag, with all that was in it and the namespace that it was given."""
    if plugin.element is None:
        element = Element("plugin", name=plugin.name, filename=plugin.filename)
        for tag, text in plugin.tags.items():
            _add_text(element, tag, text)
        return element
    element = copy.deepcopy(plugin.element)
    element.tail = None
    namespace = plugin.tags.get(NAMESPACE, "")
    found = element.find(NAMESPACE)
    if namespace and found is None:
        _add_text(element, NAMESPACE, namespace)
    elif namespace:
        found.text = namespace
    return element


def _sensors(link: Link, model: Model) -> Iterator[Element]:
    """Yield the sensors of a link, and those of the links that were merged into it."""
    written: Set[int] = set()
    for plugin in model.plugins:
        sensor, holder = plugin.sensor, plugin.link or model.root_links()[0].name
        keeper = model.frames[holder][0] if holder in model.frames else holder
        if sensor is None or keeper != link.name or id(sensor) in written:
            continue
        written.add(id(sensor))
        element = copy.deepcopy(sensor)
        element.tail = None
        for old in element.findall("plugin"):
            element.remove(old)
        if holder != keeper:
            _name_frame(element, holder)
        element.extend(plugin_element(p) for p in model.plugins if p.sensor is sensor)
        yield element


def _name_frame(sensor: Element, frame: str) -> None:
    """Say that a sensor's pose is given in a frame."""
    pose = sensor.find("pose")
    if pose is None:
        pose = _add_text(sensor, "pose", "0 0 0 0 0 0")
    pose.set("frame", frame)


def _named(
    shapes: Iterable[Union[Collision, Visual]], kind: str
) -> Iterator[Tuple[str, Union[Collision, Visual]]]:
    """Yield shapes with names that occur once."""
    taken: Set[str] = set()
    for shape in shapes:
        name, number = shape.name or kind, 0
        while name in taken:
            number += 1
            name = f"{shape.name or kind}_{number}"
        taken.add(name)
        yield name, shape


def _add_inertia(parent: Element, inertia: Inertia) -> None:
    element = SubElement(parent, "inertial")
    _add_pose(element, Pose(inertia.centre))
    _add_numbers(element, "mass", inertia.mass)
    upper = [(row, column) for row in range(3) for column in range(row, 3)]
    elements = {f"i{'xyz'[r]}{'xyz'[c]}": inertia.matrix[r, c] for r, c in upper}
    _add_each(SubElement(element, "inertia"), elements)


def _add_surface(parent: Element, collision: Collision) -> None:
    surface = SubElement(parent, "surface")
    friction = {"mu": collision.friction, "mu2": collision.friction}
    _add_each(SubElement(SubElement(surface, "friction"), "ode"), friction)
    spring = {"kp": collision.stiffness, "kd": collision.damping}
    said = {tag: value for tag, value in spring.items() if value is not None}
    if said:
        _add_each(SubElement(SubElement(surface, "contact"), "ode"), said)


def _add_joint(parent: Element, joint: Joint) -> None:
    # SDF has no continuous joints: they are revolute ones without limits.
    kind = "revolute" if joint.kind == "continuous" else joint.kind
    element = SubElement(parent, "joint", name=joint.name, type=kind)
    _add_text(element, "parent", joint.parent)
    _add_text(element, "child", joint.child)
    axis = SubElement(element, "axis")
    _add_numbers(axis, "xyz", joint.axis)
    bounds = {"lower": -FAR, "upper": FAR}
    if joint.kind != "continuous":
        bounds.update((k, v) for k, v in joint.limits.items() if k in bounds)
    more = {k: v for k, v in joint.limits.items() if k in ("effort", "velocity")}
    _add_each(SubElement(axis, "limit"), {**bounds, **more})
    dynamics = {"damping": joint.damping, "friction": joint.friction}
    _add_each(SubElement(axis, "dynamics"), dynamics)


def _relative(path: Path, folder: Path) -> str:
    try:
        return str(path.relative_to(folder.resolve()))
    except ValueError:
        return ""


def _add_surroundings(parent: Element, world: World) -> None:
    _add_numbers(parent, "gravity", world.gravity)
    physics = SubElement(parent, "physics", name="default", type="ode")
    _add_numbers(physics, "max_step_size", 1.0 / STEPS_PER_SECOND)
    _add_text(physics, "real_time_factor", "1")
    _add_text(physics, "real_time_update_rate", str(STEPS_PER_SECOND))
    scene = SubElement(parent, "scene")
    _add_each(scene, {"ambient": world.ambient, "background": world.background})
    _add_flag(scene, "shadows", world.shadows)
    for light in world.lights:
        _add_light(parent, light)


def _add_light(parent: Element, light: Light) -> None:
    element = SubElement(parent, "light", name=light.name, type=light.kind)
    _add_pose(element, light.pose)
    _add_flag(element, "cast_shadows", light.casts_shadows)
    _add_numbers(element, "diffuse", light.diffuse)
    _add_numbers(element, "direction", light.direction)
    _add_each(SubElement(element, "attenuation"), asdict(light.attenuation))
    if light.kind == "spot":
        cone = light.cone
        angles = {"inner_angle": cone.inner, "outer_angle": cone.outer, "falloff": cone.falloff}
        _add_each(SubElement(element, "spot"), angles)


def _state(snapshot: Snapshot) -> Element:
    element = Element("state", world_name=snapshot.world.name)
    seconds, rest = divmod(snapshot.step, STEPS_PER_SECOND)
    _add_text(element, "sim_time", f"{seconds} {rest * (NANOSECONDS // STEPS_PER_SECOND)}")
    _add_text(element, "iterations", snapshot.step)
    for model, state in snapshot.models:
        # What never moves stands where its model says.
        if not model.static:
            element.append(_model_state(model, state))
    return element


def _model_state(model: Model, state: ModelState) -> Element:
    element = Element("model", name=model.name)
    _add_pose(element, state.pose)
    for name, (position, _) in state.joints.items():
        joint = SubElement(element, "joint", name=name)
        _add_numbers(joint, "angle", position, axis="0")
    for name, link in state.links.items():
        child = SubElement(element, "link", name=name)
        _add_pose(child, link.pose)
        _add_numbers(child, "velocity", (*link.linear, *link.angular))
    return element
