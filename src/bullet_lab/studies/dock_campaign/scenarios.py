"""Dockings drawn at random: where the robot starts, what it is told, and how well it sees."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.floor_plan import Footprint, footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.studies.dock_campaign.docking import MARKER_POSE, TURNING_RADIUS, DockingScenario

WORLDS = ("docking", "docking_dots", "docking_nested", "docking_decoy")
DOCKS = {"docking_nested": "nested_dock"}
"""Names of docks in the database by worlds; of others it is "dock"."""

LIGHTS = ("default", "dark", "bright", "backlit")
ODOMETRY = ("odom", "noisy_odom")
ROBOT_HEIGHT = 0.55
NEAREST, FARTHEST = 0.7, 5.0
WIDEST = math.radians(60.0)
DATABASE_ERROR = (0.3, 0.3, math.radians(10.0))
LARGEST_ODOMETRY_STD = 0.1
LARGEST_IMAGE_NOISE = 0.02
LARGEST_BLUR = 1.0

_MOST_ATTEMPTS = 10_000


class ScenarioError(LabError):
    """Nothing can be drawn."""


@dataclass(frozen=True)
class DrawSettings:
    """What scenarios are drawn from.

    Attributes:
        seed: of all that is random, >= 0.
        worlds: names of worlds, each as likely as the others.
        lights: of `LIGHTS`, likewise; the world's own is "default".
        odometry: of `ODOMETRY`, likewise.
    """

    seed: int = 1
    worlds: Tuple[str, ...] = WORLDS
    lights: Tuple[str, ...] = LIGHTS
    odometry: Tuple[str, ...] = ODOMETRY

    def __post_init__(self):
        if self.seed < 0:
            raise ScenarioError(f"seed must be an integer >= 0, not {self.seed}")
        for name, known in (("worlds", WORLDS), ("lights", LIGHTS), ("odometry", ODOMETRY)):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ScenarioError(f"{name} must not be empty nor hold a name twice")
            for value in values:
                if value not in known:
                    raise ScenarioError(f"{name}: '{value}' is not one of {', '.join(known)}")


def draw_scenario(settings: DrawSettings, index: int) -> DockingScenario:
    """Return the scenario of an index, which depends on nothing but these two.

    The start's distance from the plane of the back wall is uniform within `NEAREST` to
    `FARTHEST`; its direction as seen from the marker, within `WIDEST` of the dock's axis, and
    its heading are uniform too, drawn again until `TURNING_RADIUS` around it is free. The error
    of the dock's rough pose is uniform within `DATABASE_ERROR`, and so are the standard
    deviations of noise and blur up to their largest.
    """
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
    world = str(rng.choice(settings.worlds))
    light = str(rng.choice(settings.lights))
    odometry = str(rng.choice(settings.odometry))
    error = rng.uniform(-1.0, 1.0, 3) * DATABASE_ERROR
    odometry_std = rng.uniform(0.0, LARGEST_ODOMETRY_STD)
    image_noise = rng.uniform(0.0, LARGEST_IMAGE_NOISE)
    image_blur = rng.uniform(0.0, LARGEST_BLUR)
    odometry_seed, image_seed = rng.integers(2**31, size=2)
    # Last, because it takes as many draws as it takes.
    start = _draw_start(rng, obstacles(world))
    return DockingScenario(
        world=world_uri(world),
        lighting="" if light == "default" else world_uri(f"docking_{light}"),
        start=start,
        dock=DOCKS.get(world, "dock"),
        dock_error=tuple(error.tolist()),
        odometry=odometry,
        odometry_std=float(odometry_std) if odometry == "noisy_odom" else 0.0,
        odometry_seed=int(odometry_seed),
        image_noise=float(image_noise),
        image_blur=float(image_blur),
        image_seed=int(image_seed),
    )


def world_uri(name: str) -> str:
    """Return the URI of a world of the package."""
    return f"package://bullet_lab/worlds/{name}.world"


@functools.lru_cache(maxsize=None)
def obstacles(world: str) -> Tuple[Footprint, ...]:
    """Return what the robot could run into in a world of the package, by its name."""
    found = ResourceFinder.anywhere().find(world_uri(world))
    return footprints(read_world_file(found), below=ROBOT_HEIGHT)


def _draw_start(
    rng: np.random.Generator, walls: Tuple[Footprint, ...]
) -> Tuple[float, float, float]:
    dock_x, dock_y, _ = MARKER_POSE
    distance = rng.uniform(NEAREST, FARTHEST)
    for _ in range(_MOST_ATTEMPTS):
        bearing = rng.uniform(-WIDEST, WIDEST)
        heading = rng.uniform(-math.pi, math.pi)
        x, y = dock_x - distance, dock_y + distance * math.tan(bearing)
        if all(wall.distance((x, y)) > TURNING_RADIUS for wall in walls):
            return x, y, heading
    raise ScenarioError("there is no room for a robot")
