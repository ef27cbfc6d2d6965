"""UMBmark: errors of a robot's wheels from squares that it drives by odometry, without ROS.

Example:
    bullet_lab umbmark diameter_error:=0.002
    bullet_lab umbmark path:=recordings wheel_base:=0.4
    bullet_lab umbmark robots:=20
"""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Iterator, Sequence

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    THIN,
    VERMILION,
    labelled,
    legend_below,
    panels,
    plan_axes,
)
from bullet_lab.core.parameters import boolean, integer, number, text
from bullet_lab.core.se2 import ellipse_points
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.study import (
    Record,
    Run,
    Settings,
    Summary,
    Tell,
    WorkerSettings,
    run_from,
    run_tasks,
    workers,
    write_results,
)
from bullet_lab.studies.umbmark.estimate import (
    CLOCKWISE,
    COUNTER_CLOCKWISE,
    DIRECTIONS,
    PARAMETERS,
    Benchmark,
    centre_ellipse,
    read_runs,
    return_errors,
)
from bullet_lab.studies.umbmark.robots import (
    NO_ERRORS,
    BenchmarkSettings,
    FloorRobot,
    drive_run,
    multipliers,
)

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

CORRECTED = "corrected.yaml"
STYLES = (
    (CLOCKWISE, "clockwise", BLUE, "o"),
    (COUNTER_CLOCKWISE, "counter-clockwise", ORANGE, "s"),
)


@dataclass(frozen=True)
class RandomRobotSettings(Settings):
    """Random robots instead of one."""

    robots: int = integer(0, "random robots instead of one; 0: the one", 0, 100_000)
    floor: bool = boolean(False, "drive them on the floor; else wheels roll ideally")


@dataclass(frozen=True)
class FileSettings(Settings):
    """Recorded runs of a real robot or another simulation."""

    path: str = text("", "folder or file of recorded runs; else they are driven here")
    topic: str = text("/odom", "odometry topic of a bag")
    truth_topic: str = text("/truth", "topic of a bag's true poses, Odometry or PoseStamped")
    wheel_base: float = number(0.38, "m, that the recorded odometry assumes", above=0.0)
    base: str = text("", "folder that a relative path starts from")


def run_umbmark(
    folder: Path,
    before: Benchmark,
    after: Benchmark | None,
    about: Summary,
    floor: SystematicErrors = NO_ERRORS,
) -> Summary:
    """Write tables, figure, corrected parameters and summary.json; return the summary.

    Args:
        folder: for the files.
        before: runs with the odometry as it is.
        after: runs with the correction, if there are any.
        about: other entries of summary.json.
        floor: errors found for perfect wheels; `recovered` is relative to them.
    """
    found = before.estimate
    recovered = found.relative_to(floor)
    warnings = before.warnings()
    summary = {
        "job": "umbmark",
        **about,
        "finished": True,
        "trusted": not warnings,
        "not_trusted_because": warnings,
        **before.summary(),
        "recovered": {**_by_name(recovered.errors), "intervals_95": recovered.intervals},
        "floor": _by_name(floor),
        "effective": _by_name(found.errors),
        "unexplained_m": found.residual,
        "corrected": {
            "wheel_base_m": before.base * (1.0 + found.errors.base_error),
            **multipliers(found.errors),
        },
    }
    if after is not None:
        left = after.figures["e_max_syst_m"]
        falls_by = before.figures["e_max_syst_m"] / left if left > 0.0 else None
        summary.update(after=after.summary(), falls_by=falls_by)
    if warnings:
        # An earlier run may have left one.
        (folder / CORRECTED).unlink(missing_ok=True)
    corrected = yaml.safe_dump(multipliers(found.errors), sort_keys=False)
    return write_results(
        folder,
        summary,
        {"returns.csv": _returns(before, after)},
        {"clusters.png": clusters_figure(before, after)},
        {} if warnings else {CORRECTED: corrected},
    )


def _by_name(errors: SystematicErrors) -> dict[str, float]:
    return {name: getattr(errors, name) for name in PARAMETERS}


def _returns(before: Benchmark, after: Benchmark | None) -> Iterator[Record]:
    for name, benchmark in (("before", before), ("after", after)):
        for run in benchmark.runs if benchmark is not None else ():
            record = {"correction": name, "run": run.name, "direction": run.direction}
            yield {**record, **dict(zip(("x_m", "y_m", "yaw_rad"), run.return_error().tolist()))}


def clusters_figure(before: Benchmark, after: Benchmark | None) -> Figure:
    """Draw the return errors of `Benchmark`s, to one scale, and those after the correction larger.

    A filled ellipse holds a centre of gravity with 95 % confidence, an open one 95 % of the runs.
    """
    shown = [("before the correction", before)]
    if after is not None:
        shown += [("after it, to the same scale", after), ("after it", after)]
    title = "Return errors: where the robot really was, seen from where odometry had it"
    figure, (every,) = panels((1, len(shown)), (0.6 + 4.6 * len(shown), 5.0), title)
    for axes, (title, benchmark) in zip(every, shown):
        plan_axes(axes, title=title, xlabel="x (mm), ahead at the start", ylabel="y (mm)")
        _draw_clusters(axes, benchmark)
    if after is not None:
        errors = [return_errors(before.runs, way)[:, :2] for way in DIRECTIONS]
        reach = 1150.0 * np.abs(np.concatenate(errors)).max()
        for axes in every[:2]:
            axes.set(adjustable="box", xlim=(-reach, reach), ylim=(-reach, reach))
    columns, bottom = (2, 0.15) if after is None else (0, 0.06)
    legend_below(figure, labelled(every[0]), columns, bottom, frameon=None, fontsize=9)
    return figure


