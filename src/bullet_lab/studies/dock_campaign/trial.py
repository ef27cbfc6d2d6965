"""A docking of a campaign: a random scenario, run by a worker, and its record."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Callable, Dict, Tuple

import numpy as np

from bullet_lab.core.parameters import choice, choices, integer
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.controllers import CONTROLLERS
from bullet_lab.docking.types import DockingError
from bullet_lab.docking.verdict import ERRORS, judge, largest_errors
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import Footprint, footprints
from bullet_lab.studies.dock_campaign.docking import (
    MARKER_POSE,
    TURNING_RADIUS,
    DockingOutcome,
    DockingScenario,
    dock_of,
    run_docking,
)
from bullet_lab.studies.dock_campaign.stress import (
    STRESSES,
    draw_stress,
    found_columns,
    stress_columns,
)
from bullet_lab.studies.results import Record
from bullet_lab.studies.study import MOST_SEED, Settings
from bullet_lab.studies.worlds import LIGHTS, read_world

WORLDS = ("docking", "docking_dots", "docking_nested", "docking_decoy")
DOCKS = {"docking_nested": "nested_dock"}
"""Names of docks in the database by world; in other worlds it is "dock"."""

ODOMETRY = ("odom", "noisy_odom")
NONE, ALL, EACH = "none", "all", "each"
ROBOT_HEIGHT = 0.55
NEAREST, FARTHEST = 0.7, 5.0
WIDEST = math.radians(60.0)
DATABASE_ERROR = (0.3, 0.3, math.radians(10.0))
DOCK_MODEL = "docking_station"
UNKNOWN_CLEARANCE = 1.0
LARGEST_ODOMETRY_STD = 0.1
LARGEST_IMAGE_NOISE = 0.02
LARGEST_BLUR = 1.0

_MOST_ATTEMPTS = 10_000


class ScenarioError(LabError):
    """No scenario can be drawn."""


@dataclass(frozen=True)
class DrawSettings(Settings):
    """Values that scenarios are drawn from, each with equal probability."""

    seed: int = integer(1, "seed of all that is random", 0, MOST_SEED)
    worlds: Tuple[str, ...] = choices(WORLDS, "worlds to draw from", WORLDS)
    lights: Tuple[str, ...] = choices(
        LIGHTS, "lights to draw from; default is the world's own", LIGHTS
    )
    odometry: Tuple[str, ...] = choices(ODOMETRY, "odometry to draw from", ODOMETRY)
    controller: str = choice(
        "ours", "the controller under test; it does not change the random draws", [*CONTROLLERS]
    )
    stress: Tuple[str, ...] = choices(
        (NONE,),
        "perturbations to apply together; each: one campaign for each of them, and for all",
        (NONE, ALL, EACH, *STRESSES),
    )

    @property
    def stresses(self) -> Tuple[str, ...]:
        """Names of the stresses that are drawn."""
        return tuple(STRESSES) if ALL in self.stress else self.stress


def draw_scenario(settings: DrawSettings, index: int) -> DockingScenario:
    """Return the scenario of an index, which depends on the settings and the index only.

    The start's distance from the plane of the back wall is uniform within `NEAREST` to
    `FARTHEST`. Its direction from the marker, within `WIDEST` of the dock's axis, and its heading
    are uniform too. They are drawn again until the robot is `TURNING_RADIUS` away from the dock,
    and `UNKNOWN_CLEARANCE` away from other obstacles, as it does not know of them and has no
    laser. The error of the dock's rough pose is uniform within `DATABASE_ERROR`, and so are the
    standard deviations of noise and blur up to their largest values.
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
    # Last, because its number of draws varies.
    start = _draw_start(rng, obstacles(world))
    return DockingScenario(
        world=world,
        light=light,
        start=start,
        dock=DOCKS.get(world, "dock"),
        dock_error=tuple(error.tolist()),
        odometry=odometry,
        odometry_std=float(odometry_std) if odometry == "noisy_odom" else 0.0,
        odometry_seed=int(odometry_seed),
        image_noise=float(image_noise),
        image_blur=float(image_blur),
        image_seed=int(image_seed),
        controller=settings.controller,
        stress=draw_stress(settings.stresses, settings.seed, index),
    )


