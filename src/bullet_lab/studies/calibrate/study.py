"""Calibration of noise models and systematic errors by paths with truth, without ROS.

Example:
    bullet_lab calibrate data:=results/squares
    bullet_lab calibrate coverage:=1000
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Sequence

from bullet_lab.core.parameters import choices, integer
from bullet_lab.errors import LabError
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.noise.systematic import SYSTEMATIC
from bullet_lab.studies.calibrate.recordings import (
    DataSettings,
    DriveSettings,
    coverage,
    made_up,
)
from bullet_lab.studies.calibrate.results import (
    ModelCalibration,
    calibrate,
    calibration_summary,
    coverage_figure,
    lines,
    noise_yaml,
    paths_figure,
    profiles_figure,
    residuals_figure,
)
from bullet_lab.studies.calibrate.steps import StepSettings, joined, short_steps, take_steps
from bullet_lab.studies.paths import Recording
from bullet_lab.studies.study import (
    MOST_SEED,
    Record,
    Settings,
    Summary,
    Tell,
    progress,
    run_from,
    write_results,
)

NO_ERRORS = "none"
WHEELS, GYRO = SYSTEMATIC[2:4]
MOST_COVERAGE_PATHS = 100_000
@dataclass(frozen=True)
class CalibrateSettings(Settings):
    """Models and errors to fit."""

    models: tuple[str, ...] = choices(tuple(MODELS), "noise models to fit and compare", MODELS)
    systematic: tuple[str, ...] = choices(
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
    def errors(self) -> tuple[str, ...]:
        """The systematic errors to fit."""
        return tuple(name for name in self.systematic if name != NO_ERRORS)


def run_calibration(
    folder: Path,
    settings: CalibrateSettings,
    steps: StepSettings,
    drive: DriveSettings,
    recordings: Sequence[Recording] = (),
    tell: Tell = print,
) -> Summary:
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
    true: dict[str, dict[str, float]] = {}
    if not recordings:
        recordings = [made_up(drive, settings.seed)]
        errors = {name: getattr(drive, name) for name in settings.errors}
        true = {drive.model: {**drive.noise(), **errors}}
    taken = short_steps(joined([take_steps(recording, steps) for recording in recordings]))
    taken.check()
    for line in taken.lines():
        tell(line)
    fitted = settings.errors
    if {GYRO, WHEELS} <= set(fitted) and not taken.go_both_ways():
        fitted = tuple(name for name in fitted if name != GYRO)
        tell(
            f"{GYRO} is not fitted: on a path that goes one way only, it is a {WHEELS} of "
            "-wheel_base times as much"
        )

    found = [
        calibrate(taken, model, fitted, drive.wheel_base, settings.seed)
        for model in progress(settings.models, "models", len(settings.models), tell)
    ]
    ranked = sorted(found, key=ModelCalibration.rank)
    best = ranked[0]
    if best.limited:
        raise LabError(
            f"{', '.join(best.limited)} of {best.model} on the limit, and no model without: the "
            "odometry is too far from the truth, or the steps are too short to tell more than noise"
        )
    for line in lines(ranked, true):
        tell(line)
    names = [recording.name for recording in recordings]
    summary = {
        "job": "calibrate",
        "seed": settings.seed,
        "recordings": names,
        "steps": taken.summary(),
        **calibration_summary(ranked),
    }
    figures = {
        "residuals.png": residuals_figure(found),
        "profiles.png": profiles_figure(best, true.get(best.model, {})),
        "paths.png": paths_figure(recordings, best),
    }
    source = f"{names[0]} and {len(names) - 1} more" if names[1:] else names[0]
    seconds = summary["steps"]["median_s"]
    texts = {
        f"noise_{one.model}.yaml": noise_yaml(one, source, seconds)
        for one in found
        if not one.limited
    }
    texts["noise.yaml"] = noise_yaml(best, source, seconds)
    return write_results(folder, summary, {}, figures, texts)


def run_coverage(
    folder: Path, settings: CalibrateSettings, drive: DriveSettings, tell: Tell = print
) -> Summary:
    """Count how often intervals hold the truth; write coverage.csv and .png, and summary.json.

    All random and systematic errors are fitted together.

    Raises:
        LabError: the folder cannot be written to.
    """
    found: list[Record] = []
    lap = replace(drive, laps=1)
    for model in progress(settings.models, "models", len(settings.models), tell):
        found += coverage(lap, model, SYSTEMATIC, settings.coverage, settings.seed)
    for one in found:
        tell(
            f"{one['model']:15} {one['parameter']:20} true {one['true']:8.4g}, "
            f"mean {one['mean_estimate']:8.4g}: {100.0 * one['share']:5.1f} % of {one['paths']} "
            f"intervals hold it (band {100.0 * one['band_low']:.1f} to "
            f"{100.0 * one['band_high']:.1f} %)"
        )
    summary = {"job": "calibrate", "seed": settings.seed, "coverage": found}
    tables = {"coverage.csv": found}
    return write_results(folder, summary, tables, {"coverage.png": coverage_figure(found)}, {})


def _run(
    folder: Path,
    settings: CalibrateSettings,
    data: DataSettings,
    steps: StepSettings,
    drive: DriveSettings,
    tell: Tell,
) -> None:
    if settings.coverage:
        run_coverage(folder, settings, drive, tell)
    else:
        run_calibration(folder, settings, steps, drive, data.recordings(), tell)


SETTINGS = (CalibrateSettings, DataSettings, StepSettings, DriveSettings)
main = functools.partial(run_from, "calibrate", __doc__, SETTINGS, _run)
