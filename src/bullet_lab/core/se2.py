"""Planar geometry: angles, poses, patterns of places, and confidence ellipses.

Planar poses are float arrays of shape (..., 3) that hold x (m), y (m) and yaw (rad). Leading axes
broadcast as everywhere in numpy. Every yaw that is returned lies in [-pi, pi).
"""

from __future__ import annotations

import math
from typing import Any, List, Sequence, Tuple

import numpy as np
from numpy import ndarray

PlanarPose = Tuple[float, float, float]
"""A single pose as numbers: x (m), y (m) and yaw (rad)."""

# A sum with it is a multiple of 2^-20.
_COARSE = 1.5 * 2.0**32


def wrap(angle):
    """Wrap angles into [-pi, pi): pi itself becomes -pi.

    Angles that are already inside are returned bit for bit, so wrapping does not make poses drift.

    Args:
        angle: rad, a float or an array of any shape.

    Returns:
        A float for a float or an int, otherwise an array of the same shape.

    Raises:
        ValueError: a float is infinite (an array gets NaN there, as usual in numpy).

    >>> wrap(math.pi), wrap(7.0)
    (-3.141592653589793, 0.7168146928204138)
    >>> wrap(np.array([0.5, -4.0]))
    array([0.5       , 2.28318531])
    """
    if isinstance(angle, (float, int)):
        wrapped = math.remainder(angle, math.tau)
        return wrapped if wrapped < math.pi or wrapped != wrapped else -math.pi
    largest = np.max(np.abs(angle), initial=0.0)
    if largest < math.pi:
        return np.array(angle, dtype=float)
    # fmod is slow and exact, and so is the one subtraction that may follow.
    wrapped = angle if largest < math.tau else np.fmod(angle, math.tau)
    return wrapped - math.tau * ((wrapped >= math.pi) * 1.0 - (wrapped < -math.pi) * 1.0)


def columns(rows) -> ndarray:
    """Return the columns of rows such as poses or points, (..., n) -> (n, ...).

    >>> columns([(1.0, 2.0, 0.0), (3.0, 4.0, 0.0)]).tolist()
    [[1.0, 3.0], [2.0, 4.0], [0.0, 0.0]]
    """
    return np.moveaxis(np.asarray(rows, dtype=float), -1, 0)


def wrapped(poses: ndarray) -> ndarray:
    """Return poses, or their differences, with the yaw wrapped, shape (..., 3 or more).

    >>> wrapped(np.array([1.0, 4.0, 4.0])).round(6)
    array([ 1.      ,  4.      , -2.283185])
    """
    poses = poses.copy()
    poses[..., 2] = wrap(poses[..., 2])
    return poses


def hypot(x, y):
    """Return the length of vectors, floats or arrays.

    A root is rounded alike everywhere; math.hypot and np.hypot are not (Python 3.10, glibc 2.35).

    >>> hypot(3.0, 4.0)
    5.0
    """
    square = x * x + y * y
    return math.sqrt(square) if isinstance(square, float) else np.sqrt(square)


def atan2(y: float, x: float) -> float:
    """Return the angle (rad, in [-pi, pi]) of a vector, to 4e-16, alike everywhere.

    The last bit of math.atan2 depends on the C library (glibc 2.35), that of sin and cos does not
    (since glibc 2.28). So math.atan2 gives only a multiple of 2^-20; the rest is the angle
    beyond it, whose arc tangent has two terms of its series.

    >>> atan2(1.0, 0.0) == math.pi / 2.0
    True
    """
    angle = math.atan2(y, x)
    leading = (angle + _COARSE) - _COARSE
    sin, cos = math.sin(leading), math.cos(leading)
    ahead = x * cos + y * sin
    if not 0.0 < ahead < math.inf:
        return angle
    rest = (y * cos - x * sin) / ahead
    return leading + (rest - rest * rest * rest / 3.0)


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the heading (rad, in [-pi, pi]) of a rotation.

    This is the first angle of the intrinsic z-y-x sequence. The quaternion need not have unit
    length; an all-zero one, the default in a message, gives 0.

    >>> yaw_from_quaternion(0.0, 0.0, 1.0, 1.0) == math.pi / 2.0
    True
    """
    return atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def quaternion_from_yaw(yaw: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a heading (rad).

    >>> quaternion_from_yaw(math.pi)[:3]
    (0.0, 0.0, 1.0)
    """
    return 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def pose_from_above(place: Any, turn: Any) -> PlanarPose:
    """Return the pose of a position and a quaternion, each with fields such as x, seen from above.

    >>> from types import SimpleNamespace as Message
    >>> pose_from_above(Message(x=1.0, y=2.0), Message(x=0.0, y=0.0, z=0.0, w=1.0))
    (1.0, 2.0, 0.0)
    """
    return place.x, place.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w)


def compose(a, b) -> ndarray:
    """Return the pose `b`, given in the frame of pose `a`, in the frame in which `a` is given.

    Args:
        a: poses, shape (..., 3).
        b: poses, shape (..., 3).

    Returns:
        Poses of the common broadcast shape (..., 3).

    >>> compose([1.0, 2.0, np.pi / 2.0], [[0.5, 0.0, 0.0], [0.0, 0.0, 1.0]]).round(3)
    array([[1.   , 2.5  , 1.571],
           [1.   , 2.   , 2.571]])
    """
    (ax, ay, ayaw), (bx, by, byaw) = _parts(a), _parts(b)
    cos, sin = np.cos(ayaw), np.sin(ayaw)
    return _poses(ax + cos * bx - sin * by, ay + sin * bx + cos * by, wrap(ayaw + byaw))


