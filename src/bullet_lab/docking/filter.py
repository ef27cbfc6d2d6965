"""Iterated extended Kalman filter on the corners of a marker, for many Gaussians at once.

A state of a marker has 20 numbers:

- x, y (m) and yaw (rad) of the dock in the robot's frame;
- height of the marker's centre above the floor (m);
- growth: logarithm of its size over its assumed size;
- roll, pitch and yaw (rad) of the camera against its nominal pose;
- u, v (px) by which each of the four corners is seen aside in all images alike;
- errors of the odometry: logarithm of true over reported distance; true over reported turn, less 1;
  unreported turn (rad/m) on each metre ahead, and on each metre back. Unequal wheels turn the robot
  the other way when it drives back, a drifting gyro does not: so these two are independent.

The motion model moves the first three by the odometry; the measurement model predicts the corners.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from bullet_lab.core import se2
from bullet_lab.core.se2 import PlanarPose, wrap, wrapped
from bullet_lab.docking.geometry import Viewpoint, corner_points, extent_of
from bullet_lab.docking.types import MotionStep, Sighting

STATES = 20
_OF_MARKER = 5
_EYE = np.eye(STATES)
CAMERA, CORNERS, ODOMETRY = slice(5, 8), slice(8, 16), slice(16, STATES)
"""Where a state has the camera's rotation, the offsets of the corners and the odometry errors."""

OFF_CORNER = 0.15
"""Standard deviation of the offset of a corner in all images alike, px."""

UNKNOWN_CAMERA = np.radians([1.2, 1.2, 1.2])
UNKNOWN_ODOMETRY = np.array([0.035, 0.05, 0.02, 0.02])
"""Standard deviations of both where they are not nominal."""

