"""Angles in radians and quaternions of a planar heading."""

from __future__ import annotations

import math

import numpy as np


def wrap(angle):
    """Wrap angles into [-pi, pi): pi itself becomes -pi.

    Angles that are already inside come back bit for bit, so wrapping never makes a pose drift.

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
    # fmod is exact, and so is the one subtraction that may follow.
    wrapped = np.fmod(angle, math.tau)
    return wrapped - math.tau * ((wrapped >= math.pi) * 1.0 - (wrapped < -math.pi) * 1.0)


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the heading (rad, in [-pi, pi]) of a rotation.

    This is the first angle of the intrinsic z-y-x sequence. The quaternion need not have unit
    length; an all-zero one, as in a message that nobody filled in, gives 0.

    >>> yaw_from_quaternion(0.0, 0.0, 1.0, 1.0) == math.pi / 2.0
    True
    """
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def quaternion_from_yaw(yaw: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a heading (rad).

    >>> quaternion_from_yaw(math.pi)[:3]
    (0.0, 0.0, 1.0)
    """
    return 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)
