"""Reading robots from URDF, with the tags that Gazebo adds to it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping, Optional, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import (
    WHITE,
    WORLD_LINK,
    Collision,
    Colour,
    Inertia,
    Joint,
    Link,
    Model,
    Visual,
)
from bullet_lab.simulation.world.gazebo_tags import GazeboTags, plugins_in
from bullet_lab.simulation.world.inertia import INERTIA_KEYS, inertia_at
from bullet_lab.simulation.world.materials import MaterialLibrary
from bullet_lab.simulation.world.report import ReportOnce, leaving_out
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.shapes import SHAPES, Shape, ShapeTag
from bullet_lab.simulation.world.soundness import with_sound_inertias
from bullet_lab.simulation.world.tree import (
    check_tree,
    lump_fixed_joints,
    place_links,
    rooted,
)
from bullet_lab.simulation.world.xacro import expand_xacro, is_xacro
from bullet_lab.simulation.world.xml import XmlError, parse_text, read_text

SIMULATED_JOINTS = ("fixed", "revolute", "continuous", "prismatic")
# Gazebo makes no joint of these: what hangs on them is free.
LOOSE_JOINTS = ("floating", "planar")


class UrdfError(XmlError):
    """A text is well-formed XML and yet no robot."""


def read_urdf_file(path: Path, finder: Optional[ResourceFinder] = None) -> Model:
    """Read a robot from a URDF or xacro file; see `read_urdf` and `expand_xacro`."""
    text = expand_xacro(path) if is_xacro(path) else read_text(path)
    return read_urdf(text, str(path), (finder or ResourceFinder()).beside(path))


def read_urdf(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Read a robot from URDF text.

    As in Gazebo, what hangs on a fixed joint is merged into its parent link, what hangs on a link
    called "world" is joined to the world, and `<gazebo>` elements say what the robot can do
    (`<plugin>`) and how its links rub (`<mu1>`). What makes no sense of a link is named and left
    out. `source` names the text in messages.

    Raises:
        XmlError: not XML, or no robot that could exist; the message says what and where.
    """
    root = parse_text(text, source)
    if root.tag != "robot":
        raise UrdfError(f"{source}: the root element is <{root.tag}>, not <robot>")
    tag = _Tag(root, source, finder or ResourceFinder(), ReportOnce())
    return _with_shapes_named(with_sound_inertias(_model(tag), source))


class _Tag(ShapeTag):
    """A tag, read by its attributes; `source` names what it stands in in messages.

    `report` tells the user what makes no sense in it.
    """

    def __init__(self, element: Element, source: str, finder: ResourceFinder, report: ReportOnce):
        self.element = element
        self.source = source
        self.finder = finder
        self.report = report

    def text(self, key: str, default: str = "") -> str:
        return self.element.get(key, default)

    def where(self, key: str) -> str:
        return f"{self.source}: {self.element.tag} {key}"

    def doubt(self, error: LabError) -> None:
        self.report(f"{error}; the default counts")

    def other(self, element: Element, source: str = "") -> _Tag:
        """Return another element of the same document."""
        return _Tag(element, source or self.source, self.finder, self.report)

    def within(self, tag: str) -> _Tag:
        """Return a tag in it; an empty one if there is none."""
        found = self.element.find(tag)
        return self.other(Element(tag) if found is None else found)

    def all(self, tag: str) -> Iterator[_Tag]:
        for element in self.element.findall(tag):
            yield self.other(element)

    def named(self) -> _Tag:
        """Return it with its name in messages."""
        kind, name = self.element.tag, self.text("name")
        if not name:
            raise UrdfError(f"{self.source}: a <{kind}> without a name")
        return self.other(self.element, f"{self.source}: {kind} '{name}'")

    def origin(self) -> Pose:
        tag = self.within("origin")
        return Pose.from_rpy(tag.numbers("xyz", 3, "0 0 0"), tag.numbers("rpy", 3, "0 0 0"))

    def uri(self) -> str:
        return self.text("filename")

    def find(self, uri: str) -> Path:
        try:
            return self.finder.find(uri)
        except ResourceError as error:
            raise ResourceError(f"{self.source}: {self.element.tag}: {error}") from error


