"""The iterated extended Kalman filter on the corners of a marker, for many Gaussians at once."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from bullet_lab.core.angles import wrap
from bullet_lab.docking.marker_model import (
    PixelNoise,
    Viewpoint,
    extent_of,
    noise_covariance,
    predict,
)
from bullet_lab.docking.types import CameraMount

# Pixels off below which the first linearisation will do.
_LINEAR = 4.0


def turned_place(mount: CameraMount, yaw: float) -> np.ndarray:
    """Return where (3,) a camera is when the robot has turned by a yaw (rad)."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([cos * mount.x - sin * mount.y, sin * mount.x + cos * mount.y, mount.z])


def line_of_sight(corners, view: Viewpoint, size: float) -> Tuple[np.ndarray, float]:
    """Return the direction of the marker's centre in the robot's frame, and its range.

    The direction is scaled to unit length on the floor. A slanted marker is narrower than it is
    tall, so the range comes from its height.
    """
    camera = view.camera
    centre = np.mean(corners, axis=0)
    across = (camera.cx - centre[0]) / camera.fx
    ahead = np.array([1.0, across, (camera.cy - centre[1]) / camera.fy])
    ray = view.mount.rotation() @ ahead
    cos, sin = math.cos(view.moved[2]), math.sin(view.moved[2])
    ray = np.array([cos * ray[0] - sin * ray[1], sin * ray[0] + cos * ray[1], ray[2]])
    tall = 0.5 * (np.hypot(*(corners[3] - corners[0])) + np.hypot(*(corners[2] - corners[1])))
    depth = camera.fy * size / max(float(tall), 1.0)
    floor = math.hypot(ray[0], ray[1])
    return ray / floor, depth * floor


def innovations(start, x, p, sizes, corners, view: Viewpoint, noise: PixelNoise):
    """Compare corners with states `start` of covariance `p`, linearised at states `x`.

    Returns:
        What is left to explain (n, 8), derivatives (n, 8, 5) and covariance (n, 8, 8).
    """
    seen, by_state, tilts = predict(x, sizes, view)
    bad = ~np.isfinite(seen).all(axis=1)
    seen[bad], by_state[bad], tilts[bad] = 1e4, 0.0, 0.0
    off = start - x
    off[:, 2] = wrap(off[:, 2])
    rest = corners.reshape(8) - seen - applied(by_state, off)
    covariance = noise_covariance(noise, extent_of(corners), tilts)
    return rest, by_state, covariance + by_state @ p @ by_state.transpose(0, 2, 1)


def squared_distances(rest: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return squared Mahalanobis distances (n,)."""
    return np.sum(rest * np.linalg.solve(covariance, rest[..., None])[..., 0], axis=1)


def applied(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return products (n, i) of matrices (n, i, j) and vectors (n, j).

    Not by einsum, whose last bits depend on where the arrays happen to lie in memory.
    """
    return (matrices @ vectors[..., None])[..., 0]


def filtered(start, p, sizes, corners, view: Viewpoint, noise: PixelNoise, rounds: int = 3):
    """Take corners into account by the iterated extended Kalman filter.

    Returns:
        States (n, 5), covariances (n, 5, 5), squared Mahalanobis distances of the corners (n,)
        and logarithms of the determinants of their covariances (n,).
    """
    corners = np.asarray(corners, dtype=float)
    x = start
    for number in range(rounds):
        rest, by_state, covariance = innovations(start, x, p, sizes, corners, view, noise)
        gain = np.linalg.solve(covariance, by_state @ p).transpose(0, 2, 1)
        before, x = x, start + applied(gain, rest)
        x[:, 2] = wrap(x[:, 2])
        if number == 0 and rounds < 6 and np.max(np.abs(rest)) < _LINEAR:
            break
        if np.max(np.abs(x - before)) < 1e-4:
            break
    left = p - gain @ by_state @ p
    left = 0.5 * (left + left.transpose(0, 2, 1))
    return x, left, squared_distances(rest, covariance), np.linalg.slogdet(covariance)[1]
