"""Planar poses: float arrays of shape (..., 3) holding x (m), y (m) and yaw (rad).

Leading axes broadcast as everywhere in numpy. Every yaw that is returned lies in [-pi, pi).
"""

from __future__ import annotations

from typing import Tuple

import numpy as np

from bullet_lab.core.angles import wrap

PlanarPose = Tuple[float, float, float]
"""One of them as numbers, for those who hold one at a time: x (m), y (m) and yaw (rad)."""


def compose(a, b) -> np.ndarray:
    """Return the pose `b`, given in the frame of pose `a`, in the frame that `a` is given in.

    Args:
        a: poses, shape (..., 3).
        b: poses, shape (..., 3).

    Returns:
        Poses of the common broadcast shape (..., 3).

    >>> compose([1.0, 2.0, np.pi / 2.0], [[0.5, 0.0, 0.0], [0.0, 0.0, 1.0]]).round(3)
    array([[1.   , 2.5  , 1.571],
           [1.   , 2.   , 2.571]])
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        np.broadcast_arrays(
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap(a[..., 2] + b[..., 2]),
        ),
        axis=-1,
    )


def between(a, b) -> np.ndarray:
    """Return pose `b` as seen from pose `a`; `compose` with `a` gives `b` again.

    Args:
        a: poses, shape (..., 3).
        b: poses in the same frame as `a`, shape (..., 3).

    Returns:
        Poses of the common broadcast shape (..., 3).

    >>> between([1.0, 2.0, np.pi / 2.0], [1.0, 2.5, 0.0]).round(3)
    array([ 0.5  ,  0.   , -1.571])
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack(
        np.broadcast_arrays(cos * dx + sin * dy, cos * dy - sin * dx, wrap(b[..., 2] - a[..., 2])),
        axis=-1,
    )


def inverse(pose) -> np.ndarray:
    """Return the origin as seen from each pose, shape (..., 3).

    >>> inverse([1.0, 0.0, 0.0])
    array([-1.,  0.,  0.])
    """
    return between(pose, np.zeros(3))


def steps(poses) -> np.ndarray:
    """Return each pose of a path as seen from the one before: (..., n, 3) gives (..., n-1, 3).

    >>> steps([(0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (1.0, 0.0, 0.0)])
    array([[ 1. ,  0. ,  0.5],
           [ 0. ,  0. , -0.5]])
    """
    poses = np.asarray(poses, dtype=float)
    return between(poses[..., :-1, :], poses[..., 1:, :])
