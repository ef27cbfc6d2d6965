"""Calibration of noise models and systematic errors by paths with truth, without ROS.

Example:
    python3 -m bullet_lab.studies.calibrate.study results/mine --data results/squares
    python3 -m bullet_lab.studies.calibrate.study results/coverage --coverage 1000
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from bullet_lab.core.files import make_folder
from bullet_lab.core.parameters import choices, integer, name_list, text
from bullet_lab.noise.calibration import SYSTEMATIC, Problem
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.calibrate.drive import (
    Coverage,
    DriveSettings,
    coverage,
    coverage_rows,
    made_up,
)
from bullet_lab.studies.calibrate.figures import (
    coverage_figure,
    paths_figure,
    profiles_figure,
    residuals_figure,
)
from bullet_lab.studies.calibrate.recordings import (
    Recording,
    RecordingError,
    Topics,
    find_recordings,
    read_pair,
)
from bullet_lab.studies.calibrate.results import (
    Calibration,
    calibrate,
    calibration_summary,
    lines,
    noise_yaml,
)
from bullet_lab.studies.calibrate.steps import Steps, StepSettings, joined, take_steps
from bullet_lab.studies.results import write_results
from bullet_lab.studies.study import MOST_SEED, Settings, Tell, progress, run_from, silent
from bullet_lab.studies.workers import run_tasks, this_process

NO_ERRORS = "none"
WHEELS, GYRO = SYSTEMATIC[2:]
_LEAST_SHARE = 0.05  # of the distance, forwards and backwards, to fit both of these
MOST_COVERAGE_PATHS = 100_000


@dataclass(frozen=True)
class CalibrateSettings(Settings):
    """Models and errors to fit."""

    models: Tuple[str, ...] = choices(tuple(MODELS), "noise models to fit and compare", MODELS)
    systematic: Tuple[str, ...] = choices(
        SYSTEMATIC, "systematic errors to fit with them", (*SYSTEMATIC, NO_ERRORS)
    )
    seed: int = integer(1, "seed of the bootstrap and of what is made up", 0, MOST_SEED)
    coverage: int = integer(
        0,
        "number of made-up paths of one lap; count how often intervals hold the truth, instead",
        0,
        MOST_COVERAGE_PATHS,
    )

    @property
    def errors(self) -> Tuple[str, ...]:
        """The systematic errors to fit."""
        return tuple(name for name in self.systematic if name != NO_ERRORS)


@dataclass(frozen=True)
class DataSettings:
    """Files of the paths."""

    data: Tuple[str, ...] = name_list(
        "bags, tables with both paths, or folders of recordings; none: a made-up drive"
    )
    truth: str = text("", "file of the truth, instead of data")
    odometry: str = text("", "file of the odometry that belongs to it")
    truth_topic: str = text("/odom", "topic of the truth in bags")
    odometry_topic: str = text("/noisy_odom", "topic of the odometry in bags")
    base: str = text("", "folder that relative paths start from")

    def recordings(self) -> List[Recording]:
        """Read the recordings; none if no file is given. Raises LabError."""
        topics = Topics(self.truth_topic, self.odometry_topic)
        if bool(self.truth) != bool(self.odometry):
            raise RecordingError("truth and odometry are one recording: both files are needed")
        found: List[Recording] = []
        if self.truth:
            found.append(read_pair(self._path(self.truth), self._path(self.odometry), topics))
        if self.data:
            found += find_recordings([self._path(name) for name in self.data], topics)
        return found

    def _path(self, name: str) -> Path:
        return Path(self.base) / name


def run_calibration(
    folder: Path,
    settings: CalibrateSettings,
    steps: StepSettings,
    drive: DriveSettings,
    recordings: Sequence[Recording] = (),
    tell: Tell = silent,
) -> Dict[str, Any]:
    """Calibrate; write noise.yaml, figures and summary.json; return the summary.

    Args:
        folder: for the results.
        settings: models and errors to fit.
        steps: settings of the steps.
        drive: made up if there are no recordings.
        recordings: to calibrate by.
        tell: prints a line.

    Raises:
        LabError: recordings that are not usable, or a folder that cannot be written to.
    """
    true: Dict[str, Dict[str, float]] = {}
    if not recordings:
        recordings = [made_up(drive, settings.seed)]
        errors = {name: getattr(drive, name) for name in settings.errors}
        true = {drive.model: {**drive.noise(), **errors}}
    taken = joined([take_steps(recording, steps) for recording in recordings])
    taken.check()
    about = _about_steps(taken)
    fitted = settings.errors if _separable(taken) else _without_gyro(settings.errors)
    for line in _remarks(about):
        tell(line)
    if fitted != settings.errors:
        tell(
            f"{GYRO} is not fitted: on a path that goes one way only, it is a {WHEELS} of "
            "-wheel_base times as much"
        )
    pairs = StepPairs(
        taken.true, taken.odometry[np.newaxis], taken.truth_std_m, taken.truth_std_rad
    )

    def calibrate_model(number: int) -> Calibration:
        problem = Problem(pairs, settings.models[number], fitted, drive.wheel_base)
        return calibrate(problem, taken.follows, settings.seed)

    count = len(settings.models)
    found = run_tasks(calibrate_model, count, this_process, tell, "calibrate", "model", " models")
    for line in lines(found, true):
        tell(line)
    summary = {
        "job": "calibrate",
        "seed": settings.seed,
        "recordings": [recording.name for recording in recordings],
        "steps": about,
        **calibration_summary(found),
    }
    best = min(found, key=lambda one: one.aic)
    figures = {
        "residuals.png": residuals_figure(found),
        "profiles.png": profiles_figure(best, true.get(best.model, {})),
        "paths.png": paths_figure(recordings, best),
    }
    return write_results(folder, summary, {}, figures, _noise_files(found, best, summary))


def _noise_files(
    found: Sequence[Calibration], best: Calibration, summary: Dict[str, Any]
) -> Dict[str, str]:
    """Return the YAML files for noisy_odom by name."""
    source, *others = summary["recordings"]
    if others:
        source += f" and {len(others)} more"
    seconds = summary["steps"]["median_s"]
    texts = {f"noise_{one.model}.yaml": noise_yaml(one, source, seconds) for one in found}
    return {**texts, "noise.yaml": noise_yaml(best, source, seconds)}


def _separable(taken: Steps) -> bool:
    """Return whether the robot drives both forwards and backwards.

    Otherwise the gyro's bias has the same effect as unequal wheels.
    """
    ahead = taken.true[:, 0]
    less = min(ahead[ahead > 0.0].sum(), -ahead[ahead < 0.0].sum())
    return less >= _LEAST_SHARE * np.abs(ahead).sum()


def _without_gyro(errors: Tuple[str, ...]) -> Tuple[str, ...]:
    """Return the errors without the gyro's bias if unequal wheels are among them."""
    return tuple(name for name in errors if name != GYRO or WHEELS not in errors)


