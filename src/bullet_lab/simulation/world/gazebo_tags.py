"""What Gazebo's own tags ask for, and which tags of its documents are not simulated.

These are the names of its materials, `<plugin>` and `<gazebo>`. What is not simulated is said once
each by name.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator
from xml.etree.ElementTree import Element

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.world.description import WHITE, Link, Model, PluginTag
from bullet_lab.simulation.world.materials import MaterialLibrary
from bullet_lab.simulation.world.report import ReportOnce, leaving_out
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.xml import TagReader


def plugins_in(parent: Element, link: str = "") -> Iterator[PluginTag]:
    """Yield the plugins that stand in an element or in the sensors below it."""
    for holder in (parent, *parent.findall("sensor")):
        sensor = None if holder is parent else holder
        for element in holder.findall("plugin"):
            tags = {child.tag: (child.text or "").strip() for child in element}
            filename, name = element.get("filename", ""), element.get("name", "")
            yield PluginTag(filename, name, tags, link, sensor, element)


# Of a `<gazebo reference=…>`: Coulomb's coefficients, and N/m and N s/m of the link's contacts.
FRICTION = {"mu1": "friction", "mu2": "cross_friction"}
SPRING = {"kp": "stiffness", "kd": "damping"}
# Whether gravity pulls the link, and what says that with the sense turned round.
GRAVITY = {"gravity": True, "turnGravityOff": False}
LINK_TAGS = frozenset((*FRICTION, *SPRING, *GRAVITY, "fdir1", "material", "selfCollide"))
# Read elsewhere, or for the eye alone.
QUIET_TAGS = frozenset(("plugin", "sensor", "visualize", "visual"))
# How ODE computes, which is its own business.
QUIET_TAGS |= frozenset(("minDepth", "maxVel", "maxContacts"))
QUIET_TAGS |= frozenset(("provideFeedback", "implicitSpringDamper"))


class _LinkTag(TagReader):
    """Reads both spellings of a tag's `value`, as Gazebo does: <mu1>1</mu1>, <mu1 value="1"/>."""

    def __init__(self, element: Element, where: str):
        self._element = element
        self._where = where

    def text(self, key: str, default: str = "") -> str:
        return (self._element.get(key) or self._element.text or "").strip()

    def where(self, key: str) -> str:
        return self._where


class GazeboTags:
    """The `<gazebo>` elements of a URDF document: what Gazebo is told of its links.

    References to nothing but the names of links and joints in `references` are reported, too, and
    tags that make no sense. `static` is what is said of the whole robot. `materials` knows what
    the names of materials mean, and `finder` where their scripts are.
    """

    def __init__(
        self,
        elements: Iterable[Element],
        references: Iterable[str],
        source: str,
        materials: MaterialLibrary,
        finder: ResourceFinder,
    ):
        self._source, self._materials, self._finder = source, materials, finder
        self._report = ReportOnce()
        # By link: fields of its collisions, and its `look` and `self_collide`.
        self._told: Dict[str, Dict[str, Any]] = {}
        self.static = False
        known = set(references)
        for element in elements:
            name = element.get("reference")
            if name is None:
                for child in element.findall("static"):
                    with leaving_out(self._report):
                        self.static = self._tag(child, "robot").boolean("value", False)
                self._report_unknown(element, frozenset(("static",)))
                continue
            if name not in known:
                self._report(f"<gazebo reference='{name}'>: there is no such link or joint")
            for child in element:
                with leaving_out(self._report):
                    self._read(child, self._told.setdefault(name, {}), name)
            self._report_unknown(element, LINK_TAGS)

    def apply(self, link: Link) -> Link:
        """Return a link as Gazebo would have it."""
        told = dict(self._told.get(link.name, {}))
        cross = told.get("cross_friction")
        if cross is not None and "direction" not in told:
            mu = told.setdefault("friction", cross)
            if mu != cross:
                where = f"{self._source}: <mu2> of '{link.name}'"
                said = f"without <fdir1>, friction has one coefficient here, <mu1>: {mu:g}"
                self._report(f"{where}: {said}")
        look = told.pop("look", None)
        told.pop("gravity", None)
        link = replace(link, self_collide=told.pop("self_collide", link.self_collide))
        if look is not None:
            colour, material = look
            painted = (replace(v, colour=colour, material=material) for v in link.visuals)
            link = replace(link, visuals=tuple(painted))
        return replace(link, collisions=tuple(replace(c, **told) for c in link.collisions))

    def weigh(self, model: Model) -> Model:
        """Return a model, with its links merged, whose links gravity pulls or not.

        As in Gazebo, the last of what was merged into one that says so decides for all of it.
        """
        links = []
        for link in model.links:
            merged = (name for name, (keeper, _) in model.frames.items() if keeper == link.name)
            names = [name for name in (link.name, *merged) if "gravity" in self._told.get(name, {})]
            pulled = not names or self._told[names[-1]]["gravity"]
            if not pulled and names[-1] != link.name:
                what = f"'{names[-1]}', which is fixed to '{link.name}', turns gravity off"
                self._report(f"{self._source}: {what} for both")
            links.append(replace(link, gravity=pulled))
        return replace(model, links=tuple(links))

    def _tag(self, child: Element, part: str) -> _LinkTag:
        return _LinkTag(child, f"{self._source}: <{child.tag}> of '{part}'")

    def _read(self, child: Element, told: Dict[str, Any], link: str) -> None:
        tag = self._tag(child, link)
        where = tag.where("value")
        if child.tag in FRICTION:
            told[FRICTION[child.tag]] = tag.friction("value", 1.0)
        elif child.tag in SPRING:
            told[SPRING[child.tag]] = tag.coefficient("value", 0.0)
        elif child.tag in GRAVITY:
            told["gravity"] = tag.boolean("value", False) == GRAVITY[child.tag]
        elif child.tag == "fdir1":
            if any(tag.numbers("value", 3)):
                told["direction"] = tag.direction("value", "")
        elif child.tag == "selfCollide":
            told["self_collide"] = tag.boolean("value", False)
        elif child.tag == "material":
            look = self._materials.named(tag.text("value"), where, self._finder)
            if look is not None:
                told["look"] = look
        elif child.tag == "visual" and child.find("material") is not None:
            # As it would stand in SDF.
            element = child.find("material")
            colour, look = self._materials.of_element(element, where, self._finder, WHITE)
            if look.covers:
                told["look"] = (colour, look)

    def _report_unknown(self, element: Element, known: Iterable[str]) -> None:
        for child in element:
            is_as_it_is = (child.text or "").strip() in URDF_AS_IT_IS.get(child.tag, ())
            if child.tag not in QUIET_TAGS and child.tag not in known and not is_as_it_is:
                self._report(f"{self._source}: <gazebo>: <{child.tag}> is not simulated")


