"""Reading robots from URDF, with the tags that Gazebo adds to it."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, Iterable, List, Optional, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    WHITE,
    Box,
    Collision,
    Colour,
    Cylinder,
    Geometry,
    Inertia,
    Joint,
    Link,
    Mesh,
    Model,
    Plugin,
    Sphere,
    Visual,
)
from bullet_lab.simulation.world.gazebo_materials import gazebo_colour
from bullet_lab.simulation.world.inertia import check_inertia, matrix_from_elements
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.tree import check_tree, lump_fixed_joints, place_links
from bullet_lab.simulation.world.xacro import expand_xacro, is_xacro
from bullet_lab.simulation.world.xml import (
    XmlError,
    boolean,
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
        return Model(name, place_links(links, joints), joints, self._plugins())

    def _plugins(self) -> Tuple[Plugin, ...]:
        found: List[Plugin] = []
        for element in self._root.findall("gazebo"):
            found.extend(plugins_in(element, element.get("reference", "")))
        return tuple(found)

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
        entries = [
            number(tensor.get(key, "0"), f"{where}: {key}")
            for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        ]
        origin = self._origin(element, link)
        turn = origin.rotation_matrix()
        matrix = turn @ matrix_from_elements(*entries) @ turn.T
        inertia = Inertia(mass, origin.position, matrix)
        check_inertia(inertia, where)
        return inertia

    def _geometry(self, element: Element, link: str) -> Geometry:
        where = f"{self._source}: link '{link}'"
        holder = element.find("geometry")
        shape = holder[0] if holder is not None and len(holder) else None
        if shape is None:
            raise UrdfError(f"{where}: <{element.tag}> without a geometry")
        if shape.tag == "box":
            return Box(sizes(shape.get("size"), 3, f"{where}: box size"))
        if shape.tag == "cylinder":
            keys = ("radius", "length")
            return Cylinder(*(sizes(shape.get(k), 1, f"{where}: cylinder {k}")[0] for k in keys))
        if shape.tag == "sphere":
            return Sphere(*sizes(shape.get("radius"), 1, f"{where}: sphere radius"))
        if shape.tag == "mesh":
            return self._mesh(shape, where)
        raise UrdfError(f"{where}: no geometry is called <{shape.tag}>")

    def _mesh(self, shape: Element, where: str) -> Mesh:
        uri = shape.get("filename", "")
        scale = mesh_scale(shape.get("scale", "1 1 1"), f"{where}: mesh scale")
        try:
            return Mesh(self._finder.find(uri), uri, scale)
        except ResourceError as error:
            raise ResourceError(f"{where}: mesh: {error}") from error

    def _joint(self, element: Element) -> Joint:
        name = self._name(element, "joint")
        where = f"{self._source}: joint '{name}'"
        kind = element.get("type", "")
        if kind not in SIMULATED_JOINTS:
            raise UrdfError(f"{where}: type '{kind}' is not one of {', '.join(SIMULATED_JOINTS)}")
        axis, limit, dynamics = (element.find(tag) for tag in ("axis", "limit", "dynamics"))
        along = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
        return Joint(
            name,
            kind,
            self._end(element, "parent", where),
            self._end(element, "child", where),
            self._origin(element, name),
            direction(along, f"{where}: axis"),
            {} if limit is None else {k: number(v, f"{where}: {k}") for k, v in limit.items()},
            _attribute(dynamics, "damping", where),
            _attribute(dynamics, "friction", where),
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
        position = numbers(origin.get("xyz", "0 0 0"), 3, where)
        return Pose.from_rpy(position, numbers(origin.get("rpy", "0 0 0"), 3, where))

    def _colour(self, element: Element) -> Colour:
        return numbers(element.get("rgba"), 4, f"{self._source}: colour")

    def _name(self, element: Element, kind: str) -> str:
        name = element.get("name")
        if not name:
            raise UrdfError(f"{self._source}: a <{kind}> without a name")
        return name


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


def _attribute(element: Optional[Element], name: str, where: str) -> float:
    return 0.0 if element is None else number(element.get(name, "0"), f"{where}: {name}")


LOG = logging.getLogger(__name__)

# Read elsewhere, or for the eye alone.
QUIET_TAGS = frozenset(("plugin", "sensor", "visualize", "visual"))
# Texts that ask for what happens anyway.
AS_IT_IS = {"gravity": ("1", "true"), "turnGravityOff": ("0", "false"), "static": ("0", "false")}


@dataclass(frozen=True)
class LinkTags:
    """What Gazebo is told of one link; None where it is told nothing.

    `mu` is Coulomb's coefficient, `stiffness` (N/m) and `damping` (N s/m) are those of its
    contacts.
    """

    colour: Optional[Colour] = None
    mu: Optional[float] = None
    stiffness: Optional[float] = None
    damping: Optional[float] = None
    self_collide: bool = False

    def apply(self, link: Link) -> Link:
        """Return the link as Gazebo would have it."""
        changes = {"friction": self.mu, "stiffness": self.stiffness, "damping": self.damping}
        told = {key: value for key, value in changes.items() if value is not None}
        visuals = link.visuals
        if self.colour is not None:
            visuals = tuple(replace(visual, colour=self.colour) for visual in visuals)
        return replace(
            link,
            visuals=visuals,
            collisions=tuple(replace(shape, **told) for shape in link.collisions),
            self_collide=self.self_collide,
        )


class GazeboTags:
    """Collects the `<gazebo>` elements of a document.

    Tags that are not simulated are reported once each by name, and so are references to nothing.

    Args:
        elements: the `<gazebo>` elements.
        references: names of the links and joints that may be referred to.
        source: names the document in messages.

    Raises:
        XmlError: a tag that is simulated makes no sense.
    """

    def __init__(self, elements: Iterable[Element], references: Iterable[str], source: str):
        self._source = source
        self._tags: Dict[str, LinkTags] = {}
        self._reported: set = set()
        known = set(references)
        for element in elements:
            name = element.get("reference")
            if name is None:
                self._report_unknown(element, ())
                continue
            if name not in known:
                self._report(f"<gazebo reference='{name}'>: there is no such link or joint")
            self._tags[name] = self._read(element, self._tags.get(name, LinkTags()), name)

    def apply(self, link: Link) -> Link:
        """Return a link as Gazebo would have it."""
        tags = self._tags.get(link.name)
        return link if tags is None else tags.apply(link)

    def _read(self, element: Element, tags: LinkTags, link: str) -> LinkTags:
        readers = {
            "material": self._material,
            "mu1": self._mu1,
            "mu2": self._mu2,
            "kp": self._kp,
            "kd": self._kd,
            "selfCollide": self._self_collide,
        }
        for child in element:
            if child.tag in readers:
                # Gazebo reads both spellings: <mu1>1</mu1> and <mu1 value="1"/>.
                text = (child.get("value") or child.text or "").strip()
                where = f"{self._source}: <{child.tag}> of '{link}'"
                tags = readers[child.tag](tags, text, where)
        self._report_unknown(element, readers)
        return tags

    def _material(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        colour = gazebo_colour(text)
        if colour is None:
            self._report(f"{where}: material '{text}' is not known and not drawn")
            return tags
        return replace(tags, colour=colour)

    def _mu1(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        return replace(tags, mu=friction(text, where))

    def _mu2(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        # Bullet's friction is the same in all directions.
        value = friction(text, where)
        if tags.mu is None:
            return replace(tags, mu=value)
        if value != tags.mu:
            self._report(f"{where}: friction has one coefficient here, <mu1>: {tags.mu:g}")
        return tags

    def _kp(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        # A coefficient that must not be negative, like that of friction.
        return replace(tags, stiffness=friction(text, where))

    def _kd(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        return replace(tags, damping=friction(text, where))

    def _self_collide(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        return replace(tags, self_collide=boolean(text, where))

    def _report_unknown(self, element: Element, known: Iterable[str]) -> None:
        for child in element:
            is_as_it_is = (child.text or "").strip() in AS_IT_IS.get(child.tag, ())
            if child.tag not in QUIET_TAGS and child.tag not in known and not is_as_it_is:
                self._report(f"{self._source}: <gazebo>: <{child.tag}> is not simulated")

    def _report(self, message: str) -> None:
        if message not in self._reported:
            self._reported.add(message)
            LOG.warning("%s", message)
