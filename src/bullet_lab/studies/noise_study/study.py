"""Thousands of noisy versions of one path, at every level of noise, without ROS.

Example:
    python3 -m bullet_lab.studies.noise_study.study results/noise_study --paths 10000
    python3 -m bullet_lab.studies.noise_study.study results/mine --path odom.tum --levels 0.05 0.1
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, NoReturn, Optional, Sequence, Tuple

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.drive.square import PlanarPose, Square
from bullet_lab.errors import LabError
from bullet_lab.noise.noisy_paths import study_generator
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.interruption import interrupt_once
from bullet_lab.studies.noise_study.figures import (
    coverage_figure,
    distance_figure,
    levels_figure,
    rates_figure,
)
from bullet_lab.studies.noise_study.resampling import resample
from bullet_lab.studies.noise_study.results import (
    SUMMARY,
    case_summary,
    check_path,
    kept_path,
    read_path,
    whole_results,
    write_error_by_distance,
    write_metrics,
    write_tum,
)
from bullet_lab.studies.noise_study.statistics import Case, level_rule, study_case
from bullet_lab.studies.squares import SECONDS_PER_STEP, drive_square

LARGEST_STD = 10.0
"""At this level a robot has lost its heading after some centimetres."""

MOST_PATHS = 10_000_000
KEPT_PATHS = 60
SIDES_PER_LAP = 4
STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130


class StudyError(LabError):
    """A study that cannot be made."""


@dataclass(frozen=True)
class StudySettings:
    """What is studied.

    Attributes:
        levels: std, per metre and per radian (m/√m, rad/√m for the rate-invariant model).
        models: names of noise rules.
        rates: of the messages, Hz.
        paths: noisy paths for each level, model and rate.
        seed: of all that is random, >= 0.
        delta: m, of the relative pose error and the drift.
    """

    levels: Tuple[float, ...] = (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
    models: Tuple[str, ...] = MODELS
    rates: Tuple[float, ...] = (0.9, 5.0, 20.0)
    paths: int = 3000
    seed: int = 1
    delta: float = 1.0

    def __post_init__(self):
        for name in ("levels", "models", "rates"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise StudyError(f"{name} must not be empty nor hold a value twice")
        for std in self.levels:
            if not 0.0 <= std <= LARGEST_STD:
                raise StudyError(f"a level must be from 0 to {LARGEST_STD:g}, not {std:g}")
        for model in self.models:
            level_rule(model, 0.0)
        if not 2 <= self.paths <= MOST_PATHS:
            raise StudyError(f"paths must be from 2 to {MOST_PATHS}, not {self.paths}")
        if self.seed < 0:
            raise StudyError(f"seed must be an integer >= 0, not {self.seed}")


def simulated_square(laps: int = 1) -> Trajectory:
    """Return the odometry of the square that the report drives, from the simulation, at 20 Hz.

    Raises:
        StudyError: laps is not >= 1.
    """
    if laps < 1:
        raise StudyError(f"laps must be >= 1, not {laps}")
    stamps: List[float] = []
    poses: List[PlanarPose] = []

    def record(step: int, pose: PlanarPose) -> None:
        stamps.append(step * SECONDS_PER_STEP)
        poses.append(pose)

    drive_square(Square(sides=SIDES_PER_LAP * laps), record, rest=0.0)
    return Trajectory(stamps, poses)


def study(
    trajectory: Trajectory, settings: StudySettings, tell: Callable[[str], None] = lambda _: None
) -> List[Case]:
    """Study every level, model and rate on a path; nothing is written.

    Args:
        trajectory: the perfect path.
        settings: what is studied.
        tell: gets a line of text when a model is done at a rate.

    Returns:
        A case for each, by model, then rate, then level, in the order of the settings.

    Raises:
        LabError: a path or a setting that makes no sense.
    """
    check_path(trajectory)
    cases: List[Case] = []
    for model in settings.models:
        for rate in settings.rates:
            start = time.monotonic()
            at_rate = resample(trajectory, rate)
            cases += [
                study_case(
                    at_rate,
                    (model, std, rate),
                    study_generator(settings.seed, model, std, rate),
                    settings.paths,
                    settings.delta,
                    KEPT_PATHS,
                )
                for std in settings.levels
            ]
            seconds = time.monotonic() - start
            tell(
                f"{model} at {rate:g} Hz: {len(settings.levels)} levels, {settings.paths} paths "
                f"of {len(at_rate)} messages each, {seconds:.1f} s; "
                f"{_verdict(cases[-len(settings.levels) :])}"
            )
    return cases


def _verdict(cases: Sequence[Case]) -> str:
    """Say in words up to which level the first-order ellipse is to be trusted."""
    noisy = [case for case in cases if case.sample.coverage["first_order"] is not None]
    bad = min((c for c in noisy if not c.theory.gaussian_enough()), key=_level, default=None)
    if not noisy:
        return "no ellipses"
    if bad is None:
        return "ellipses are right at all levels"
    worst = max(noisy, key=_level)
    covered = 100.0 * worst.sample.coverage["first_order"]
    return (
        f"first-order ellipses are right below std {bad.std:g} and at {worst.std:g} cover "
        f"{covered:.1f} %, their area {worst.theory.area_ratio():.2f} of the exact one"
    )


def _level(case: Case) -> float:
    return case.std


def run_study(
    folder: Path,
    settings: StudySettings,
    trajectory: Trajectory,
    source: str = "",
    tell: Callable[[str], None] = lambda _: None,
) -> Dict[str, Any]:
    """Study a path and leave tables, pictures, TUM files and summary.json.

    The same settings and path give the same tables. Nothing is written before all is computed.

    Args:
        folder: where the files go; made if need be.
        settings: what is studied.
        trajectory: the perfect path.
        source: where it is from, in words for summary.json.
        tell: gets a line of text now and then.

    Returns:
        What summary.json says.

    Raises:
        LabError: a path or a setting that makes no sense, or a folder that cannot be written to.
    """
    cases = study(trajectory, settings, tell)
    summary = {
        "job": "noise_study",
        "seed": settings.seed,
        "paths": settings.paths,
        "levels": list(settings.levels),
        "models": list(settings.models),
        "rates_hz": list(settings.rates),
        "delta_m": settings.delta,
        "path": {
            "source": source,
            "poses": len(trajectory),
            "length_m": trajectory.length(),
            "duration_s": float(trajectory.stamps[-1] - trajectory.stamps[0]),
            "laps": len(cases[0].perfect_closure),
        },
        "cases": [case_summary(case) for case in cases],
    }
    with whole_results(folder) as part:
        write_json(part / SUMMARY, summary)
        write_metrics(part / "metrics.csv", cases)
        write_error_by_distance(part / "error_by_distance.csv", cases)
        _write_tum_files(part / "tum", cases, max(settings.rates))
        _draw(part, cases, trajectory, settings)
    return summary


def _write_tum_files(folder: Path, cases: Sequence[Case], rate: float) -> None:
    """Write the first noisy path of each model and level at a rate, and the perfect one."""
    folder.mkdir()
    for case in cases:
        if case.rate == rate:
            write_tum(folder / "perfect.tum", case.trajectory)
            write_tum(folder / f"{case.model}_std_{case.std:g}.tum", kept_path(case, 0))


def _draw(
    folder: Path, cases: Sequence[Case], trajectory: Trajectory, settings: StudySettings
) -> None:
    fastest = [case for case in cases if case.rate == max(settings.rates)]
    for model in settings.models:
        of_model = [case for case in fastest if case.model == model]
        save(levels_figure(of_model), folder / f"levels_{model}.png")
    save(distance_figure(fastest), folder / "error_by_distance.png")
    save(rates_figure(cases, trajectory), folder / "message_rate.png")
    save(coverage_figure(cases), folder / "coverage.png")


class _Parser(argparse.ArgumentParser):
    """A parser that complains in one line."""

    def error(self, message: str) -> NoReturn:
        _end(message, STATUS_BAD_INPUT)


def _parser() -> argparse.ArgumentParser:
    default = StudySettings()
    parser = _Parser(prog="noise_study", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--path", default="", help="TUM, CSV or bag file; else the square")
    parser.add_argument("--topic", default="/odom", help="of a bag, nav_msgs/Odometry")
    parser.add_argument("--base", default="", help="folder that a relative --path starts from")
    parser.add_argument("--laps", type=int, default=1, help="times round the simulated square")
    parser.add_argument("--levels", type=float, nargs="+", default=default.levels)
    parser.add_argument("--models", nargs="+", default=default.models)
    parser.add_argument("--rates", type=float, nargs="+", default=default.rates, help="Hz")
    parser.add_argument("--paths", type=int, default=default.paths, help="for each of them")
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--delta", type=float, default=default.delta, help="m, of the RPE")
    return parser


def main(arguments: Optional[Sequence[str]] = None) -> NoReturn:
    """Run the study from the command line, and exit: 0 done, 2 bad input, 130 interrupted."""
    words = sys.argv[1:] if arguments is None else arguments
    # roslaunch adds its own: __name:=… and __log:=…
    words = [word for word in words if not re.match(r"__\w+:=", word)]
    try:
        # What is half done is then cleared away, as on Ctrl-C.
        interrupt_once()
        values = _parser().parse_args(words)
        _run(values)
    except LabError as error:
        _end(str(error), STATUS_BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(STATUS_INTERRUPTED)
    sys.exit(0)


def _run(values: argparse.Namespace) -> None:
    settings = StudySettings(
        tuple(values.levels),
        tuple(values.models),
        tuple(values.rates),
        values.paths,
        values.seed,
        values.delta,
    )
    if values.path:
        source = Path(values.base) / values.path
        trajectory = read_path(source, values.topic)
    else:
        source = "the report's square, simulated"
        trajectory = simulated_square(values.laps)
    # Better known now than after the work.
    make_folder(values.out)
    run_study(values.out, settings, trajectory, str(source), _tell)


def _tell(line: str) -> None:
    print(f"noise_study: {line}", flush=True)


def _end(line: str, status: int) -> NoReturn:
    print(f"noise_study: {line}", file=sys.stderr, flush=True)
    sys.exit(status)


if __name__ == "__main__":
    main()
