"""Worlds of the package and their lights, by name."""

from __future__ import annotations

import functools
from dataclasses import replace

from bullet_lab.simulation.world.description import World
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file

ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"

DEFAULT_LIGHT = "default"
LIGHTS = (DEFAULT_LIGHT, "dark", "bright", "backlit")
"""Names of lights. A world keeps its own light by default; the others are those of the worlds
`docking_dark` and so on."""


@functools.lru_cache
def read_world(name: str) -> World:
    """Return a world of the package; raises LabError."""
    uri = f"package://bullet_lab/worlds/{name}.world"
    return read_world_file(ResourceFinder.anywhere().find(uri))


def lit_world(name: str, light: str) -> World:
    """Return a world of the package in one of `LIGHTS`; raises LabError."""
    world = read_world(name)
    if light == DEFAULT_LIGHT:
        return world
    other = read_world(f"docking_{light}")
    return replace(world, lights=other.lights, ambient=other.ambient, background=other.background)
