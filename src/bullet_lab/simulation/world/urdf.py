"""Read robots from URDF, with the tags that Gazebo adds to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Collection, Dict, Iterable, Mapping, Optional, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import (
    LIMITS,
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
from bullet_lab.simulation.world.inertia import INERTIA_KEYS, inertia_at
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import SHAPES, Shape
from bullet_lab.simulation.world.tags import Document, Tag, plugins_in
from bullet_lab.simulation.world.tree import (
    check_tree,
    lump_fixed_joints,
    place_links,
    rooted,
    with_sound_inertias,
)
from bullet_lab.simulation.world.xacro import expand_xacro, is_xacro
from bullet_lab.simulation.world.xml import (
    TagReader,
    XmlError,
    leaving_out,
    parse_text,
    read_text,
)

SIMULATED_JOINTS = ("fixed", "revolute", "continuous", "prismatic")
# Gazebo makes no joint of these: their child links are free.
LOOSE_JOINTS = ("floating", "planar")

# Tags in `<gazebo reference=…>`: coefficients of friction, and stiffness and damping of contacts.
FRICTION = {"mu1": "friction", "mu2": "cross_friction"}
SPRING = {"kp": "stiffness", "kd": "damping"}
# Whether "true" in the tag means that gravity pulls the link.
GRAVITY = {"gravity": True, "turnGravityOff": False}
LINK_TAGS = (*FRICTION, *SPRING, *GRAVITY, "fdir1", "material", "selfCollide")
# These are read elsewhere, are only for Gazebo's window, or are settings of its engine ODE.
QUIET_TAGS = frozenset(
    ("plugin", "sensor", "visualize", "visual")
    + ("minDepth", "maxVel", "maxContacts", "provideFeedback", "implicitSpringDamper")
)


def read_urdf_file(path: Path, finder: Optional[ResourceFinder] = None) -> Model:
    """Read a robot from a URDF or xacro file; see `read_urdf` and `expand_xacro`."""
    text = expand_xacro(path) if is_xacro(path) else read_text(path)
    return read_urdf(text, str(path), (finder or ResourceFinder()).beside(path))


def read_urdf(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Read a robot from URDF text; `source` names the text in messages.

    As in Gazebo, links on fixed joints are merged into their parent links, children of a link
    called "world" are joined to the world, and `<gazebo>` elements hold plugins and friction. An
    invalid shape is reported and left out.

    Raises:
        XmlError: not XML, or no possible robot; the message says what and where.
    """
    return read_urdf_element(parse_text(text, source), source, finder)


def read_urdf_element(root: Element, source: str, finder: Optional[ResourceFinder]) -> Model:
    """Read a robot from the root element of a URDF document; as `read_urdf`."""
    if root.tag != "robot":
        raise XmlError(f"{source}: the root element is <{root.tag}>, not <robot>")
    tag = _UrdfTag(root, source, Document(finder or ResourceFinder()))
    model = with_sound_inertias(_model(tag), source)
    return replace(model, links=tuple(map(_with_collision_names, model.links)))


class _UrdfTag(Tag):
    """Reads attributes by their paths, such as "inertial/mass/value"."""

    file_key = "filename"

    def text(self, key: str, default: str = "") -> str:
        path, _, name = key.rpartition("/")
        element = self.element.find(path or ".")
        return default if element is None else element.get(name, default)

    def where(self, key: str) -> str:
        path, _, name = key.rpartition("/")
        return f"{self.source}: {path.rpartition('/')[2] or self.element.tag} {name}"

    def pose(self) -> Pose:
        xyz, rpy = (self.numbers(f"origin/{key}", 3, "0 0 0") for key in ("xyz", "rpy"))
        return Pose.from_rpy(xyz, rpy)


def _model(root: _UrdfTag) -> Model:
    """Return a robot, with links on fixed joints merged into their parents."""
    element, source = root.element, root.source
    colours: Dict[str, Colour] = {}
    for material in map(root.other, element.iter("material")):
        with leaving_out(root.document.report):
            if material.element.find("color") is not None:
                colours[material.name] = _colour(material)
    links = tuple(_link(root.named(link), colours) for link in element.findall("link"))
    joints = tuple(_joint(root.named(joint)) for joint in element.findall("joint"))
    check_tree(links, joints, source)
    tags = _GazeboTags(root, {part.name for part in (*links, *joints)})
    links = place_links(tuple(map(tags.apply, links)), joints)
    links, joints = rooted(
        tuple(link for link in links if link.name != WORLD_LINK),
        tuple(joint for joint in joints if joint.kind not in LOOSE_JOINTS),
        source,
    )
    plugins = tuple(
        plugin
        for gazebo in element.findall("gazebo")
        for plugin in plugins_in(gazebo, gazebo.get("reference", ""))
    )
    robot = Model(root.name or "robot", links, joints, plugins, static=tags.static)
    return tags.apply_gravity(lump_fixed_joints(robot, rename=True))


