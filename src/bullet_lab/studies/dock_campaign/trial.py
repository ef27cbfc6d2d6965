"""One docking of a campaign: run where a worker is, returned as a plain record."""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, Mapping

from bullet_lab.studies.dock_campaign.docking import DockingOutcome, DockingScenario, run_docking
from bullet_lab.studies.dock_campaign.results import DOCKED
from bullet_lab.studies.dock_campaign.scenarios import DrawSettings, draw_scenario
from bullet_lab.studies.workers import in_own_thread

Record = Mapping[str, Any]
Dock = Callable[[DockingScenario], DockingOutcome]

LARGEST_ERRORS = {"distance_error_m": 0.02, "lateral_error_m": 0.01, "yaw_error_deg": 1.0}
"""A robot that says it has docked has, by the simulator's truth, if it is within these."""

WALL_CONTACT, INACCURATE, CRASHED = "wall_contact", "inaccurate", "crashed"


def run_trial(settings: DrawSettings, index: int, dock: Dock = run_docking) -> Record:
    """Run the docking of an index and return its record; never raises what the docking raises.

    It runs in the one thread of this process that draws.
    """
    return in_own_thread(_run_trial, settings, index, dock)


def _run_trial(settings: DrawSettings, index: int, dock: Dock) -> Record:
    scenario = draw_scenario(settings, index)
    try:
        outcome = dock(scenario)
    except Exception as error:  # what broke this docking shall not end the campaign
        return crashed_record(settings, index, f"{type(error).__name__}: {error}")
    return {**_drawn(index, scenario), **_found(outcome)}


def crashed_record(settings: DrawSettings, index: int, why: str) -> Record:
    """Return the record of a docking that came to no end."""
    nothing = dict.fromkeys(_NUMBERS)
    return {
        **_drawn(index, draw_scenario(settings, index)),
        "result": CRASHED,
        "message": " ".join(why.split()),
        **nothing,
    }


_NUMBERS = (
    *("distance_error_m", "lateral_error_m", "yaw_error_deg", "wall_contacts", "retries"),
    *("sim_time_s", "end_x_m", "end_y_m", "end_yaw_deg", "renderer"),
)


def _drawn(index: int, scenario: DockingScenario) -> Dict[str, Any]:
    x, y, yaw = scenario.start
    error_x, error_y, error_yaw = scenario.dock_error
    return {
        "index": index,
        "world": _name_of(scenario.world),
        "light": _name_of(scenario.lighting).replace("docking_", "") or "default",
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
    }


def _name_of(world: str) -> str:
    return world.rsplit("/", 1)[-1].replace(".world", "")


def _found(outcome: DockingOutcome) -> Dict[str, Any]:
    _, x, y, yaw = (float(value) for value in outcome.truth[-1])
    return {
        "result": judge(outcome),
        "message": outcome.message,
        "distance_error_m": float(outcome.distance_error_m),
        "lateral_error_m": float(outcome.lateral_error_m),
        "yaw_error_deg": float(outcome.yaw_error_deg),
        "wall_contacts": int(outcome.wall_contacts),
        "retries": int(outcome.retries),
        "sim_time_s": float(outcome.sim_time_s),
        "end_x_m": x,
        "end_y_m": y,
        "end_yaw_deg": math.degrees(yaw),
        "renderer": outcome.renderer,
    }


def judge(outcome: DockingOutcome) -> str:
    """Return DOCKED, or in a word what went wrong.

    A docking is a success if the robot says so, is right, and has touched nothing.
    """
    if outcome.wall_contacts:
        return WALL_CONTACT
    if not outcome.docked:
        return outcome.error_name.lower()
    within = all(abs(getattr(outcome, name)) <= most for name, most in LARGEST_ERRORS.items())
    return DOCKED if within else INACCURATE
