"""Read the elements of SDF and URDF documents, and warn of those that are not simulated.

Actors become models: people and things that walk along a path, with the path's plugin.
"""

from __future__ import annotations

import copy
import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, TypeVar
from xml.etree.ElementTree import Element, SubElement, fromstring

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import WORLD_LINK, Inertia, PluginTag
from bullet_lab.simulation.world.materials import MaterialLibrary
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Shape, Sphere
from bullet_lab.simulation.world.tree import INERTIA_KEYS, inertia_at
from bullet_lab.simulation.world.xml import ElementReader, ReportOnce, XmlError

LOG = logging.getLogger(__name__)

# The SDF version that Gazebo 11 reads.
NEWEST = (1, 7)

# The children of each SDF element that are simulated.
SDF_READ = {
    "sdf": "world model light include",
    "world": "model light include actor gravity scene state physics frame",
    "actor": "script pose link plugin",
    "model": "link joint plugin pose static frame include model",
    "link": "pose inertial visual collision sensor plugin self_collide gravity",
    "visual": "geometry pose material cast_shadows transparency",
    "collision": "geometry pose surface",
    "joint": "parent child pose axis axis2",
    "surface": "friction contact",
    "physics": "gravity",
}
# Children that Gazebo writes into every saved world, or that have no visible effect here.
SDF_QUIET = {
    "world": "gui atmosphere wind magnetic_field spherical_coordinates audio",
    "actor": "skin animation static joint",
    "model": "allow_auto_disable",
    "link": "must_be_base_link",
    "visual": "meta laser_retro",
    "collision": "max_contacts laser_retro",
    "joint": "physics sensor",
    # Settings of Gazebo's engines.
    "physics": "ode bullet simbody dart max_contacts real_time_factor",
}
# Values that ask for what the simulation does anyway.
SDF_DEFAULTS = {
    "kinematic": ("0", "false"),
    "enable_wind": ("0", "false"),
    "self_collide": ("0", "false"),
    "transparency": ("0", "0.0"),
    "max_step_size": ("0.001", "1e-3", "1e-03"),
    "real_time_update_rate": ("1000", "1000.0"),
}
# Plugins of worlds and of the server that make Gazebo's ROS interface; the bridge provides it.
SERVER_PLUGINS = ("libgazebo_ros_api_plugin", "libgazebo_ros_paths_plugin", "libgazebo_ros")

PATH_PLUGIN = "libbullet_lab_path.so"
# An actor's skin is not drawn; m and kg of a grown person instead, just above the floor.
FIGURE = """<link name="link"><inertial><mass>80</mass></inertial>
  <collision name="body"><pose>0 0 0.75 0 0 0</pose>
    <geometry><cylinder><radius>0.2</radius><length>1.46</length></cylinder></geometry></collision>
  <collision name="head"><pose>0 0 1.6 0 0 0</pose>
    <geometry><sphere><radius>0.12</radius></sphere></geometry></collision>
  <visual name="body"><pose>0 0 0.75 0 0 0</pose>
    <geometry><cylinder><radius>0.2</radius><length>1.46</length></cylinder></geometry></visual>
  <visual name="head"><pose>0 0 1.6 0 0 0</pose>
    <geometry><sphere><radius>0.12</radius></sphere></geometry></visual></link>"""

# The frame of the model or of the world that contains the others.
MODEL_FRAME = "__model__"
OUTERMOST = ("", MODEL_FRAME, WORLD_LINK)

AnyTag = TypeVar("AnyTag", bound="Tag")


class Frames:
    """The frames of a model or a world, which are given in each other, as in SDF 1.7.

    A model's frames are its links, joints, `<frame>`s and nested models; a world's are its models
    and `<frame>`s. Frames of a nested model are named `model::name`.
    """

    def __init__(self, source: str):
        self._source, self._report = source, ReportOnce()
        # For each frame: its pose, the frame that it is given in, and the one that it moves with.
        self._frames: dict[str, tuple[Pose, str, str]] = {}

    def add(self, name: str, pose: Pose, base: str = "", carrier: str = "") -> None:
        """Add a frame at a pose in another one, by default the outermost."""
        self._frames.setdefault(name, (pose, base or MODEL_FRAME, carrier))

    def pose(self, name: str) -> Pose:
        """Return the pose of a frame in the outermost one.

        An unknown frame, or one that is given in itself, counts as the outermost, with a warning.
        """
        pose, seen = Pose(), {name}
        while name not in OUTERMOST:
            own, base, _ = self._frames.get(name, (Pose(), "", ""))
            if name not in self._frames or base in seen - set(OUTERMOST):
                reason = "is given in itself" if base else "is unknown"
                what = f"frame '{name}' {reason}; the model's frame is used"
                self._report(f"{self._source}: {what}")
                base = MODEL_FRAME
            pose, name = own * pose, base
            seen.add(name)
        return pose

    def carrier(self, name: str) -> str:
        """Return the name at the end of the chain of carriers, which may be unknown."""
        seen = set()
        while name in self._frames and self._frames[name][2] and name not in seen:
            seen.add(name)
            name = self._frames[name][2]
        return name