def _link(tag: _UrdfTag, colours: Mapping[str, Colour]) -> Link:
    return Link(
        tag.name,
        inertia=_inertia(tag),
        visuals=_shapes(tag, "visual", lambda visual: _visual(visual, colours)),
        collisions=_shapes(tag, "collision", lambda shape: _collision(shape, tag.name)),
    )


def _shapes(link: _UrdfTag, kind: str, read: Callable[[_UrdfTag], Any]) -> Tuple[Any, ...]:
    """Return the valid visuals or collisions of a link."""
    found = []
    for element in link.element.findall(kind):
        with leaving_out(link.document.report):
            found.append(read(link.other(element)))
    return tuple(found)


def _collision(tag: _UrdfTag, link: str) -> Collision:
    return Collision(_geometry(tag), tag.pose(), name=tag.name or link)


def _visual(tag: _UrdfTag, colours: Mapping[str, Colour]) -> Visual:
    if tag.element.find("material/color") is None:
        colour = colours.get(tag.text("material/name"), WHITE)
    else:
        colour = _colour(tag.other(tag.element.find("material")))
    return Visual(_geometry(tag), tag.pose(), colour, tag.name)


def _inertia(tag: _UrdfTag) -> Optional[Inertia]:
    element = tag.element.find("inertial")
    if element is None:
        return None
    tag = tag.other(element)
    mass = tag.coefficient("mass/value", 0.0)
    elements = [tag.number(f"inertia/{key}", 0.0) for key in INERTIA_KEYS]
    return inertia_at(tag.pose(), mass, elements)


def _geometry(tag: _UrdfTag) -> Shape:
    holder = tag.element.find("geometry")
    if holder is None or not len(holder):
        raise XmlError(f"{tag.source}: <{tag.element.tag}> without a geometry")
    kind = SHAPES.get(holder[0].tag)
    if kind is None or not kind.in_urdf:
        raise XmlError(f"{tag.source}: unknown geometry <{holder[0].tag}>")
    return kind.read(tag.other(holder[0]))


def _joint(tag: _UrdfTag) -> Joint:
    kind = tag.text("type")
    if kind not in SIMULATED_JOINTS:
        is_free = kind in LOOSE_JOINTS
        what = "its child is free" if is_free else "its links are fixed to each other"
        tag.document.report(f"{tag.source}: type '{kind}' is not simulated; {what}")
        kind = kind if is_free else "fixed"
    for end in ("parent", "child"):
        if not tag.text(f"{end}/link"):
            raise XmlError(f"{tag.source}: no <{end} link=…>")
    limits = tag.element.find("limit")
    given = () if limits is None else limits.attrib
    return Joint(
        tag.name,
        kind,
        tag.text("parent/link"),
        tag.text("child/link"),
        tag.pose(),
        tag.direction("axis/xyz", "1 0 0"),
        {key: tag.bound(f"limit/{key}") for key in given if key in LIMITS},
        tag.number("dynamics/damping", 0.0),
        tag.number("dynamics/friction", 0.0),
    )


def _colour(material: _UrdfTag) -> Colour:
    return material.numbers("color/rgba", 4)


def _with_collision_names(link: Link) -> Link:
    """Return a link whose collisions have the names that Gazebo gives: link_collision_1."""
    collisions = []
    for number, shape in enumerate(link.collisions):
        suffix = f"_{number}" if number else ""
        collisions.append(replace(shape, name=f"{shape.name}_collision{suffix}"))
    return replace(link, collisions=tuple(collisions))


class _LinkTag(TagReader):
    """Reads both spellings of a tag's value, as Gazebo does: <mu1>1</mu1>, <mu1 value="1"/>."""

    def __init__(self, element: Element, where: str):
        self._element = element
        self._where = where

    def text(self, key: str, default: str = "") -> str:
        return (self._element.get(key) or self._element.text or "").strip()

    def where(self, key: str) -> str:
        return self._where


