"""Writing models and worlds as SDF 1.6: what was read of them, wherever it came from.

A running world loads again to the same state: its models stand in the file with their present
poses, and how their links move and where their joints are is in its `<state>`, as in worlds that
Gazebo saves.
"""

from __future__ import annotations

import copy
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Set, Tuple, Union
from xml.etree.ElementTree import Element, SubElement, tostring

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.world.description import (
    SEPARATOR,
    WORLD_LINK,
    Collision,
    Joint,
    Light,
    Link,
    Material,
    Mesh,
    Model,
    ModelState,
    PluginTag,
    Snapshot,
    Visual,
    World,
)
from bullet_lab.simulation.world.mesh_parts import has_own_looks
from bullet_lab.simulation.world.resources import package_uri

VERSION = "1.6"
NANOSECONDS = 10**9
INDENT = "  "
# Where a joint that is limited on one side ends on the other, as SDF has it.
FAR = 1e16
NAMESPACE = "robotNamespace"
# What joints to the world are called, after the link that they hold.
ANCHOR = "_to_world"


def world_text(snapshot: Snapshot, folder: Path) -> Tuple[str, List[str]]:
    """Return a world as SDF.

    Args:
        snapshot: the world and where everything is.
        folder: where the file will lie; files below it are named by their path from it.

    Returns:
        The text of the file, and notes on what whoever loads it should know.
    """
    sdf = Element("sdf", version=VERSION)
    world = _add(sdf, "world", _surroundings(snapshot.world), name=snapshot.world.name)
    world.find("physics").attrib.update(name="default", type="ode")
    for light in snapshot.world.lights:
        _add(world, "light", _light(light), name=light.name, type=light.kind)
    uris = _Uris(folder)
    for model, state in snapshot.models:
        _add_model(world, model, _built_at(state), uris)
    _add_state(world, snapshot)
    _indent(sdf)
    text = tostring(sdf, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}\n', uris.notes


def _add(parent: Element, tag: str, content: Any, **attributes: str) -> Element:
    """Add an element with attributes and its content.

    That is, by their tags, the contents of the elements in it; or a text, a truth value, a pose or
    numbers, none of them rounded.
    """
    element = SubElement(parent, tag, attributes)
    if isinstance(content, dict):
        for inner, value in content.items():
            _add(element, inner, value)
        return element
    if isinstance(content, Pose):
        content = (*content.position, *content.rpy())
    if isinstance(content, bool):
        content = "true" if content else "false"
    elif not isinstance(content, str):
        numbers = content if isinstance(content, Iterable) else (content,)
        content = " ".join(repr(float(number)) for number in numbers)
    element.text = content
    return element


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


class _Uris:
    """How a document in a folder can name other files, whatever they were called before."""

    def __init__(self, folder: Path):
        self.notes: List[str] = []
        self._folder = folder.resolve()
        self._uris: Dict[Path, str] = {}

    def of(self, uri: str, path: Path) -> str:
        if uri.startswith(("package://", "model://")):
            return uri
        if path not in self._uris:
            whole = path.resolve()
            self._uris[path] = package_uri(whole) or self._relative(whole)
        return self._uris[path]

    def _relative(self, path: Path) -> str:
        try:
            return str(path.relative_to(self._folder))
        except ValueError:
            self.notes.append(f"{path} lies outside all packages: a world elsewhere cannot use it")
            return path.as_uri()


def _built_at(state: ModelState) -> Pose:
    """Return where a model is built: where its joints to the world are, if there are any."""
    return state.links[WORLD_LINK].pose if WORLD_LINK in state.links else state.pose


