"""A drive to calibrate by, with known noise, and the coverage of intervals on many such drives."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, make_dataclass
from typing import Any, Callable, Dict, Iterator, List, Sequence, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.parameters import choice, integer, number
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.calibration import Problem, fit, intervals
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps
from bullet_lab.noise.odometry_noise import MODELS, NoisyPath, noise_fields, rule_of
from bullet_lab.noise.systematic import SystematicErrors, SystematicPath, chords
from bullet_lab.studies.calibrate.recordings import Recording
from bullet_lab.studies.shares import clopper_pearson

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

_NoiseParameters: Any = make_dataclass("_NoiseParameters", noise_fields(), frozen=True)


def _error(name: str, value: float) -> Any:
    """Declare a parameter of `SystematicErrors` with another default."""
    (entry,) = (entry for entry in fields(SystematicErrors) if entry.name == name)
    return field(default=value, metadata=entry.metadata)


@dataclass(frozen=True)
class DriveSettings(_NoiseParameters, SystematicErrors):
    """The made-up drive, and the errors of its odometry."""

    scale_error: float = _error("scale_error", 0.01)
    base_error: float = _error("base_error", -0.02)
    diameter_error: float = _error("diameter_error", 0.004)
    gyro_bias_per_metre: float = _error("gyro_bias_per_metre", 0.01)
    model: str = choice("probabilistic", "noise model of the made-up drive", MODELS)
    rate: float = number(5.0, "Hz of its odometry", above=0.0, maximum=1000.0)
    laps: int = integer(3, "of it, 39 s and 6.3 m each", 1, 1000)

    def noise(self, model: str = "") -> Dict[str, float]:
        """Return the parameters of a noise model by name."""
        values = {name: getattr(self, name) for name, _, _ in noise_fields()}
        rule = rule_of(model or self.model, values)
        return {entry.name: getattr(rule, entry.name) for entry in fields(rule)}


def calibration_drive(settings: DriveSettings) -> Trajectory:
    """Return the true path of the drive."""
    period = 1.0 / settings.rate
    lap = [(v, w) for v, w, s in _COMMANDS for _ in range(max(1, round(s * settings.rate)))]
    arcs = np.array([(v * period, 0.0, w * period) for v, w in lap * settings.laps])
    poses: List[np.ndarray] = [np.zeros(3)]
    for step in chords(arcs):
        poses.append(se2.compose(poses[-1], step))
    return Trajectory(period * np.arange(len(poses)), np.array(poses))


def made_up(settings: DriveSettings, seed: int) -> Recording:
    """Return the drive with an odometry as `noisy_odom` would make it."""
    truth = calibration_drive(settings)
    errors = SystematicPath(SystematicErrors.of(settings))
    noise = NoisyPath(rule_of(settings.model, settings.noise()), seed)
    poses = [noise.update(*errors.update(*pose).pose).pose for pose in truth.poses.tolist()]
    return Recording("a drive that was made up", truth, Trajectory(truth.stamps, np.array(poses)))


@dataclass(frozen=True)
class Coverage:
    """Estimates of a parameter over many paths.

    Attributes:
        model: name of the noise model.
        name: of the parameter.
        true: its value.
        paths: number of paths.
        held: number of intervals that hold the true value.
        mean: of the estimates.
        low: mean of the finite lower ends.
        high: mean of the finite upper ends.
    """

    model: str
    name: str
    true: float
    paths: int
    held: int
    mean: float
    low: float
    high: float

    def band(self) -> Tuple[float, float]:
        """Return the 95 % band (Clopper and Pearson) of the share of `held`."""
        return clopper_pearson(self.held, self.paths, 0.025)

    def summary(self) -> Dict[str, object]:
        """Return the figures for summary.json."""
        return {**asdict(self), "share": self.held / self.paths, "band_95": self.band()}


def coverage(
    settings: DriveSettings,
    model: str,
    systematic: Sequence[str],
    paths: int,
    seed: int,
    note: Callable[[], None] = lambda: None,
) -> List[Coverage]:
    """Calibrate many noisy versions of the drive, jointly for random and systematic errors.

    Args:
        settings: of the drive, with the true values.
        model: of the noise.
        systematic: systematic errors that are applied and fitted; the others are 0.
        paths: number of paths.
        seed: of the paths, >= 0.
        note: called after each path.
    """
    true = {**settings.noise(model), **{name: getattr(settings, name) for name in systematic}}
    estimates, ends = [], []
    for pairs in _paths(settings, model, systematic, paths, seed):
        problem = Problem(pairs, model, systematic, settings.wheel_base)
        found = fit(problem)
        estimates.append(found.estimates)
        ends.append(intervals(problem, found))
        for _ in range(len(problem)):
            note()
    values, bounds = np.concatenate(estimates), np.concatenate(ends)
    result = []
    for j, name in enumerate(problem.names):
        low, high = bounds[:, j].T
        held = int(((low <= true[name]) & (true[name] <= high)).sum())
        means = (float(np.mean(part[np.isfinite(part)])) for part in (values[:, j], low, high))
        result.append(Coverage(model, name, true[name], paths, held, *means))
    return result


def _paths(
    settings: DriveSettings, model: str, systematic: Sequence[str], paths: int, seed: int
) -> Iterator[StepPairs]:
    """Yield the steps of noisy versions, as noisy_odom would make them, in blocks."""
    truth = calibration_drive(settings).poses
    wrong = {name: getattr(settings, name) for name in (*systematic, "wheel_base")}
    reported = SystematicErrors(**wrong).path(truth)
    steps = noisy_steps(reported, rule_of(model, settings.noise(model)))
    generator = np.random.default_rng([seed, 1])
    for block in noisy_blocks(steps, generator, paths, _STEPS_AT_A_TIME):
        heading = reported[:, 2] + block.heading_error
        poses = np.stack((block.position.real, block.position.imag, heading), axis=-1)
        yield StepPairs(se2.steps(truth), se2.steps(poses))


def coverage_rows(found: Sequence[Coverage]) -> Iterator[List[object]]:
    """Yield a header and a row for each parameter, for a table."""
    yield [
        *("model", "parameter", "true", "paths", "held", "share", "band_low", "band_high"),
        *("mean_estimate", "mean_low", "mean_high"),
    ]
    for one in found:
        counts = (one.paths, one.held, one.held / one.paths, *one.band())
        yield [one.model, one.name, one.true, *counts, one.mean, one.low, one.high]
