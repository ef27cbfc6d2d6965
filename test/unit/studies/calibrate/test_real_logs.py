"""Logs of real robots with truth, which are not a part of the package.

BULLET_LAB_LOGS names a folder with mrclam*_truth.tum and mrclam*_odom.tum. Run with `-m long -s`,
which prints the figures.
"""

import functools
import os
from pathlib import Path

import numpy as np
import pytest

from bullet_lab.core import se2
from bullet_lab.noise.calibration import Problem, covariance, fit
from bullet_lab.noise.goodness import INSIDE, LENGTHS, judged, predicted
from bullet_lab.noise.systematic import arcs, path_of
from bullet_lab.studies.calibrate.alignment import robust_fit
from bullet_lab.studies.calibrate.results import ModelCalibration, predictions
from bullet_lab.studies.calibrate.steps import (
    StepSettings,
    long_length,
    pairs_of,
    part_of,
    short_steps,
    take_steps,
)
from bullet_lab.studies.paths import find_recordings

FOLDER = os.environ.get("BULLET_LAB_LOGS", "")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not FOLDER, reason="BULLET_LAB_LOGS names no folder"),
]
ERRORS = ("scale_error", "base_error", "diameter_error", "way_per_turn")
SHARES = {1.0: (0.90, 0.98), 5.0: (0.90, 0.98), 20.0: (0.85, 1.0)}
WALKS = ("rate_invariant", "random_walk")


def winner(steps):
    """The best random walk of long steps, without its intervals and tests, which take long."""
    length, found = long_length(steps), []
    pairs, _ = pairs_of(steps, length)
    for model in WALKS:
        make = functools.partial(Problem, model=model, systematic=ERRORS)
        prediction = judged(list(predictions(make, steps, length)))
        found.append(ModelCalibration(fit(make(pairs)), None, None, prediction, length))
    return sorted(found, key=ModelCalibration.rank)[0]


def turn_gain(one):
    """True / reported turn, with the standard error that is published."""
    values = one.published()
    gain = (1.0 + values["scale_error"]) / (1.0 + values["base_error"])
    relative, scale = (part[0] for part in covariance(one.fit.information))
    inverse = relative / np.outer(scale, scale)
    names = one.fit.problem.names
    slope = np.zeros(len(names))
    for name, by in (("scale_error", gain), ("base_error", -gain)):
        slope[names.index(name)] = 0.01 * by / (1.0 + values[name])
    return gain, float(np.sqrt(one.prediction.dispersion * slope @ inverse @ slope))


def robust_gain(steps):
    """By Huber's regression of turns within about a second on the reported turn and way."""
    index = np.flatnonzero(np.diff(np.floor(np.cumsum(steps.seconds)), prepend=-1.0))
    true, odometry = (arcs(se2.steps(path_of(one)[index])) for one in (steps.true, steps.odometry))
    found, _ = robust_fit(odometry[:, [2, 0]], true[:, 2])
    return float(found[0])


def ends(one, other):
    """Squares and logarithms of the density of the other half's windows, by length."""
    windows = (predicted(one.fit, *pairs_of(other), length) for length in LENGTHS)
    return [found.squares(one.prediction.dispersion) for found in windows]


def figures(found):
    """The share of ends that are held and the mean density, of all windows of all halves."""
    squares, densities = (np.concatenate(columns) for columns in zip(*found))
    return np.mean(squares <= INSIDE), densities.mean()


def test_what_is_found_of_real_robots_and_how_it_predicts():
    found, apart = [], []
    for recording in find_recordings([Path(FOLDER)], ("", "")):
        if not Path(recording.name).name.startswith("mrclam"):
            continue
        steps = short_steps(take_steps(recording, StepSettings()))
        parts = [part_of(steps, number) for number in (0, 1)]
        whole, *halves = map(winner, (steps, *parts))
        (gain, error), (one, one_error), (two, two_error) = map(turn_gain, (whole, *halves))
        apart.append((gain - robust_gain(steps), error, one - two, np.hypot(one_error, two_error)))
        print(
            f"\n{Path(recording.name).name}: {whole.model}, turn gain {gain:.3f} ± "
            f"{1.96 * error:.3f}; halves {one:.3f}, {two:.3f}; "
            f"dispersions {[round(half.prediction.dispersion, 2) for half in halves]}"
        )
        found += [ends(half, other) for half, other in zip(halves, reversed(parts))]
    for length, *windows in zip(LENGTHS, *found):
        held, density = figures(windows)
        print(f"{length:g} m: {100 * held:.1f} % held, density {density:.2f}")
        low, high = SHARES[length]
        assert low <= held <= high
    off, error, between, both = np.array(apart).T
    assert (np.abs(off) < 1.96 * error).all()
    assert (np.abs(between) < 1.96 * both).all()
    assert (np.abs(off) < 0.02).sum() >= len(off) - 1
