"""How often the 95 % intervals hold the truth, on synthetic paths of known noise."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Callable, Dict, Iterator, List, Sequence, Tuple

import numpy as np
from scipy.stats import beta

from bullet_lab.core import se2
from bullet_lab.noise.calibration import Problem, fit, intervals
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps
from bullet_lab.noise.odometry_noise import rule_of
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.calibrate.drive import DriveSettings, calibration_drive

_STEPS_AT_A_TIME = 50_000


@dataclass(frozen=True)
class Coverage:
    """How a parameter came out over many paths.

    Attributes:
        model: name of the noise model.
        name: of the parameter.
        true: its value.
        paths: how many.
        held: how many of the intervals hold the true value.
        mean: of the estimates.
        low: mean of the lower ends that are finite.
        high: likewise, of the upper ones.
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
        """Return the 95 % band (Clopper and Pearson) of the share that is held."""
        held, paths = self.held, self.paths
        return (
            float(beta.ppf(0.025, held, paths - held + 1)) if held else 0.0,
            float(beta.ppf(0.975, held + 1, paths - held)) if held < paths else 1.0,
        )

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
        systematic: which of the systematic errors are put on and fitted; the others are 0.
        paths: how many.
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
    """Yield the steps of noisy versions, as noisy_odom makes them, in blocks."""
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
