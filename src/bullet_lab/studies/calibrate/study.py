"""The parameters of noise models and of systematic errors from paths with truth, without ROS.

Example:
    python3 -m bullet_lab.studies.calibrate.study results/mine --data results/squares
    python3 -m bullet_lab.studies.calibrate.study results/coverage --coverage 1000
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, NoReturn, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.parameters import choices, integer, name_list, text
from bullet_lab.noise.calibration import SYSTEMATIC, Problem
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies.calibrate.coverage import Coverage, coverage, coverage_rows
from bullet_lab.studies.calibrate.drive import DriveSettings, made_up
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
from bullet_lab.studies.study import (
    MOST_SEED,
    SUMMARY,
    Settings,
    Tell,
    progress,
    run_from,
    silent,
    whole_results,
    write_table,
)

NO_ERRORS = "none"
WHEELS, GYRO = SYSTEMATIC[2:]
_BOTH_WAYS = 0.05  # of the way at least are driven forwards, and backwards
MOST_COVERAGE_PATHS = 100_000


@dataclass(frozen=True)
class CalibrateSettings(Settings):
    """What is asked."""

    models: Tuple[str, ...] = choices(tuple(MODELS), "noise models to fit and compare", MODELS)
    systematic: Tuple[str, ...] = choices(
        SYSTEMATIC, "systematic errors to fit with them", (*SYSTEMATIC, NO_ERRORS)
    )
    seed: int = integer(1, "seed of the bootstrap and of what is made up", 0, MOST_SEED)
    coverage: int = integer(
        0,
        "count on so many made-up paths of one lap how often intervals hold the truth, instead",
        0,
        MOST_COVERAGE_PATHS,
    )

    @property
    def errors(self) -> Tuple[str, ...]:
        """The systematic errors to fit."""
        return tuple(name for name in self.systematic if name != NO_ERRORS)


@dataclass(frozen=True)
class DataSettings:
    """Where the paths are."""

    data: Tuple[str, ...] = name_list(
        "bags, tables with both paths, or folders of recordings; none: a drive that is made up"
    )
    truth: str = text("", "file of the truth, instead of data")
    odometry: str = text("", "file of the odometry that belongs to it")
    truth_topic: str = text("/odom", "topic of the truth in bags")
    odometry_topic: str = text("/noisy_odom", "topic of the odometry in bags")
    base: str = text("", "folder that relative paths start from")

    def recordings(self) -> List[Recording]:
        """Read them; raises LabError. There are none where nothing is named."""
        topics = Topics(self.truth_topic, self.odometry_topic)
        if bool(self.truth) != bool(self.odometry):
            raise RecordingError("truth and odometry are two files of one recording: name both")
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
    """Calibrate, leave noise.yaml, pictures and summary.json, and return what that says.

    Args:
        folder: for the results.
        settings: what is asked.
        steps: how steps are taken.
        drive: that is made up where there are no recordings.
        recordings: to calibrate by.
        tell: gets lines of text.

    Raises:
        LabError: recordings that cannot be used, or a folder that cannot be written to.
    """
    invented = not recordings
    recordings = recordings or [made_up(drive, settings.seed)]
    taken = joined([take_steps(recording, steps) for recording in recordings])
    taken.check()
    errors, left_out = _separable(taken, settings.errors)
    for remark in (*_remarks(taken), *left_out):
        tell(remark)
    found = []
    with progress("calibrate", len(settings.models), tell, unit="model", things=" models") as note:
        for model in settings.models:
            problem = Problem(_pairs(taken), model, errors, drive.wheel_base)
            found.append(calibrate(problem, taken.follows, settings.seed))
            note()
    true = _true_values(drive, settings) if invented else {}
    for line in lines(found, true):
        tell(line)
    summary = {
        "job": "calibrate",
        "seed": settings.seed,
        "recordings": [recording.name for recording in recordings],
        "steps": _about_steps(taken),
        **calibration_summary(found),
    }
    _write(folder, found, taken, recordings, summary, true)
    return summary


def _pairs(taken: Steps) -> StepPairs:
    return StepPairs(
        taken.true,
        taken.odometry[np.newaxis],
        taken.truth_std_m,
        taken.truth_std_rad,
    )


def _separable(taken: Steps, errors: Sequence[str]) -> Tuple[Tuple[str, ...], List[str]]:
    """Leave out the gyro's bias where it cannot be told from unequal wheels, and say so."""
    way = taken.true[:, 0]
    less = min(way[way > 0.0].sum(), -way[way < 0.0].sum())
    if {GYRO, WHEELS} <= set(errors) and less < _BOTH_WAYS * np.abs(way).sum():
        kept = tuple(name for name in errors if name != GYRO)
        return kept, [
            f"{GYRO} is not fitted: on a path that goes one way only, it is a {WHEELS} of "
            "-wheel_base times as much"
        ]
    return tuple(errors), []


