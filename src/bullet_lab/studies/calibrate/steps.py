"""Steps of recordings: motions between the same stamps, by truth and by odometry.

A step is in the body frame at its begin, so that frames and full turns do not matter. Steps go
from stamp to stamp of the slower of the two paths; the faster one is interpolated, with a constant
velocity between two of its poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.parameters import boolean, number
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.likelihood import RESOLUTION
from bullet_lab.noise.systematic import arcs, chords
from bullet_lab.studies.calibrate.recordings import Recording
from bullet_lab.studies.paths import snapped

FEWEST_STEPS = 30
"""Smallest number of steps for a calibration."""

_STILL = 1e-6  # m and rad, motion of a robot at rest
_SLIP = 0.01  # m, true motion at which a step without odometry is counted
_WIDEST_OFFSET = 1.0  # s
_MOST_DECIMALS = 8
_MEDIAN = 0.6745  # of the magnitude of a standard normal number
_NOTEWORTHY = 1e-5  # m and rad, of the truth's noise
_TIMES = 100.0  # shortest step as a multiple of the truth's noise

# m and rad: equal except for rounding.
SAME = 1e-9
# m and rad in all, for a check of the scale.
LEAST_DISTANCE = 0.5
LEAST_TURN = 1.0
# Errors of real odometry are at most 20 %; mm and degrees are a factor of 57 and more.
LARGEST_SCALE = 2.0
# Of the distance, forwards and backwards, to fit both the gyro's bias and unequal wheels.
LEAST_SHARE = 0.05


class StepsError(LabError):
    """Truth and odometry do not match, or have too few steps in common."""


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
    find_offset: bool = boolean(False, "find time_offset, within a second of the given one")
    max_gap: float = number(
        5.0, "times the median time between poses after which some are missing", above=1.0
    )


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of some recordings.

    Attributes:
        true: (dx m, dy m, dyaw rad) in the body frame before each, shape (n, 3).
        odometry: the same by the odometry, shape (n, 3).
        follows: whether each begins at the end of the one before, shape (n,).
        seconds: duration of each, shape (n,).
        resting: number of other steps, in which the robot was at rest.
        gaps: number of steps over a gap.
        unseen: number of the resting steps in which the truth moved.
        truth_std_m: standard deviation of the truth's position.
        truth_std_rad: standard deviation of the truth's heading.
        remarks: lines for the user.
    """

    true: np.ndarray
    odometry: np.ndarray
    follows: np.ndarray
    seconds: np.ndarray
    resting: int
    gaps: int
    unseen: int
    truth_std_m: float
    truth_std_rad: float
    remarks: Tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.true)

    def go_both_ways(self) -> bool:
        """Return whether the robot drives both forwards and backwards.

        Otherwise the gyro's bias has the same effect as unequal wheels.
        """
        ahead = self.true[:, 0]
        less = min(ahead[ahead > 0.0].sum(), -ahead[ahead < 0.0].sum())
        return less >= LEAST_SHARE * np.abs(ahead).sum()

    def summary(self) -> Dict[str, Any]:
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

    def lines(self) -> List[str]:
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
        """Raise StepsError, with the likely cause, if odometry and truth do not match.

        Distance ahead and turn of the odometry are compared with the truth's by their regression,
        which noise of the odometry does not bias.
        """
        if np.abs(self.true - self.odometry).max(initial=0.0) <= SAME:
            raise StepsError("the odometry equals the truth: are both from one topic or column?")
        kinds = ((0, "distance", "m", LEAST_DISTANCE), (2, "turn", "rad", LEAST_TURN))
        for column, what, unit, least in kinds:
            true, odometry = self.true[:, column], self.odometry[:, column]
            if np.abs(true).sum() < least:
                continue
            share = float(true @ odometry / (true @ true))
            if share < 0.0:
                raise StepsError(
                    f"the odometry's {what} has the opposite sign of the truth's: "
                    f"is the sign of the {what}, or an axis, of one of them reversed?"
                )
            if not 1.0 / LARGEST_SCALE <= share <= LARGEST_SCALE:
                raise StepsError(
                    f"the odometry's {what} is {share:.3g} times the truth's; "
                    f"at most {LARGEST_SCALE:g} times is plausible: are both in {unit}?"
                )


