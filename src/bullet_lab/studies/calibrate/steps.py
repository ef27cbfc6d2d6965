"""Steps of recordings: motions between the same stamps, by truth and by odometry.

A step is in the body frame at its begin, so that frames and full turns do not matter. Steps go
from stamp to stamp of the slower of the two paths; the faster one is interpolated, with a constant
velocity between two of its poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Sequence

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.parameters import boolean, number
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.systematic import end_of
from bullet_lab.studies.calibrate.alignment import (
    FEWEST_STEPS,
    SURE,
    clock_offset,
    interpolated,
    jitter,
    joined_ends,
    marker_place,
    resolution,
)
from bullet_lab.studies.paths import Recording, snapped

_STILL = 1e-6  # m and rad, motion of a robot at rest
_SLIP = 0.01  # m, true motion at which a step without odometry is counted
# Of the times between poses: longer ones are rare.
_MOST_WAITS = 0.98
_NOTEWORTHY = 1e-5  # m and rad, of the truth's noise
_TIMES = 100.0  # shortest step as a multiple of the truth's noise

SHORT = (0.02, 0.04)
"""m and rad, within which a motion is taken as an arc."""

LONG = ((0.5, 1.0), (0.25, 0.5), (0.125, 0.25))
"""m and rad of long steps: errors within them are not those that remain after some metres."""

EACH = (0.0, 0.0)
"""The length of steps that are not joined."""

LEAST_STD = 3e-3
"""m and rad: standard deviation of the ends of long steps, at least.

A robot that turns on the spot has no way, and a random walk no noise of it.
"""

FEWEST_LONG = 36
"""Of the long steps of a fit."""

# m and rad: equal except for rounding.
SAME = 1e-9
# m and rad in all, for a check of the scale.
LEAST_DISTANCE = 0.5
LEAST_TURN = 1.0
# Errors of real odometry are at most 20 %; mm and degrees are a factor of 57 and more.
LARGEST_SCALE = 2.0
# Of the distance, forwards and backwards, to fit both the gyro's bias and unequal wheels.
LEAST_SHARE = 0.05

# Fields of `Steps` with a row for each step.
_ROWS = ("true", "odometry", "follows", "seconds")


@dataclass(frozen=True)
class StepSettings:
    """Noise of the truth, length of steps, and offset of the clocks."""

    truth_std_m: float = number(
        0.0, "standard deviation of the truth's position, m; 0: by its jitter and digits", 0.0
    )
    truth_std_rad: float = number(
        0.0, "standard deviation of the truth's heading, rad; 0: by its jitter and digits", 0.0
    )
    min_distance: float = number(
        0.0, "m to go before a step ends; 0: a message, or by the truth's jitter", 0.0
    )
    min_angle: float = number(
        0.0, "rad to turn before a step ends; 0: a message, or by the jitter", 0.0
    )
    time_offset: float = number(0.0, "s that the odometry's clock is behind the truth's")
    find_offset: bool = boolean(True, "correct what is left of time_offset, up to a second")
    find_marker: bool = boolean(True, "correct for the place of the truth's point on the robot")
    max_gap: float = number(
        5.0, "times the usual time between poses after which some are missing", above=1.0
    )


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of some recordings.

    Attributes:
        true: (dx m, dy m, dyaw rad) in the body frame before each, shape (n, 3).
        odometry: the same by the odometry, shape (n, 3).
        follows: whether each begins at the end of the one before, shape (n,).
        seconds: duration of each, shape (n,).
        resting: number of other steps, in which the robot was at rest: they are parts of the next.
        gaps: number of steps over a gap.
        unseen: number of the resting steps in which the truth moved.
        truth_std_m: standard deviation of the truth's position.
        truth_std_rad: standard deviation of the truth's heading.
        remarks: lines for the user.
    """

    true: ndarray
    odometry: ndarray
    follows: ndarray
    seconds: ndarray
    resting: int
    gaps: int
    unseen: int
    truth_std_m: float
    truth_std_rad: float
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.true)

    def go_both_ways(self) -> bool:
        """Return whether the robot drives both forwards and backwards.

        Otherwise the gyro's bias has the same effect as unequal wheels.
        """
        ahead = self.true[:, 0]
        less = min(ahead[ahead > 0.0].sum(), -ahead[ahead < 0.0].sum())
        return less >= LEAST_SHARE * np.abs(ahead).sum()

    def summary(self) -> dict[str, Any]:
        """Return the figures for summary.json."""
        return {
            "count": len(self),
            "median_s": float(np.median(self.seconds)),
            "length_m": float(np.hypot(self.true[:, 0], self.true[:, 1]).sum()),
            "turned_rad": float(np.abs(self.true[:, 2]).sum()),
            "resting": self.resting,
            "over_gaps": self.gaps,
            "moved_unseen": self.unseen,
            "truth_std_m": self.truth_std_m,
            "truth_std_rad": self.truth_std_rad,
            "remarks": self.remarks,
        }

    def lines(self) -> list[str]:
        """Return the numbers and the remarks as lines for the user."""
        about = self.summary()
        found = [
            f"{len(self)} steps of {about['median_s']:.3g} s, {about['length_m']:.1f} m and "
            f"{about['turned_rad']:.1f} rad in all; {self.resting} more stood still, "
            f"{self.gaps} went over a gap"
        ]
        if self.unseen:
            found.append(
                f"in {self.unseen} steps the truth moved and the odometry did not: "
                "they are left out"
            )
        return [*found, *self.remarks]

    def check(self) -> None:
        """Raise LabError, with the likely cause, if odometry and truth do not match.

        Distance ahead and turn of the odometry are compared with the truth's by their regression,
        which noise of the odometry does not bias.
        """
        if np.abs(self.true - self.odometry).max(initial=0.0) <= SAME:
            raise LabError("the odometry equals the truth: are both from one topic or column?")
        kinds = ((0, "distance", "m", LEAST_DISTANCE), (2, "turn", "rad", LEAST_TURN))
        for column, what, unit, least in kinds:
            true, odometry = self.true[:, column], self.odometry[:, column]
            if np.abs(true).sum() < least:
                continue
            share = float(true @ odometry / (true @ true))
            if share < 0.0:
                raise LabError(
                    f"the odometry's {what} has the opposite sign of the truth's: "
                    f"is the sign of the {what}, or an axis, of one of them reversed?"
                )
            if not 1.0 / LARGEST_SCALE <= share <= LARGEST_SCALE:
                raise LabError(
                    f"the odometry's {what} is {share:.3g} times the truth's; "
                    f"at most {LARGEST_SCALE:g} times is plausible: are both in {unit}?"
                )


