"""Where the corners of a dock's marker are seen, and how that moves with the dock.

A marker state is (x, y, yaw, height, growth): pose of the dock in the robot's frame, height of
the marker's centre above the floor, and logarithm of its size over the size it is taken for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.docking.types import CameraMount, PlanarPose

STATES = 5
# How much states are moved to find out what the pixels do, and the disturbances too.
_NUDGES = 1e-4 * np.eye(STATES)
_TILT = 1e-4


@dataclass(frozen=True)
class PixelNoise:
    """What the corners of one image are uncertain by.

    Attributes:
        corner: px, standard deviation of each corner, on its own.
        relative: as part of the marker's size in the image, added to it.
        small: px², divided by the size in the image and added too: corners of a marker of few
            pixels per cell are off together with the pattern and the blur.
        tilt: rad, pitch and roll of the robot, for all corners together.
        turn: rad, of its yaw at the moment of the image.
    """

    corner: float = 0.35
    relative: float = 0.0015
    small: float = 16.0
    tilt: float = math.radians(0.15)
    turn: float = math.radians(0.03)


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A camera as it was when it took an image, seen from the robot as it is now.

    Attributes:
        camera: its geometry.
        mount: where it is on the robot.
        moved: pose of the robot at the time of the image, in its present frame.
    """

    camera: PinholeCamera
    mount: CameraMount
    moved: PlanarPose = (0.0, 0.0, 0.0)

    def optical(self, points: np.ndarray) -> np.ndarray:
        """Turn (..., 3) points of the robot's present frame into the optical frame."""
        cos, sin = math.cos(self.moved[2]), math.sin(self.moved[2])
        x, y = points[..., 0] - self.moved[0], points[..., 1] - self.moved[1]
        then = np.stack([cos * x + sin * y, cos * y - sin * x, points[..., 2]], axis=-1)
        there = (then - (self.mount.x, self.mount.y, self.mount.z)) @ self.mount.rotation()
        return np.stack([-there[..., 1], -there[..., 2], there[..., 0]], axis=-1)

    def pixels(self, optical: np.ndarray) -> np.ndarray:
        """Return (..., 2) pixels of (..., 3) points of the optical frame."""
        return self.camera.project(optical.reshape(-1, 3)).reshape(*optical.shape[:-1], 2)


def corner_points(states: np.ndarray, sizes) -> np.ndarray:
    """Return the corners of markers in the robot's frame.

    Args:
        states: (..., 5).
        sizes: m, edge of the black square, of the shape (...).

    Returns:
        (..., 4, 3): top left, top right, bottom right and bottom left, as one looks at it.
    """
    # Copies, since numpy's functions round differently where they take columns of a larger array
    # to overlap with their result, which depends on where that happens to lie in memory.
    half = 0.5 * (np.asarray(sizes, dtype=float) * np.exp(states[..., 4].copy()))[..., None]
    across = half * np.array([1.0, -1.0, -1.0, 1.0])
    up = half * np.array([1.0, 1.0, -1.0, -1.0])
    x, y, yaw, height = (states[..., i, None] for i in range(4))
    yaw = yaw.copy()
    return np.stack([x - np.sin(yaw) * across, y + np.cos(yaw) * across, height + up], axis=-1)


def predict(
    states: np.ndarray, sizes: np.ndarray, view: Viewpoint
) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where corners are seen, and the derivatives of that.

    Args:
        states: (n, 5) marker states.
        sizes: (n,) m.
        view: the camera.

    Returns:
        Pixels (n, 8) as u, v of each corner in turn; derivatives by the state (n, 8, 5); and by
        pitch, roll and yaw of the robot at the moment of the image (n, 8, 3). NaN for a marker
        that is not ahead of the camera.
    """
    count = len(states)
    nudged = np.concatenate([states[:, None], states[:, None] + _NUDGES], axis=1)
    points = view.optical(corner_points(nudged, np.repeat(sizes[:, None], STATES + 1, axis=1)))
    here = points[:, 0]
    x, y, z = here[..., 0], here[..., 1], here[..., 2]
    zero = np.zeros_like(x)
    tilted = here[:, None] + _TILT * np.stack(
        [
            np.stack([zero, -z, y], axis=-1),
            np.stack([-y, x, zero], axis=-1),
            np.stack([z, zero, -x], axis=-1),
        ],
        axis=1,
    )
    pixels = view.pixels(np.concatenate([points, tilted], axis=1)).reshape(count, -1, 8)
    seen = pixels[:, 0]
    changes = (pixels[:, 1:] - pixels[:, :1]).transpose(0, 2, 1)
    return seen, changes[..., :STATES] / 1e-4, changes[..., STATES:] / _TILT


def noise_covariance(noise: PixelNoise, extent: float, tilts: np.ndarray) -> np.ndarray:
    """Return the (n, 8, 8) covariance of the corners of one image.

    Args:
        noise: how uncertain they are.
        extent: px, size of the marker in the image.
        tilts: (n, 8, 3) derivatives by pitch, roll and yaw.
    """
    own = noise.corner**2 + (noise.relative * extent) ** 2 + (noise.small / extent) ** 2
    spread = tilts * np.array([noise.tilt, noise.tilt, noise.turn])
    return own * np.eye(8) + spread @ spread.transpose(0, 2, 1)


def extent_of(corners: np.ndarray) -> float:
    """Return the size of a marker in the image: its mean diagonal over the root of two, in px."""
    diagonals = np.hypot(*(corners[2] - corners[0])), np.hypot(*(corners[3] - corners[1]))
    return float(np.mean(diagonals)) / math.sqrt(2.0)
