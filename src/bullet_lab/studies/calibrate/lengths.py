"""Short and long steps, made of those between messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.systematic import end_of
from bullet_lab.studies.calibrate.alignment import joined_ends
from bullet_lab.studies.calibrate.steps import Steps

SHORT = (0.02, 0.04)
"""m and rad, within which a motion is taken as an arc."""

LONG = ((0.5, 1.0), (0.25, 0.5), (0.125, 0.25))
"""m and rad of long steps: errors within them are not those that remain after some metres."""

LEAST_STD = 3e-3
"""m and rad: standard deviation of the ends of long steps, at least.

A robot that turns on the spot has no way, and a random walk no noise of it.
"""

FEWEST_LONG = 36
"""Of the long steps of a fit."""


def long_length(short: Steps) -> Tuple[float, float]:
    """Return the longest of `LONG` of which there are enough; 0, 0 if there is none."""
    for length in LONG:
        if len(joined_ends(short.true, short.follows, *length)[0]) >= FEWEST_LONG:
            return length
    return 0.0, 0.0


def short_steps(steps: Steps) -> Steps:
    """Return steps between messages joined to steps of `SHORT`; longer ones are kept."""
    first, last = joined_ends(steps.true, steps.follows, *SHORT)
    true, odometry = (end_of(_within(one, first, last)) for one in (steps.true, steps.odometry))
    return replace(
        steps,
        true=_wrapped(true),
        odometry=_wrapped(odometry),
        follows=_follows(steps, first, last),
        seconds=np.add.reduceat(steps.seconds, first) if len(first) else steps.seconds[:0],
    )


def pairs_of(steps: Steps) -> StepPairs:
    """Return the steps for a likelihood."""
    return StepPairs(
        steps.true, steps.odometry[np.newaxis], steps.truth_std_m, steps.truth_std_rad
    )


def long_pairs(short: Steps, length: Tuple[float, float]) -> Tuple[StepPairs, np.ndarray]:
    """Return long steps that consist of short ones, and whether each follows the one before.

    Args:
        short: as of `short_steps`.
        length: m and rad after which a long step ends; 0, 0: with each short one.
    """
    first, last = joined_ends(short.true, short.follows, *length)
    within = _within(short.true, first, last)
    reported = _wrapped(end_of(_within(short.odometry, first, last)))
    pairs = StepPairs(
        _wrapped(end_of(within)),
        reported[np.newaxis],
        max(short.truth_std_m, LEAST_STD),
        max(short.truth_std_rad, LEAST_STD),
        within,
    )
    return pairs, _follows(short, first, last)


def part_of(steps: Steps, number: int) -> Steps:
    """Return the first (0) or the second half (1) of steps."""
    middle = len(steps) // 2
    rows = slice(None, middle) if number == 0 else slice(middle, None)
    names = ("true", "odometry", "follows", "seconds")
    return replace(steps, **{name: getattr(steps, name)[rows] for name in names})


def _within(rows: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the rows of each joined step, filled up with zeros, (n, m, 3)."""
    counts = last - first
    found = np.zeros((len(first), int(counts.max(initial=1)), 3))
    for number, (begin, end) in enumerate(zip(first, last)):
        found[number, : end - begin] = rows[begin:end]
    return found


def _follows(steps: Steps, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    found = np.zeros(len(first), dtype=bool)
    found[1:] = (first[1:] == last[:-1]) & steps.follows[first[1:]]
    return found


def _wrapped(steps: np.ndarray) -> np.ndarray:
    steps[:, 2] = se2.wrap(steps[:, 2])
    return steps
