"""Read robots from URDF, with the tags that Gazebo adds to it, and from xacro.

A xacro file is a program: its `${…}` are Python expressions. The xacro package restricts the names
in them, but this is no protection. So a file is only expanded if the user names its path, never if
it came as text. A separate process expands it, which has limited time and memory and cannot write
files. It can read everything that the user can read, with the environment: do not expand xacro
files of strangers.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections import defaultdict
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Collection, Mapping
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import (
    LIMITS,
    WHITE,
    WORLD_LINK,
    Appearance,
    Collision,
    Colour,
    Joint,
    Link,
    Model,
    Visual,
)
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Shape
from bullet_lab.simulation.world.tags import Document, SdfTag, Tag, plugins_in
from bullet_lab.simulation.world.tree import (
    check_tree,
    lump_fixed_joints,
    place_links,
    rooted,
    with_sound_inertias,
)
from bullet_lab.simulation.world.xml import (
    MAXIMUM_BYTES,
    XmlError,
    leaving_out,
    parse_text,
    read_text,
)

# The limits of the process that expands xacro, and of its message.
SECONDS = 30
MEMORY_BYTES = 1 << 30
LONGEST_MESSAGE = 300
# Digits of a sensor's numbers: Gazebo converts URDF to SDF, and writes that with so many.
SENSOR_DIGITS = 6

# Stands between the names of a link and of a shape that had another name.
LUMP = "_fixed_joint_lump__"
SIMULATED_JOINTS = ("fixed", "revolute", "continuous", "prismatic")
# The elements of a robot and of a link.
ROBOT_PARTS = ("link", "joint", "gazebo", "material", "transmission")
LINK_PARTS = ("inertial", "visual", "collision")
# Gazebo makes no joint of these: their child links are free.
LOOSE_JOINTS = ("floating", "planar")

# These are read elsewhere, are only for Gazebo's window, or are settings of its engine ODE.
QUIET_TAGS = (
    *("plugin", "sensor", "visualize", "visual"),
    *("minDepth", "maxVel", "maxContacts", "provideFeedback", "implicitSpringDamper"),
)


class XacroError(XmlError):
    """A xacro file cannot be expanded."""


def read_urdf_text(path: Path) -> str:
    """Return the URDF text of a URDF or xacro file; raise XmlError."""
    return expand_xacro(path) if path.suffix.lower() == ".xacro" else read_text(path)


def expand_xacro(path: Path) -> str:
    """Return the URDF text of a xacro file, whose `<xacro:arg>` have their defaults.

    Raises:
        XacroError: the xacro package or the file is missing, the file is invalid, or it takes too
            much time or memory; the message says which.
    """
    child = Path(__file__).with_name("xacro_child.py")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(
            [sys.executable, "-B", str(child), str(path), str(SECONDS), str(MEMORY_BYTES)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=2 * SECONDS,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise XacroError(f"{path}: xacro took longer than {2 * SECONDS} s") from error
    if done.returncode != 0:
        raise XacroError(f"{path}: {_reason(done)}")
    if len(done.stdout) > MAXIMUM_BYTES:
        raise XacroError(f"{path}: xacro makes more than {MAXIMUM_BYTES} bytes of it")
    return done.stdout.decode()


def _reason(done: subprocess.CompletedProcess) -> str:
    if done.returncode < 0:
        return f"xacro took more than {SECONDS} s"
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return lines[-1][:LONGEST_MESSAGE] if lines else "xacro failed without a message"


def read_urdf_file(path: Path) -> Model:
    """Read a robot from a URDF or xacro file; see `read_urdf` and `expand_xacro`."""
    return read_urdf(read_urdf_text(path), str(path), path.parent)


def read_urdf(text: str, source: str, folder: Path | None = None) -> Model:
    """Read a robot from URDF text.

    As in Gazebo, links on fixed joints are merged into their parent links, children of a link
    called "world" are joined to the world, and `<gazebo>` elements hold plugins and friction. An
    invalid shape is reported and left out.

    Args:
        text: of the document.
        source: its name in messages.
        folder: the folder that it belongs to; None for one that came alone.

    Raises:
        XmlError: not XML, or no possible robot; the message says what and where.
    """
    return read_urdf_element(parse_text(text, source), source, Document(ResourceFinder(folder)))


def read_urdf_element(root: Element, source: str, document: Document) -> Model:
    """Read a robot from the root element of a URDF document; as `read_urdf`."""
    if root.tag != "robot":
        raise XmlError(f"{source}: the root element is <{root.tag}>, not <robot>")
    model = with_sound_inertias(_model(UrdfTag(root, source, document)), source)
    return replace(model, links=tuple(map(_with_collision_names, model.links)))


class UrdfTag(Tag):
    """Reads attributes by their paths, such as "inertial/mass/value"."""

    file_key = "filename"

    def text(self, key: str, default: str = "") -> str:  # noqa: D102
        path, _, name = key.rpartition("/")
        element = self.element.find(path or ".")
        return default if element is None else element.get(name, default)

    def where(self, key: str) -> str:  # noqa: D102
        path, _, name = key.rpartition("/")
        return f"{self.source}: {path.rpartition('/')[2] or self.element.tag} {name}"

    def pose(self) -> Pose:  # noqa: D102
        xyz, rpy = (self.numbers(f"origin/{key}", 3, "0 0 0") for key in ("xyz", "rpy"))
        return Pose.from_rpy(xyz, rpy)

    def shape(self, element: Element, where: str) -> Shape:  # noqa: D102
        shape = None if element.tag == "plane" else super().shape(element, self.source)
        if shape is None:
            raise XmlError(f"{self.source}: unknown geometry <{element.tag}>")
        return shape

    def colour(self) -> Colour:
        """Return the colour in a <material>; raise XmlError."""
        return self.numbers("color/rgba", 4)


def _model(root: UrdfTag) -> Model:
    """Return a robot, with links on fixed joints merged into their parents."""
    element, source = root.element, root.source
    painted = map(root.other, element.iterfind(".//material[color]"))
    colours = dict(root.document.each(lambda one: (one.name, one.colour()), painted))
    for child in (*element, *element.iterfind("link/*")):
        # Others have a namespace, as xacro's own.
        if "}" not in child.tag and child.tag not in ROBOT_PARTS + LINK_PARTS:
            why = f"if it is a macro of xacro, it is called <xacro:{child.tag}>"
            root.document.report(f"{source}: <{child.tag}> is not known and left out; {why}")
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
    for sensor in element.iterfind("gazebo/sensor"):
        _shorten_numbers(sensor)
    plugins = tuple(
        plugin
        for gazebo in element.findall("gazebo")
        for plugin in plugins_in(gazebo, gazebo.get("reference", ""))
    )
    robot = Model(root.name or "robot", links, joints, plugins, static=tags.static)
    return tags.apply_gravity(lump_fixed_joints(robot))


def _shorten_numbers(element: Element) -> None:
    """Round the numbers in a sensor, but for its plugins' tags, to SENSOR_DIGITS digits."""
    for child in element:
        if child.tag != "plugin":
            _shorten_numbers(child)
    with suppress(ValueError):
        numbers = map(float, (element.text or "").split())
        element.text = " ".join(f"{number:.{SENSOR_DIGITS}g}" for number in numbers)