def take_steps(recording: Recording, settings: StepSettings) -> Steps:
    """Return the steps of a recording.

    Raises:
        LabError: the stamps have no time in common, or too short a one.
    """
    truth, odometry = recording.truth, recording.odometry
    odometry = replace(odometry, stamps=odometry.stamps + settings.time_offset)
    stamps = _common_stamps(truth, odometry, recording.name)
    remarks = [
        f"{name}: {path.remark}"
        for name, path in (("truth", truth), ("odometry", odometry))
        if path.remark
    ]
    offset, error = clock_offset(truth, odometry, stamps)
    if abs(offset) > max(SURE * error, 0.25 * float(np.median(np.diff(stamps)))):
        whole, reach = settings.time_offset + offset, 1.96 * error
        remarks.append(
            f"the odometry's clock is {whole:.3f} s behind the truth's "
            f"(95 % {whole - reach:.3f} to {whole + reach:.3f} s); "
            + ("corrected" if settings.find_offset else f"time_offset:={whole:.3f} corrects it")
        )
        if settings.find_offset:
            odometry = replace(odometry, stamps=odometry.stamps + offset)
            stamps = _common_stamps(truth, odometry, recording.name)
    true_poses, poses = (interpolated(path, stamps) for path in (truth, odometry))
    if settings.find_marker:
        place, error = marker_place(true_poses, poses, stamps)
        if place.any():
            true_poses = se2.compose(true_poses, se2.inverse(place))
            remarks.append(_about_marker(place, error))
    broken = _over_gap(stamps, (truth, odometry), settings.max_gap)
    # The numbers of a made-up drive may be round without rounding: then the odometry's are not.
    least = min(map(resolution, (truth, odometry)))
    follows = ~broken & np.concatenate(([False], ~broken[:-1]))
    seen_m, seen_rad = jitter(se2.steps(true_poses), se2.steps(poses), follows)
    std_m = settings.truth_std_m or max(seen_m, least)
    std_rad = settings.truth_std_rad or max(seen_rad, least)
    if max(std_m, std_rad) > _NOTEWORTHY:
        settings = _long_enough(settings, true_poses, std_m, std_rad)
        remarks.append(_about_jitter(settings, std_m, std_rad))
    whole = np.flatnonzero(~broken)
    # A length that is not given ends no step that the other one does not end.
    lengths = settings.min_distance, settings.min_angle
    lengths = tuple(one or np.inf for one in lengths) if any(lengths) else lengths
    first, last = joined_ends(se2.steps(true_poses)[whole], follows[whole], *lengths)
    first, last = whole[first], whole[last - 1] + 1
    true = se2.between(true_poses[first], true_poses[last])
    reported = se2.between(poses[first], poses[last])
    still = np.any([(np.abs(one) < _STILL).all(axis=1) for one in (true, reported)], axis=0)
    unseen = still & (np.hypot(true[:, 0], true[:, 1]) > _SLIP)
    moving = np.flatnonzero(~still)
    # A rest belongs to the step after it, as the robot may come to a stop unseen.
    apart = np.cumsum(unseen | (first != np.concatenate(([-1], last[:-1]))))[moving]
    follows = np.zeros(len(moving), dtype=bool)
    follows[1:] = apart[1:] == apart[:-1]
    first, last = first[moving], last[moving]
    first[1:] = np.where(follows[1:], last[:-1], first[1:])
    return Steps(
        true=se2.between(true_poses[first], true_poses[last]),
        odometry=se2.between(poses[first], poses[last]),
        follows=follows,
        seconds=stamps[last] - stamps[first],
        resting=int(still.sum()),
        gaps=int(broken.sum()),
        unseen=int(unseen.sum()),
        truth_std_m=std_m,
        truth_std_rad=std_rad,
        remarks=tuple(f"{recording.name}: {remark}" for remark in remarks),
    )