class _GazeboTags:
    """The `<gazebo>` elements of a URDF document, which describe its links.

    Invalid tags, tags that are not simulated, and references to anything but `names` are reported.
    `static` is that of the whole robot.
    """

    def __init__(self, root: _UrdfTag, names: Collection[str]):
        self._root, self._report = root, root.document.report
        # For each link: fields of its collisions, and its `look`, `gravity` and `self_collide`.
        self._fields: Dict[str, Dict[str, Any]] = {}
        self.static = False
        for element in root.element.findall("gazebo"):
            name = element.get("reference")
            if name is None:
                for child in element.findall("static"):
                    with leaving_out(self._report):
                        self.static = self._tag(child, "robot").boolean("value", False)
                self._report_unknown(element, ("static",))
                continue
            if name not in names:
                self._report(f"<gazebo reference='{name}'>: unknown link or joint")
            for child in element:
                with leaving_out(self._report):
                    self._read(child, self._fields.setdefault(name, {}), name)
            self._report_unknown(element, LINK_TAGS)

    def apply(self, link: Link) -> Link:
        """Return a link with what the tags describe, but for gravity."""
        fields = dict(self._fields.get(link.name, {}))
        cross = fields.get("cross_friction")
        if cross is not None and "direction" not in fields:
            mu = fields.setdefault("friction", cross)
            if mu != cross:
                where = f"{self._root.source}: <mu2> of '{link.name}'"
                what = f"without <fdir1>, friction has one coefficient here, <mu1>: {mu:g}"
                self._report(f"{where}: {what}")
        look = fields.pop("look", None)
        fields.pop("gravity", None)
        link = replace(link, self_collide=fields.pop("self_collide", link.self_collide))
        if look is not None:
            colour, material = look
            painted = (replace(v, colour=colour, material=material) for v in link.visuals)
            link = replace(link, visuals=tuple(painted))
        return replace(link, collisions=tuple(replace(c, **fields) for c in link.collisions))

    def apply_gravity(self, model: Model) -> Model:
        """Return a model, whose links are merged, with gravity turned off where the tags say so.

        As in Gazebo, the last of the links that were merged into one decides for all of it.
        """
        links = []
        for link in model.links:
            merged = [name for name, (base, _) in model.frames.items() if base == link.name]
            names = [n for n in (link.name, *merged) if "gravity" in self._fields.get(n, {})]
            is_pulled = not names or self._fields[names[-1]]["gravity"]
            if not is_pulled and names[-1] != link.name:
                what = f"'{names[-1]}', which is fixed to '{link.name}', turns gravity off"
                self._report(f"{self._root.source}: {what} for both")
            links.append(replace(link, gravity=is_pulled))
        return replace(model, links=tuple(links))

    def _tag(self, child: Element, part: str) -> _LinkTag:
        return _LinkTag(child, f"{self._root.source}: <{child.tag}> of '{part}'")

    def _read(self, child: Element, fields: Dict[str, Any], link: str) -> None:
        tag, document = self._tag(child, link), self._root.document
        where = tag.where("value")
        if child.tag in FRICTION:
            fields[FRICTION[child.tag]] = tag.friction("value", 1.0)
        elif child.tag in SPRING:
            fields[SPRING[child.tag]] = tag.coefficient("value", 0.0)
        elif child.tag in GRAVITY:
            fields["gravity"] = tag.boolean("value", False) == GRAVITY[child.tag]
        elif child.tag == "fdir1":
            if any(tag.numbers("value", 3)):
                fields["direction"] = tag.direction("value", "")
        elif child.tag == "selfCollide":
            fields["self_collide"] = tag.boolean("value", False)
        elif child.tag == "material":
            look = document.materials.named(tag.text("value"), where)
            if look is not None:
                fields["look"] = look
        elif child.tag == "visual" and child.find("material") is not None:
            # The same as in SDF.
            element = child.find("material")
            colour, look = document.materials.of_element(element, where, document.finder, WHITE)
            if look.covers:
                fields["look"] = (colour, look)

    def _report_unknown(self, element: Element, known: Iterable[str]) -> None:
        for child in element:
            is_default = child.tag == "static" and (child.text or "").strip() in ("0", "false")
            if child.tag not in QUIET_TAGS and child.tag not in known and not is_default:
                self._report(f"{self._root.source}: <gazebo>: <{child.tag}> is not simulated")
