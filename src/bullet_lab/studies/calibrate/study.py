"""Calibration of noise models and systematic errors by paths with truth, without ROS.

Example:
    bullet_lab calibrate data:=results/squares
    bullet_lab calibrate coverage:=1000
"""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Iterator, Sequence

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.parameters import (
    choice,
    choices,
    integer,
    name_list,
    number,
    part_of,
    text,
)
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.calibration import Problem, fit, intervals
from bullet_lab.noise.likelihood import RESOLUTION, StepPairs
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps
from bullet_lab.noise.odometry_noise import MODELS, NoiseRule, NoisyPath, noise_parameters, rule_of
from bullet_lab.noise.systematic import SYSTEMATIC, SystematicErrors, SystematicPath, chords
from bullet_lab.studies.calibrate.results import (
    ModelCalibration,
    calibrate,
    coverage_figure,
    lines,
    model_summary,
    noise_yaml,
    paths_figure,
    profiles_figure,
    residuals_figure,
)
from bullet_lab.studies.calibrate.steps import StepSettings, joined, short_steps, take_steps
from bullet_lab.studies.paths import Recording, find_recordings, read_pair
from bullet_lab.studies.study import (
    MOST_SEED,
    Record,
    Settings,
    Summary,
    Tell,
    clopper_pearson,
    progress,
    run_from,
    write_results,
)

NO_ERRORS = "none"
WHEELS, GYRO = SYSTEMATIC[2:4]
MOST_COVERAGE_PATHS = 100_000
_STEPS_AT_A_TIME = 50_000
_COMMANDS = (
    (0.2, 0.0, 10.0),
    (0.0, 0.5236, 3.0),
    (0.2, -0.3, 5.0),
    (-0.2, 0.0, 5.0),
    (0.0, -0.5236, 3.0),
    (-0.15, 0.25, 6.0),
    (0.2, 0.3, 7.0),
)
"""Commands of a lap: m/s, rad/s and s."""


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


@dataclass(frozen=True)
class DataSettings:
    """Files of the paths."""

    data: tuple[str, ...] = name_list(
        "bags, tables with both paths, or folders of recordings; none: a made-up drive"
    )
    truth: str = text("", "file of the truth, instead of data")
    odometry: str = text("", "file of the odometry that belongs to it")
    truth_topic: str = text("/odom", "topic of the truth in bags")
    odometry_topic: str = text("/noisy_odom", "topic of the odometry in bags")
    base: str = text("", "folder that relative paths start from")

    def recordings(self) -> list[Recording]:
        """Read the recordings; none if no file is given. Raises LabError."""
        base, topics = Path(self.base), (self.truth_topic, self.odometry_topic)
        if bool(self.truth) != bool(self.odometry):
            raise LabError("truth and odometry are one recording: both files are needed")
        found: list[Recording] = []
        if self.truth:
            found.append(read_pair(base / self.truth, base / self.odometry, topics))
        if self.data:
            found += find_recordings([base / name for name in self.data], topics)
        return found


def _error(name: str, value: float) -> Any:
    """Declare a parameter of `SystematicErrors` with another default."""
    return field(default=value, metadata=SystematicErrors.__dataclass_fields__[name].metadata)


@dataclass(frozen=True)
class DriveSettings(noise_parameters(), SystematicErrors):
    """The made-up drive, and the errors of its odometry."""

    scale_error: float = _error("scale_error", 0.01)
    base_error: float = _error("base_error", -0.02)
    diameter_error: float = _error("diameter_error", 0.004)
    gyro_bias_per_metre: float = _error("gyro_bias_per_metre", 0.01)
    way_per_turn: float = _error("way_per_turn", 0.01)
    model: str = choice("probabilistic", "noise model of the made-up drive", MODELS)
    rate: float = number(5.0, "Hz of its odometry", above=0.0, maximum=1000.0)
    laps: int = integer(3, "of it, 39 s and 6.3 m each", 1, 1000)

    def rule(self, model: str) -> NoiseRule:
        """Return the rule of a noise model, with the parameters of the drive."""
        return rule_of(model, asdict(self))

    def noise(self) -> dict[str, float]:
        """Return the parameters of the drive's noise model by name."""
        return asdict(self.rule(self.model))