def between(a, b) -> ndarray:
    """Return pose `b` in the frame of pose `a`, the inverse of `compose`, of the same shapes.

    >>> between([1.0, 2.0, np.pi / 2.0], [1.0, 2.5, 0.0]).round(3)
    array([ 0.5  ,  0.   , -1.571])
    """
    (ax, ay, ayaw), (bx, by, byaw) = _parts(a), _parts(b)
    cos, sin = np.cos(ayaw), np.sin(ayaw)
    dx, dy = bx - ax, by - ay
    return _poses(cos * dx + sin * dy, cos * dy - sin * dx, wrap(byaw - ayaw))


def _parts(poses) -> Sequence:
    # A single pose as numbers, which are much faster than arrays.
    poses = np.asarray(poses, dtype=float)
    return poses.tolist() if poses.ndim == 1 else (poses[..., 0], poses[..., 1], poses[..., 2])


def _poses(x, y, yaw) -> ndarray:
    # Several times as fast as np.stack of np.broadcast_arrays.
    poses = np.empty((*np.broadcast(x, y, yaw).shape, 3))
    poses[..., 0], poses[..., 1], poses[..., 2] = x, y, yaw
    return poses


def inverse(pose) -> ndarray:
    """Return the pose of the origin in the frame of each pose, shape (..., 3).

    >>> inverse([1.0, 0.0, 0.0])
    array([-1.,  0.,  0.])
    """
    return between(pose, np.zeros(3))


def steps(poses) -> ndarray:
    """Return each pose of a path in the frame of the previous one: (..., n, 3) to (..., n-1, 3).

    >>> steps([(0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (1.0, 0.0, 0.0)])
    array([[ 1. ,  0. ,  0.5],
           [ 0. ,  0. , -0.5]])
    """
    poses = np.asarray(poses, dtype=float)
    return between(poses[..., :-1, :], poses[..., 1:, :])


def logarithm(poses) -> ndarray:
    """Return the exponential coordinates (m, m, rad) of poses, shape (..., 3).

    They are the constant velocity that leads from the origin to the pose in one unit of time, along
    an arc: the logarithm of the pose's matrix. With p = x + iy and h the yaw, in [-pi, pi), the
    first two are (h/2) (cot(h/2) - i) p.
    (G. S. Chirikjian, Stochastic Models, Information Theory, and Lie Groups 2, 2012, section 10.6.)

    >>> logarithm([[2.0, 2.0, np.pi / 2.0], [1.0, -2.0, 0.0]]).round(6)
    array([[ 3.141593,  0.      ,  1.570796],
           [ 1.      , -2.      ,  0.      ]])
    """
    x, y, yaw = columns(poses)
    yaw = wrap(yaw)
    velocity = straightening(yaw) * (x + 1j * y)
    return np.stack([velocity.real, velocity.imag, yaw], axis=-1)


def straightening(yaw) -> ndarray:
    """Return (h/2) (cot(h/2) - i) for angles h (rad, within a turn), 1 for 0; see `logarithm`."""
    half = 0.5 * np.asarray(yaw, dtype=float)
    small = np.abs(half) < 1e-4
    tangent = np.tan(np.where(small, 1.0, half))
    return np.where(small, 1.0 - half * half / 3.0, half / tangent) - 1j * half


def line(count: int, spacing: float) -> List[PlanarPose]:
    """Return places along x from the origin, `spacing` m apart, with yaw 0."""
    return [(spacing * index, 0.0, 0.0) for index in range(count)]


def grid(count: int, spacing: float) -> List[PlanarPose]:
    """Return places row by row in a square grid that starts at the origin.

    The grid is as many places wide as the root of their number, rounded up; rows run along x
    and follow each other along y.
    """
    width = math.ceil(math.sqrt(count))
    return [(spacing * (index % width), spacing * (index // width), 0.0) for index in range(count)]


def circle(count: int, radius: float) -> List[PlanarPose]:
    """Return places at equal distances on a circle about the origin, facing outwards."""
    angles = [math.tau * index / count for index in range(count)]
    return [
        (radius * math.cos(a), radius * math.sin(a), math.remainder(a, math.tau)) for a in angles
    ]


LEVEL = 0.95
"""Probability that a Gaussian position lies within the ellipse."""

SQUARE_RADIUS = -2.0 * math.log(1.0 - LEVEL)
"""Of the ellipse, in variances: the quantile of chi-square with two degrees of freedom."""


def ellipse_points(covariance, count: int = 73) -> ndarray:
    """Return points of the 95 % ellipse around the origin, (count, 2) in m.

    The first and the last are the same. Of the covariance (m²), the first two rows and columns are
    used.

    >>> ellipse_points(np.diag([0.04, 0.01]), 5).round(3).max(axis=0)
    array([0.49 , 0.245])
    """
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float)[:2, :2])
    radii = np.sqrt(SQUARE_RADIUS * np.maximum(values, 0.0))
    angles = np.linspace(0.0, math.tau, count)
    return (radii * np.column_stack((np.cos(angles), np.sin(angles)))) @ vectors.T
