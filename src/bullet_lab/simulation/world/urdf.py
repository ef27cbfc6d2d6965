"""Reading robots from URDF, with the tags that Gazebo adds to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Dict, Optional
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    WHITE,
    Collision,
    Colour,
    Inertia,
    Joint,
    Link,
    Model,
    Visual,
)
from bullet_lab.simulation.world.gazebo_tags import GazeboTags, plugins_in
from bullet_lab.simulation.world.inertia import inertia_at
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.shapes import SHAPES, Shape, ShapeTag
from bullet_lab.simulation.world.tree import check_tree, lump_fixed_joints, place_links
from bullet_lab.simulation.world.xacro import expand_xacro, is_xacro
from bullet_lab.simulation.world.xml import (
    TagReader,
    XmlError,
    direction,
    number,
    numbers,
    parse_text,
    read_text,
)

INERTIA_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
SIMULATED_JOINTS = ("fixed", "revolute", "continuous", "prismatic")


class UrdfError(XmlError):
    """A text is well-formed XML and yet no robot."""


def read_urdf_file(path: Path, finder: Optional[ResourceFinder] = None) -> Model:
    """Read a robot from a URDF or xacro file; see `read_urdf` and `expand_xacro`."""
    text = expand_xacro(path) if is_xacro(path) else read_text(path)
    return read_urdf(text, str(path), (finder or ResourceFinder()).beside(path))


def read_urdf(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Read a robot from URDF text.

    As in Gazebo, what hangs on a fixed joint is merged into its parent link, and
    `<gazebo>` elements say what the robot can do (`<plugin>`) and how its links rub (`<mu1>`).

    Args:
        text: the URDF.
        source: names the text in messages.
        finder: finds the mesh files.

    Raises:
        XmlError: not XML, or no robot that could exist; the message says what and where.
        ResourceError: a mesh cannot be found or must not be read.
    """
    root = parse_text(text, source)
    if root.tag != "robot":
        raise UrdfError(f"{source}: the root element is <{root.tag}>, not <robot>")
    reader = _Reader(root, source, finder or ResourceFinder())
    return _with_shapes_named(lump_fixed_joints(reader.model(), rename=True))


