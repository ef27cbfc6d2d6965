"""Write models and worlds as SDF 1.6, and read the states of models.

A saved world loads again to the same state. Models have their present poses, and the `<state>`
holds the states of links and joints, as in worlds that Gazebo saves.
"""

from __future__ import annotations

import copy
import logging
import math
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, Mapping
from xml.etree.ElementTree import Element, SubElement, tostring

from bullet_lab.core.pose import Pose, add, cross, dot, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.world.description import (
    NO_LIMIT,
    SEPARATOR,
    WORLD_LINK,
    Collision,
    FrameState,
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
from bullet_lab.simulation.world.xml import ElementReader, XmlError

LOG = logging.getLogger(__name__)

VERSION = "1.6"
NANOSECONDS = 10**9
INDENT = "  "
# Child elements by their tags; None stands for none.
Content = Dict[str, Any]
# SDF has no joints without limits.
UNLIMITED = {"lower": -NO_LIMIT, "upper": NO_LIMIT}
# The elements of a <spot>, in the order of the fields of a `Cone`.
SPOT_KEYS = ("inner_angle", "outer_angle", "falloff")
# The end of the name of a joint to the world, after the name of its link.
ANCHOR = "_to_world"


def world_text(snapshot: Snapshot, folder: Path) -> tuple[str, list[str]]:
    """Return a world as SDF.

    Args:
        snapshot: the world and the states of its models.
        folder: that of the file; files below it get relative paths.

    Returns:
        The text of the file, and notes for the user.
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
    """Add an element with its attributes and its content.

    The content is a `Content`, or a text, a truth value, a pose or numbers. Numbers are not
    rounded.
    """
    element = SubElement(parent, tag, attributes)
    if isinstance(content, dict):
        for inner, value in content.items():
            if value is not None:
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
    """Put each nested element on its own line."""
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
    """Gives the URIs by which a document in a folder can name other files."""

    def __init__(self, folder: Path):
        self.notes: list[str] = []
        self._folder = folder.resolve()
        self._uris: dict[Path, str] = {}

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
    """Return the pose of a model without its motion: that of its joints to the world, if any."""
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
        # SDF has no continuous joints; they are revolute joints without limits.
        kind = "revolute" if joint.kind == "continuous" else joint.kind
        _add(element, "joint", _joint(joint), name=joint.name, type=kind)
    scopes = {"": element}
    for plugin in (plugin for plugin in model.plugins if plugin.sensor is None):
        _in_scope(scopes, plugin.scope).append(plugin_element(plugin))


def _in_scope(scopes: dict[str, Element], scope: str) -> Element:
    """Return the element of a nested model; it only holds plugins, as the rest has full names."""
    if scope not in scopes:
        outer, _, name = scope[: -len(SEPARATOR)].rpartition(SEPARATOR)
        within = _in_scope(scopes, outer + SEPARATOR if outer else "")
        scopes[scope] = _add(within, "model", {}, name=name)
    return scopes[scope]


def _add_link(parent: Element, link: Link, model: Model, uris: _Uris) -> None:
    inertial = link.inertia and {
        "pose": Pose(link.inertia.centre, link.inertia.axes),
        "mass": link.inertia.mass,
        "inertia": link.inertia.elements(link.inertia.axes),
    }
    content = {
        "pose": link.pose,
        "self_collide": True if link.self_collide else None,
        "gravity": None if link.gravity else False,
        "inertial": inertial,
    }
    element = _add(parent, "link", content, name=link.name)
    for name, collision in _named(link.collisions, "collision"):
        content = {**_shape(collision, uris), "surface": _surface(collision)}
        _add(element, "collision", content, name=name)
    for name, visual in _named(link.visuals, "visual"):
        shadows = None if visual.casts_shadows else False
        content = {**_shape(visual, uris), "cast_shadows": shadows}
        _add_material(_add(element, "visual", content, name=name), visual, uris)
    element.extend(_sensors(link, model))


def _add_material(parent: Element, visual: Visual, uris: _Uris) -> None:
    """Add the material of a visual, without what is in the file of a mesh."""
    material, shape = visual.material, visual.geometry
    content: Content = {}
    if material.covers or not (isinstance(shape, Mesh) and has_own_looks(shape)):
        content = {
            "ambient": material.ambient or visual.colour,
            "diffuse": visual.colour,
            "emissive": None if material.emissive == Material.emissive else material.emissive,
            "lighting": None if material.lit else False,
        }
    elif visual.colour[3] < 1.0:
        _add(parent, "transparency", 1.0 - visual.colour[3])
    if not content and not material.name:
        return
    element = _add(parent, "material", content)
    if material.name:
        script = _add(element, "script", {})
        for uri, path in material.scripts:
            _add(script, "uri", uris.of(uri, path))
        _add(script, "name", material.name)


def _named(shapes: Iterable[Any], kind: str) -> Iterator[tuple[str, Any]]:
    """Yield shapes with unique names."""
    taken: set[str] = set()
    for shape in shapes:
        name, number = shape.name or kind, 0
        while name in taken:
            number += 1
            name = f"{shape.name or kind}_{number}"
        taken.add(name)
        yield name, shape


def _shape(shape: Collision | Visual, uris: _Uris) -> Content:
    geometry = shape.geometry
    content: Content = {}
    if isinstance(geometry, Mesh):
        content["uri"] = uris.of(geometry.uri, geometry.path)
        if geometry.submesh:
            content["submesh"] = {"name": geometry.submesh, "center": geometry.centred}
    return {"pose": shape.pose, "geometry": {geometry.tag: {**content, **geometry.measures()}}}


def _surface(collision: Collision) -> Content:
    mu, cross, direction = collision.friction, collision.cross_friction, collision.direction
    friction = {"mu": mu, "mu2": mu if cross is None else cross, "fdir1": direction}
    spring = {"kp": collision.stiffness, "kd": collision.damping}
    is_hard = collision.stiffness is None and collision.damping is None
    return {"friction": {"ode": friction}, "contact": None if is_hard else {"ode": spring}}


def _joint(joint: Joint) -> Content:
    limits = {**UNLIMITED, **joint.limits, **(UNLIMITED if joint.kind == "continuous" else {})}
    axis = {
        "xyz": joint.axis,
        "limit": limits,
        "dynamics": {"damping": joint.damping, "friction": joint.friction},
    }
    place = Pose(joint.anchor) if any(joint.anchor) else None
    return {"pose": place, "parent": joint.parent, "child": joint.child, "axis": axis}


def plugin_element(plugin: PluginTag) -> Element:
    """Return a plugin's tag with all its content, and what it was given besides."""
    if plugin.element is None:
        element = Element("plugin", name=plugin.name, filename=plugin.filename)
    else:
        element = _copied(plugin.element)
    written = {child.tag for child in element}
    for tag, text in plugin.tags.items():
        if tag not in written:
            _add(element, tag, text)
    return element


def _copied(element: Element) -> Element:
    element = copy.deepcopy(element)
    element.tail = None
    return element


def _sensors(link: Link, model: Model) -> Iterator[Element]:
    """Yield the sensors of a link and of the links that were merged into it."""
    written: set[int] = set()
    for plugin in model.plugins:
        sensor, holder = plugin.sensor, plugin.link or model.canonical_link().name
        base = model.frames[holder][0] if holder in model.frames else holder
        if sensor is None or base != link.name or id(sensor) in written:
            continue
        written.add(id(sensor))
        element = _copied(sensor)
        for old in element.findall("plugin"):
            element.remove(old)
        if holder != base:
            # Its pose is in the frame of the merged link.
            pose = element.find("pose")
            pose = _add(element, "pose", "0 0 0 0 0 0") if pose is None else pose
            pose.set("frame", holder)
        own = (p for p in model.plugins if p.sensor is sensor and not p.is_bare_sensor)
        element.extend(map(plugin_element, own))
        yield element


def _surroundings(world: World) -> Content:
    return {
        "gravity": world.gravity,
        "physics": {
            "max_step_size": 1.0 / STEPS_PER_SECOND,
            "real_time_factor": "1",
            "real_time_update_rate": str(STEPS_PER_SECOND),
            "ode": {"solver": {"friction_model": "cone_model"}} if world.coulomb else None,
        },
        "scene": {
            "ambient": world.ambient,
            "background": world.background,
            "shadows": world.shadows,
        },
    }


def _light(light: Light) -> Content:
    return {
        "pose": light.pose,
        "cast_shadows": light.casts_shadows,
        "diffuse": light.diffuse,
        "specular": light.specular,
        "direction": light.direction,
        "attenuation": asdict(light.attenuation),
        "spot": dict(zip(SPOT_KEYS, astuple(light.cone))) if light.kind == "spot" else None,
    }


def _add_state(world: Element, snapshot: Snapshot) -> None:
    seconds, rest = divmod(snapshot.step, STEPS_PER_SECOND)
    time = f"{seconds} {rest * (NANOSECONDS // STEPS_PER_SECOND)}"
    content = {"sim_time": time, "iterations": str(snapshot.step)}
    element = _add(world, "state", content, world_name=snapshot.world.name)
    for model, state in snapshot.models:
        # A static model has no state.
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


def read_states(element: Element, models: Iterable[Model], source: str) -> dict[str, ModelState]:
    """Return the states of a world's models in a saved `<state>`, by their names."""
    known = {model.name: model for model in models}
    states: dict[str, ModelState] = {}
    for child in element.findall("model"):
        name = child.get("name", "")
        where = f"{source}: state of model '{name}'"
        if name not in known:
            LOG.warning("%s: unknown model", where)
            continue
        try:
            states[name] = _model_state(child, known[name], where)
        except XmlError as error:
            LOG.warning("%s; the model keeps its initial state", error)
    return states


def _model_state(element: Element, model: Model, source: str) -> ModelState:
    present = model.links_by_name()
    links: dict[str, FrameState] = {}
    for name, child in _in_state(element, "link"):
        if name in present:
            tag = ElementReader(child, f"{source}: link '{name}'")
            values = tag.numbers("velocity", 6, "0 0 0 0 0 0")
            links[name] = FrameState(tag.pose(), values[:3], values[3:])
    if WORLD_LINK in present:
        links[WORLD_LINK] = FrameState(model.pose)
    positions = {
        name: ElementReader(child, source).number("angle")
        for name, child in _in_state(element, "joint")
    }
    joints = {}
    for joint in model.joints:
        if joint.kind != "ball":
            position, rate = _joint_state(joint, links)
            joints[joint.name] = (positions.get(joint.name, position), rate)
    return ModelState(ElementReader(element, source).pose(), links, joints)


def _in_state(element: Element, tag: str, scope: str = "") -> Iterator[tuple[str, Element]]:
    """Yield the links or joints of a state by their full names, with those of nested models."""
    for child in element.findall(tag):
        yield scope + child.get("name", ""), child
    for nested in element.findall("model"):
        yield from _in_state(nested, tag, f"{scope}{nested.get('name', '')}{SEPARATOR}")


def _joint_state(joint: Joint, links: Mapping[str, FrameState]) -> tuple[float, float]:
    """Return position (rad or m) and velocity of a joint, from the states of its links."""
    if joint.parent not in links or joint.child not in links:
        return 0.0, 0.0
    parent, child = links[joint.parent], links[joint.child]
    moved = (parent.pose * joint.pose).inverse() * child.pose
    axis = child.pose.rotate(joint.axis)
    if joint.kind == "prismatic":
        arm = subtract(child.pose.position, parent.pose.position)
        carried = add(parent.linear, cross(parent.angular, arm))
        return dot(joint.axis, moved.position), dot(axis, subtract(child.linear, carried))
    *turn, w = moved.quaternion
    angle = math.remainder(2.0 * math.atan2(dot(joint.axis, turn), w), math.tau)
    return angle, dot(axis, subtract(child.angular, parent.angular))
