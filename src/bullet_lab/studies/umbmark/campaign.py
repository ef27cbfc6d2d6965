"""Random robots, each calibrated by squares: how well injected errors are recovered."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLUE, GREEN, GREY, VERMILION
from bullet_lab.core.parameters import boolean, integer
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.results import (
    Record,
    labelled,
    legend_below,
    panels,
    rows_of,
    write_results,
)
from bullet_lab.studies.study import Settings, Tell
from bullet_lab.studies.umbmark.benchmark import Benchmark, DriveSettings, drive_run
from bullet_lab.studies.umbmark.estimate import PARAMETERS
from bullet_lab.studies.umbmark.runs import DIRECTIONS
from bullet_lab.studies.workers import Run, run_tasks

DIAMETER_ERRORS = (0.001, 0.01)
BASE_ERRORS = (0.005, 0.03)
BASES = (0.15, 0.8)
SIDES = (1.0, 6.0)
FLOOR_SIDES = (1.0, 2.0)
SPEEDS = (0.1, 0.5)
TURN_SPEEDS = (0.3, 1.0)

SHARE = 0.05
LEAST = 2e-5
"""An error counts as recovered if it is found to this share of itself, or to this difference."""


@dataclass(frozen=True)
class CampaignSettings(Settings):
    """Random robots instead of one."""

    robots: int = integer(0, "random robots instead of one; 0: the one", 0, 100_000)
    floor: bool = boolean(False, "drive them on the floor; else wheels roll ideally")


def draw_robot(drive: DriveSettings, floor: bool, index: int) -> Tuple[DriveSettings, float]:
    """Return the drive of a robot, and its assumed base (m); they depend on seed and index only.

    Sizes of errors are uniform within `DIAMETER_ERRORS` and `BASE_ERRORS`, their signs are
    equally likely; base, side and speeds are uniform too. On the floor, robot and speeds are those
    of the settings.
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
    return drawn, float(base)


def calibrate_robot(drive: DriveSettings, floor: bool, index: int) -> Record:
    """Calibrate a random robot and return its row of the table.

    Without noise it drives one square in each direction, as all others would be the same; again
    with the correction, and on the floor once without errors. With noise it drives all squares.
    """
    drawn, base = draw_robot(drive, floor, index)

    def benchmark(settings: DriveSettings, correction: SystematicErrors) -> Benchmark:
        numbers = range(len(DIRECTIONS) * settings.runs)
        ideal_base = None if floor else base
        drives = [drive_run(settings, correction, 0, ideal_base, number) for number in numbers]
        return Benchmark.of_drives(drives, settings.side)

    no_errors = right = SystematicErrors()
    quiet = replace(drawn, std=0.0, runs=1)
    if floor:
        perfect = replace(quiet, diameter_error=0.0, base_error=0.0)
        right = benchmark(perfect, no_errors).estimate.errors
    before = benchmark(quiet, no_errors)
    after = benchmark(quiet, before.estimate.errors)
    noisy = benchmark(drawn, no_errors).estimate.relative_to(right)
    found_quiet = before.estimate.relative_to(right).errors
    record: Dict[str, Any] = {"robot": index, "side_m": quiet.side, "base_m": before.base}
    for name, closed in zip(PARAMETERS, (before.figures.e_d, before.figures.e_b)):
        injected = getattr(quiet, name)
        found = getattr(found_quiet, name)
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
                f"{name}_held": low is not None and low <= injected <= high,
            }
        )
    record["e_max_syst_m"] = before.figures.e_max_syst
    record["e_max_syst_after_m"] = after.figures.e_max_syst
    return record


def run_campaign(
    folder: Path, drive: DriveSettings, campaign: CampaignSettings, run: Run, tell: Tell
) -> Mapping[str, Any]:
    """Calibrate random robots; write campaign.csv, campaign.png and summary.json; return that.

    Raises:
        LabError: a robot cannot be driven, or the folder cannot be written to.
    """
    task = functools.partial(calibrate_robot, drive, campaign.floor)
    records = run_tasks(task, campaign.robots, run, tell, "calibrating", "robot", " robots")
    summary = {"job": "umbmark", **asdict(drive), **asdict(campaign), **campaign_summary(records)}
    table, figure = rows_of(records), campaign_figure(records)
    return write_results(folder, summary, {"campaign.csv": table}, {"campaign.png": figure}, {})


def campaign_summary(records: Sequence[Record]) -> Dict[str, Any]:
    """Return the totals of a campaign."""
    ends = [(record["e_max_syst_m"], record["e_max_syst_after_m"]) for record in records]
    falls = [before / after for before, after in ends if after > 0.0]
    summary: Dict[str, Any] = {"finished": True, "least_fall": min(falls, default=None)}
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
    """Return the totals of a campaign as lines for the user."""
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


def campaign_figure(records: Sequence[Record]) -> Figure:
    """Draw estimated minus injected errors, by the closed forms and by the fit."""
    figure, (every,) = panels((1, len(PARAMETERS)), (11.0, 4.6))
    for axes, name in zip(every, PARAMETERS):
        injected = np.array([record[name] for record in records])

        # None becomes NaN, which is not drawn.
        closed, found, noisy, low, high = (
            np.array([record[f"{name}_{kind}"] for record in records], float) - injected
            for kind in ("closed_form", "found", "with_noise", "low", "high")
        )
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.plot(injected, closed, "x", color=VERMILION, label="closed forms")
        reach = np.abs(np.stack((noisy - low, high - noisy)))
        style = {"fmt": ".", "color": BLUE, "elinewidth": 1.0}
        axes.errorbar(injected, noisy, reach, label="fit, with noise: 95 % intervals", **style)
        axes.plot(injected, found, "o", color=GREEN, markersize=4, label="fit, no noise")
        axes.set(xlabel=f"injected {name} (%)", ylabel="found less injected")
        axes.xaxis.set_major_formatter(lambda value, _: f"{100.0 * value:g}")
        axes.set_yscale("symlog", linthresh=1e-4)
        axes.grid(alpha=0.3)
    legend_below(figure, labelled(axes), bottom=0.06, frameon=None, fontsize=9)
    return figure
