"""Random robots, each calibrated by squares: how well injected errors are recovered."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

import numpy as np

from bullet_lab.core.figures import save
from bullet_lab.core.files import write_json
from bullet_lab.core.parameters import boolean, integer
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.study import SUMMARY, Settings, Tell, progress, whole_results, write_table
from bullet_lab.studies.umbmark.benchmark import Benchmark, DriveSettings
from bullet_lab.studies.umbmark.drives import Robot, drive_square
from bullet_lab.studies.umbmark.estimate import PARAMETERS
from bullet_lab.studies.umbmark.figures import campaign_figure
from bullet_lab.studies.umbmark.robots import IdealRobot, Wheels
from bullet_lab.studies.umbmark.runs import DIRECTIONS
from bullet_lab.studies.workers import Run as RunTasks
from bullet_lab.studies.workers import TaskLostError

DIAMETER_ERRORS = (0.001, 0.01)
BASE_ERRORS = (0.005, 0.03)
BASES = (0.15, 0.8)
SIDES = (1.0, 6.0)
FLOOR_SIDES = (1.0, 2.0)
SPEEDS = (0.1, 0.5)
TURN_SPEEDS = (0.3, 1.0)
DIAMETER = 0.2

SHARE, LEAST = 0.05, 2e-5
"""An error counts as recovered within this share of itself, or within this, whichever is more."""

Record = Dict[str, Any]


@dataclass(frozen=True)
class CampaignSettings(Settings):
    """Random robots instead of one."""

    robots: int = integer(0, "random robots instead of one; 0: the one", 0, 100_000)
    floor: bool = boolean(False, "drive them on the floor; else wheels roll ideally")


@dataclass(frozen=True)
class RandomRobot:
    """A robot of a campaign: what it drives, and its base (m), as believed."""

    drive: DriveSettings
    base: float


def draw_robot(drive: DriveSettings, floor: bool, index: int) -> RandomRobot:
    """Return the robot of an index; it depends on nothing but seed and index.

    Sizes of errors are uniform within `DIAMETER_ERRORS` and `BASE_ERRORS`, their signs as likely
    as not; base, side and speeds are uniform too. On the floor it is always the robot of the
    settings, at its speeds.
    """
    generator = np.random.default_rng(np.random.SeedSequence(drive.seed, spawn_key=(index,)))
    sizes = [generator.uniform(*limits) for limits in (DIAMETER_ERRORS, BASE_ERRORS)]
    signs = generator.choice((-1.0, 1.0), 2)
    base, share, speed, turn_speed = (
        generator.uniform(*limits) for limits in (BASES, (0.0, 1.0), SPEEDS, TURN_SPEEDS)
    )
    shortest, longest = FLOOR_SIDES if floor else SIDES
    errors = dict(zip(PARAMETERS, (signs * sizes).tolist()))
    seed, side = int(generator.integers(2**31)), float(shortest + share * (longest - shortest))
    drawn = replace(drive, **errors, seed=seed, side=side)
    if not floor:
        drawn = replace(drawn, speed=float(speed), turn_speed=float(turn_speed))
    return RandomRobot(drawn, float(base))


def calibrate_robot(drive: DriveSettings, floor: bool, index: int) -> Record:
    """Calibrate a random robot, and return what came of it.

    Without noise a square each way is driven, as all others would be the same; once more with the
    correction, and on the floor once without errors. With noise, the squares of the settings.
    """
    robot = draw_robot(drive, floor, index)
    still = replace(robot.drive, std=0.0, runs=1)
    right = SystematicErrors()
    if floor:
        nothing = replace(still, diameter_error=0.0, base_error=0.0)
        right = _benchmark(robot, nothing, floor, right).estimate.errors
    before = _benchmark(robot, still, floor, SystematicErrors())
    after = _benchmark(robot, still, floor, before.estimate.errors)
    noisy = _benchmark(robot, robot.drive, floor, SystematicErrors()).estimate.beside(right)
    found_still = before.estimate.beside(right).errors
    record: Record = {"robot": index, "side_m": still.side, "base_m": before.base}
    for name, closed in zip(PARAMETERS, (before.figures.e_d, before.figures.e_b)):
        injected = getattr(still, name)
        found = getattr(found_still, name)
        low, high = (noisy.intervals or {}).get(name, (None, None))
        record.update(
            {
                name: injected,
                f"{name}_closed_form": closed - 1.0,
                f"{name}_found": found,
                f"{name}_recovered": abs(found - injected) <= max(SHARE * abs(injected), LEAST),
                f"{name}_with_noise": getattr(noisy.errors, name),
                f"{name}_low": low,
                f"{name}_high": high,
                f"{name}_held": low is not None and noisy.holds(name, injected),
            }
        )
    record["e_max_syst_m"] = before.figures.e_max_syst
    record["e_max_syst_after_m"] = after.figures.e_max_syst
    return record


def _benchmark(
    robot: RandomRobot, drive: DriveSettings, floor: bool, correction: SystematicErrors
) -> Benchmark:
    runs, base = [], robot.base
    for number in range(len(DIRECTIONS) * drive.runs):
        direction = DIRECTIONS[number % len(DIRECTIONS)]
        one: Any = _robot(robot.base, drive, floor, correction)
        try:
            square, noise = drive.square(direction), drive.noise(number, 0)
            runs.append(drive_square(one, square, f"{direction} {number}", noise))
            base = one.believed.base
        finally:
            one.close()
    return Benchmark.of(runs, base, drive.side)


def _robot(
    base: float, drive: DriveSettings, floor: bool, correction: SystematicErrors
) -> Robot:
    if floor:
        return drive.plan.build(drive.errors, correction)
    believed = Wheels(DIAMETER, DIAMETER, base)
    return IdealRobot(believed.times(drive.errors), believed.times(correction))


def run_campaign(
    folder: Path, drive: DriveSettings, campaign: CampaignSettings, run: RunTasks, tell: Tell
) -> Mapping[str, Any]:
    """Calibrate random robots; leave campaign.csv, campaign.png and summary.json; return that.

    Raises:
        LabError: a robot cannot be driven, or the folder not be written to.
    """
    task = functools.partial(calibrate_robot, drive, campaign.floor)
    found: Dict[int, Record] = {}
    with progress("calibrating", campaign.robots, tell, unit="robot", things=" robots") as note:
        for index, record in run(task, range(campaign.robots)):
            if isinstance(record, TaskLostError):
                raise record
            found[index] = record
            note()
    records = [found[index] for index in range(campaign.robots)]
    summary = {"job": "umbmark", **asdict(drive), **asdict(campaign), **campaign_summary(records)}
    with whole_results(folder) as part:
        write_table(part / "campaign.csv", [records[0], *(r.values() for r in records)])
        save(campaign_figure(records), part / "campaign.png")
        write_json(part / SUMMARY, summary)
    return summary


def campaign_summary(records: Sequence[Record]) -> Record:
    """Return what the records of a campaign come down to."""
    ends = [(record["e_max_syst_m"], record["e_max_syst_after_m"]) for record in records]
    falls = [before / after for before, after in ends if after > 0.0]
    summary: Record = {"finished": True, "least_fall": min(falls, default=None)}
    for name in PARAMETERS:
        misses = [abs(r[f"{name}_found"] - r[name]) for r in records]
        closed = [abs(r[f"{name}_closed_form"] - r[name]) / abs(r[name]) for r in records]
        summary[name] = {
            "recovered": sum(r[f"{name}_recovered"] for r in records),
            "largest_miss": max(misses),
            "largest_relative_miss": max(m / abs(r[name]) for m, r in zip(misses, records)),
            "largest_relative_miss_of_closed_form": max(closed),
            "held_by_interval": sum(r[f"{name}_held"] for r in records),
        }
    return summary


def describe_campaign(records: int, summary: Mapping[str, Any]) -> List[str]:
    """Return what a campaign comes down to as lines for people."""
    lines: List[str] = []
    for name in PARAMETERS:
        own = summary[name]
        lines += [
            f"{name} without noise: {own['recovered']} of {records} recovered within "
            f"{100.0 * SHARE:g} % of it or {LEAST:g}; the farthest off by "
            f"{own['largest_miss']:.1e}, {100.0 * own['largest_relative_miss']:.2g} % "
            f"(closed forms: {100.0 * own['largest_relative_miss_of_closed_form']:.0f} %)",
            f"{name} with noise: {own['held_by_interval']} of {records} within their 95 % interval",
        ]
    fall = summary["least_fall"]
    falls = "to nothing" if fall is None else f"{fall:.0f} times or more"
    return [*lines, f"the largest systematic return error falls {falls} with the correction"]