def _draw_clusters(axes: Axes, benchmark: Benchmark) -> None:
    axes.axhline(0.0, **THIN)
    axes.axvline(0.0, **THIN)
    for direction, title, colour, marker in STYLES:
        # Both directions share an entry of the legend.
        once = "_" if direction == CLOCKWISE else ""
        errors = 1000.0 * return_errors(benchmark.runs, direction)
        centre = errors[:, :2].mean(axis=0)
        axes.plot(*errors[:, :2].T, marker, color=colour, markersize=5, alpha=0.7, label=title)
        axes.plot(*centre, "+", color=BLACK, markersize=11, label=f"{once}centres of gravity")
        shape = centre_ellipse(errors)
        if shape is not None:
            border = centre + ellipse_points(shape)
            label = f"{once}95 % ellipses of the centres"
            axes.fill(*border.T, color=colour, alpha=0.25, linewidth=0, label=label)
            border = centre + ellipse_points(np.cov(errors[:, :2].T))
            label = f"{once}95 % ellipses of the runs"
            axes.plot(*border.T, color=colour, linewidth=0.9, label=label)


def describe(
    before: Benchmark, after: Benchmark | None, floor: SystematicErrors = NO_ERRORS
) -> list[str]:
    """Return the results as lines for the user."""
    lines = [f"NOT TO BE TRUSTED: {warning}" for warning in before.warnings()]
    lines += _figures(before)
    found, figures = before.estimate, before.figures
    lines.append(
        f"closed forms, for small errors: E_d {figures['e_d']:.5f}, E_b {figures['e_b']:.5f}"
    )
    for name, title in (("diameter_error", "D_right/D_left"), ("base_error", "base/assumed")):
        value = getattr(found.errors, name)
        between = ""
        if found.intervals is not None:
            low, high = found.intervals[name]
            between = f", 95 % within {1.0 + low:.6f} to {1.0 + high:.6f}"
        lines.append(f"fit of the full model: {title} {1.0 + value:.6f}{between}")
    if not floor.none:
        recovered = _joined(_by_name(found.relative_to(floor).errors))
        lines.append(f"of that, beyond the effect of this floor on perfect wheels: {recovered}")
    base = before.base * (1.0 + found.errors.base_error)
    lines.append(f"corrected: base {base:.6f} m; {_joined(multipliers(found.errors))}")
    if after is not None:
        lines += [f"driven again: {line}" for line in _figures(after)]
    return lines


def _joined(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.6f}" for name, value in values.items())


def _figures(benchmark: Benchmark) -> list[str]:
    figures = benchmark.figures
    lines = []
    for direction in DIRECTIONS:
        x, y = figures[f"centre_{direction}_m"]
        errors = return_errors(benchmark.runs, direction) * (1000.0, 1000.0, math.degrees(1.0))
        each = ", ".join(f"({dx:.2f}, {dy:.2f}, {turn:.3f})" for dx, dy, turn in errors.tolist())
        lines += [
            f"return errors {direction} (mm, mm, °): {each}",
            f"centre of gravity {direction}: ({1000.0 * x:.2f}, {1000.0 * y:.2f}) mm",
        ]
    return [*lines, f"E_max,syst {1000.0 * figures['e_max_syst_m']:.2f} mm"]


def draw_robot(
    drive: BenchmarkSettings, floor: bool, index: int
) -> tuple[BenchmarkSettings, float]:
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


def calibrate_robot(drive: BenchmarkSettings, floor: bool, index: int) -> Record:
    """Calibrate a random robot and return its row of the table.

    Without noise it drives one square in each direction, as all others would be the same; again
    with the correction, and on the floor once without errors. With noise it drives all squares.
    """
    drawn, base = draw_robot(drive, floor, index)

    def benchmark(settings: BenchmarkSettings, correction: SystematicErrors) -> Benchmark:
        numbers = range(len(DIRECTIONS) * settings.runs)
        ideal_base = None if floor else base
        runs = [drive_run(settings, correction, 0, ideal_base, number) for number in numbers]
        return Benchmark.of(runs, settings.side)

    right = NO_ERRORS
    quiet = replace(drawn, std=0.0, runs=1)
    if floor:
        perfect = replace(quiet, diameter_error=0.0, base_error=0.0)
        right = benchmark(perfect, NO_ERRORS).estimate.errors
    before = benchmark(quiet, NO_ERRORS)
    after = benchmark(quiet, before.estimate.errors)
    noisy = benchmark(drawn, NO_ERRORS).estimate.relative_to(right)
    found_quiet = before.estimate.relative_to(right).errors
    record = {"robot": index, "side_m": quiet.side, "base_m": before.base}
    for name, closed in zip(PARAMETERS, (before.figures["e_d"], before.figures["e_b"])):
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
    record["e_max_syst_m"] = before.figures["e_max_syst_m"]
    record["e_max_syst_after_m"] = after.figures["e_max_syst_m"]
    return record