@dataclass(frozen=True)
class Document:
    """The document that elements stand in.

    Attributes:
        finder: finds the files that it names.
        version: of its SDF.
        depth: the number of includes around it.
        report: logs each warning once.
        materials: those that were read so far.
        frames: of the model; None for poses as they are given.
        inside: the frame that poses are returned in.
    """

    finder: ResourceFinder
    version: tuple[int, ...] = NEWEST
    depth: int = 0
    report: ReportOnce = field(default_factory=ReportOnce)
    materials: MaterialLibrary = field(default_factory=MaterialLibrary)
    frames: Frames | None = None
    inside: str = ""

    def each(self, read: Callable[[Any], Any], parts: Iterable[Any]) -> list[Any]:
        """Return what `read` makes of parts, but for None.

        A part at which it raises a LabError is reported and left out; a missing file is reported
        where it is named first.
        """
        found = []
        for part in parts:
            try:
                found.append(read(part))
            except LabError as error:
                of_file = error.__cause__ if isinstance(error, ResourceError) else None
                self.report(f"{error}; it is left out", str(of_file or error))
        return [one for one in found if one is not None]


class Tag(ElementReader):
    """An element of a document; invalid values are reported, and the defaults are used.

    `file_key` is the key of the file in a <mesh>.
    """

    file_key = "uri"

    def __init__(self, element: Element, source: str, document: Document):
        super().__init__(element, source)
        self.document = document

    @property
    def name(self) -> str:
        """The element's name; empty without one."""
        return self.element.get("name", "")

    def doubt(self, error: LabError) -> None:  # noqa: D102
        self.document.report(f"{error}; the default is used")

    def other(self: AnyTag, element: Element, source: str = "") -> AnyTag:
        """Return the reader of another element of the document."""
        return type(self)(element, source or self.source, self.document)

    def part(self: AnyTag, path: str, source: str = "") -> AnyTag:
        """Return the reader of an element in it, or of an empty one if that is missing."""
        found = self.element.find(path)
        return self.other(Element(path) if found is None else found, source)

    def below(self: AnyTag, element: Element) -> AnyTag:
        """Return the reader of an element in it, which messages name."""
        return self.other(element, f"{self.source}: {element.tag} '{element.get('name', '')}'")

    def named(self: AnyTag, element: Element) -> AnyTag:
        """Return the same; raise XmlError for an element without a name."""
        if not element.get("name"):
            raise XmlError(f"{self.source}: a <{element.tag}> without a name")
        return self.below(element)

    def file(self, uri: str) -> Path:
        """Return the file that a URI means; raise ResourceError."""
        try:
            return self.document.finder.find(uri)
        except ResourceError as error:
            raise ResourceError(f"{self.where(self.file_key)}: {error}") from error

    def shapes(self: AnyTag, kind: str, read: Callable[[AnyTag, Shape], Any]) -> tuple[Any, ...]:
        """Return what `read` makes of the valid visuals or collisions of a link."""

        def whole(element: Element) -> Any:
            holder, where = element.find("geometry"), f"{self.source}: <{kind}>"
            if holder is None or not len(holder):
                raise XmlError(f"{where} without a geometry")
            shape = self.shape(holder[0], where)
            return None if shape is None else read(self.other(element), shape)

        return tuple(self.document.each(whole, self.element.findall(kind)))

    def shape(self, element: Element, where: str) -> Shape | None:
        """Return the shape of a visual or collision, `where` in messages; None if unknown."""
        read = SHAPE_READERS.get(element.tag)
        return None if read is None else read(self.other(element, where))

    def inertia(self, mass: float, moment: float) -> Inertia:
        """Return the inertia in an <inertial>; `moment` is the default of its diagonal, kg m²."""
        defaults = zip(INERTIA_KEYS, 3 * (moment,) + 3 * (0.0,))
        moments = {key: self.number(f"inertia/{key}", default) for key, default in defaults}
        return inertia_at(self.pose(), mass, moments)


def _mesh(tag: Tag) -> Mesh:
    uri, scale, part = tag.text(tag.file_key), tag.scale("scale"), tag.text("submesh/name")
    return Mesh(tag.file(uri), uri, scale, part, tag.boolean("submesh/center", False))


# The measures of shapes are attributes (URDF) or children (SDF) of the same names.
SHAPE_READERS: dict[str, Callable[[Tag], Shape]] = {
    "box": lambda tag: Box(tag.sizes("size", 3)),
    "cylinder": lambda tag: Cylinder(*tag.sizes("radius", 1), *tag.sizes("length", 1)),
    "sphere": lambda tag: Sphere(*tag.sizes("radius", 1)),
    "plane": lambda tag: Plane(tag.direction("normal", "0 0 1"), tag.sizes("size", 2, "1 1")),
    "mesh": _mesh,
}