def _link(tag: UrdfTag, colours: Mapping[str, Colour]) -> Link:
    def visual(tag: UrdfTag, shape: Shape) -> Visual:
        material = tag.part("material")
        if material.element.find("color") is None:
            colour = colours.get(material.name, WHITE)
        else:
            colour = material.colour()
        return Visual(shape, tag.pose(), colour, tag.name)

    def collision(inner: UrdfTag, shape: Shape) -> Collision:
        return Collision(shape, inner.pose(), name=inner.name or tag.name)

    inertial = tag.element.find("inertial")
    inner = None if inertial is None else tag.other(inertial)
    return Link(
        tag.name,
        inertia=inner and inner.inertia(inner.coefficient("mass/value"), 0.0),
        visuals=tag.shapes("visual", visual),
        collisions=tag.shapes("collision", collision),
    )


def _joint(tag: UrdfTag) -> Joint:
    kind = tag.text("type")
    if kind not in SIMULATED_JOINTS:
        is_free = kind in LOOSE_JOINTS
        what = "its child is free" if is_free else "its links are fixed to each other"
        tag.document.report(f"{tag.source}: type '{kind}' is not simulated; {what}")
        kind = kind if is_free else "fixed"
    for end in ("parent", "child"):
        if not tag.text(f"{end}/link"):
            raise XmlError(f"{tag.source}: no <{end} link=…>")
    return Joint(
        tag.name,
        kind,
        tag.text("parent/link"),
        tag.text("child/link"),
        tag.pose(),
        # SolidWorks writes a zero vector for fixed joints.
        Joint.axis if kind == "fixed" else tag.direction("axis/xyz", "1 0 0"),
        {k: tag.bound(f"limit/{k}") for k in tag.part("limit").element.attrib if k in LIMITS},
        tag.number("dynamics/damping"),
        tag.number("dynamics/friction"),
    )


