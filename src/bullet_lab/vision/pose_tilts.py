"""How far off the pose of a flat marker may be, beyond what its likelihood's curvature tells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera

# Tilts (n, 2) at which the likelihood is looked at, up to so many standard deviations.
_REACH = 3.5
_TILTS = np.stack(np.meshgrid(*2 * [np.linspace(-_REACH, _REACH, 15)]), axis=-1).reshape(-1, 2)
# From so many standard deviations on the other pose does not matter.
_FAR = 16.0


@dataclass(frozen=True, eq=False)
class Seen:
    """What a pose is judged by.

    Attributes:
        points: (4, 3) m, in the marker's frame.
        corners: (4, 2) px, where they are seen.
        camera: geometry of the image.
        whitening: (8, 8), by which the corners' errors become independent ones of 1.
    """

    points: np.ndarray
    corners: np.ndarray
    camera: PinholeCamera
    whitening: np.ndarray


def mean_squares(
    rotation: np.ndarray,
    translation: np.ndarray,
    covariance: np.ndarray,
    turn: np.ndarray,
    seen: Seen,
) -> np.ndarray:
    """Return the mean squares (6, 6) of a pose's error in place of the curvature's inverse.

    How a marker that faces the camera looks changes with the square of its tilt: what tilts are as
    likely is no ellipse, and the estimate is not in its middle. The likelihood is summed over both
    tilts, up to half way to the other pose, with every angle between the marker's axis and the
    line of sight as likely as any; all else follows the tilts to first order.

    Args:
        rotation: (3, 3), of the marker in the optical frame.
        translation: (3,) m.
        covariance: (6, 6), of `translation` and of small rotations; the curvature's inverse.
        turn: (3,) rotation vector to the other pose; of length 0 if there is none.
        seen: the corners.
    """
    sight = translation / np.linalg.norm(translation)
    across = np.linalg.svd(sight[None])[2][1:]
    of_tilts = across @ covariance[3:, 3:] @ across.T
    away = across @ turn
    if not np.linalg.det(of_tilts) > 0.0 or away @ away > _FAR**2 * np.trace(of_tilts):
        return covariance
    scale = np.linalg.cholesky(of_tilts + np.outer(away, away) / (2.0 * _REACH) ** 2)
    tilts = _TILTS @ scale.T
    tilts = tilts[tilts @ away <= 0.5 * (away @ away)]
    along = covariance[:, 3:] @ across.T @ np.linalg.inv(of_tilts)
    moves, squares = _followed(rotation, translation, tilts @ along.T, seen)
    facing = across @ np.cross(sight, rotation[:, 2])
    likely = np.exp(-0.5 * (squares - squares.min()))
    likely /= np.hypot(np.hypot(*(tilts - facing).T), math.sqrt(np.trace(of_tilts)))
    beside = covariance - along @ of_tilts @ along.T
    squares = beside + (moves.T * (likely / likely.sum())) @ moves
    return squares if np.isfinite(squares).all() else covariance


def _followed(
    rotation: np.ndarray, translation: np.ndarray, moves: np.ndarray, seen: Seen
) -> Tuple[np.ndarray, np.ndarray]:
    """Return moves (n, 6) with the best place and roll for their tilts, and their squares (n,)."""
    turned = seen.points @ rotation.T
    residuals = _residuals(turned, translation, moves, seen) @ seen.whitening.T
    _, jacobian = linearised(rotation, translation, seen.points, seen.corners, seen.camera)
    free = np.zeros((6, 4))
    free[:3, :3], free[3:, 3] = np.eye(3), translation / np.linalg.norm(translation)
    basis, upper = np.linalg.qr(seen.whitening @ jacobian @ free)
    in_basis = residuals @ basis
    squares = np.square(residuals).sum(axis=1) - np.square(in_basis).sum(axis=1)
    return moves - in_basis @ np.linalg.inv(upper).T @ free.T, squares


def _residuals(
    turned: np.ndarray, translation: np.ndarray, moves: np.ndarray, seen: Seen
) -> np.ndarray:
    """Return the residuals (n, 8) in px of turned points (4, 3) that are moved by (n, 6)."""
    angles = np.linalg.norm(moves[:, 3:], axis=1)
    axes = moves[:, 3:] / np.maximum(angles, 1e-12)[:, None]
    # Rodrigues' formula.
    sine, cosine = (np.reshape(f(angles), (-1, 1, 1)) for f in (np.sin, np.cos))
    axes = axes[:, None]
    points = cosine * turned + sine * np.cross(axes, turned)
    points += (1.0 - cosine) * (axes * turned).sum(axis=2, keepdims=True) * axes
    points += (translation + moves[:, :3])[:, None]
    pixels, _ = _projected(points.reshape(-1, 3), seen.camera)
    return pixels.reshape(len(moves), 8) - seen.corners.ravel()


def linearised(
    rotation: np.ndarray,
    translation: np.ndarray,
    points: np.ndarray,
    corners: np.ndarray,
    camera: PinholeCamera,
) -> Tuple[np.ndarray, np.ndarray]:
    """Return the (8,) residuals in px and their (8, 6) derivatives by x, y, z and rotations."""
    turned = points @ rotation.T
    pixels, by_point = _projected(turned + translation, camera)
    crosses = np.zeros((4, 3, 3))
    crosses[:, 0, 1], crosses[:, 0, 2], crosses[:, 1, 2] = turned[:, 2], -turned[:, 1], turned[:, 0]
    crosses -= np.swapaxes(crosses, 1, 2)
    jacobian = np.concatenate((by_point, by_point @ crosses), axis=2).reshape(8, 6)
    return (pixels - corners).ravel(), jacobian


def _projected(seen: np.ndarray, camera: PinholeCamera) -> Tuple[np.ndarray, np.ndarray]:
    """Return the pixels (n, 2) of points of the optical frame and their (n, 2, 3) derivatives."""
    if not any(camera.distortion):
        x, y = seen[:, 0], seen[:, 1]
        z = np.where(seen[:, 2] > 0.0, seen[:, 2], np.nan)
        u, v = camera.fx * x / z, camera.fy * y / z
        by_point = np.zeros((len(seen), 2, 3))
        by_point[:, 0, 0], by_point[:, 0, 2] = camera.fx / z, -u / z
        by_point[:, 1, 1], by_point[:, 1, 2] = camera.fy / z, -v / z
        return np.column_stack((u + camera.cx, v + camera.cy)), by_point
    # By central differences through the lens.
    step = 1e-6 * float(np.abs(seen[:, 2]).mean())
    shifts = step * np.vstack((np.zeros(3), np.eye(3), -np.eye(3)))
    pixels = camera.project((seen[:, None] + shifts).reshape(-1, 3)).reshape(len(seen), 7, 2)
    by_point = np.swapaxes((pixels[:, 1:4] - pixels[:, 4:]) / (2.0 * step), 1, 2)
    return pixels[:, 0], by_point