def joined(found: Sequence[Steps]) -> Steps:
    """Return the steps of all recordings; raises LabError if there are too few."""
    steps = Steps(
        *(np.concatenate([getattr(one, name) for one in found]) for name in _ROWS),
        *(sum(getattr(one, name) for one in found) for name in ("resting", "gaps", "unseen")),
        truth_std_m=max(one.truth_std_m for one in found),
        truth_std_rad=max(one.truth_std_rad for one in found),
        remarks=tuple(remark for one in found for remark in one.remarks),
    )
    if len(steps) < FEWEST_STEPS:
        raise LabError(
            f"{len(steps)} steps with a moving robot are too few: {FEWEST_STEPS} at least "
            f"({steps.resting} more stood still, {steps.gaps} went over a gap)"
        )
    return steps


def _long_enough(
    settings: StepSettings, poses: ndarray, std_m: float, std_rad: float
) -> StepSettings:
    """Return the settings with steps that are long compared with the truth's noise.

    Given lengths of steps are kept.
    """
    if settings.min_distance or settings.min_angle:
        return settings
    steps = np.abs(se2.steps(poses))
    distance, angle = _TIMES * std_m, _TIMES * std_rad
    if np.median(np.maximum(steps[:, 0] / distance, steps[:, 2] / angle)) >= 1.0:
        return settings
    return replace(settings, min_distance=distance, min_angle=angle)


def _about_jitter(settings: StepSettings, std_m: float, std_rad: float) -> str:
    noise = f"the truth has noise of {1e3 * std_m:.2g} mm and {1e3 * std_rad:.2g} mrad"
    if not (settings.min_distance or settings.min_angle):
        return noise
    return (
        f"{noise}; steps end after {settings.min_distance:.3g} m or {settings.min_angle:.3g} rad "
        "(min_distance, min_angle)"
    )


def _about_marker(place: Sequence[float], error: Sequence[float]) -> str:
    x, y, yaw = (
        f"{scale * value:.1f} ± {1.96 * scale * spread:.1f}" if value else "0"
        for value, spread, scale in zip(place, error, (1e3, 1e3, np.degrees(1.0)))
    )
    return (
        f"the truth's point is {x} mm ahead of the axle, {y} mm to its left, and turned by {yaw}° "
        "(95 %); corrected"
    )


