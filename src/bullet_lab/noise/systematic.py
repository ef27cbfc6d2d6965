"""Systematic errors of odometry: wheels and gyro differ from their nominal parameters.

Between two poses the middle of the axle travels a distance s and turns by phi, so that with the
base B (distance of the wheels' contacts) and the nominal base b, the wheels of a side rho times as
large as nominal,

    s_left, s_right = s -+ phi B / 2,
    s' = (s_right / rho_right + s_left / rho_left) / 2
    phi' = (s_right / rho_right - s_left / rho_left) / b + gyro_bias_per_metre |s|

are reported (docs/noisy_odom.md). In turns the wheels slip: they roll s + loss |phi| in the
direction of s. A robot that turns on the spot has nothing to lose: if the middle of the axle goes
less than half the loss, the wheels roll s.

The diameters are given by their mean and their ratio, as by Borenstein and Feng, Measurement and
correction of systematic odometry errors in mobile robots (1996).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Optional, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.parameters import number
from bullet_lab.core.se2 import PlanarPose, columns, wrap, wrapped
from bullet_lab.noise.odometry_noise import body_step

LARGEST_ERRORS = {
    "scale_error": 0.5,
    "base_error": 0.5,
    "diameter_error": 0.5,
    # rad/m; more than a turn on each metre.
    "gyro_bias_per_metre": 10.0,
    # m/rad; more than wheels of a robot roll as it turns.
    "way_per_turn": 0.5,
}
"""Limits of the errors by their names."""

TICKS: Any = number(
    0.0, "whole ticks of each wheel's encoder in a metre; 0: exact", 0.0, maximum=1e6
)
"""A parameter."""

SYSTEMATIC = tuple(LARGEST_ERRORS)
"""Those of `SystematicErrors` that a path determines; its wheel_base has to be known."""

# Keeps the draws of errors apart from those of the noise.
_STREAM = 5


def _error(name: str, doc: str) -> Any:
    return number(0.0, doc, minimum=-LARGEST_ERRORS[name], maximum=LARGEST_ERRORS[name])


def _spread(name: str) -> Any:
    doc = f"standard deviation of {name}, from path to path"
    return number(0.0, doc, minimum=0.0, maximum=LARGEST_ERRORS[name])


@dataclass(frozen=True)
class SystematicErrors:
    """The real robot relative to the odometry's nominal parameters; 0 for no error.

    With larger wheels the odometry reports distances and turns that are too small, with a wider
    base turns that are too large. A larger right wheel turns the robot to the left while it reports
    a straight line. Driving forwards, gyro_bias_per_metre is hard to distinguish from a
    diameter_error of -gyro_bias_per_metre · wheel_base. docs/noisy_odom.md has all units.

    >>> SystematicErrors(base_error=0.25).steps([[0.0, 0.0, 0.8], [1.0, 0.0, 0.0]])
    array([[0., 0., 1.],
           [1., 0., 0.]])
    """

    scale_error: float = _error(
        "scale_error", "mean diameter of the wheels / what odometry believes - 1"
    )
    base_error: float = _error("base_error", "distance of the wheels / what odometry believes - 1")
    diameter_error: float = _error(
        "diameter_error", "right diameter / left diameter of the wheels - 1"
    )
    gyro_bias_per_metre: float = _error(
        "gyro_bias_per_metre", "rad that the heading gains on each metre"
    )
    wheel_base: float = number(
        0.38, "m, distance of the wheels that diameter_error and ticks_per_metre are for", 0.01
    )
    way_per_turn: float = _error("way_per_turn", "m of way that is lost in each radian of a turn")
    ticks_per_metre: float = TICKS

    @property
    def none(self) -> bool:
        """Whether all errors are 0."""
        return not self.ticks_per_metre and not any(getattr(self, name) for name in SYSTEMATIC)

    @property
    def resolution(self) -> Tuple[float, float]:
        """Standard deviations of way (m) and heading (rad) that whole ticks leave, uniform errors.

        >>> [round(std, 9) for std in SystematicErrors(ticks_per_metre=1000.0).resolution]
        [0.000204124, 0.001074338]
        """
        if not self.ticks_per_metre:
            return 0.0, 0.0
        one_wheel = 1.0 / (math.sqrt(12.0) * self.ticks_per_metre)
        return math.sqrt(0.5) * one_wheel, math.sqrt(2.0) * one_wheel / self.wheel_base

    @property
    def diameters(self) -> Tuple[float, float]:
        """Diameter of the left and of the right wheel / the nominal ones.

        Their ratio is 1 + diameter_error and their mean 1 + scale_error.

        >>> SystematicErrors(scale_error=0.5, diameter_error=-0.5).diameters[0]
        2.0
        """
        mean = (1.0 + self.scale_error) / (1.0 + 0.5 * self.diameter_error)
        return mean, mean * (1.0 + self.diameter_error)

    def matrix(self) -> ndarray:
        """Return the 2x2 matrix from true to reported distance and turn (m, rad), without gyro."""
        left, right = self.diameters
        total, difference = 1.0 / right + 1.0 / left, 1.0 / right - 1.0 / left
        base = self.wheel_base * (1.0 + self.base_error)
        return np.array(
            (
                (0.5 * total, 0.25 * base * difference),
                (difference / self.wheel_base, 0.5 * (1.0 + self.base_error) * total),
            )
        )

    def steps(self, steps) -> ndarray:
        """Return the reported steps for true steps, by encoders without ticks.

        Both are (dx m, dy m, dyaw rad) in the body frame before each, (..., 3), the reported dyaw
        not wrapped. A motion across the wheels, which they do not measure, is scaled like the
        distance.
        """
        ahead, across, turn = columns(arcs(steps))
        loss = self.way_per_turn * np.abs(turn)
        ahead = ahead + np.where(2.0 * np.abs(ahead) > np.abs(loss), np.sign(ahead) * loss, 0.0)
        matrix = self.matrix()
        drift = self.gyro_bias_per_metre * np.abs(ahead)
        new_ahead = matrix[0, 0] * ahead + matrix[0, 1] * turn
        new_turn = matrix[1, 0] * ahead + matrix[1, 1] * turn + drift
        return chords(np.stack((new_ahead, matrix[0, 0] * across, new_turn), axis=-1))

    def path(self, poses) -> ndarray:
        """Return the reported poses for true ones (m, m, rad), as `SystematicPath`, both (n, 3)."""
        path = SystematicPath(self)
        return np.array([path.update(*pose).pose for pose in np.asarray(poses, float).tolist()])


def arcs(steps) -> ndarray:
    """Return the arcs from pose to pose: distance ahead, distance across (m) and turn (rad).

    Each is the motion at a constant velocity that leads to (dx m, dy m, dyaw rad), (..., 3), with
    |dyaw| <= pi; a robot with two wheels does not move across.

    >>> arcs([2.0, 2.0, np.pi / 2.0]).round(6)
    array([3.141593, 0.      , 1.570796])
    """
    dx, dy, dyaw = columns(steps)
    half = 0.5 * dyaw
    cos, sin, chord = np.cos(half), np.sin(half), np.sinc(half / np.pi)
    return np.stack(((cos * dx + sin * dy) / chord, (cos * dy - sin * dx) / chord, dyaw), axis=-1)


def chords(arcs_) -> ndarray:
    """Return the steps (dx m, dy m, dyaw rad) that arcs lead to: the inverse of `arcs`.

    >>> chords([np.pi, 0.0, np.pi / 2.0]).round(6)
    array([2.      , 2.      , 1.570796])
    """
    ahead, across, turn = columns(arcs_)
    half = 0.5 * turn
    cos, sin, chord = np.cos(half), np.sin(half), np.sinc(half / np.pi)
    return np.stack(
        (chord * (cos * ahead - sin * across), chord * (sin * ahead + cos * across), turn), axis=-1
    )


class SystematicStep(NamedTuple):
    """The report of odometry for one message.

    Attributes:
        pose: reported x (m), y (m) and yaw (rad, in [-pi, pi)).
        motion_error: reported minus true step as (dx m, dy m, dyaw rad), each step in the body
            frame before it.
    """

    pose: PlanarPose
    motion_error: PlanarPose


_NO_ERROR = (0.0, 0.0, 0.0)


class SystematicPath:
    """Makes the reported path from a true path, pose by pose.

    The first pose is returned unchanged; without errors all poses are, bit for bit.

    Attributes:
        ticks: that the left and the right encoder have counted.

    >>> path = SystematicPath(SystematicErrors(scale_error=-0.5))
    >>> [path.update(x, 0.0, 0.0).pose for x in (1.0, 2.0)]
    [(1.0, 0.0, 0.0), (3.0, 0.0, 0.0)]
    """

    def __init__(self, errors: SystematicErrors):
        self._errors = errors
        self._matrix = errors.matrix().tolist()
        self.restart()

    def restart(self) -> None:
        """Start a new path with the next pose."""
        self._true: Optional[PlanarPose] = None
        self._reported: PlanarPose = _NO_ERROR
        # m, of the left and the right wheel.
        self._rolled = (0.0, 0.0)
        self.ticks = (0, 0)

    def update(self, x: float, y: float, yaw: float) -> SystematicStep:
        """Return the reported pose for the next true pose (m, m, rad), which is finite."""
        before, self._true = self._true, (x, y, yaw)
        if before is None or self._errors.none:
            self._reported = (x, y, yaw)
            return SystematicStep(self._reported, _NO_ERROR)
        true = body_step(before, self._true)
        step = self._step(*true)
        x, y, yaw = self._reported
        cos, sin = math.cos(yaw), math.sin(yaw)
        dx, dy, dyaw = step
        self._reported = (x + cos * dx - sin * dy, y + sin * dx + cos * dy, wrap(yaw + dyaw))
        error = (dx - true[0], dy - true[1], dyaw - true[2])
        return SystematicStep(self._reported, error)

    def _step(self, dx: float, dy: float, dyaw: float) -> PlanarPose:
        """Return what `SystematicErrors.steps` returns, for floats, and many times as fast."""
        half = 0.5 * dyaw
        cos, sin, chord = math.cos(half), math.sin(half), _sinc(half)
        ahead, across = (cos * dx + sin * dy) / chord, (cos * dy - sin * dx) / chord
        loss = self._errors.way_per_turn * abs(dyaw)
        if 2.0 * abs(ahead) > abs(loss):
            ahead += math.copysign(1.0, ahead) * loss
        (ahead_ahead, ahead_turn), (turn_ahead, turn_turn) = self._matrix
        drift = self._errors.gyro_bias_per_metre * abs(ahead)
        turn = turn_ahead * ahead + turn_turn * dyaw
        ahead, across = ahead_ahead * ahead + ahead_turn * dyaw, ahead_ahead * across
        if self._errors.ticks_per_metre:
            ahead, turn = self._count(ahead, turn)
        turn += drift
        half = 0.5 * turn
        cos, sin, chord = math.cos(half), math.sin(half), _sinc(half)
        return chord * (cos * ahead - sin * across), chord * (sin * ahead + cos * across), turn

    def _count(self, ahead: float, turn: float) -> Tuple[float, float]:
        """Return the way (m) and the turn (rad) by the ticks that the encoders count in a step."""
        per_metre, base = self._errors.ticks_per_metre, self._errors.wheel_base
        rim = 0.5 * base * turn
        self._rolled = (self._rolled[0] + ahead - rim, self._rolled[1] + ahead + rim)
        before, self.ticks = self.ticks, tuple(math.floor(per_metre * way) for way in self._rolled)
        left, right = ((now - then) / per_metre for now, then in zip(self.ticks, before))
        return 0.5 * (left + right), (right - left) / base


def _sinc(angle: float) -> float:
    return math.sin(angle) / angle if angle else 1.0


@dataclass(frozen=True)
class SystematicSpread:
    """Standard deviations of the systematic errors from path to path; 0 if they are known."""

    scale_error_std: float = _spread("scale_error")
    base_error_std: float = _spread("base_error")
    diameter_error_std: float = _spread("diameter_error")
    gyro_bias_per_metre_std: float = _spread("gyro_bias_per_metre")
    way_per_turn_std: float = _spread("way_per_turn")


class SpreadPath:
    """Makes reported paths from true ones, each with errors of its own; like `SystematicPath`.

    Beside each path, one more is followed for each error, with the error one standard deviation
    larger: to first order, the covariance is the sum of the squares of their distances.

    >>> path = SpreadPath(SystematicErrors(), SystematicSpread(scale_error_std=0.1), seed=1)
    >>> for x in (0.0, 1.0):
    ...     step = path.update(x, 0.0, 0.0)
    >>> path.covariance.round(4)[0]
    array([0.0083, 0.    , 0.    ])
    """

    def __init__(self, errors: SystematicErrors, spread: SystematicSpread, seed: int):
        self._errors = errors
        stds = {name: getattr(spread, f"{name}_std") for name in SYSTEMATIC}
        self._stds = {name: std for name, std in stds.items() if std > 0.0}
        self._generator = np.random.default_rng([seed, _STREAM])
        exact = replace(errors, ticks_per_metre=0.0)
        self._known = SystematicPath(exact)
        self._others = [
            SystematicPath(replace(exact, **{name: getattr(exact, name) + std}))
            for name, std in self._stds.items()
        ]
        self.restart()

    def restart(self) -> None:
        """Start a new path, with errors of its own, with the next pose."""
        drawn = {}
        for name, std in self._stds.items():
            value = getattr(self._errors, name) + std * self._generator.standard_normal()
            drawn[name] = float(np.clip(value, -LARGEST_ERRORS[name], LARGEST_ERRORS[name]))
        self._own = SystematicPath(replace(self._errors, **drawn))
        for path in (self._known, *self._others):
            path.restart()
        self.covariance = np.zeros((3, 3))

    @property
    def ticks(self) -> Tuple[int, int]:
        """Ticks that the left and the right encoder have counted on this path."""
        return self._own.ticks

    def update(self, x: float, y: float, yaw: float) -> SystematicStep:
        """Return the report for the next true pose (m, m, rad), which is finite.

        `covariance` is then that of its x (m), y (m) and yaw (rad) from path to path, (3, 3).
        """
        if self._others:
            known = self._known.update(x, y, yaw).pose
            others = np.array([path.update(x, y, yaw).pose for path in self._others])
            rows = wrapped(others - known)
            self.covariance = rows.T @ rows
        return self._own.update(x, y, yaw)


def end_of(steps) -> ndarray:
    """Return the pose that steps lead to: (dx m, dy m, dyaw rad), (..., n, 3) -> (..., 3).

    The heading is not wrapped.

    >>> end_of([[1.0, 0.0, np.pi / 2.0], [1.0, 0.0, 0.0]]).round(6)
    array([1.      , 1.      , 1.570796])
    """
    dx, dy, dyaw = columns(steps)
    heading = np.cumsum(dyaw, axis=-1)
    before = heading - dyaw
    x = np.sum(np.cos(before) * dx - np.sin(before) * dy, axis=-1)
    y = np.sum(np.sin(before) * dx + np.cos(before) * dy, axis=-1)
    return np.stack((x, y, heading[..., -1]), axis=-1)


def path_of(steps: ndarray) -> ndarray:
    """Return the poses that steps lead to, the start included: (n, 3) to (n + 1, 3)."""
    heading = np.concatenate(([0.0], np.cumsum(steps[:, 2])))
    moves = (steps[:, 0] + 1j * steps[:, 1]) * np.exp(1j * heading[:-1])
    places = np.concatenate(([0j], np.cumsum(moves)))
    return np.column_stack((places.real, places.imag, wrap(heading)))
