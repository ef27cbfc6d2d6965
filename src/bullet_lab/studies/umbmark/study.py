"""Squares driven by odometry each way, and what they say of a robot's wheels, without ROS.

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
from typing import Any, Dict, List, NoReturn, Optional, Sequence, Tuple

import yaml

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.parameters import number, text
from bullet_lab.noise import systematic
from bullet_lab.studies.study import (
    SUMMARY,
    Settings,
    Tell,
    progress,
    run_from,
    silent,
    whole_results,
    write_table,
)
from bullet_lab.studies.umbmark.benchmark import Benchmark, DriveSettings
from bullet_lab.studies.umbmark.campaign import CampaignSettings, describe_campaign, run_campaign
from bullet_lab.studies.umbmark.drives import drive_square
from bullet_lab.studies.umbmark.estimate import PARAMETERS
from bullet_lab.studies.umbmark.figures import clusters_figure
from bullet_lab.studies.umbmark.floor import multipliers
from bullet_lab.studies.umbmark.runs import DIRECTIONS, Run, return_errors
from bullet_lab.studies.umbmark.sources import read_runs
from bullet_lab.studies.workers import Run as RunTasks
from bullet_lab.studies.workers import TaskLostError, WorkerSettings, workers

NONE = systematic.SystematicErrors()


@dataclass(frozen=True)
class FileSettings(Settings):
    """Runs that were recorded, of a real robot or another simulation."""

    path: str = text("", "folder or file of recorded runs; else they are driven here")
    topic: str = text("/odom", "odometry topic of a bag")
    truth_topic: str = text("/truth", "topic of a bag's true poses, Odometry or PoseStamped")
    wheel_base: float = number(0.38, "m, that the recorded odometry believes in", above=0.0)
    base: str = text("", "folder that a relative path starts from")


def drive_run(
    settings: DriveSettings, correction: systematic.SystematicErrors, laps: int, number: int
) -> Tuple[Run, float]:
    """Drive a run on the floor, of an even number clockwise; return it, and the believed base.

    Args:
        settings: of the drive.
        correction: what an earlier calibration has found.
        laps: how many rounds of runs there were before, for the noise.
        number: of the run, from 0 on.
    """
    direction = DIRECTIONS[number % len(DIRECTIONS)]
    robot = settings.plan.build(settings.errors, correction)
    try:
        name, noise = f"{direction} {number // len(DIRECTIONS) + 1}", settings.noise(number, laps)
        return drive_square(robot, settings.square(direction), name, noise), robot.believed.base
    finally:
        robot.close()


def drive_runs(
    settings: DriveSettings,
    correction: systematic.SystematicErrors,
    laps: int,
    run: RunTasks,
    title: str,
    tell: Tell = silent,
) -> Benchmark:
    """Drive all runs of both ways on the floor and evaluate them; raises LabError."""
    numbers = range(len(DIRECTIONS) * settings.runs)
    task = functools.partial(drive_run, settings, correction, laps)
    found: Dict[int, Tuple[Run, float]] = {}
    with progress(title, len(numbers), tell, unit="square", things=f" squares {title}") as note:
        for index, result in run(task, numbers):
            if isinstance(result, TaskLostError):
                raise result
            found[index] = result
            note()
    runs = [found[index][0] for index in numbers]
    # The fit counts turns by the base as it was believed, whose correction the runs have had.
    return Benchmark.of(runs, found[0][1], settings.side)


def run_umbmark(
    folder: Path,
    before: Benchmark,
    after: Optional[Benchmark],
    about: Dict[str, Any],
    floor: systematic.SystematicErrors = NONE,
) -> Dict[str, Any]:
    """Leave tables, picture, corrected parameters and summary.json; return what that says.

    Args:
        folder: for the files.
        before: the runs by the odometry as it is.
        after: those with the correction, if there are any.
        about: what else summary.json says.
        floor: what is found where nothing is wrong, which is not among what is recovered.
    """
    found = before.estimate
    recovered = found.beside(floor)
    summary: Dict[str, Any] = {
        "job": "umbmark",
        **about,
        "finished": True,
        **before.summary(),
        "recovered": {
            **_named(recovered.errors),
            "intervals_95": recovered.intervals
            and {name: list(ends) for name, ends in recovered.intervals.items()},
        },
        "floor": _named(floor),
        "effective": _named(found.errors),
        "unexplained_m": found.residual,
        "corrected": {
            "wheel_base_m": before.base * (1.0 + found.errors.base_error),
            **multipliers(found.errors),
        },
    }
    if after is not None:
        times = _ratio(before.figures.e_max_syst, after.figures.e_max_syst)
        summary.update(after=after.summary(), falls_by=times)
    with whole_results(folder) as part:
        write_table(part / "returns.csv", _return_rows(before, after))
        text_ = yaml.safe_dump(multipliers(found.errors), sort_keys=False)
        (part / "corrected.yaml").write_text(text_)
        save(clusters_figure(before, after), part / "clusters.png")
        write_json(part / SUMMARY, summary)
    return summary


def _named(errors: systematic.SystematicErrors) -> Dict[str, float]:
    return {name: getattr(errors, name) for name in PARAMETERS}


def _ratio(before: float, after: float) -> Optional[float]:
    return before / after if after > 0.0 else None


def _return_rows(before: Benchmark, after: Optional[Benchmark]):
    yield ("correction", "run", "direction", "x_m", "y_m", "yaw_rad")
    for name, benchmark in (("before", before), ("after", after)):
        for run in benchmark.runs if benchmark is not None else ():
            yield (name, run.name, run.direction, *run.return_error().tolist())


def describe(
    before: Benchmark, after: Optional[Benchmark], floor: systematic.SystematicErrors = NONE
) -> List[str]:
    """Return what came of it as lines for people."""
    lines = [*_figures(before)]
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
        recovered = ", ".join(f"{k} {v:.6f}" for k, v in _named(found.beside(floor).errors).items())
        lines.append(f"of that, beyond what this floor does to wheels that are right: {recovered}")
    parameters = ", ".join(f"{k} {v:.6f}" for k, v in multipliers(found.errors).items())
    base = before.base * (1.0 + found.errors.base_error)
    lines.append(f"corrected: base {base:.6f} m; {parameters}")
    if after is not None:
        lines += [f"driven again: {line}" for line in _figures(after)]
    return lines


def _figures(benchmark: Benchmark) -> List[str]:
    figures = benchmark.figures
    lines = []
    for way, (x, y) in zip(DIRECTIONS, (figures.centre_cw, figures.centre_ccw)):
        errors = return_errors(benchmark.runs, way) * (1000.0, 1000.0, math.degrees(1.0))
        each = ", ".join(f"({dx:.2f}, {dy:.2f}, {turn:.3f})" for dx, dy, turn in errors.tolist())
        lines += [
            f"return errors {way} (mm, mm, °): {each}",
            f"centre of gravity {way}: ({1000.0 * x:.2f}, {1000.0 * y:.2f}) mm",
        ]
    return [*lines, f"E_max,syst {1000.0 * figures.e_max_syst:.2f} mm"]


def _run(
    folder: Path,
    drive: DriveSettings,
    files: FileSettings,
    campaign: CampaignSettings,
    work: WorkerSettings,
    tell: Tell,
) -> None:
    make_folder(folder)
    about = asdict(drive)
    if not files.path:
        # Better known now than from each worker.
        drive.plan.check()
    run = workers(work.workers)
    if campaign.robots:
        found = run_campaign(folder, drive, campaign, run, tell)
        for line in describe_campaign(campaign.robots, found):
            tell(line)
        return
    after: Optional[Benchmark] = None
    floor = NONE
    if files.path:
        source = Path(files.base) / files.path
        runs = read_runs(source, files.topic, files.truth_topic, drive.side)
        before = Benchmark.of(runs, files.wheel_base)
        about = {"source": str(source), "wheel_base_m": files.wheel_base}
    else:
        if not drive.errors.none:
            right = replace(drive, diameter_error=0.0, base_error=0.0, std=0.0, runs=1)
            floor = drive_runs(right, NONE, 0, run, "without errors", tell).estimate.errors
            tell(f"without errors, {_effective(floor)}")
        before = drive_runs(drive, NONE, 0, run, "by the odometry as it is", tell)
        after = drive_runs(drive, before.estimate.errors, 1, run, "with the correction", tell)
        if drive.errors.none:
            tell(f"no errors were injected, and {_effective(before.estimate.errors)}")
    run_umbmark(folder, before, after, about, floor)
    for line in describe(before, after, floor):
        tell(line)


def _effective(errors: systematic.SystematicErrors) -> str:
    return (
        "these wheels roll on this floor as if D_right/D_left were "
        f"{1.0 + errors.diameter_error:.6f} and the base {1.0 + errors.base_error:.6f} of what is "
        "believed"
    )


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Run the study from the command line; see `run_from`."""
    settings = (DriveSettings, FileSettings, CampaignSettings, WorkerSettings)
    run_from("umbmark", __doc__, settings, _run, words)


if __name__ == "__main__":
    main()