def _true_values(drive: DriveSettings, settings: CalibrateSettings) -> Dict[str, Dict[str, float]]:
    errors = {name: getattr(drive, name) for name in settings.errors}
    return {drive.model: {**drive.noise(), **errors}}


def _remarks(taken: Steps) -> List[str]:
    length = float(np.hypot(taken.true[:, 0], taken.true[:, 1]).sum())
    said = [
        f"{len(taken)} steps of {np.median(taken.seconds):.3g} s, {length:.1f} m and "
        f"{np.abs(taken.true[:, 2]).sum():.1f} rad in all; {taken.resting} more stood still, "
        f"{taken.gaps} went over a gap"
    ]
    if taken.unseen:
        said.append(
            f"in {taken.unseen} steps the truth moved and the odometry saw nothing of it: "
            "they are left out"
        )
    return [*said, *taken.remarks]


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


def _write(
    folder: Path,
    found: Sequence[Calibration],
    taken: Steps,
    recordings: Sequence[Recording],
    summary: Mapping[str, Any],
    true: Mapping[str, Mapping[str, float]],
) -> None:
    source = recordings[0].name
    if len(recordings) > 1:
        source += f" and {len(recordings) - 1} more"
    seconds = float(np.median(taken.seconds))
    best = min(found, key=lambda one: one.aic)
    with whole_results(folder) as part:
        for one in found:
            (part / f"noise_{one.model}.yaml").write_text(noise_yaml(one, source, seconds))
        (part / "noise.yaml").write_text(noise_yaml(best, source, seconds))
        save(residuals_figure(found), part / "residuals.png")
        save(profiles_figure(best, true.get(best.model, {})), part / "profiles.png")
        save(paths_figure(recordings, best), part / "paths.png")
        write_json(part / SUMMARY, summary)


def run_coverage(
    folder: Path, settings: CalibrateSettings, drive: DriveSettings, tell: Tell = silent
) -> Dict[str, Any]:
    """Count how often intervals hold the truth, leave coverage.csv and .png, and summary.json.

    Random and systematic errors, all of them, are fitted together.

    Raises:
        LabError: a folder that cannot be written to.
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
    with whole_results(folder) as part:
        write_table(part / "coverage.csv", coverage_rows(found))
        save(coverage_figure(found), part / "coverage.png")
        write_json(part / SUMMARY, summary)
    return summary


def _run(
    folder: Path,
    settings: CalibrateSettings,
    data: DataSettings,
    steps: StepSettings,
    drive: DriveSettings,
    tell: Tell,
) -> None:
    # Better known now than after the work.
    make_folder(folder)
    if settings.coverage:
        run_coverage(folder, settings, drive, tell)
    else:
        run_calibration(folder, settings, steps, drive, data.recordings(), tell)


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Calibrate from the command line; see `run_from`."""
    kinds = (CalibrateSettings, DataSettings, StepSettings, DriveSettings)
    run_from("calibrate", __doc__, kinds, _run, words)


if __name__ == "__main__":
    main()
