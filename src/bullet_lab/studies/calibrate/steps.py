"""Steps of recordings: what truth and odometry say of the same moments.

Only steps are compared, each in the body frame before it, so neither where a path starts in its
frame nor a yaw beyond a turn matters. Steps go from stamp to stamp of the slower of the two; the
faster one is interpolated, at a constant velocity between two of its poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Sequence, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.parameters import boolean, number
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.noise.likelihood import RESOLUTION
from bullet_lab.noise.systematic import arcs, chords
from bullet_lab.studies.calibrate.recordings import Recording
from bullet_lab.studies.noise_study.paths import snapped

FEWEST_STEPS = 30
"""Of fewer, no more could be said than that they are few."""

_STILL = 1e-6  # m and rad; who moves less stands
_SLIP = 0.01  # m; more than this in a step that odometry saw nothing of
_WIDEST_OFFSET = 1.0
_MOST_DECIMALS = 8
_MEDIAN = 0.6745  # of the size of a standard normal number
_NOTEWORTHY = 1e-5  # m and rad, of the truth's noise
_TIMES = 100.0  # so many times the truth's noise is a step at least


class StepsError(LabError):
    """Two paths have no steps in common, or too few."""


@dataclass(frozen=True)
class StepSettings:
    """How steps are taken from truth and odometry."""

    truth_std_m: float = number(
        0.0, "standard deviation of the truth's position, m; 0: by its jitter and digits", 0.0
    )
    truth_std_rad: float = number(
        0.0, "standard deviation of the truth's heading, rad; 0: by its jitter and digits", 0.0
    )
    min_distance: float = number(
        0.0, "m to go before a step ends; 0: a message, or as the truth's jitter asks for", 0.0
    )
    min_angle: float = number(
        0.0, "rad to turn before a step ends; 0: a message, or as the jitter asks for", 0.0
    )
    time_offset: float = number(0.0, "s that the odometry's clock is behind the truth's")
    find_offset: bool = boolean(False, "find time_offset, within a second of what is said")
    max_gap: float = number(
        5.0, "times the usual time between poses after which some are missing", above=1.0
    )


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of some recordings.

    Attributes:
        true: (dx m, dy m, dyaw rad) in the body frame before each, shape (n, 3).
        odometry: the same by the odometry, shape (n, 3).
        follows: whether each begins where the one before it ended, shape (n,).
        seconds: how long each takes, shape (n,).
        resting: how many more there were in which the robot stood still.
        gaps: how many went over a gap.
        unseen: in how many of the resting ones the truth moved all the same.
        truth_std_m: standard deviation of the truth's position.
        truth_std_rad: standard deviation of the truth's heading.
        remarks: what should be said of them.
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
    if settings.find_offset:
        odometry = _shifted(odometry, offset)
        stamps = _common_stamps(truth, odometry, recording.name)
        whole = settings.time_offset + offset
        remarks.append(f"time_offset found: {whole:.4f} s, with a standard error of {error:.4f} s")
    elif abs(offset) > max(4.0 * error, 0.25 * float(np.median(np.diff(stamps)))):
        whole = settings.time_offset + offset
        remarks.append(
            f"the odometry's clock seems to be {whole:.3f} s behind the truth's "
            f"(standard error {error:.3f} s): time_offset:={whole:.3f}, or find_offset:=true"
        )
    there, seen = (interpolated(path, stamps) for path in (truth, odometry))
    broken = _over_gap(stamps, (truth, odometry), settings.max_gap)
    noise, jitters = _truth_noise(truth, odometry, settings)
    settings = replace(settings, truth_std_m=noise[0], truth_std_rad=noise[1])
    if jitters:
        settings = _long_enough(settings, there)
        remarks.append(_about_jitter(settings))
    first, last = _ends(there, broken, settings)
    true, said = se2.between(there[first], there[last]), se2.between(seen[first], seen[last])
    still = _still(true) | _still(said)
    moving = np.flatnonzero(~still)
    follows = np.zeros(len(moving), dtype=bool)
    follows[1:] = first[moving[1:]] == last[moving[:-1]]
    return Steps(
        true=true[moving],
        odometry=said[moving],
        follows=follows,
        seconds=(stamps[last] - stamps[first])[moving],
        resting=int(still.sum()),
        gaps=int(broken.sum()),
        unseen=int((still & (np.hypot(true[:, 0], true[:, 1]) > _SLIP)).sum()),
        truth_std_m=noise[0],
        truth_std_rad=noise[1],
        remarks=tuple(f"{recording.name}: {remark}" for remark in remarks),
    )


def joined(found: Sequence[Steps]) -> Steps:
    """Return the steps of all; raises StepsError where they are too few."""
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

    Between two poses the robot goes on the arc that a constant velocity makes; at the stamp of a
    pose it is that pose, bit for bit.

    >>> path = Trajectory([0.0, 1.0], [(0.0, 0.0, 0.0), (2.0, 2.0, np.pi / 2.0)])
    >>> interpolated(path, np.array([0.0, 0.5])).round(3)
    array([[0.   , 0.   , 0.   ],
           [1.414, 0.586, 0.785]])
    """
    before = np.clip(np.searchsorted(path.stamps, stamps, side="right") - 1, 0, len(path) - 1)
    after = np.minimum(before + 1, len(path) - 1)
    seconds = np.where(after > before, path.stamps[after] - path.stamps[before], 1.0)
    share = (stamps - path.stamps[before]) / seconds
    way = arcs(se2.between(path.poses[before], path.poses[after]))
    return se2.compose(path.poses[before], chords(share[:, np.newaxis] * way))


