"""Squares that a robot drove by odometry, and the errors of its wheels that follow from them.

`Benchmark` has the closed forms of UMBmark, a fit of the model, and the reasons to distrust them.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Mapping, Sequence

import numpy as np
from numpy import ndarray
from scipy import optimize, stats

from bullet_lab.core import se2
from bullet_lab.core.files import Summary
from bullet_lab.core.se2 import PlanarPose, wrapped
from bullet_lab.core.trajectory import Trajectory, finite_numbers
from bullet_lab.errors import LabError
from bullet_lab.noise.exact_moments import first_order_moments
from bullet_lab.noise.noisy_paths import noisy_steps
from bullet_lab.noise.odometry_noise import RateInvariantRule
from bullet_lab.noise.systematic import SystematicErrors, arcs, chords, end_of
from bullet_lab.studies.paths import Recording, Topics, columns_of, find_recordings, read_table

CLOCKWISE, COUNTER_CLOCKWISE = "cw", "ccw"
DIRECTIONS = (CLOCKWISE, COUNTER_CLOCKWISE)
# m; a robot on wheels drives no square farther away, and sums of squares stay finite.
FARTHEST = 1e6

RETURNS = ("direction", "x", "y", "yaw")
"""Columns of a table with the true pose at the end of each run, measured with a ruler."""

AT_REST = 0.01
"""m from the first or last pose, within which the robot counts as at rest."""

CONFIDENCE = 0.95
PARAMETERS = ("diameter_error", "base_error")
LARGEST = 0.4
"""Bound of the fit for each parameter."""

_STEP = 1e-6  # of a parameter, for derivatives
# Of a parameter: the largest difference between equal runs, from rounding.
_ROUNDING = 1e-12

# Sides: half the perimeter, farther than wheels with errors of some percent bring a robot.
MOST_OF_SIDE = 2.0
# Of the return error: wheels explain less of it than they leave.
MOST_LEFT = 0.5
# Of the side: the error of rulers and random noise.
LEAST_LEFT = 0.01
# Standard errors beyond chance.
SURE = 3.0
# m and rad: equal except for rounding.
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class SquareRun:
    """One square, until the odometry reports the pose of its start.

    Attributes:
        name: of the run, for the user.
        odometry: reported poses: x (m), y (m) and yaw (rad), shape (n, 3).
        start: true pose at the first of these, in any frame.
        end: true pose at the last, in the same frame.
        base: distance of the wheels that the odometry assumed, m.

    Raises:
        LabError: the odometry does not turn by 360°, or a number is out of range.
    """

    name: str
    odometry: ndarray
    start: PlanarPose
    end: PlanarPose
    base: float

    def __post_init__(self) -> None:
        """Check that it is a square."""
        if len(self.odometry) < 2 or not np.isfinite(self.odometry).all():
            raise LabError(f"{self.name}: there is no odometry of a square")
        largest = max(np.abs(self.odometry).max(), *map(abs, (*self.start, *self.end)))
        if largest > FARTHEST:
            raise LabError(
                f"{self.name}: {largest:g} is out of range: positions are in m, angles in rad, "
                f"and at most {FARTHEST:g}"
            )
        turned = abs(self.turned())
        if not 0.75 < turned / (2.0 * np.pi) < 1.25:
            raise LabError(
                f"{self.name}: the odometry turns by {np.degrees(turned):.0f}°, not once round, "
                "as on a square with the turn after its last side"
            )

    def turned(self) -> float:
        """Return the total change of the reported heading, rad, counter-clockwise > 0."""
        return float(self.steps()[:, 2].sum())

    @property
    def direction(self) -> str:
        """One of `DIRECTIONS`."""
        return COUNTER_CLOCKWISE if self.turned() > 0.0 else CLOCKWISE

    def steps(self) -> ndarray:
        """Return the reported steps (dx m, dy m, dyaw rad), shape (n - 1, 3)."""
        return se2.steps(self.odometry)

    def side(self) -> float:
        """Return the reported length (m) of a side: a quarter of the path."""
        return float(np.hypot(*np.diff(self.odometry[:, :2], axis=0).T).sum() / 4.0)

    def moved(self) -> ndarray:
        """Return the true end in the frame of the true start: (m, m, rad)."""
        return se2.between(self.start, self.end)

    def return_error(self) -> ndarray:
        """Return true minus reported end (m, m, rad), x ahead and y to the left at the start."""
        return wrapped(self.moved() - se2.between(self.odometry[0], self.odometry[-1]))


def return_errors(runs: Sequence[SquareRun], direction: str) -> ndarray:
    """Return the return errors of the runs in a direction, shape (n, 3)."""
    errors = [run.return_error() for run in runs if run.direction == direction]
    return np.array(errors).reshape(-1, 3)


def read_runs(path: Path, topics: Topics, side: float, base: float) -> list[SquareRun]:
    """Read a run from each recording that `find_recordings` finds, or from each row of a table.

    Such a table of returns (`RETURNS`: cw or ccw, m, m, rad) has the true pose at the end of each
    run, in the frame of its start; its odometry reports a perfect square of the side (m). The base
    (m) is that which the odometry assumed. Raises LabError if there is no file that can be read.
    """
    files = sorted(path.iterdir()) if os.path.isdir(path) else [path]
    runs = [
        _measured_run(where, row, side, base)
        for file in files
        if set(RETURNS) <= columns_of(file)
        for where, row in read_table(file, RETURNS)[1]
    ]
    return runs or [_run(one, base) for one in find_recordings([path], topics)]


def _run(recording: Recording, base: float) -> SquareRun:
    """Return a run from the first to the last poses of both: the robot rests there."""
    truth, odometry, name = recording.truth, recording.odometry, Path(recording.name).stem
    _check_times(name, odometry, truth)
    first, last = truth.poses[[0, -1]].tolist()
    turns = [se2.steps(one.poses)[:, 2].sum() for one in (odometry, truth)]
    if turns[0] * turns[1] < 0.0:
        raise LabError(
            f"{name}: odometry and truth turn in opposite directions: "
            "is the y axis or the yaw of one of them mirrored?"
        )
    remarks = "; ".join(filter(None, (odometry.remark, truth.remark)))
    name = f"{name} ({remarks})" if remarks else name
    return SquareRun(name, odometry.poses, tuple(first), tuple(last), base)


def _check_times(name: str, odometry: Trajectory, truth: Trajectory) -> None:
    """Raise LabError unless the truth covers the time in which the robot drives."""
    from_start, from_end = (
        np.flatnonzero(np.hypot(*(odometry.poses - rest)[:, :2].T) > AT_REST)
        for rest in odometry.poses[[0, -1]]
    )
    if not (from_start.size and from_end.size):
        return
    begin, end = odometry.stamps[[from_start[0], from_end[-1]]]
    if truth.stamps[0] > begin or truth.stamps[-1] < end:
        raise LabError(
            f"{name}: the robot drives from {begin:.3f} to {end:.3f} s, but the truth covers "
            f"{truth.stamps[0]:.3f} to {truth.stamps[-1]:.3f} s: are both of one run and one clock?"
        )


def _measured_run(where: str, row: Mapping[str, str], side: float, base: float) -> SquareRun:
    direction = (row["direction"] or "").strip().lower()
    if direction not in DIRECTIONS:
        raise LabError(f"{where}: the direction has to be one of {', '.join(DIRECTIONS)}")
    x, y, yaw = finite_numbers([row[name] for name in RETURNS[1:]], where)
    square = perfect_square(side, direction)
    return SquareRun(where, square, (0.0, 0.0, 0.0), (x, y, yaw), base)


def perfect_square(side: float, direction: str) -> ndarray:
    """Return the poses of a perfect square, before and after each turn, shape (13, 3).

    >>> perfect_square(2.0, "ccw")[3].round(6)
    array([2.      , 0.      , 1.570796])
    """
    turn = -0.5 * np.pi if direction == CLOCKWISE else 0.5 * np.pi
    poses = [np.zeros(3)]
    for _ in range(4):
        x, y, yaw = poses[-1]
        x, y = x + side * np.cos(yaw), y + side * np.sin(yaw)
        # Half a turn at a time, so that the direction of the turn is defined.
        poses += [np.array((x, y, yaw + share * turn)) for share in (0.0, 0.5, 1.0)]
    return np.array(poses)


def closed_forms(runs: Sequence[SquareRun], side: float) -> Summary:
    """Return Borenstein and Feng's figures by closed forms, which hold for small angles.

    docs/jobs/umbmark.md derives them for this square.

    Args:
        runs: in both directions.
        side: L, m.

    Returns:
        Centres of gravity x, y (m) of the return errors in both directions, their distances from
        zero and the larger one (m); alpha_deg, of each turn, error of type A: too little where it
        is > 0; beta_deg, of each side, error of type B: to the left where it is > 0; e_d, right
        diameter / left diameter, relative to the assumed ones; e_b, base / the assumed one.
    """
    cw, ccw = (return_errors(runs, direction)[:, :2].mean(axis=0) for direction in DIRECTIONS)
    alpha = float(cw[0] + ccw[0]) / (-4.0 * side)
    beta = float(cw[0] - ccw[0]) / (-4.0 * side)
    # R = (L / 2) / sin(beta / 2) and E_d = (R + b / 2) / (R - b / 2), without dividing by 0.
    bend = runs[0].base * math.sin(0.5 * beta) / side
    r_cw, r_ccw = float(np.hypot(*cw)), float(np.hypot(*ccw))
    return {
        "centre_cw_m": cw.tolist(),
        "centre_ccw_m": ccw.tolist(),
        "r_cw_m": r_cw,
        "r_ccw_m": r_ccw,
        "e_max_syst_m": max(r_cw, r_ccw),
        "alpha_deg": float(np.degrees(alpha)),
        "beta_deg": float(np.degrees(beta)),
        "e_d": (1.0 + bend) / (1.0 - bend),
        "e_b": 0.5 * math.pi / (0.5 * math.pi - alpha),
    }


@dataclass(frozen=True)
class Estimate:
    """Errors of the wheels, by a fit of the full kinematic model to all runs.

    Attributes:
        errors: with diameter_error and base_error.
        intervals: of 95 % confidence, by name; None if a direction has one run, or equal runs.
        residual: m, distance from zero of the farther centre of gravity of the return errors that
            the odometry would have with the fit.
    """

    errors: SystematicErrors
    intervals: dict[str, tuple[float, float]] | None
    residual: float

    def on_bounds(self) -> list[str]:
        """Return the names of the parameters that lie on the bounds of the fit."""
        return [name for name in PARAMETERS if abs(getattr(self.errors, name)) > 0.999 * LARGEST]

    def relative_to(self, floor: SystematicErrors) -> Estimate:
        """Return this estimate relative to the errors that perfect wheels have on the floor."""

        def relative(name: str, value: float) -> float:
            return (1.0 + value) / (1.0 + getattr(floor, name)) - 1.0

        errors = {name: relative(name, getattr(self.errors, name)) for name in PARAMETERS}
        intervals = self.intervals and {
            name: (relative(name, low), relative(name, high))
            for name, (low, high) in self.intervals.items()
        }
        return Estimate(replace(self.errors, **errors), intervals, self.residual)


def fit(runs: Sequence[SquareRun]) -> Estimate:
    """Fit diameter_error and base_error to the true pose at the end of each run.

    docs/jobs/umbmark.md has the model, its weights and the intervals.

    Args:
        runs: in both directions, of odometry that assumed the same base.
    """
    base = runs[0].base
    every = [run.steps() for run in runs]
    # Shorter runs are filled with zeros.
    reported = np.zeros((len(runs), max(map(len, every)), 3))
    for row, steps in zip(reported, every):
        row[: len(steps)] = arcs(steps)
    moved = np.array([run.moved() for run in runs])
    walk = RateInvariantRule(1.0)
    odometry = (se2.between(run.odometry[0], run.odometry) for run in runs)
    moments = [first_order_moments(noisy_steps(poses, walk)) for poses in odometry]
    roots = np.linalg.inv(np.linalg.cholesky([one.covariance[-1] for one in moments]))

    def left(parameters: ndarray) -> ndarray:
        """Return the differences of the ends in units of their standard deviations."""
        difference = _end_errors(reported, moved, _errors(parameters, base))
        return np.einsum("rij,rj->ri", roots, difference).ravel()

    bounds = (-LARGEST, LARGEST)
    found = optimize.least_squares(left, (0.0, 0.0), bounds=bounds, x_scale=1e-2, xtol=1e-13)
    errors = _errors(found.x, base)
    slopes = [
        (left(found.x + step) - left(found.x - step)) / (2.0 * _STEP)
        for step in _STEP * np.eye(len(PARAMETERS))
    ]
    shares = np.linalg.pinv(np.stack(slopes, axis=-1)).reshape(len(PARAMETERS), len(runs), 3)
    shares = -np.einsum("prk,rk->rp", shares, left(found.x).reshape(len(runs), 3))
    directions = np.array([run.direction for run in runs])
    ends = _end_errors(reported, moved, errors)[:, :2]
    centres = [ends[directions == direction].mean(axis=0) for direction in DIRECTIONS]
    return Estimate(
        errors,
        _intervals(found.x, shares, directions),
        float(max(np.hypot(*centre) for centre in centres)),
    )


def _errors(parameters: Sequence[float], base: float) -> SystematicErrors:
    named = dict(zip(PARAMETERS, map(float, parameters)))
    return SystematicErrors(**named, wheel_base=base)


def _end_errors(reported: ndarray, moved: ndarray, errors: SystematicErrors) -> ndarray:
    """Return true ends minus those predicted with errors: (m, m, rad), (runs, 3).

    `reported` has distance ahead, aside (m) and turn (rad) of each step, (runs, n, 3), and `moved`
    the true ends in the frames of the true starts (m, m, rad), (runs, 3).
    """
    undo = np.linalg.inv(errors.matrix())
    ahead, aside, turn = se2.columns(reported)
    new_ahead = undo[0, 0] * ahead + undo[0, 1] * turn
    new_turn = undo[1, 0] * ahead + undo[1, 1] * turn
    return wrapped(moved - end_of(chords(np.stack((new_ahead, aside, new_turn), axis=-1))))


def _intervals(
    found: ndarray, shares: ndarray, directions: ndarray
) -> dict[str, tuple[float, float]] | None:
    """Return the intervals of the parameters from the influence of each run on them, (n, 2)."""
    if np.abs(found).max() > 0.999 * LARGEST:
        # On a bound the sum of squares has no minimum, so that no interval holds.
        return None
    groups = [shares[directions == direction] for direction in DIRECTIONS]
    if min(map(len, groups)) < 2:
        return None
    variance = sum(len(own) * own.var(axis=0, ddof=1) for own in groups)
    freedom = len(shares) - len(groups)
    if (variance <= _ROUNDING**2).any():
        # The runs of each direction are equal: their spread is unknown.
        return None
    reach = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, freedom) * np.sqrt(variance)
    ends = list(zip((found - reach).tolist(), (found + reach).tolist()))
    return dict(zip(PARAMETERS, ends))


def centre_ellipse(errors: ndarray) -> ndarray | None:
    """Return a 2x2 matrix (m²) whose 95 % ellipse is that of the centre of return errors.

    `core.se2.ellipse_points` draws the ellipse of a known covariance. This one is estimated from
    the errors (x, y (m) and so on, shape (n, 2) or wider), and scaled by Hotelling's T²; None for
    fewer than three errors.
    """
    count = len(errors)
    if count < 3:
        return None
    hotelling = 2.0 * (count - 1) / (count - 2) * stats.f.ppf(CONFIDENCE, 2, count - 2)
    return np.cov(errors[:, :2].T) / count * hotelling / se2.SQUARE_RADIUS


@dataclass(frozen=True)
class Benchmark:
    """Runs and their evaluation."""

    runs: tuple[SquareRun, ...]
    figures: Summary
    estimate: Estimate

    @classmethod
    def of(cls, runs: Sequence[SquareRun], side: float | None = None) -> Benchmark:
        """Evaluate runs; raises LabError unless there are runs in both directions.

        `side` (m) is the mean reported one by default.
        """
        if {run.direction for run in runs} != set(DIRECTIONS):
            raise LabError("squares have to be driven both ways, clockwise and counter-clockwise")
        length = float(np.mean([run.side() for run in runs])) if side is None else side
        return cls(tuple(runs), closed_forms(runs, length), fit(runs))

    @property
    def base(self) -> float:
        """The base (m) that the odometry assumed."""
        return self.runs[0].base

    def warnings(self) -> list[str]:
        """Return the reasons to distrust the result, with likely causes; empty without any."""
        largest, left = self.figures["e_max_syst_m"], self.estimate.residual
        side = float(np.mean([run.side() for run in self.runs]))
        found = [
            f"{name} lies on the bound of the fit, {100.0 * LARGEST:.0f} %: "
            "are wheel_base and the units right?"
            for name in self.estimate.on_bounds()
        ]
        if largest > MOST_OF_SIDE * side:
            found.append(
                f"the mean return error of {largest:.3g} m is more than half the way round: "
                f"is the side {side:.3g} m, and are positions in m?"
            )
        if left > max(MOST_LEFT * largest, LEAST_LEFT * side, SURE * self._standard_error()):
            found.append(
                f"{left:.3g} m of the mean return error of {largest:.3g} m are not explained by "
                "wheels: are angles in rad and positions in m, and is the y axis to the left?"
            )
        if all(np.abs(run.return_error()).max() < SAME for run in self.runs):
            found.append("the odometry equals the truth: are both from the same topic or column?")
        return found

    def _standard_error(self) -> float:
        """Return the larger standard error (m) of both centres; 0 for single runs."""
        errors = [return_errors(self.runs, direction)[:, :2] for direction in DIRECTIONS]
        return max(
            math.sqrt(float(one.var(axis=0, ddof=1).sum()) / len(one)) if len(one) > 1 else 0.0
            for one in errors
        )

    def summary(self) -> Summary:
        """Return the figures of the benchmark by their usual names."""
        squares = {d: sum(run.direction == d for run in self.runs) for d in DIRECTIONS}
        return {"squares": squares, **self.figures}