def take_steps(recording: Recording, settings: StepSettings) -> Steps:
    """Return the steps of a recording.

    Raises:
        StepsError: the stamps have no time in common, or too short a one.
    """
    truth, odometry = recording.truth, recording.odometry
    odometry = _shifted(odometry, settings.time_offset)
    stamps = _common_stamps(truth, odometry, recording.name)
    remarks: List[str] = []
    offset, error = clock_offset(truth, odometry, stamps)
    whole = settings.time_offset + offset
    if settings.find_offset:
        odometry = _shifted(odometry, offset)
        stamps = _common_stamps(truth, odometry, recording.name)
        remarks.append(f"time_offset found: {whole:.4f} s, with a standard error of {error:.4f} s")
    elif abs(offset) > max(4.0 * error, 0.25 * float(np.median(np.diff(stamps)))):
        remarks.append(
            f"the odometry's clock seems to be {whole:.3f} s behind the truth's "
            f"(standard error {error:.3f} s): time_offset:={whole:.3f}, or find_offset:=true"
        )
    true_poses, poses = (interpolated(path, stamps) for path in (truth, odometry))
    broken = _over_gap(stamps, (truth, odometry), settings.max_gap)
    # The numbers of a made-up drive may be round without rounding: then the odometry's are not.
    least = min(map(resolution, (truth, odometry)))
    seen_m, seen_rad = jitter(truth)
    std_m = settings.truth_std_m or max(seen_m, least)
    std_rad = settings.truth_std_rad or max(seen_rad, least)
    if max(std_m, std_rad) > _NOTEWORTHY:
        settings = _long_enough(settings, true_poses, std_m, std_rad)
        remarks.append(_about_jitter(settings, std_m, std_rad))
    first, last = _ends(true_poses, broken, settings)
    true = se2.between(true_poses[first], true_poses[last])
    reported = se2.between(poses[first], poses[last])
    still = np.any([(np.abs(one) < _STILL).all(axis=1) for one in (true, reported)], axis=0)
    moving = np.flatnonzero(~still)
    follows = np.zeros(len(moving), dtype=bool)
    follows[1:] = first[moving[1:]] == last[moving[:-1]]
    return Steps(
        true=true[moving],
        odometry=reported[moving],
        follows=follows,
        seconds=(stamps[last] - stamps[first])[moving],
        resting=int(still.sum()),
        gaps=int(broken.sum()),
        unseen=int((still & (np.hypot(true[:, 0], true[:, 1]) > _SLIP)).sum()),
        truth_std_m=std_m,
        truth_std_rad=std_rad,
        remarks=tuple(f"{recording.name}: {remark}" for remark in remarks),
    )


def joined(found: Sequence[Steps]) -> Steps:
    """Return the steps of all recordings; raises StepsError if there are too few."""
    steps = Steps(
        *(
            np.concatenate([getattr(one, name) for one in found])
            for name in ("true", "odometry", "follows", "seconds")
        ),
        *(sum(getattr(one, name) for one in found) for name in ("resting", "gaps", "unseen")),
        truth_std_m=max(one.truth_std_m for one in found),
        truth_std_rad=max(one.truth_std_rad for one in found),
        remarks=tuple(remark for one in found for remark in one.remarks),
    )
    if len(steps) < FEWEST_STEPS:
        raise StepsError(
            f"{len(steps)} steps with a moving robot are too few: {FEWEST_STEPS} at least "
            f"({steps.resting} more stood still, {steps.gaps} went over a gap)"
        )
    return steps


def interpolated(path: Trajectory, stamps: np.ndarray) -> np.ndarray:
    """Return the poses (m, m, rad) at stamps within a path, shape (n, 3).

    Between two poses the robot drives the arc of a constant velocity; at the stamp of a pose the
    result is that pose, bit for bit.

    >>> path = Trajectory([0.0, 1.0], [(0.0, 0.0, 0.0), (2.0, 2.0, np.pi / 2.0)])
    >>> interpolated(path, np.array([0.0, 0.5])).round(3)
    array([[0.   , 0.   , 0.   ],
           [1.414, 0.586, 0.785]])
    """
    before = np.clip(np.searchsorted(path.stamps, stamps, side="right") - 1, 0, len(path) - 1)
    after = np.minimum(before + 1, len(path) - 1)
    seconds = np.where(after > before, path.stamps[after] - path.stamps[before], 1.0)
    share = (stamps - path.stamps[before]) / seconds
    whole = arcs(se2.between(path.poses[before], path.poses[after]))
    return se2.compose(path.poses[before], chords(share[:, np.newaxis] * whole))


def resolution(path: Trajectory) -> float:
    """Return the standard deviation (m or rad) of the rounding of a file's poses.

    >>> float(resolution(Trajectory([0.0, 1.0], [(0.0, 0.5, 0.0), (0.25, 1.0, 0.0)])))
    0.005773502691896258
    """
    places = path.poses[:, :2]
    for decimals in range(1, _MOST_DECIMALS + 1):
        if np.abs(places - places.round(decimals)).max() < 1e-3 * 10.0**-decimals:
            # The rounding of a quaternion has twice the effect on the heading.
            return 2.0 * 10.0**-decimals / np.sqrt(12.0)
    return RESOLUTION


def jitter(path: Trajectory) -> Tuple[float, float]:
    """Return the standard deviation of white noise on a path, m and rad; 0 without noise.

    Differences of the third and the fourth order of a smooth path are small, the latter smaller.
    Those of white noise have sqrt(20) and sqrt(70) times its standard deviation. Their medians are
    not affected by starts and stops of the robot.

    >>> jitter(Trajectory(np.arange(9.0), np.tile([0.5, 0.0, 0.0], (9, 1)) * np.arange(9)[:, None]))
    (0.0, 0.0)
    """
    if len(path) < FEWEST_STEPS:
        return 0.0, 0.0
    columns = np.column_stack((path.poses[:, :2], np.unwrap(path.poses[:, 2])))
    third, fourth = (
        np.median(np.abs(np.diff(columns, order, axis=0)), axis=0) / (_MEDIAN * np.sqrt(scale))
        for order, scale in ((3, 20.0), (4, 70.0))
    )
    x_std, y_std, yaw_std = np.where(fourth > 0.7 * third, fourth, 0.0).tolist()
    return float(np.sqrt(0.5 * (x_std**2 + y_std**2))), yaw_std


