"""How truth and odometry belong together: clocks, noise of the truth, and the truth's marker.

And steps that are joined to longer ones.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.se2 import wrapped
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.likelihood import RESOLUTION
from bullet_lab.noise.systematic import arcs, chords

FEWEST_STEPS = 30
"""Smallest number of steps for a calibration."""

SURE = 4.0
"""Standard errors beyond which an offset, or the place of a marker, is corrected."""

_WIDEST_OFFSET = 1.0  # s
_MOST_DECIMALS = 8
_MEDIAN = 0.6745  # of the magnitude of a standard normal number
_WINDOW = 1.0  # s, long enough for a motion to tell the place of a marker
_FEWEST_WINDOWS = 20
_ROUNDS = 30  # of a robust regression
_HUBER = 1.345  # standard deviations beyond which an error counts less
# m, m and rad; nearer to the axle's middle, a marker is not corrected.
_NOTEWORTHY_PLACE = (1e-3, 2e-3, 1e-3)


def interpolated(path: Trajectory, stamps: ndarray) -> ndarray:
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


def joined_ends(
    steps: ndarray, follows: ndarray, distance: float, angle: float
) -> tuple[ndarray, ndarray]:
    """Join steps (m, m, rad; (n, 3)) until they are so far (m) or turned so much (rad).

    `follows` says whether each begins at the end of the one before, (n,); others are not joined.
    The result is the first step of each joined one, and the one after its last, (k,) and (k,).
    """
    first, last = [], []
    begin, place, heading = 0, 0j, 0.0
    rows = zip(*np.asarray(steps).T.tolist(), follows.tolist())
    for index, (dx, dy, turn, on) in enumerate(rows):
        if not on:
            begin, place, heading = index, 0j, 0.0
        place += complex(dx, dy) * np.exp(1j * heading)
        heading += turn
        if abs(place) >= distance or abs(heading) >= angle:
            first.append(begin)
            last.append(index + 1)
            begin, place, heading = index + 1, 0j, 0.0
    return np.array(first, dtype=int), np.array(last, dtype=int)


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


def jitter(true_steps, steps, follows: ndarray) -> tuple[float, float]:
    """Return the standard deviation of white noise on the truth's poses, m and rad; 0 without.

    White noise of a pose goes into two steps, with opposite signs: the difference of the truth's
    steps and the odometry's has the covariance -std² with that of the next step, and none with
    the one after. Noise of the odometry has neither; what is slow has both.

    Args:
        true_steps: (dx m, dy m, dyaw rad) in the body frame before each, shape (n, 3).
        steps: those of the odometry, shape (n, 3).
        follows: whether each begins where the one before it ended, shape (n,).
    """
    three = follows[1:-1] & follows[2:]
    if three.sum() < FEWEST_STEPS:
        return 0.0, 0.0
    left = wrapped(true_steps - steps)[:, ::2]
    middle = np.median(left, axis=0)
    reach = 3.0 * np.median(np.abs(left - middle), axis=0) / _MEDIAN
    left = np.clip(left - middle, -reach, reach)
    variance = np.mean((left[:-2] * (left[2:] - left[1:-1]))[three], axis=0)
    error = np.mean(left**2, axis=0) * np.sqrt(2.0 / three.sum())
    std_m, std_rad = np.sqrt(np.where(variance > SURE * error, variance, 0.0)).tolist()
    return std_m, std_rad


def clock_offset(truth: Trajectory, odometry: Trajectory, stamps: ndarray):
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


def _motion(path: Trajectory, begins: ndarray, window: float) -> ndarray:
    """Return the distances and turns of a robot within windows of time, (n, 2), in any frame."""
    dx, dy, turns = (
        np.interp(begins + window, path.stamps, column) - np.interp(begins, path.stamps, column)
        for column in (*path.poses[:, :2].T, np.unwrap(path.poses[:, 2]))
    )
    return np.column_stack((np.hypot(dx, dy), turns))


def marker_place(true_poses, poses, stamps: ndarray) -> tuple[ndarray, ndarray]:
    """Estimate where the truth's point is on a robot that does not slide to the side.

    A point ahead of the axle moves aside in turns, one on the left moves back in left turns, and
    one with a yaw moves aside on straight ways. With way s and turn phi of the odometry's arcs,
    and the truth's arcs relative to them,

        aside = x phi - yaw s,    ahead = k s + c |phi| - y phi,

    by robust regressions (Huber) on windows of about a second.

    Args:
        true_poses: x (m), y (m) and yaw (rad), shape (n, 3).
        poses: those of the odometry at the same stamps, shape (n, 3).
        stamps: s, shape (n,).

    Returns:
        The place x (m, ahead of the axle), y (m, to the left) and yaw (rad), (3,), with 0 for what
        is not surely different from it; and the standard errors of the same, (3,).
    """
    index = np.unique(np.searchsorted(stamps, np.arange(stamps[0], stamps[-1], _WINDOW)))
    true, reported = (arcs(se2.steps(one[index])) for one in (true_poses, poses))
    way, _, turn = reported.T
    if len(index) < _FEWEST_WINDOWS or not np.abs(way).sum() * np.abs(turn).sum():
        return np.zeros(3), np.full(3, np.inf)
    aside, aside_error = robust_fit(np.stack((turn, -way), 1), true[:, 1] - reported[:, 1])
    columns = np.stack((-turn, way, np.sign(way) * np.abs(turn)), 1)
    ahead, ahead_error = robust_fit(columns, true[:, 0])
    place = np.array((aside[0], ahead[0], aside[1]))
    error = np.array((aside_error[0], ahead_error[0], aside_error[1]))
    return np.where(np.abs(place) > np.maximum(SURE * error, _NOTEWORTHY_PLACE), place, 0.0), error


def robust_fit(columns: ndarray, values: ndarray) -> tuple[ndarray, ndarray]:
    """Return Huber's estimate of values = columns @ x, (k,), and its standard errors, (k,).

    The errors allow for a spread that differs from value to value (the sandwich).

    >>> robust_fit(np.ones((4, 1)), np.array([1.0, 1.0, 1.0, 9.0]))[0].round(3)
    array([1.])
    """
    weights = np.ones(len(values))
    for _ in range(_ROUNDS):
        inverse = np.linalg.pinv((columns.T * weights) @ columns)
        found = inverse @ (columns.T @ (weights * values))
        left = values - columns @ found
        scale = np.median(np.abs(left)) / _MEDIAN + 1e-12
        weights = 1.0 / np.maximum(np.abs(left) / (_HUBER * scale), 1.0)
    # Only errors within the bound change with the estimate, and it has used some of them up.
    inverse = np.linalg.pinv((columns.T * (weights == 1.0)) @ columns)
    pull = columns * (weights * left)[:, np.newaxis]
    spread = inverse @ (pull.T @ pull) @ inverse * len(left) / (len(left) - len(found))
    return found, np.sqrt(np.maximum(np.diagonal(spread), 0.0))