class SdfTag(Tag):
    """An SDF element."""

    def shape(self, element: Element, where: str) -> Shape | None:  # noqa: D102
        shape = super().shape(element, where)
        if shape is None and element.tag != "empty":
            LOG.warning("%s: geometry <%s> is not simulated", where, element.tag)
        return shape

    def inside(self, frames: Frames, name: str) -> SdfTag:
        """Return the reader of the same element that returns poses in one of the frames."""
        document = replace(self.document, frames=frames, inside=name)
        return SdfTag(self.element, self.source, document)

    def base(self) -> str:
        """Return the frame that its <pose> is given in; empty for the one around it."""
        pose = self.part("pose").element
        return pose.get("relative_to") or pose.get("frame") or ""

    def pose(self) -> Pose:  # noqa: D102
        base, pose = self.base(), super().pose()
        frames, inside = self.document.frames, self.document.inside
        if frames is None or base in ("", inside):
            return pose
        return frames.pose(inside).inverse() * frames.pose(base) * pose


def version_of(root: Element) -> tuple[int, ...]:
    """Return the version of an <sdf>, by default the newest."""
    try:
        return tuple(int(part) for part in root.get("version", "").split("."))
    except ValueError:
        return NEWEST


def plugins_in(parent: Element, link: str = "") -> Iterator[PluginTag]:
    """Yield the plugins in an element and in the sensors below it.

    A sensor without a plugin yields a tag without filename and element.
    """
    for holder in (parent, *parent.findall("sensor")):
        sensor = None if holder is parent else holder
        if sensor is not None and sensor.find("plugin") is None:
            yield PluginTag("", sensor.get("name", ""), {}, link, sensor)
        for element in holder.findall("plugin"):
            tags = {child.tag: (child.text or "").strip() for child in element}
            filename, name = element.get("filename", ""), element.get("name", "")
            yield PluginTag(filename, name, tags, link, sensor, element)


def report_unknown(element: Element, source: str, report: ReportOnce) -> None:
    """Warn once of each kind of element in an <sdf> that is not simulated."""
    read, quiet = SDF_READ[element.tag].split(), SDF_QUIET.get(element.tag, "").split()
    ignored = []
    for child in element:
        if child.tag in SDF_READ and child.tag in read:
            report_unknown(child, source, report)
        elif child.tag not in read and child.tag not in quiet and _has_effect(child):
            name = f"<{child.tag}>"
            if child.tag == "plugin":
                name = f"plugin '{child.get('name', '')}' ({child.get('filename', '')})"
            ignored.append(f"{name} is not simulated")
    if element.tag == "physics" and ignored:
        # Nearly every world has some of these: one line for all of them.
        ignored = [f"{', '.join(ignored)}; the time step is {1.0 / STEPS_PER_SECOND:g} s"]
    for line in ignored:
        report(f"{source}: <{element.tag}>: {line}")


def _has_effect(element: Element) -> bool:
    if element.tag == "plugin" and Path(element.get("filename", "")).stem in SERVER_PLUGINS:
        return False
    if element.tag in ("bounce", "velocity_decay"):
        values = ((child.text or "").strip() for child in element if child.tag != "threshold")
        return any(value.strip("+-0.") for value in values)
    return (element.text or "").strip() not in SDF_DEFAULTS.get(element.tag, ())


def actor_model(actor: Element) -> Element:
    """Return the <model> that stands for an <actor>.

    An actor without links is a figure that stands on the floor: of its poses, only x, y and yaw
    count.
    """
    model = Element("model", dict(actor.attrib))
    model.extend(child for child in actor if child.tag in ("pose", "plugin"))
    links = [copy.deepcopy(link) for link in actor.findall("link")]
    script = Element("plugin", name="path", filename=PATH_PLUGIN)
    script.extend(copy.deepcopy(child) for path in actor.findall("script") for child in path)
    # Without a path, a plugin of its own may move it, or it stands.
    if script.find("trajectory/waypoint") is not None:
        model.append(script)
    elif model.find("plugin") is None:
        SubElement(model, "static").text = "1"
    if not links:
        links = [fromstring(FIGURE)]
        for pose in (*model.findall("pose"), *script.iter("pose")):
            pose.text = _upright(pose.text or "")
    for link in links:
        if link.find("gravity") is None:
            SubElement(link, "gravity").text = "0"
    model.extend(links)
    return model


def _upright(pose: str) -> str:
    """Return the six numbers of a pose with height, roll and pitch 0; other texts unchanged."""
    words = pose.split()
    return " ".join((*words[:2], "0 0 0", words[5])) if len(words) == 6 else pose