@functools.lru_cache(maxsize=None)
def obstacles(world: str) -> Tuple[Footprint, ...]:
    """Return the obstacles of the robot in a world of the package, by its name."""
    return footprints(read_world(world), below=ROBOT_HEIGHT)


def _draw_start(rng: np.random.Generator, walls: Tuple[Footprint, ...]) -> PlanarPose:
    dock_x, dock_y, _ = MARKER_POSE
    distance = rng.uniform(NEAREST, FARTHEST)
    for _ in range(_MOST_ATTEMPTS):
        bearing = rng.uniform(-WIDEST, WIDEST)
        heading = rng.uniform(-math.pi, math.pi)
        x, y = dock_x - distance, dock_y + distance * math.tan(bearing)
        if all(wall.distance((x, y)) > _clearance(wall) for wall in walls):
            return x, y, heading
    raise ScenarioError(f"{_MOST_ATTEMPTS} draws found no start with enough room for a robot")


def _clearance(wall: Footprint) -> float:
    return TURNING_RADIUS if wall.name == DOCK_MODEL else UNKNOWN_CLEARANCE


CRASHED = "crashed"
"""Result of a docking that did not end, beside those of `judge`."""

TOLERANCES = {name: name.replace("error", "tolerance") for name in ERRORS}
"""Names of the columns with the dock's own tolerances, by those of the errors."""

COSTS = {name: name.replace("error", "cost") for name in ERRORS}
"""Names of the columns with the cost of the stress, which is added to the tolerance."""


def run_trial(
    settings: DrawSettings,
    index: int,
    dock: Callable[[DockingScenario], DockingOutcome] = run_docking,
) -> Record:
    """Run the docking of an index and return its record; an error becomes a crashed record."""
    scenario = draw_scenario(settings, index)
    try:
        outcome = dock(scenario)
    except Exception as error:  # one docking must not end the campaign
        return crashed_record(settings, index, f"{type(error).__name__}: {error}")
    x, y, yaw = (float(value) for value in outcome.end)
    errors = {name: float(getattr(outcome, name)) for name in ERRORS}
    known = dock_of(scenario)
    tolerance = scenario.stress.allowed(known.tolerance, known.docked_distance)
    reported = DockingError[outcome.error_name]
    return {
        **_drawn(index, scenario),
        "result": judge(reported, errors, tolerance, outcome.wall_contacts),
        "message": outcome.message,
        **errors,
        "wall_contacts": int(outcome.wall_contacts),
        "retries": int(outcome.retries),
        "sim_time_s": float(outcome.sim_time_s),
        "end_x_m": x,
        "end_y_m": y,
        "end_yaw_deg": math.degrees(yaw),
        "renderer": outcome.renderer,
        **found_columns(outcome.calibration),
    }


_MEASURED = (
    *(*ERRORS, "wall_contacts", "retries"),
    *("sim_time_s", "end_x_m", "end_y_m", "end_yaw_deg", "renderer"),
    *found_columns(None),
)


def crashed_record(settings: DrawSettings, index: int, why: str) -> Record:
    """Return the record of a docking that did not end."""
    drawn, message = _drawn(index, draw_scenario(settings, index)), " ".join(why.split())
    return {**drawn, "result": CRASHED, "message": message, **dict.fromkeys(_MEASURED)}


def _drawn(index: int, scenario: DockingScenario) -> Dict[str, Any]:
    x, y, yaw = scenario.start
    error_x, error_y, error_yaw = scenario.dock_error
    dock = dock_of(scenario)
    return {
        "index": index,
        "world": scenario.world,
        "light": scenario.light,
        "start_x_m": x,
        "start_y_m": y,
        "start_yaw_deg": math.degrees(yaw),
        "database_error_x_m": error_x,
        "database_error_y_m": error_y,
        "database_error_yaw_deg": math.degrees(error_yaw),
        "odometry": scenario.odometry,
        "odometry_std": scenario.odometry_std,
        "image_noise": scenario.image_noise,
        "image_blur_px": scenario.image_blur,
        **{TOLERANCES[name]: value for name, value in largest_errors(dock.tolerance).items()},
        **stress_columns(scenario.stress),
        **dict(zip(COSTS.values(), scenario.stress.costs(dock.docked_distance))),
    }
