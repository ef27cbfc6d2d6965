"""Writing a running world as an SDF 1.6 file that loads again to the same state.

The models stand in the file with their present poses. How their links move and where their
joints are is in its `<state>`, as in worlds that Gazebo saves.
"""

from __future__ import annotations

from pathlib import Path
from typing import List, Tuple
from xml.etree.ElementTree import Element, SubElement, tostring

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.simulation import Snapshot
from bullet_lab.simulation.world.description import Light, Model, ModelState, World
from bullet_lab.simulation.world.writer import (
    ModelWriter,
    add_flag,
    add_pose,
    add_text,
    indent,
    numbers_text,
)

VERSION = "1.6"
NANOSECONDS = 10**9


def world_text(snapshot: Snapshot, folder: Path) -> Tuple[str, List[str]]:
    """Return a world as SDF.

    Args:
        snapshot: the world and where everything is.
        folder: where the file will lie; meshes below it are named by their path from it.

    Returns:
        The text of the file, and notes on what whoever loads it should know.
    """
    sdf = Element("sdf", version=VERSION)
    world = SubElement(sdf, "world", name=snapshot.world.name)
    _add_surroundings(world, snapshot.world)
    writer = ModelWriter(folder)
    for model, state in snapshot.models:
        world.append(writer.element(model, state.pose))
    world.append(_state(snapshot))
    indent(sdf)
    text = tostring(sdf, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}\n', writer.notes


def _add_surroundings(parent: Element, world: World) -> None:
    add_text(parent, "gravity", numbers_text(world.gravity))
    physics = SubElement(parent, "physics", name="default", type="ode")
    add_text(physics, "max_step_size", repr(STEP_SECONDS))
    add_text(physics, "real_time_factor", "1")
    add_text(physics, "real_time_update_rate", str(STEPS_PER_SECOND))
    scene = SubElement(parent, "scene")
    add_text(scene, "ambient", numbers_text(world.ambient))
    add_text(scene, "background", numbers_text(world.background))
    add_flag(scene, "shadows", world.shadows)
    for light in world.lights:
        _add_light(parent, light)


def _add_light(parent: Element, light: Light) -> None:
    element = SubElement(parent, "light", name=light.name, type=light.kind)
    add_pose(element, light.pose)
    add_flag(element, "cast_shadows", light.casts_shadows)
    add_text(element, "diffuse", numbers_text(light.diffuse))
    add_text(element, "direction", numbers_text(light.direction))
    attenuation = SubElement(element, "attenuation")
    for tag in ("range", "constant", "linear", "quadratic"):
        add_text(attenuation, tag, repr(float(getattr(light.attenuation, tag))))
    if light.kind == "spot":
        spot = SubElement(element, "spot")
        cone = light.cone
        angles = {"inner_angle": cone.inner, "outer_angle": cone.outer, "falloff": cone.falloff}
        for tag, value in angles.items():
            add_text(spot, tag, repr(float(value)))


def _state(snapshot: Snapshot) -> Element:
    element = Element("state", world_name=snapshot.world.name)
    seconds, rest = divmod(snapshot.step, STEPS_PER_SECOND)
    add_text(element, "sim_time", f"{seconds} {rest * (NANOSECONDS // STEPS_PER_SECOND)}")
    add_text(element, "iterations", snapshot.step)
    for model, state in snapshot.models:
        # What never moves stands where its model says.
        if not model.static:
            element.append(_model_state(model, state))
    return element


def _model_state(model: Model, state: ModelState) -> Element:
    element = Element("model", name=model.name)
    add_pose(element, state.pose)
    for name, (position, _) in state.joints.items():
        joint = SubElement(element, "joint", name=name)
        add_text(joint, "angle", repr(float(position)), axis="0")
    for name, link in state.links.items():
        child = SubElement(element, "link", name=name)
        add_pose(child, link.pose)
        add_text(child, "velocity", numbers_text((*link.linear, *link.angular)))
    return element