# Standard deviations where the corners, the camera and the odometry are nominal.
_SEEN_RIGHT = 0.02
_KNOWN_CAMERA = np.radians([0.05, 0.05, 0.05])
_KNOWN_ODOMETRY = np.array([0.003, 0.003, 0.001, 0.001])
_OF_POSE, _OF_ODOMETRY = 3, len(UNKNOWN_ODOMETRY)
# Probability that a camera, or an odometry, is nominal.
_AS_KNOWN = 0.7
# Standard deviation of each corner in one image, px: of any; as a share of the marker's size in the
# image; and px², divided by that size, as corners of a marker of few pixels per cell are off
# together with the pattern and the blur.
_CORNER = 0.1
_RELATIVE = 0.0015
_SMALL = 5.0
# Standard deviations of roll, pitch and yaw of the robot at the moment of the image, rad.
_ROBOT_TILT = np.array([math.radians(0.15), math.radians(0.15), math.radians(0.03)])
# Steps of the numerical derivatives: no step first, then one of each state; and of a tilt, rad.
_NUDGES = 1e-4 * np.eye(_OF_MARKER + 1, _OF_MARKER, -1)
_TILT = 1e-4
# Generators of roll, pitch and yaw of the camera, about the optical -z, x and y axes, by which
# optical points are multiplied from the right.
_TURNS = np.array(
    [
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
        [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
    ]
)
# Innovation, px, below which one linearisation is enough.
_LINEAR = 4.0
# Standard deviation of a hidden corner, px. If the squared distance of the corners (8 values) is
# suspicious, each corner is left out in turn; one is hidden if the distance falls to such a part.
_HIDDEN = 1e3
_SUSPICIOUS, _EXPLAINED = 26.0, 0.4


@dataclass(frozen=True, eq=False)
class GaussianPose:
    """Pose of a dock in the robot's frame: mean (3,) of m, m, rad and covariance (3, 3)."""

    mean: ndarray
    covariance: ndarray

    @property
    def deviations(self) -> ndarray:
        """Standard deviations of x, y (m) and yaw (rad)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @functools.cached_property
    def robot(self) -> PlanarPose:
        """Likeliest pose of the robot in the dock's frame."""
        return tuple(se2.inverse(self.mean).tolist())

    @property
    def lateral_deviation(self) -> float:
        """Standard deviation of the robot's distance from the dock's axis, m.

        >>> covariance = np.array([[0.0, 0.0, 0.0], [0.0, 0.09, -0.04], [0.0, -0.04, 0.04]])
        >>> round(GaussianPose(np.array([2.0, 0.0, 0.0]), covariance).lateral_deviation, 9)
        0.3
        >>> round(GaussianPose(np.array([0.0, 2.0, np.pi / 2.0]), covariance).lateral_deviation, 9)
        0.4
        """
        x, y, yaw = self.mean
        away = np.array([math.sin(yaw), -math.cos(yaw), -(x * math.cos(yaw) + y * math.sin(yaw))])
        return math.sqrt(max(float(away @ self.covariance @ away), 0.0))

    def excess(self, poses: ndarray) -> ndarray:
        """Return by how much (n, 3) poses are farther off than 3.3 standard deviations, squared."""
        off = wrapped(poses - self.mean)
        squares = np.sum((off @ np.linalg.inv(self.covariance)) * off, axis=1)
        return np.maximum(squares - 11.0, 0.0)

    def turned_to(self, yaw: float, variance: float) -> GaussianPose:
        """Return the pose updated by a yaw (rad, rad²) from another source.

        If the two contradict each other, the more certain one is right: few pixels are off
        together, and then in all images alike.
        """
        off = wrap(yaw - float(self.mean[2]))
        own = self.covariance
        excess = off * off / (4.0 * (float(own[2, 2]) + variance))
        if excess > 1.0:
            if variance > own[2, 2]:
                return self
            own = own * excess
        gain = own[:, 2] / (own[2, 2] + variance)
        return GaussianPose(wrapped(self.mean + gain * off), own - np.outer(gain, own[2]))


class DriftingPose:
    """An earlier estimate of the dock's pose, moved along by odometry with unknown errors.

    It is asked for rarely, and moved only then.
    """

    def __init__(self, pose: GaussianPose):
        states = _OF_POSE + _OF_ODOMETRY
        self._x, self._p = np.zeros((1, states)), np.zeros((1, states, states))
        self._x[0, :3] = pose.mean
        self._p[0, :3, :3] = pose.covariance
        self._p[0, 3:, 3:] = np.diag(UNKNOWN_ODOMETRY**2)
        self._steps: list[MotionStep] = []

    @property
    def pose(self) -> GaussianPose:
        """The pose in the robot's present frame; the odometry may well be nominal."""
        for motion in self._steps:
            self._x, self._p = carried(self._x, self._p, motion)
        self._steps.clear()
        x, p = as_known(self._x, self._p, (_DRIFTING_ODOMETRY,))
        return GaussianPose(x[0, :3].copy(), p[0, :3, :3].copy())

    def move(self, motion: MotionStep) -> None:
        """Follow a step of the robot."""
        self._steps.append(motion)


def true_steps(step, errors: ndarray) -> ndarray:
    """Return the true steps (..., 3) of one reported step, given odometry errors (..., 4).

    >>> true_steps((0.5, 0.0, 1.0), np.array([0.0, 0.1, 0.2, 0.0]))
    array([0.5, 0. , 1.2])
    >>> true_steps((-0.5, 0.0, 1.0), np.array([0.0, 0.1, 0.2, 0.4]))
    array([-0.5,  0. ,  1.3])
    """
    dx, dy, dyaw = step
    longer = np.exp(errors[..., 0].copy())
    steps = np.empty((*errors.shape[:-1], _OF_POSE))
    steps[..., 0], steps[..., 1] = longer * dx, longer * dy
    steps[..., 2] = (1.0 + errors[..., 1]) * dyaw + errors[..., 2] * max(dx, 0.0)
    steps[..., 2] += errors[..., 3] * max(-dx, 0.0)
    return steps


def carried(x: ndarray, p: ndarray, motion: MotionStep) -> tuple[ndarray, ndarray]:
    """Return states (n, i) and covariances (n, i, i) in the robot's frame after a step.

    The first three numbers are a pose, the last four the odometry errors.
    """
    steps = true_steps(motion.step, x[:, -_OF_ODOMETRY:])
    turned = steps[:, 2].copy()  # see corner_points
    cos, sin = np.cos(turned), np.sin(turned)
    x, (dx, dy) = x.copy(), (x[:, :2] - steps[:, :2]).T
    x[:, 0], x[:, 1] = cos * dx + sin * dy, cos * dy - sin * dx
    x[:, 2] = wrap(x[:, 2] - turned)
    by_state = np.zeros_like(p)
    by_state[:] = _EYE[: x.shape[1], : x.shape[1]]
    by_state[:, 0, 0] = by_state[:, 1, 1] = cos
    by_state[:, 0, 1], by_state[:, 1, 0] = sin, -sin
    by_step = np.zeros((len(x), 3, 3))
    by_step[:, :2, :2] = -by_state[:, :2, :2]
    by_step[:, 0, 2], by_step[:, 1, 2] = x[:, 1], -x[:, 0]
    by_step[:, 2, 2] = -1.0
    by_error = np.zeros((len(x), _OF_POSE, _OF_ODOMETRY))
    by_error[:, :2, 0] = steps[:, :2]
    ahead = motion.step[0]
    by_error[:, 2, 1:] = motion.step[2], max(ahead, 0.0), max(-ahead, 0.0)
    by_state[:, :_OF_POSE, -_OF_ODOMETRY:] = by_step @ by_error
    p = by_state @ p @ by_state.transpose(0, 2, 1)
    p[:, :3, :3] += by_step @ motion.covariance @ by_step.transpose(0, 2, 1)
    return x, p


def _prior(where: slice, known: ndarray, unknown: ndarray) -> tuple[slice, ndarray, float]:
    """Return a part of the states, its covariance if nominal, and a logarithm if it is not.

    `known` and `unknown` are its standard deviations then.
    """
    return where, np.diag(known**2), np.sum(np.log(unknown))


_PRIORS = (
    _prior(CORNERS, np.full(8, _SEEN_RIGHT), np.full(8, OFF_CORNER)),
    _prior(CAMERA, _KNOWN_CAMERA, UNKNOWN_CAMERA),
    _prior(ODOMETRY, _KNOWN_ODOMETRY, UNKNOWN_ODOMETRY),
)
_AFTER_POSE = slice(_OF_POSE, _OF_POSE + _OF_ODOMETRY)
_DRIFTING_ODOMETRY = _prior(_AFTER_POSE, _KNOWN_ODOMETRY, UNKNOWN_ODOMETRY)


def as_known(x: ndarray, p: ndarray, priors=_PRIORS) -> tuple[ndarray, ndarray]:
    """Return states (n, i) and covariances, given that much is probably nominal.

    A camera, an odometry and corners are nominal more often than not. By Bayes' rule, with the
    density ratio of Savage and Dickey (J. M. Dickey, Annals of Mathematical Statistics 42, 1971)
    for the images, each is nominal with some probability; mean and covariance are of both cases.
    """
    for part, known, log_unknown in priors:
        wide = p[:, part, part] + known
        solved = np.linalg.solve(wide, np.concatenate([p[:, part], x[:, part, None]], axis=2))
        gain = solved[..., :-1].transpose(0, 2, 1)
        logs = log_unknown - 0.5 * np.linalg.slogdet(wide)[1]
        logs = logs - 0.5 * np.sum(x[:, part] * solved[..., -1], axis=1)
        logs = np.minimum(np.maximum(logs, -50.0), 50.0)
        right = _AS_KNOWN / (_AS_KNOWN + (1.0 - _AS_KNOWN) * np.exp(-logs))
        off = -applied(gain, x[:, part])
        x = x + right[:, None] * off
        right = right[:, None, None]
        p = p - right * (gain @ p[:, part])
        p = p + right * (1.0 - right) * (off[:, :, None] * off[:, None, :])
    return x, p


def predict(states: ndarray, sizes: ndarray, view: Viewpoint) -> tuple[ndarray, ndarray, ndarray]:
    """Return where corners of (n, 20) states with sizes (n,) are seen, and its derivatives.

    Returns:
        Pixels (n, 8) as u, v of each corner in turn; derivatives by the state (n, 8, 20); and by
        roll, pitch and yaw of the robot at the moment of the image (n, 8, 3). NaN for a marker
        that is not ahead of the camera.
    """
    count, nudged = len(states), states[:, None, :_OF_MARKER] + _NUDGES
    points = view.optical(corner_points(nudged, sizes[:, None]))
    points = points @ _camera_turns(states[:, CAMERA])[:, None]
    here = points[:, :1]
    tilted = here + _TILT * (here @ _TURNS)
    pixels = view.pixels(np.concatenate([points, tilted], axis=1)).reshape(count, -1, 8)
    seen = pixels[:, 0]
    changes = (pixels[:, 1:] - pixels[:, :1]).transpose(0, 2, 1)
    tilts = changes[..., _OF_MARKER:] / _TILT
    by_state = np.zeros((count, 8, STATES))
    by_state[..., :_OF_MARKER] = changes[..., :_OF_MARKER] / 1e-4
    by_state[..., CAMERA] = tilts
    by_state[..., CORNERS] = _EYE[:8, :8]
    return seen + states[:, CORNERS], by_state, tilts


def _camera_turns(turns: ndarray) -> ndarray:
    """Return what optical points have to be multiplied by from the right: (n, 3, 3).

    `turns` are (n, 3) roll, pitch and yaw of the camera against its known place, rad, in its frame.
    """
    size = np.sqrt(np.sum(turns * turns, axis=1))[:, None, None]
    cross = (turns @ _TURNS.reshape(3, 9)).reshape(-1, 3, 3)
    half = np.sinc(0.5 * size / np.pi)
    return _EYE[:3, :3] + np.sinc(size / np.pi) * cross + 0.5 * half * half * (cross @ cross)


@dataclass(frozen=True, eq=False)
class Measurement:
    """The corners of a marker in one image."""

    sighting: Sighting
    view: Viewpoint
    repeated: float = 1.0  #: factor of the standard deviations of images that repeat each other

    def covariance(self, tilts: ndarray) -> ndarray:
        """Return the (n, 8, 8) covariance of the corners, px²; `tilts` are as of `predict`."""
        extent, deviations = extent_of(self.sighting.corners), self.sighting.deviations
        own = _CORNER**2 + (_RELATIVE * extent) ** 2 + (_SMALL / extent) ** 2
        each = own * _EYE[:8, :8]
        if deviations is not None:
            each = each + np.diag(np.square(deviations).ravel())
        spread = tilts * _ROBOT_TILT
        return self.repeated**2 * (each + spread @ spread.transpose(0, 2, 1))


def innovations(start, x, p, sizes, measured: Measurement):
    """Compare corners with states `start` of covariance `p`, linearised at states `x`.

    Returns:
        Innovations (n, 8) px, their derivatives by the state (n, 8, 20), their covariance
        (n, 8, 8), and the corners (n, 8) px that `predict` returns.
    """
    predicted, by_state, tilts = predict(x, sizes, measured.view)
    seen, bad = predicted, ~np.isfinite(predicted).all(axis=1)
    if bad.any():
        seen = predicted.copy()
        seen[bad], by_state[bad], tilts[bad] = 1e4, 0.0, 0.0
    rest = measured.sighting.corners.reshape(8) - seen - applied(by_state, wrapped(start - x))
    covariance = measured.covariance(tilts) + by_state @ p @ by_state.transpose(0, 2, 1)
    return rest, by_state, covariance, predicted


def squared_distances(rest: ndarray, covariance: ndarray) -> ndarray:
    """Return the squared Mahalanobis distances (n,) of (n, i) with covariances (n, i, i).

    >>> squared_distances(np.array([[3.0, 4.0]]), np.array([np.diag([9.0, 4.0])]))
    array([5.])
    """
    return (rest * np.linalg.solve(covariance, rest[..., None])[..., 0]).sum(axis=1)


def applied(matrices: ndarray, vectors: ndarray) -> ndarray:
    """Return products (n, i) of matrices (n, i, j) and vectors (n, j).

    Not by einsum, whose last bits depend on where the arrays happen to lie in memory.
    """
    return (matrices @ vectors[..., None])[..., 0]


def iterated_update(start, p, sizes, measured: Measurement, rounds: int, hidden=None):
    """Update states by corners in an image (Bell and Cathey 1993: Gauss-Newton steps).

    The states `start` are (n, 20), their covariances `p` (n, 20, 20), the `sizes` (n,) m. There are
    at most `rounds` linearisations. The corner of the index `hidden` does not count.

    Returns:
        States (n, 20), covariances (n, 20, 20), squared Mahalanobis distances of the corners (n,)
        and logarithms of the determinants of their covariances (n,).
    """
    x = start
    for number in range(rounds):
        rest, by_state, covariance, _ = innovations(start, x, p, sizes, measured)
        if hidden is not None:
            pixel = [2 * hidden, 2 * hidden + 1]
            covariance[:, pixel, pixel] += _HIDDEN**2
        gain = np.linalg.solve(covariance, by_state @ p).transpose(0, 2, 1)
        before, x = x, wrapped(start + applied(gain, rest))
        if number == 0 and rounds < 6 and np.abs(rest).max() < _LINEAR:
            break
        if np.abs(x - before).max() < 1e-4:
            break
    left = p - gain @ by_state @ p
    left = 0.5 * (left + left.transpose(0, 2, 1))
    return x, left, squared_distances(rest, covariance), np.linalg.slogdet(covariance)[1]


def robust_update(start, p, sizes, measured: Measurement, rounds: int = 3, judges=slice(None)):
    """Do as `iterated_update`, but leave out a corner if that alone explains the image.

    Something before a corner moves it by pixels, and leaves the others where they are. Only the
    `judges` among the states decide: very unlikely ones may explain anything.
    """
    given = start, p, sizes, measured, rounds
    best = whole = iterated_update(*given)
    least = np.min(whole[2][judges])
    if least < _SUSPICIOUS:
        return whole
    limit = _EXPLAINED * least
    for corner in range(4):
        without = iterated_update(*given, hidden=corner)
        found = np.min(without[2][judges])
        if found < min(least, limit):
            best, least = without, found
    return best if least < _SUSPICIOUS else whole