def _common_stamps(truth: Trajectory, odometry: Trajectory, name: str) -> ndarray:
    """Return the stamps of the slower path within the times of both."""
    start = max(truth.stamps[0], odometry.stamps[0])
    end = min(truth.stamps[-1], odometry.stamps[-1])
    if end <= start:
        raise LabError(
            f"{name}: truth (stamps {truth.stamps[0]:.3f} to {truth.stamps[-1]:.3f} s) and "
            f"odometry ({odometry.stamps[0]:.3f} to {odometry.stamps[-1]:.3f} s) have no time in "
            "common; time_offset is added to the odometry's"
        )
    inside = [
        path.stamps[(path.stamps >= start) & (path.stamps <= end)] for path in (truth, odometry)
    ]
    slower = int(len(inside[1]) <= len(inside[0]))
    stamps = inside[slower]
    if len(stamps) < 2:
        raise LabError(f"{name}: truth and odometry have fewer than two poses in common")
    return snapped(stamps, (truth, odometry)[1 - slower].stamps)


def _over_gap(stamps: ndarray, paths: Sequence[Trajectory], most: float) -> ndarray:
    """Return whether each step between neighbouring stamps is over a gap of a path, (n-1,)."""
    broken = np.zeros(len(stamps) - 1, dtype=bool)
    for path in paths:
        waits = np.diff(path.stamps)
        # The median is no measure of a log that comes in bursts.
        usual = np.sort(waits)[int(_MOST_WAITS * (len(waits) - 1))]
        gaps = np.flatnonzero(waits > most * usual)
        begin, end = path.stamps[gaps], path.stamps[gaps + 1]
        later = np.searchsorted(end, stamps[:-1], side="right")
        known = later < len(gaps)
        broken[known] |= begin[later[known]] < stamps[1:][known]
    return broken


def long_length(short: Steps) -> tuple[float, float]:
    """Return the longest of `LONG` of which there are enough; `EACH` if there is none."""
    counts = (len(joined_ends(short.true, short.follows, *length)[0]) for length in LONG)
    return next((length for length, n in zip(LONG, counts) if n >= FEWEST_LONG), EACH)


def short_steps(steps: Steps) -> Steps:
    """Return steps between messages joined to steps of `SHORT`; longer ones are kept."""
    first, last = joined_ends(steps.true, steps.follows, *SHORT)
    true, odometry = (end_of(_within(one, first, last)) for one in (steps.true, steps.odometry))
    return replace(
        steps,
        true=se2.wrapped(true),
        odometry=se2.wrapped(odometry),
        follows=_follows(steps, first, last),
        seconds=np.add.reduceat(steps.seconds, first) if len(first) else steps.seconds[:0],
    )


def pairs_of(short: Steps, length: tuple[float, float] = EACH) -> tuple[StepPairs, ndarray]:
    """Return steps for a likelihood, and whether each follows the one before.

    Args:
        short: as of `short_steps`.
        length: m and rad after which a long step ends, which consists of short ones.
    """
    if length == EACH:
        stds = short.truth_std_m, short.truth_std_rad
        return StepPairs(short.true, short.odometry[np.newaxis], *stds), short.follows
    first, last = joined_ends(short.true, short.follows, *length)
    within = _within(short.true, first, last)
    reported = se2.wrapped(end_of(_within(short.odometry, first, last)))
    pairs = StepPairs(
        se2.wrapped(end_of(within)),
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
    return replace(steps, **{name: getattr(steps, name)[rows] for name in _ROWS})


def _within(rows: ndarray, first: ndarray, last: ndarray) -> ndarray:
    """Return the rows of each joined step, filled up with zeros, (n, m, 3)."""
    counts = last - first
    found = np.zeros((len(first), int(counts.max(initial=1)), 3))
    for row, begin, end in zip(found, first, last):
        row[: end - begin] = rows[begin:end]
    return found


def _follows(steps: Steps, first: ndarray, last: ndarray) -> ndarray:
    found = np.zeros(len(first), dtype=bool)
    found[1:] = (first[1:] == last[:-1]) & steps.follows[first[1:]]
    return found