def run_campaign(
    folder: Path, drive: BenchmarkSettings, campaign: RandomRobotSettings, run: Run, tell: Tell
) -> Summary:
    """Calibrate random robots; write campaign.csv, campaign.png and summary.json; return that.

    Raises LabError if a robot cannot be driven, or the folder cannot be written to.
    """
    task = functools.partial(calibrate_robot, drive, campaign.floor)
    records = run_tasks(task, campaign.robots, run, tell, "robots")
    summary = {"job": "umbmark", **asdict(drive), **asdict(campaign), **campaign_summary(records)}
    figures = {"campaign.png": campaign_figure(records)}
    return write_results(folder, summary, {"campaign.csv": records}, figures, {})


def campaign_summary(records: Sequence[Record]) -> Summary:
    """Return the totals of a campaign."""
    ends = [(record["e_max_syst_m"], record["e_max_syst_after_m"]) for record in records]
    falls = [before / after for before, after in ends if after > 0.0]
    summary = {"finished": True, "least_fall": min(falls, default=None)}
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


def describe_campaign(records: int, summary: Summary) -> list[str]:
    """Return the totals of a campaign as lines for the user."""
    lines: list[str] = []
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
        axes.axhline(0.0, **THIN)
        axes.plot(injected, closed, "x", color=VERMILION, label="closed forms")
        reach = np.abs(np.stack((noisy - low, high - noisy)))
        style = {"fmt": ".", "color": BLUE, "elinewidth": 1.0}
        axes.errorbar(injected, noisy, reach, label="fit, with noise: 95 % intervals", **style)
        axes.plot(injected, found, "o", color=GREEN, markersize=4, label="fit, no noise")
        axes.set(xlabel=f"injected {name} (%)", ylabel="found less injected")
        axes.xaxis.set_major_formatter(lambda value, _: f"{100.0 * value:g}")
        axes.set_yscale("symlog", linthresh=1e-4)
    legend_below(figure, labelled(axes), bottom=0.06, frameon=None, fontsize=9)
    return figure


def _run(
    folder: Path,
    drive: BenchmarkSettings,
    files: FileSettings,
    campaign: RandomRobotSettings,
    work: WorkerSettings,
    tell: Tell,
) -> list[str]:
    if not files.path:
        # Errors and warnings appear once here, instead of in each worker.
        FloorRobot(drive.robot, drive.controller, NO_ERRORS, NO_ERRORS).close()
    run = workers(work.workers)
    if campaign.robots:
        found = run_campaign(folder, drive, campaign, run, tell)
        return describe_campaign(campaign.robots, found)
    if files.path:
        source = Path(files.base) / files.path
        topics = files.truth_topic, files.topic
        before = Benchmark.of(read_runs(source, topics, drive.side, files.wheel_base))
        about = {"source": str(source), "wheel_base_m": files.wheel_base}
        run_umbmark(folder, before, None, about)
        return describe(before, None)
    floor = NO_ERRORS
    if not drive.errors.none:
        perfect = replace(drive, diameter_error=0.0, base_error=0.0, std=0.0, runs=1)
        floor = _drive(perfect, NO_ERRORS, 0, run, "without errors", tell).estimate.errors
        tell(f"without errors, {_effective(floor)}")
    before = _drive(drive, NO_ERRORS, 0, run, "by the odometry as it is", tell)
    after = _drive(drive, before.estimate.errors, 1, run, "with the correction", tell)
    if drive.errors.none:
        tell(f"no errors were injected, and {_effective(before.estimate.errors)}")
    run_umbmark(folder, before, after, asdict(drive), floor)
    return describe(before, after, floor)


def _drive(
    settings: BenchmarkSettings,
    correction: SystematicErrors,
    laps: int,
    run: Run,
    title: str,
    tell: Tell,
) -> Benchmark:
    """Drive all runs on the floor and evaluate them; for the arguments see `drive_run`."""
    count = len(DIRECTIONS) * settings.runs
    task = functools.partial(drive_run, settings, correction, laps, None)
    runs = run_tasks(task, count, run, tell, f"squares {title}")
    return Benchmark.of(runs, settings.side)


def _effective(errors: SystematicErrors) -> str:
    return (
        "these wheels roll on this floor as if D_right/D_left were "
        f"{1.0 + errors.diameter_error:.6f} and the base {1.0 + errors.base_error:.6f} of the "
        "assumed one"
    )


SETTINGS = (BenchmarkSettings, FileSettings, RandomRobotSettings, WorkerSettings)
main = functools.partial(run_from, "umbmark", __doc__, SETTINGS, _run)