def _add_model(parent: Element, model: Model, pose: Pose, uris: _Uris) -> None:
    element = _add(parent, "model", {"pose": pose, "static": model.static}, name=model.name)
    for name, (link, place) in model.frames.items():
        _add(_add(element, "frame", {}, name=name), "pose", place, frame=link)
    for link in model.own_links():
        _add_link(element, link, model, uris)
        if link.anchored:
            ends = {"parent": WORLD_LINK, "child": link.name}
            _add(element, "joint", ends, name=f"{link.name}{ANCHOR}", type="fixed")
    for joint in model.joints:
        # SDF has no continuous joints: they are revolute ones without limits.
        kind = "revolute" if joint.kind == "continuous" else joint.kind
        _add(element, "joint", _joint(joint), name=joint.name, type=kind)
    scopes: Dict[str, Element] = {"": element}
    for plugin in (plugin for plugin in model.plugins if plugin.sensor is None):
        _in_scope(scopes, plugin.scope).append(plugin_element(plugin))


def _in_scope(scopes: Dict[str, Element], scope: str) -> Element:
    """Return the element of a nested model, which holds plugins alone: all else is named fully."""
    if scope not in scopes:
        outer, _, name = scope[: -len(SEPARATOR)].rpartition(SEPARATOR)
        within = _in_scope(scopes, outer + SEPARATOR if outer else "")
        scopes[scope] = _add(within, "model", {}, name=name)
    return scopes[scope]


def _add_link(parent: Element, link: Link, model: Model, uris: _Uris) -> None:
    content: Dict[str, Any] = {"pose": link.pose}
    if link.self_collide:
        content["self_collide"] = True
    if not link.gravity:
        content["gravity"] = False
    if link.inertia is not None:
        centre = Pose(link.inertia.centre)
        moments = {"mass": link.inertia.mass, "inertia": link.inertia.elements()}
        content["inertial"] = {"pose": centre, **moments}
    element = _add(parent, "link", content, name=link.name)
    for name, collision in _named(link.collisions, "collision"):
        content = {**_shape(collision, uris), "surface": _surface(collision)}
        _add(element, "collision", content, name=name)
    for name, visual in _named(link.visuals, "visual"):
        content = _shape(visual, uris)
        if not visual.casts_shadows:
            content["cast_shadows"] = False
        _add_material(_add(element, "visual", content, name=name), visual, uris)
    element.extend(_sensors(link, model))


def _add_material(parent: Element, visual: Visual, uris: _Uris) -> None:
    """Add what a visual looks like, but for what a mesh brings itself."""
    material, shape = visual.material, visual.geometry
    said: Dict[str, Any] = {}
    if material.covers or not (isinstance(shape, Mesh) and has_own_looks(shape)):
        said = {"ambient": material.ambient or visual.colour, "diffuse": visual.colour}
        if material.emissive != Material.emissive:
            said["emissive"] = material.emissive
        if not material.lit:
            said["lighting"] = False
    elif visual.colour[3] < 1.0:
        _add(parent, "transparency", 1.0 - visual.colour[3])
    if not said and not material.name:
        return
    element = _add(parent, "material", said)
    if material.name:
        script = _add(element, "script", {})
        for uri, path in material.scripts:
            _add(script, "uri", uris.of(uri, path))
        _add(script, "name", material.name)


def _named(shapes: Iterable[Any], kind: str) -> Iterator[Tuple[str, Any]]:
    """Yield shapes with names that occur once."""
    taken: Set[str] = set()
    for shape in shapes:
        name, number = shape.name or kind, 0
        while name in taken:
            number += 1
            name = f"{shape.name or kind}_{number}"
        taken.add(name)
        yield name, shape


def _shape(shape: Union[Collision, Visual], uris: _Uris) -> Dict[str, Any]:
    geometry = shape.geometry
    said: Dict[str, Any] = {}
    if isinstance(geometry, Mesh):
        said["uri"] = uris.of(geometry.uri, geometry.path)
        if geometry.submesh:
            said["submesh"] = {"name": geometry.submesh, "center": geometry.centred}
    return {"pose": shape.pose, "geometry": {geometry.tag: {**said, **geometry.measures()}}}


def _surface(collision: Collision) -> Dict[str, Any]:
    cross = collision.cross_friction
    friction: Dict[str, Any] = {"mu": collision.friction}
    friction["mu2"] = collision.friction if cross is None else cross
    if collision.direction is not None:
        friction["fdir1"] = collision.direction
    spring = {"kp": collision.stiffness, "kd": collision.damping}
    said = {tag: value for tag, value in spring.items() if value is not None}
    contact = {"contact": {"ode": said}} if said else {}
    return {"friction": {"ode": friction}, **contact}