class _Reader:
    def __init__(self, root: Element, source: str, finder: ResourceFinder):
        self._root = root
        self._source = source
        self._finder = finder
        self._colours: Dict[str, Colour] = {}
        for material in root.iter("material"):
            colour = material.find("color")
            if colour is not None:
                self._colours[material.get("name", "")] = self._colour(colour)

    def model(self) -> Model:
        links = tuple(self._link(element) for element in self._root.findall("link"))
        joints = tuple(self._joint(element) for element in self._root.findall("joint"))
        check_tree(links, joints, self._source)
        references = [part.name for part in (*links, *joints)]
        tags = GazeboTags(self._root.findall("gazebo"), references, self._source)
        links = tuple(map(tags.apply, links))
        name = self._root.get("name") or "robot"
        plugins = tuple(
            plugin
            for element in self._root.findall("gazebo")
            for plugin in plugins_in(element, element.get("reference", ""))
        )
        return Model(name, place_links(links, joints), joints, plugins)

    def _link(self, element: Element) -> Link:
        name = self._name(element, "link")
        return Link(
            name,
            inertia=self._inertia(element.find("inertial"), name),
            visuals=tuple(self._visual(e, name) for e in element.findall("visual")),
            collisions=tuple(
                Collision(
                    self._geometry(e, name), self._origin(e, name), name=e.get("name") or name
                )
                for e in element.findall("collision")
            ),
        )

    def _visual(self, element: Element, link: str) -> Visual:
        colour = WHITE
        material = element.find("material")
        if material is not None:
            colour = self._colours.get(material.get("name", ""), WHITE)
            own = material.find("color")
            colour = colour if own is None else self._colour(own)
        geometry, origin = self._geometry(element, link), self._origin(element, link)
        return Visual(geometry, origin, colour, element.get("name", ""))

    def _inertia(self, element: Optional[Element], link: str) -> Optional[Inertia]:
        if element is None:
            return None
        where = f"{self._source}: link '{link}'"
        mass_element, tensor = element.find("mass"), element.find("inertia")
        if mass_element is None or tensor is None:
            raise UrdfError(f"{where}: <inertial> needs <mass> and <inertia>")
        mass = number(mass_element.get("value"), f"{where}: mass")
        moments = _Attributes(tensor, where)
        elements = [moments.number(key, 0.0) for key in INERTIA_KEYS]
        return inertia_at(self._origin(element, link), mass, elements, where)

    def _geometry(self, element: Element, link: str) -> Shape:
        where = f"{self._source}: link '{link}'"
        holder = element.find("geometry")
        shape = holder[0] if holder is not None and len(holder) else None
        if shape is None:
            raise UrdfError(f"{where}: <{element.tag}> without a geometry")
        kind = SHAPES.get(shape.tag)
        if kind is None or not kind.in_urdf:
            raise UrdfError(f"{where}: no geometry is called <{shape.tag}>")
        return kind.read(_ShapeAttributes(shape, where, self._finder))

    def _joint(self, element: Element) -> Joint:
        name = self._name(element, "joint")
        where = f"{self._source}: joint '{name}'"
        kind = element.get("type", "")
        if kind not in SIMULATED_JOINTS:
            raise UrdfError(f"{where}: type '{kind}' is not one of {', '.join(SIMULATED_JOINTS)}")
        axis, limit = element.find("axis"), element.find("limit")
        along = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
        dynamics = _Attributes(element.find("dynamics"), where)
        return Joint(
            name,
            kind,
            self._end(element, "parent", where),
            self._end(element, "child", where),
            self._origin(element, name),
            direction(along, f"{where}: axis"),
            {} if limit is None else {k: number(v, f"{where}: {k}") for k, v in limit.items()},
            dynamics.number("damping", 0.0),
            dynamics.number("friction", 0.0),
        )

    def _end(self, element: Element, tag: str, where: str) -> str:
        end = element.find(tag)
        link = None if end is None else end.get("link")
        if not link:
            raise UrdfError(f"{where}: no <{tag} link=…>")
        return link

    def _origin(self, element: Element, what: str) -> Pose:
        origin = element.find("origin")
        if origin is None:
            return Pose()
        where = f"{self._source}: origin in '{what}'"
        xyz, rpy = (numbers(origin.get(key, "0 0 0"), 3, where) for key in ("xyz", "rpy"))
        return Pose.from_rpy(xyz, rpy)

    def _colour(self, element: Element) -> Colour:
        return numbers(element.get("rgba"), 4, f"{self._source}: colour")

    def _name(self, element: Element, kind: str) -> str:
        name = element.get("name")
        if not name:
            raise UrdfError(f"{self._source}: a <{kind}> without a name")
        return name


class _Attributes(TagReader):
    """The attributes of a tag, which may be missing."""

    def __init__(self, element: Optional[Element], where: str):
        self._element = Element("") if element is None else element
        self._where = where

    def text(self, key: str, default: str = "") -> str:
        return self._element.get(key, default)

    def where(self, key: str) -> str:
        return f"{self._where}: {key}"


class _ShapeAttributes(_Attributes, ShapeTag):
    def __init__(self, element: Element, where: str, finder: ResourceFinder):
        super().__init__(element, f"{where}: {element.tag}")
        self._finder = finder

    def where(self, key: str) -> str:
        return f"{self._where} {key}"

    def uri(self) -> str:
        return self.text("filename")

    def find(self, uri: str) -> Path:
        try:
            return self._finder.find(uri)
        except ResourceError as error:
            raise ResourceError(f"{self._where}: {error}") from error


def _with_shapes_named(model: Model) -> Model:
    """Return the model with names of shapes as Gazebo makes them: link_collision_1."""

    def named(number: int, shape: Collision) -> Collision:
        return replace(shape, name=f"{shape.name}_collision" + (f"_{number}" if number else ""))

    return replace(
        model,
        links=tuple(
            replace(link, collisions=tuple(named(*c) for c in enumerate(link.collisions)))
            for link in model.links
        ),
    )