def resolution(path: Trajectory) -> float:
    """Return the standard deviation that the digits of a file give to its poses, m or rad.

    >>> resolution(Trajectory([0.0, 1.0], [(0.0, 0.5, 0.0), (0.25, 1.0, 0.0)]))
    0.005773502691896258
    """
    places = path.poses[:, :2]
    for decimals in range(1, _MOST_DECIMALS + 1):
        if np.abs(places - places.round(decimals)).max() < 1e-3 * 10.0**-decimals:
            # A quaternion's digits give twice as much to the heading.
            return 2.0 * 10.0**-decimals / np.sqrt(12.0)
    return RESOLUTION


def jitter(path: Trajectory) -> Tuple[float, float]:
    """Return the standard deviation of white noise on a path, m and rad; 0 where none is seen.

    Differences of the third and of the fourth order of a smooth path are small, and ever smaller;
    those of white noise have sqrt(20) and sqrt(70) times its standard deviation. Their medians
    pass over where the robot starts and stops.

    >>> jitter(Trajectory(np.arange(9.0), np.tile([0.5, 0.0, 0.0], (9, 1)) * np.arange(9)[:, None]))
    (0.0, 0.0)
    """
    x, y, yaw = path.poses[:, 0], path.poses[:, 1], np.unwrap(path.poses[:, 2])
    if len(path) < FEWEST_STEPS:
        return 0.0, 0.0
    x_std, y_std, yaw_std = (_white(column) for column in (x, y, yaw))
    return float(np.sqrt(0.5 * (x_std**2 + y_std**2))), yaw_std


def _white(values: np.ndarray) -> float:
    third, fourth = (
        float(np.median(np.abs(np.diff(values, order)))) / (_MEDIAN * np.sqrt(scale))
        for order, scale in ((3, 20.0), (4, 70.0))
    )
    return fourth if fourth > 0.7 * third else 0.0


def _truth_noise(truth: Trajectory, odometry: Trajectory, settings: StepSettings):
    """Return the standard deviations of the truth, m and rad, and whether they are to be seen."""
    # A drive that was made up may be round; where the other path is not, digits were not cut.
    least = min(map(resolution, (truth, odometry)))
    seen_m, seen_rad = jitter(truth)
    std_m = settings.truth_std_m or max(seen_m, least)
    std_rad = settings.truth_std_rad or max(seen_rad, least)
    return (std_m, std_rad), max(std_m, std_rad) > _NOTEWORTHY