def _long_enough(
    settings: StepSettings, poses: np.ndarray, std_m: float, std_rad: float
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


def clock_offset(truth: Trajectory, odometry: Trajectory, stamps: np.ndarray):
    """Return the delay (s) of the odometry's clock behind the truth's, and its standard error.

    It is the offset, within a second, for which distances and turns of both are most similar. The
    standard error is infinite if the motion does not determine it.
    """
    period = float(np.median(np.diff(stamps)))
    # Long enough to average the noise of single messages.
    window = max(4.0 * period, 0.5)
    inside = (stamps > stamps[0] + _WIDEST_OFFSET) & (
        stamps < stamps[-1] - window - _WIDEST_OFFSET
    )
    begins = stamps[inside]
    if len(begins) < FEWEST_STEPS:
        return 0.0, np.inf
    reported = _motion(odometry, begins, window)
    scale = np.std(reported, axis=0) + 1e-3

    def dissimilarity(offset: float) -> float:
        difference = (_motion(truth, begins + offset, window) - reported) / scale
        # Without the mean difference, which comes from errors of scale.
        return float(np.sum(np.square(difference - difference.mean(axis=0))))

    spacing = 0.5 * period
    count = int(_WIDEST_OFFSET / spacing)
    offsets = spacing * np.arange(-count, count + 1)
    sums = np.array([dissimilarity(offset) for offset in offsets])
    best = int(np.argmin(sums))
    if best in (0, len(offsets) - 1):
        return 0.0, np.inf
    low, middle, high = sums[best - 1 : best + 2]
    curvature = (low - 2.0 * middle + high) / spacing**2
    if curvature <= 0.0:
        return 0.0, np.inf
    offset = offsets[best] + 0.5 * spacing * (low - high) / (low - 2.0 * middle + high)
    # Windows overlap, so that fewer are independent.
    independent = 2.0 * len(begins) * period / window
    return float(offset), float(np.sqrt(2.0 * middle / max(independent, 1.0) / curvature))


def _motion(path: Trajectory, begins: np.ndarray, window: float) -> np.ndarray:
    """Return the distances and turns of a robot within windows of time, (n, 2), in any frame."""
    dx, dy, turns = (
        np.interp(begins + window, path.stamps, column) - np.interp(begins, path.stamps, column)
        for column in (*path.poses[:, :2].T, np.unwrap(path.poses[:, 2]))
    )
    return np.column_stack((np.hypot(dx, dy), turns))


def _shifted(path: Trajectory, seconds: float) -> Trajectory:
    return Trajectory(path.stamps + seconds, path.poses) if seconds else path


def _common_stamps(truth: Trajectory, odometry: Trajectory, name: str) -> np.ndarray:
    """Return the stamps of the slower path within the times of both."""
    start = max(truth.stamps[0], odometry.stamps[0])
    end = min(truth.stamps[-1], odometry.stamps[-1])
    if end <= start:
        raise StepsError(
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
        raise StepsError(f"{name}: truth and odometry have fewer than two poses in common")
    return snapped(stamps, (truth, odometry)[1 - slower].stamps)


def _over_gap(stamps: np.ndarray, paths: Sequence[Trajectory], most: float) -> np.ndarray:
    """Return whether each step between neighbouring stamps is over a gap of a path, (n-1,)."""
    broken = np.zeros(len(stamps) - 1, dtype=bool)
    for path in paths:
        waits = np.diff(path.stamps)
        gaps = np.flatnonzero(waits > most * np.median(waits))
        begin, end = path.stamps[gaps], path.stamps[gaps + 1]
        later = np.searchsorted(end, stamps[:-1], side="right")
        known = later < len(gaps)
        broken[known] |= begin[later[known]] < stamps[1:][known]
    return broken


def _ends(poses: np.ndarray, broken: np.ndarray, settings: StepSettings):
    """Return the indices of the poses at the begin and the end of each step, (n,) and (n,)."""
    if settings.min_distance == 0.0 and settings.min_angle == 0.0:
        whole = np.flatnonzero(~broken)
        return whole, whole + 1
    distance = settings.min_distance or np.inf
    angle = settings.min_angle or np.inf
    first, last, begin = [], [], 0
    for index in range(1, len(poses)):
        if broken[index - 1]:
            begin = index
            continue
        dx, dy, dyaw = poses[index] - poses[begin]
        if np.hypot(dx, dy) >= distance or abs(se2.wrap(float(dyaw))) >= angle:
            first.append(begin)
            last.append(index)
            begin = index
    return np.array(first, dtype=int), np.array(last, dtype=int)