def _with_collision_names(link: Link) -> Link:
    """Return a link whose collisions have the names that Gazebo gives: link_collision_1.

    Those of merged links, and those with names of their own, have LUMP in their names.
    """
    collisions = []
    for number, shape in enumerate(link.collisions):
        suffix = f"_{number}" if number else ""
        name = shape.name if shape.name == link.name else f"{link.name}{LUMP}{shape.name}"
        collisions.append(replace(shape, name=f"{name}_collision{suffix}"))
    return replace(link, collisions=tuple(collisions))


class _LinkTag(Tag):
    """Reads both spellings of a tag's value, as Gazebo does: <mu1>1</mu1>, <mu1 value="1"/>."""

    def text(self, key: str, default: str = "") -> str:
        return (self.element.get(key) or self.element.text or "").strip()

    def where(self, key: str) -> str:
        return self.source

    def doubt(self, error: LabError) -> None:
        raise error

    def truth(self) -> bool:
        """Return whether it says "true"."""
        return self.boolean("value", False)

    def named_look(self) -> Appearance | None:
        """Return the look of the material that it names."""
        return self.document.materials.named(self.text("value"), self.source)

    def look(self) -> Appearance | None:
        """Return what the <material> in it describes; the same as in SDF."""
        document = self.document
        material = SdfTag(self.element, self.source, document).part("material")
        found = document.materials.of_tag(material, document.finder, WHITE)
        return found if found[1].covers else None


# The tags in `<gazebo reference=…>`, what they describe, and how they are read.
LINK_TAGS: dict[str, tuple[str, Callable[[_LinkTag], Any]]] = {
    "mu1": ("friction", lambda tag: tag.friction("value")),
    "mu2": ("cross_friction", lambda tag: tag.friction("value")),
    "fdir1": ("direction", lambda tag: tag.friction_direction("value")),
    "kp": ("stiffness", lambda tag: tag.coefficient("value")),
    "kd": ("damping", lambda tag: tag.coefficient("value")),
    "selfCollide": ("self_collide", _LinkTag.truth),
    "gravity": ("gravity", _LinkTag.truth),
    "turnGravityOff": ("gravity", lambda tag: not tag.truth()),
    "material": ("look", _LinkTag.named_look),
    "visual": ("look", _LinkTag.look),
}


class _GazeboTags:
    """The `<gazebo>` elements of a URDF document, which describe its links.

    Invalid tags, tags that are not simulated, and references to anything but `names` are reported.
    `static` is that of the whole robot.
    """

    def __init__(self, root: UrdfTag, names: Collection[str]):
        self._source, self._document = root.source, root.document
        # For each link: fields of its collisions, and its `look`, `gravity` and `self_collide`.
        self._fields: defaultdict[str, dict[str, Any]] = defaultdict(dict)
        self.static = False
        report = root.document.report
        for element in root.element.findall("gazebo"):
            name = element.get("reference")
            if name not in (None, *names):
                report(f"<gazebo reference='{name}'>: unknown link or joint")
            for child in element:
                part = "robot" if name is None else name
                tag = _LinkTag(child, f"{root.source}: <{child.tag}> of '{part}'", root.document)
                is_default = child.tag == "static" and (child.text or "").strip() in ("0", "false")
                with leaving_out(report):
                    if name is None and child.tag == "static":
                        self.static = tag.truth()
                    elif name is not None and child.tag in LINK_TAGS:
                        field, read = LINK_TAGS[child.tag]
                        found = read(tag)
                        if found is not None:
                            self._fields[name][field] = found
                    elif child.tag not in QUIET_TAGS and not is_default:
                        report(f"{root.source}: <gazebo>: <{child.tag}> is not simulated")

    def apply(self, link: Link) -> Link:
        """Return a link with what the tags describe, but for gravity."""
        fields = dict(self._fields.get(link.name, {}))
        cross = fields.get("cross_friction")
        if cross is not None and "direction" not in fields:
            mu = fields.setdefault("friction", cross)
            if mu != cross:
                where = f"{self._source}: <mu2> of '{link.name}'"
                what = f"without <fdir1>, friction has one coefficient here, <mu1>: {mu:g}"
                self._document.report(f"{where}: {what}")
        fields.pop("gravity", None)
        link = replace(link, self_collide=fields.pop("self_collide", link.self_collide))
        if "look" in fields:
            colour, material = fields.pop("look")
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
                self._document.report(f"{self._source}: {what} for both")
            links.append(replace(link, gravity=is_pulled))
        return replace(model, links=tuple(links))