def _long_enough(settings: StepSettings, poses: np.ndarray) -> StepSettings:
    """Have steps so long that the truth's noise is small beside them, where nobody says else."""
    if settings.min_distance or settings.min_angle:
        return settings
    steps = np.abs(se2.steps(poses))
    distance, angle = _TIMES * settings.truth_std_m, _TIMES * settings.truth_std_rad
    if np.median(np.maximum(steps[:, 0] / distance, steps[:, 2] / angle)) >= 1.0:
        return settings
    return replace(settings, min_distance=distance, min_angle=angle)


def _about_jitter(settings: StepSettings) -> str:
    said = (
        f"the truth has noise of {1e3 * settings.truth_std_m:.2g} mm and "
        f"{1e3 * settings.truth_std_rad:.2g} mrad"
    )
    if not (settings.min_distance or settings.min_angle):
        return said
    return (
        f"{said}; steps end after {settings.min_distance:.3g} m or {settings.min_angle:.3g} rad "
        "(min_distance, min_angle)"
    )


def clock_offset(truth: Trajectory, odometry: Trajectory, stamps: np.ndarray):
    """Return by how many s the odometry's clock is behind the truth's, and the standard error.

    It is where ways and turns of both are most alike, within a second. Infinite is the error
    where too little happens to tell.
    """
    period = float(np.median(np.diff(stamps)))
    # Long enough for the noise of single messages to matter little.
    window = max(4.0 * period, 0.5)
    inside = (stamps > stamps[0] + _WIDEST_OFFSET) & (
        stamps < stamps[-1] - window - _WIDEST_OFFSET
    )
    begins = stamps[inside]
    if len(begins) < FEWEST_STEPS:
        return 0.0, np.inf
    said = _motion(odometry, begins, window)
    scale = np.std(said, axis=0) + 1e-3

    def unlike(offset: float) -> float:
        difference = (_motion(truth, begins + offset, window) - said) / scale
        # What is usually off, by noise and by scales, shall not drown when.
        return float(np.sum(np.square(difference - difference.mean(axis=0))))

    spacing = 0.5 * period
    count = int(_WIDEST_OFFSET / spacing)
    offsets = spacing * np.arange(-count, count + 1)
    sums = np.array([unlike(offset) for offset in offsets])
    best = int(np.argmin(sums))
    if best in (0, len(offsets) - 1):
        return 0.0, np.inf
    low, middle, high = sums[best - 1 : best + 2]
    curvature = (low - 2.0 * middle + high) / spacing**2
    if curvature <= 0.0:
        return 0.0, np.inf
    offset = offsets[best] + 0.5 * spacing * (low - high) / (low - 2.0 * middle + high)
    # Windows overlap: so many stand for one.
    independent = 2.0 * len(begins) * period / window
    return float(offset), float(np.sqrt(2.0 * middle / max(independent, 1.0) / curvature))


def _motion(path: Trajectory, begins: np.ndarray, window: float) -> np.ndarray:
    """Return how far a robot goes and turns within a time, (n, 2); any frame will do."""
    x, y = (np.interp(begins, path.stamps, column) for column in path.poses[:, :2].T)
    x_end, y_end = (np.interp(begins + window, path.stamps, c) for c in path.poses[:, :2].T)
    heading = np.unwrap(path.poses[:, 2])
    turns = np.interp(begins + window, path.stamps, heading) - np.interp(
        begins, path.stamps, heading
    )
    return np.column_stack((np.hypot(x_end - x, y_end - y), turns))


def _shifted(path: Trajectory, seconds: float) -> Trajectory:
    return Trajectory(path.stamps + seconds, path.poses) if seconds else path


def _common_stamps(truth: Trajectory, odometry: Trajectory, name: str) -> np.ndarray:
    """Return the stamps of the slower path at which there are both."""
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
        raise StepsError(f"{name}: truth and odometry have less than two poses in common")
    return snapped(stamps, (truth, odometry)[1 - slower].stamps)


def _over_gap(stamps: np.ndarray, paths: Sequence[Trajectory], most: float) -> np.ndarray:
    """Return which steps between neighbouring stamps go over a gap of a path, (n-1,)."""
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
    """Return the indices of the poses at which steps begin and end, (n,) and (n,)."""
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


def _still(steps: np.ndarray) -> np.ndarray:
    return (np.abs(steps) < _STILL).all(axis=1)