# The elements that are looked into, and what is read of each.
SDF_READ = {
    "sdf": {"world", "model", "light", "include"},
    "world": {"model", "light", "include", "gravity", "scene", "state", "physics"},
    "model": {"link", "joint", "plugin", "pose", "static", "frame", "include", "model"},
    "link": {"pose", "inertial", "visual", "collision", "sensor", "plugin"}
    | {"self_collide", "gravity"},
    "visual": {"geometry", "pose", "material", "cast_shadows", "transparency"},
    "collision": {"geometry", "pose", "surface"},
    "joint": {"parent", "child", "pose", "axis", "axis2"},
    "surface": {"friction", "contact"},
    "physics": {"gravity"},
}
# What Gazebo writes into every world that it saves, or what changes nothing that can be seen here.
SDF_QUIET = {
    "world": {"gui", "atmosphere", "wind", "magnetic_field", "spherical_coordinates", "audio"},
    "model": {"allow_auto_disable"},
    "link": {"must_be_base_link"},
    "visual": {"meta", "laser_retro"},
    "collision": {"max_contacts", "laser_retro"},
    "joint": {"physics", "sensor"},
    # How Gazebo's engines compute is their own business.
    "physics": {"ode", "bullet", "simbody", "dart", "max_contacts", "real_time_factor"},
}
# Texts that ask for what happens anyway.
URDF_AS_IT_IS = {
    "static": ("0", "false"),
}
SDF_AS_IT_IS = {
    "kinematic": ("0", "false"),
    "enable_wind": ("0", "false"),
    "self_collide": ("0", "false"),
    "transparency": ("0", "0.0"),
    "max_step_size": ("0.001", "1e-3", "1e-03"),
    "real_time_update_rate": ("1000", "1000.0"),
}


# Plugins of worlds and of the server that give Gazebo its ROS interface, which the bridge has.
SERVER_PLUGINS = ("libgazebo_ros_api_plugin", "libgazebo_ros_paths_plugin", "libgazebo_ros")


def report_unknown(element: Element, source: str, report: ReportOnce) -> None:
    """Warn of each kind of tag in an <sdf> that is not simulated; `source` names the document."""
    read, quiet = SDF_READ[element.tag], SDF_QUIET.get(element.tag, ())
    unread = []
    for child in element:
        if child.tag in SDF_READ and child.tag in read:
            report_unknown(child, source, report)
        elif child.tag not in read and child.tag not in quiet and _asks_for_something(child):
            name = f"<{child.tag}>"
            if child.tag == "plugin":
                name = f"plugin '{child.get('name', '')}' ({child.get('filename', '')})"
            unread.append(f"{name} is not simulated")
    if element.tag == "physics" and unread:
        # Nearly every world has some of these: one line for all of them.
        unread = [f"{', '.join(unread)}; the time step is {1.0 / STEPS_PER_SECOND:g} s"]
    for line in unread:
        report(f"{source}: <{element.tag}>: {line}")


def _asks_for_something(element: Element) -> bool:
    if element.tag == "plugin" and Path(element.get("filename", "")).stem in SERVER_PLUGINS:
        return False
    if element.tag in ("bounce", "velocity_decay"):
        said = ((child.text or "").strip() for child in element if child.tag != "threshold")
        return any(word.strip("+-0.") for word in said)
    return (element.text or "").strip() not in SDF_AS_IT_IS.get(element.tag, ())