def calibration_drive(settings: DriveSettings) -> Trajectory:
    """Return the true path of the drive."""
    period = 1.0 / settings.rate
    lap = [(v, w) for v, w, s in _COMMANDS for _ in range(max(1, round(s * settings.rate)))]
    arcs = np.array([(v * period, 0.0, w * period) for v, w in lap * settings.laps])
    poses = [np.zeros(3)]
    for step in chords(arcs):
        poses.append(se2.compose(poses[-1], step))
    return Trajectory(period * np.arange(len(poses)), np.array(poses))


def made_up(settings: DriveSettings, seed: int) -> Recording:
    """Return the drive with an odometry as `noisy_odom` would make it."""
    truth = calibration_drive(settings)
    errors = SystematicPath(part_of(SystematicErrors, settings))
    noise = NoisyPath(settings.rule(settings.model), seed)
    poses = [noise.update(*errors.update(*pose).pose).pose for pose in truth.poses.tolist()]
    return Recording("a drive that was made up", truth, Trajectory(truth.stamps, np.array(poses)))


def coverage(
    settings: DriveSettings,
    model: str,
    systematic: Sequence[str],
    paths: int,
    seed: int,
) -> list[Record]:
    """Calibrate many noisy versions of the drive, jointly for random and systematic errors.

    The errors that are not in `systematic` are 0 and not fitted. The result has for each parameter
    the number of paths, that of the intervals that hold its true value, their share with its 95 %
    band (Clopper and Pearson), and the means of the estimates and of the finite ends.
    """
    errors = {name: getattr(settings, name) for name in systematic}
    true = {**asdict(settings.rule(model)), **errors}
    estimates, ends = [], []
    for pairs in _paths(settings, model, systematic, paths, seed):
        found = fit(Problem(pairs, model, systematic, settings.wheel_base))
        estimates.append(found.estimates)
        ends.append(intervals(found))
    values, bounds = np.concatenate(estimates), np.concatenate(ends)
    result = []
    for j, name in enumerate(found.problem.names):
        low, high = bounds[:, j].T
        held = int(((low <= true[name]) & (true[name] <= high)).sum())
        band_low, band_high = clopper_pearson(held, paths, 0.025)
        columns = {"mean_estimate": values[:, j], "mean_low": low, "mean_high": high}
        result.append(
            {
                "model": model,
                "parameter": name,
                "true": true[name],
                "paths": paths,
                "held": held,
                "share": held / paths,
                "band_low": band_low,
                "band_high": band_high,
                **{mean: float(np.mean(c[np.isfinite(c)])) for mean, c in columns.items()},
            }
        )
    return result


def _paths(
    settings: DriveSettings, model: str, systematic: Sequence[str], paths: int, seed: int
) -> Iterator[StepPairs]:
    """Yield the steps of noisy versions, as noisy_odom would make them, in blocks."""
    truth = calibration_drive(settings).poses
    names = (*systematic, "wheel_base", "ticks_per_metre")
    errors = SystematicErrors(**{name: getattr(settings, name) for name in names})
    stds = [max(RESOLUTION, std) for std in errors.resolution]
    reported = errors.path(truth)
    steps = noisy_steps(reported, settings.rule(model))
    generator = np.random.default_rng([seed, 1])
    for block in noisy_blocks(steps, generator, paths, _STEPS_AT_A_TIME):
        yield StepPairs(se2.steps(truth), se2.steps(block.poses(reported)), *stds)


def run_calibration(
    folder: Path,
    settings: CalibrateSettings,
    steps: StepSettings,
    drive: DriveSettings,
    recordings: Sequence[Recording],
    tell: Tell,
) -> Summary:
    """Calibrate by recordings, or the made-up drive if there are none.

    Write noise.yaml, figures and summary.json; return the summary. Raises LabError for recordings
    that are not usable, or a folder that cannot be written to.
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
        "best": best.model,
        "models": list(map(model_summary, ranked)),
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