def _remarks(about: Dict[str, Any]) -> List[str]:
    remarks = [
        f"{about['count']} steps of {about['median_s']:.3g} s, {about['length_m']:.1f} m and "
        f"{about['turned_rad']:.1f} rad in all; {about['resting']} more stood still, "
        f"{about['over_gaps']} went over a gap"
    ]
    if about["moved_unseen"]:
        remarks.append(
            f"in {about['moved_unseen']} steps the truth moved and the odometry did not: "
            "they are left out"
        )
    return [*remarks, *about["remarks"]]


def _about_steps(taken: Steps) -> Dict[str, Any]:
    return {
        "count": len(taken),
        "median_s": float(np.median(taken.seconds)),
        "length_m": float(np.hypot(taken.true[:, 0], taken.true[:, 1]).sum()),
        "turned_rad": float(np.abs(taken.true[:, 2]).sum()),
        "resting": taken.resting,
        "over_gaps": taken.gaps,
        "moved_unseen": taken.unseen,
        "truth_std_m": taken.truth_std_m,
        "truth_std_rad": taken.truth_std_rad,
        "remarks": list(taken.remarks),
    }



def run_coverage(
    folder: Path, settings: CalibrateSettings, drive: DriveSettings, tell: Tell = silent
) -> Dict[str, Any]:
    """Count how often intervals hold the truth; write coverage.csv and .png, and summary.json.

    All random and systematic errors are fitted together.

    Raises:
        LabError: the folder cannot be written to.
    """
    found: List[Coverage] = []
    lap = replace(drive, laps=1)
    total = settings.coverage * len(settings.models)
    with progress("coverage", total, tell, unit="path", things=" paths") as note:
        for model in settings.models:
            found += coverage(lap, model, SYSTEMATIC, settings.coverage, settings.seed, note)
    for one in found:
        low, high = one.band()
        tell(
            f"{one.model:15} {one.name:20} true {one.true:8.4g}, mean {one.mean:8.4g}: "
            f"{100.0 * one.held / one.paths:5.1f} % of {one.paths} intervals hold it "
            f"(band {100.0 * low:.1f} to {100.0 * high:.1f} %)"
        )
    summary = {
        "job": "calibrate",
        "seed": settings.seed,
        "coverage": [one.summary() for one in found],
    }
    tables = {"coverage.csv": coverage_rows(found)}
    return write_results(folder, summary, tables, {"coverage.png": coverage_figure(found)}, {})


def _run(
    folder: Path,
    settings: CalibrateSettings,
    data: DataSettings,
    steps: StepSettings,
    drive: DriveSettings,
    tell: Tell,
) -> None:
    # A folder that cannot be written to shows here, instead of after the work.
    make_folder(folder)
    if settings.coverage:
        run_coverage(folder, settings, drive, tell)
    else:
        run_calibration(folder, settings, steps, drive, data.recordings(), tell)


SETTINGS = (CalibrateSettings, DataSettings, StepSettings, DriveSettings)
main = functools.partial(run_from, "calibrate", __doc__, SETTINGS, _run)


if __name__ == "__main__":
    main()
