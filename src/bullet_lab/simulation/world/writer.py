"""Writing models as SDF 1.6: what was read of them, wherever it came from."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Set, Tuple, Union
from xml.etree.ElementTree import Element, SubElement

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Cylinder,
    Geometry,
    Inertia,
    Joint,
    Link,
    Mesh,
    Model,
    Plane,
    Plugin,
    Sphere,
    Visual,
)
from bullet_lab.simulation.world.resources import package_uri

INDENT = "  "


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with blanks between them, none rounded."""
    return " ".join(repr(float(value)) for value in values)


def add_text(parent: Element, tag: str, text: Any, **attributes: str) -> Element:
    """Add an element that holds a text."""
    element = SubElement(parent, tag, attributes)
    element.text = str(text)
    return element


def add_flag(parent: Element, tag: str, value: bool) -> None:
    """Add an element that says true or false."""
    add_text(parent, tag, "true" if value else "false")


def pose_text(pose: Pose) -> str:
    """Return x, y, z, roll, pitch and yaw."""
    return numbers_text((*pose.position, *pose.rpy()))


def add_pose(parent: Element, pose: Pose, **attributes: str) -> None:
    """Add a pose, in a `frame` if one is given."""
    add_text(parent, "pose", pose_text(pose), **attributes)


def indent(element: Element, level: int = 0) -> None:
    """Put each element that stands in others on a line of its own."""
    if not len(element):
        return
    inner = "\n" + INDENT * (level + 1)
    if not (element.text or "").strip():
        element.text = inner
    for child in element:
        indent(child, level + 1)
        if not (child.tail or "").strip():
            child.tail = inner
    element[-1].tail = "\n" + INDENT * level


# Where a joint that is limited on one side ends on the other, as SDF has it.
FAR = 1e16
NAMESPACE = "robotNamespace"


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
        add_pose(element, pose)
        add_flag(element, "static", model.static)
        for name, (link, place) in model.frames.items():
            add_pose(SubElement(element, "frame", name=name), place, frame=link)
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
        add_pose(element, link.pose)
        if link.self_collide:
            add_flag(element, "self_collide", True)
        if link.inertia is not None:
            _add_inertia(element, link.inertia)
        for name, collision in _named(link.collisions, "collision"):
            child = self._add_shape(element, "collision", name, collision)
            _add_surface(child, collision)
        for name, visual in _named(link.visuals, "visual"):
            child = self._add_shape(element, "visual", name, visual)
            if not visual.casts_shadows:
                add_flag(child, "cast_shadows", False)
            colour = numbers_text(visual.colour)
            material = SubElement(child, "material")
            add_text(material, "ambient", colour)
            add_text(material, "diffuse", colour)
        element.extend(_sensors(link, model))

    def _add_shape(
        self, parent: Element, tag: str, name: str, shape: Union[Collision, Visual]
    ) -> Element:
        element = SubElement(parent, tag, name=name)
        add_pose(element, shape.pose)
        self._add_geometry(SubElement(element, "geometry"), shape.geometry)
        return element

    def _add_geometry(self, parent: Element, geometry: Geometry) -> None:
        if isinstance(geometry, Box):
            add_text(SubElement(parent, "box"), "size", numbers_text(geometry.size))
        elif isinstance(geometry, Cylinder):
            cylinder = SubElement(parent, "cylinder")
            add_text(cylinder, "radius", repr(float(geometry.radius)))
            add_text(cylinder, "length", repr(float(geometry.length)))
        elif isinstance(geometry, Sphere):
            add_text(SubElement(parent, "sphere"), "radius", repr(float(geometry.radius)))
        elif isinstance(geometry, Plane):
            plane = SubElement(parent, "plane")
            add_text(plane, "normal", numbers_text(geometry.normal))
            add_text(plane, "size", numbers_text(geometry.size))
        else:
            mesh = SubElement(parent, "mesh")
            add_text(mesh, "uri", self._uri(geometry))
            add_text(mesh, "scale", numbers_text(geometry.scale))

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


def plugin_element(plugin: Plugin) -> Element:
    """Return a plugin's tag, with all that was in it and the namespace that it was given."""
    if plugin.element is None:
        element = Element("plugin", name=plugin.name, filename=plugin.filename)
        for tag, text in plugin.tags.items():
            add_text(element, tag, text)
        return element
    element = copy.deepcopy(plugin.element)
    element.tail = None
    namespace = plugin.tags.get(NAMESPACE, "")
    found = element.find(NAMESPACE)
    if namespace and found is None:
        add_text(element, NAMESPACE, namespace)
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
        pose = add_text(sensor, "pose", "0 0 0 0 0 0")
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
    add_pose(element, Pose(inertia.centre))
    add_text(element, "mass", repr(float(inertia.mass)))
    matrix = SubElement(element, "inertia")
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        tag = "i" + "xyz"[row] + "xyz"[column]
        add_text(matrix, tag, repr(float(inertia.matrix[row, column])))


def _add_surface(parent: Element, collision: Collision) -> None:
    surface = SubElement(parent, "surface")
    friction = SubElement(SubElement(surface, "friction"), "ode")
    for tag in ("mu", "mu2"):
        add_text(friction, tag, repr(float(collision.friction)))
    spring = {"kp": collision.stiffness, "kd": collision.damping}
    said = {tag: value for tag, value in spring.items() if value is not None}
    if said:
        contact = SubElement(SubElement(surface, "contact"), "ode")
        for tag, value in said.items():
            add_text(contact, tag, repr(float(value)))


def _add_joint(parent: Element, joint: Joint) -> None:
    # SDF has no continuous joints: they are revolute ones without limits.
    kind = "revolute" if joint.kind == "continuous" else joint.kind
    element = SubElement(parent, "joint", name=joint.name, type=kind)
    add_text(element, "parent", joint.parent)
    add_text(element, "child", joint.child)
    axis = SubElement(element, "axis")
    add_text(axis, "xyz", numbers_text(joint.axis))
    limits = SubElement(axis, "limit")
    bounds = {"lower": -FAR, "upper": FAR}
    if joint.kind != "continuous":
        bounds.update((k, v) for k, v in joint.limits.items() if k in bounds)
    more = {k: v for k, v in joint.limits.items() if k in ("effort", "velocity")}
    for tag, value in {**bounds, **more}.items():
        add_text(limits, tag, repr(float(value)))
    dynamics = SubElement(axis, "dynamics")
    add_text(dynamics, "damping", repr(float(joint.damping)))
    add_text(dynamics, "friction", repr(float(joint.friction)))


def _relative(path: Path, folder: Path) -> str:
    try:
        return str(path.relative_to(folder.resolve()))
    except ValueError:
        return ""