def _model(root: _Tag) -> Model:
    """Return a robot with the links of the document, less those that are merged into others."""
    colours = {}
    for material in map(root.other, root.element.iter("material")):
        with leaving_out(root.report):
            if material.element.find("color") is not None:
                colours[material.text("name")] = _colour(material)
    links = tuple(_link(tag.named(), colours) for tag in root.all("link"))
    joints = tuple(_joint(tag.named()) for tag in root.all("joint"))
    check_tree(links, joints, root.source)
    gazebo = root.element.findall("gazebo")
    names = [part.name for part in (*links, *joints)]
    tags = GazeboTags(gazebo, names, root.source, MaterialLibrary(), root.finder)
    links = place_links(tuple(map(tags.apply, links)), joints)
    links, joints = rooted(
        tuple(link for link in links if link.name != WORLD_LINK),
        tuple(joint for joint in joints if joint.kind not in LOOSE_JOINTS),
        root.source,
    )
    found = (plugins_in(element, element.get("reference", "")) for element in gazebo)
    plugins = tuple(itertools.chain.from_iterable(found))
    robot = Model(root.text("name") or "robot", links, joints, plugins, static=tags.static)
    return tags.weigh(lump_fixed_joints(robot, rename=True))


def _link(tag: _Tag, colours: Mapping[str, Colour]) -> Link:
    return Link(
        tag.text("name"),
        inertia=_inertia(tag),
        visuals=_shapes(tag, "visual", lambda visual: _visual(visual, colours)),
        collisions=_shapes(tag, "collision", lambda shape: _collision(shape, tag.text("name"))),
    )


def _shapes(link: _Tag, kind: str, read: Callable[[_Tag], Any]) -> Tuple[Any, ...]:
    """Return those visuals or collisions of a link that make sense."""
    found = []
    for shape in link.all(kind):
        with leaving_out(link.report):
            found.append(read(shape))
    return tuple(found)


def _collision(tag: _Tag, link: str) -> Collision:
    return Collision(_geometry(tag), tag.origin(), name=tag.text("name") or link)


def _visual(tag: _Tag, colours: Mapping[str, Colour]) -> Visual:
    material = tag.within("material")
    if material.element.find("color") is None:
        colour = colours.get(material.text("name"), WHITE)
    else:
        colour = _colour(material)
    return Visual(_geometry(tag), tag.origin(), colour, tag.text("name"))


def _inertia(link: _Tag) -> Optional[Inertia]:
    tag = link.within("inertial")
    if link.element.find("inertial") is None:
        return None
    mass, moments = tag.within("mass").coefficient("value", 0.0), tag.within("inertia")
    elements = [moments.number(key, 0.0) for key in INERTIA_KEYS]
    return inertia_at(tag.origin(), mass, elements)


def _geometry(tag: _Tag) -> Shape:
    holder = tag.element.find("geometry")
    if holder is None or not len(holder):
        raise UrdfError(f"{tag.source}: <{tag.element.tag}> without a geometry")
    shape = holder[0]
    kind = SHAPES.get(shape.tag)
    if kind is None or not kind.in_urdf:
        raise UrdfError(f"{tag.source}: no geometry is called <{shape.tag}>")
    return kind.read(tag.other(shape))


def _joint(tag: _Tag) -> Joint:
    kind = tag.text("type")
    if kind not in SIMULATED_JOINTS:
        free = kind in LOOSE_JOINTS
        what = "its child is free" if free else "it holds its links fixed"
        tag.report(f"{tag.source}: type '{kind}' is not simulated; {what}")
        kind = kind if free else "fixed"
    limit, dynamics = tag.within("limit"), tag.within("dynamics")
    for end in ("parent", "child"):
        if not tag.within(end).text("link"):
            raise UrdfError(f"{tag.source}: no <{end} link=…>")
    return Joint(
        tag.text("name"),
        kind,
        tag.within("parent").text("link"),
        tag.within("child").text("link"),
        tag.origin(),
        tag.within("axis").direction("xyz", "1 0 0"),
        {key: limit.bound(key) for key in limit.element.attrib},
        dynamics.number("damping", 0.0),
        dynamics.number("friction", 0.0),
    )


def _colour(material: _Tag) -> Colour:
    return material.within("color").numbers("rgba", 4)


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
