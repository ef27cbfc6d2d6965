"""UMBmark: errors of a robot's wheels from squares that it drives by odometry, without ROS.

Example:
    python3 -m bullet_lab.studies.umbmark.study results/umbmark --diameter-error 0.002
    python3 -m bullet_lab.studies.umbmark.study results/mine --path recordings --wheel-base 0.4
    python3 -m bullet_lab.studies.umbmark.study results/campaign --robots 20
"""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bullet_lab.core.figures import BLACK, BLUE, GREY, ORANGE, plan_axes
from bullet_lab.core.files import make_folder
from bullet_lab.core.parameters import number, text
from bullet_lab.core.se2 import ellipse_points
from bullet_lab.noise import systematic
from bullet_lab.studies.results import labelled, legend_below, panels, write_results
from bullet_lab.studies.study import Settings, Tell, run_from
from bullet_lab.studies.umbmark.benchmark import Benchmark, DriveSettings, drive_run
from bullet_lab.studies.umbmark.campaign import CampaignSettings, describe_campaign, run_campaign
from bullet_lab.studies.umbmark.estimate import PARAMETERS, centre_ellipse
from bullet_lab.studies.umbmark.robots import multipliers
from bullet_lab.studies.umbmark.runs import (
    CLOCKWISE,
    COUNTER_CLOCKWISE,
    DIRECTIONS,
    read_runs,
    return_errors,
)
from bullet_lab.studies.workers import Run, WorkerSettings, run_tasks, workers

# The class is not imported by name: the job's help describes the dataclasses of this module.
NO_ERRORS = systematic.SystematicErrors()

STYLES = (
    (CLOCKWISE, "clockwise", BLUE, "o"),
    (COUNTER_CLOCKWISE, "counter-clockwise", ORANGE, "s"),
)


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
    after: Optional[Benchmark],
    about: Dict[str, Any],
    floor: systematic.SystematicErrors = NO_ERRORS,
) -> Dict[str, Any]:
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
    summary: Dict[str, Any] = {
        "job": "umbmark",
        **about,
        "finished": True,
        "trusted": not warnings,
        "not_trusted_because": warnings,
        **before.summary(),
        "recovered": {
            **_by_name(recovered.errors),
            "intervals_95": recovered.intervals
            and {name: list(ends) for name, ends in recovered.intervals.items()},
        },
        "floor": _by_name(floor),
        "effective": _by_name(found.errors),
        "unexplained_m": found.residual,
        "corrected": {
            "wheel_base_m": before.base * (1.0 + found.errors.base_error),
            **multipliers(found.errors),
        },
    }
    if after is not None:
        left = after.figures.e_max_syst
        falls_by = before.figures.e_max_syst / left if left > 0.0 else None
        summary.update(after=after.summary(), falls_by=falls_by)
    corrected = yaml.safe_dump(multipliers(found.errors), sort_keys=False)
    write_results(
        folder,
        summary,
        {"returns.csv": _return_rows(before, after)},
        {"clusters.png": clusters_figure(before, after)},
        {} if warnings else {"corrected.yaml": corrected},
    )
    if warnings:
        # An earlier run may have left one.
        (folder / "corrected.yaml").unlink(missing_ok=True)
    return summary


def _by_name(errors: systematic.SystematicErrors) -> Dict[str, float]:
    return {name: getattr(errors, name) for name in PARAMETERS}


def _return_rows(before: Benchmark, after: Optional[Benchmark]) -> Iterator[Tuple[Any, ...]]:
    yield ("correction", "run", "direction", "x_m", "y_m", "yaw_rad")
    for name, benchmark in (("before", before), ("after", after)):
        for run in benchmark.runs if benchmark is not None else ():
            yield (name, run.name, run.direction, *run.return_error().tolist())


def clusters_figure(before: Benchmark, after: Optional[Benchmark]) -> Figure:
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
            axes.set_adjustable("box")
            axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    columns, bottom = (2, 0.15) if after is None else (0, 0.06)
    legend_below(figure, labelled(every[0]), columns, bottom, frameon=None, fontsize=9)
    return figure


def _draw_clusters(axes: Axes, benchmark: Benchmark) -> None:
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
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
    before: Benchmark, after: Optional[Benchmark], floor: systematic.SystematicErrors = NO_ERRORS
) -> List[str]:
    """Return the results as lines for the user."""
    lines = [f"NOT TO BE TRUSTED: {warning}" for warning in before.warnings()]
    lines += _figures(before)
    found, figures = before.estimate, before.figures
    lines.append(
        f"closed forms, for small errors: E_d {figures.e_d:.5f}, E_b {figures.e_b:.5f}"
    )
    for name, title in (("diameter_error", "D_right/D_left"), ("base_error", "base/believed")):
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


def _joined(values: Dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.6f}" for name, value in values.items())


def _figures(benchmark: Benchmark) -> List[str]:
    figures = benchmark.figures
    lines = []
    for direction, (x, y) in zip(DIRECTIONS, (figures.centre_cw, figures.centre_ccw)):
        errors = return_errors(benchmark.runs, direction) * (1000.0, 1000.0, math.degrees(1.0))
        each = ", ".join(f"({dx:.2f}, {dy:.2f}, {turn:.3f})" for dx, dy, turn in errors.tolist())
        lines += [
            f"return errors {direction} (mm, mm, °): {each}",
            f"centre of gravity {direction}: ({1000.0 * x:.2f}, {1000.0 * y:.2f}) mm",
        ]
    return [*lines, f"E_max,syst {1000.0 * figures.e_max_syst:.2f} mm"]


def _run(
    folder: Path,
    drive: DriveSettings,
    files: FileSettings,
    campaign: CampaignSettings,
    work: WorkerSettings,
    tell: Tell,
) -> List[str]:
    make_folder(folder)
    if not files.path:
        # An error or a warning appears once here, instead of in each worker.
        drive.plan.check()
    run = workers(work.workers)
    if campaign.robots:
        found = run_campaign(folder, drive, campaign, run, tell)
        return describe_campaign(campaign.robots, found)
    if files.path:
        source = Path(files.base) / files.path
        runs = read_runs(source, files.topic, files.truth_topic, drive.side)
        before = Benchmark.of(runs, files.wheel_base)
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
    settings: DriveSettings,
    correction: systematic.SystematicErrors,
    laps: int,
    run: Run,
    title: str,
    tell: Tell,
) -> Benchmark:
    """Drive all runs on the floor and evaluate them; for the arguments see `drive_run`."""
    count = len(DIRECTIONS) * settings.runs
    task = functools.partial(drive_run, settings, correction, laps, None)
    drives = run_tasks(task, count, run, tell, title, "square", f" squares {title}")
    return Benchmark.of_drives(drives, settings.side)


def _effective(errors: systematic.SystematicErrors) -> str:
    return (
        "these wheels roll on this floor as if D_right/D_left were "
        f"{1.0 + errors.diameter_error:.6f} and the base {1.0 + errors.base_error:.6f} of the "
        "assumed one"
    )


SETTINGS = (DriveSettings, FileSettings, CampaignSettings, WorkerSettings)
main = functools.partial(run_from, "umbmark", __doc__, SETTINGS, _run)


if __name__ == "__main__":
    main()