def _joint(joint: Joint) -> Dict[str, Any]:
    limits = {"lower": -FAR, "upper": FAR, **joint.limits}
    if joint.kind == "continuous":
        limits.update(lower=-FAR, upper=FAR)
    known = ("lower", "upper", "effort", "velocity")
    axis = {
        "xyz": joint.axis,
        "limit": {key: value for key, value in limits.items() if key in known},
        "dynamics": {"damping": joint.damping, "friction": joint.friction},
    }
    place = {"pose": Pose(joint.anchor)} if any(joint.anchor) else {}
    return {**place, "parent": joint.parent, "child": joint.child, "axis": axis}


def plugin_element(plugin: PluginTag) -> Element:
    """Return a plugin's tag, with all that was in it and the namespace that it was given."""
    if plugin.element is None:
        element = Element("plugin", name=plugin.name, filename=plugin.filename)
        for tag, text in plugin.tags.items():
            _add(element, tag, text)
        return element
    element = copy.deepcopy(plugin.element)
    element.tail = None
    namespace = plugin.tags.get(NAMESPACE, "")
    found = element.find(NAMESPACE)
    if namespace and found is None:
        _add(element, NAMESPACE, namespace)
    elif namespace:
        found.text = namespace
    return element


def _sensors(link: Link, model: Model) -> Iterator[Element]:
    """Yield the sensors of a link, and those of the links that were merged into it."""
    written: Set[int] = set()
    for plugin in model.plugins:
        sensor, holder = plugin.sensor, plugin.link or model.canonical_link().name
        keeper = model.frames[holder][0] if holder in model.frames else holder
        if sensor is None or keeper != link.name or id(sensor) in written:
            continue
        written.add(id(sensor))
        element = copy.deepcopy(sensor)
        element.tail = None
        for old in element.findall("plugin"):
            element.remove(old)
        if holder != keeper:
            # Its pose is given in the frame of the link that it was on.
            pose = element.find("pose")
            pose = _add(element, "pose", "0 0 0 0 0 0") if pose is None else pose
            pose.set("frame", holder)
        element.extend(plugin_element(p) for p in model.plugins if p.sensor is sensor)
        yield element


def _surroundings(world: World) -> Dict[str, Any]:
    return {
        "gravity": world.gravity,
        "physics": {
            "max_step_size": 1.0 / STEPS_PER_SECOND,
            "real_time_factor": "1",
            "real_time_update_rate": str(STEPS_PER_SECOND),
        },
        "scene": {
            "ambient": world.ambient,
            "background": world.background,
            "shadows": world.shadows,
        },
    }


def _light(light: Light) -> Dict[str, Any]:
    content = {
        "pose": light.pose,
        "cast_shadows": light.casts_shadows,
        "diffuse": light.diffuse,
        "direction": light.direction,
        "attenuation": asdict(light.attenuation),
    }
    if light.kind == "spot":
        inner, outer, falloff = astuple(light.cone)
        content["spot"] = {"inner_angle": inner, "outer_angle": outer, "falloff": falloff}
    return content


def _add_state(world: Element, snapshot: Snapshot) -> None:
    seconds, rest = divmod(snapshot.step, STEPS_PER_SECOND)
    time = f"{seconds} {rest * (NANOSECONDS // STEPS_PER_SECOND)}"
    content = {"sim_time": time, "iterations": str(snapshot.step)}
    element = _add(world, "state", content, world_name=snapshot.world.name)
    for model, state in snapshot.models:
        # What never moves stands where its model says.
        if model.static:
            continue
        child = _add(element, "model", {"pose": _built_at(state)}, name=model.name)
        for name, (position, _) in state.joints.items():
            _add(_add(child, "joint", {}, name=name), "angle", position, axis="0")
        for name, link in state.links.items():
            if name == WORLD_LINK:
                continue
            velocity = (*link.linear, *link.angular)
            _add(child, "link", {"pose": link.pose, "velocity": velocity}, name=name)
