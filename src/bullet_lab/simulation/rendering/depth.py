"""How far away what is seen is, in metres, from the renderer's depth buffer.

A depth buffer holds far·(z - near) / (z·(far - near)), which is fine near the eye and coarse far
from it. EGL's has 16 bits; TinyRenderer's are floating-point numbers, good for a hundredth of a
millimetre. Rays cast into the physics would be exact, but take about a microsecond each, a second
for an image, and meet the shapes of collision, not those that are seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bullet_lab.numerics.pinhole import PinholeCamera
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.choice import EGL
from bullet_lab.simulation.rendering.frame import Photographer, Shot

# EGL's steps between its near and its far plane.
STEPS = 65536.0
# In m: with a coarser depth than this at the farthest distance, a second look is worth its time.
GOOD_ENOUGH = 1e-3
# What lies in the last step before the far plane is not told from nothing.
MARGIN = 1.01


@dataclass(frozen=True)
class DepthRange:
    """What distances along the view (m) are measured.

    Attributes:
        near: what is nearer than this is not seen at all.
        closest: what is nearer than this hides what is behind it, and is not measured.
        farthest: what is farther than this is not measured.
    """

    near: float
    closest: float
    farthest: float


def depth_step(distance: float, near: float, far: float = math.inf) -> float:
    """Return how far apart two depths are (m) that EGL's buffer holds at a distance (m)."""
    return distance * distance * (1.0 / near - 1.0 / far) / STEPS


def measure_depths(
    photographer: Photographer, pose: Pose, camera: PinholeCamera, measured: DepthRange
) -> np.ndarray:
    """Return the distance of what is seen at each pixel, along the optical axis.

    Where EGL would be too coarse at the far end, it looks twice, near by and far away: each
    time its steps are divided over a shorter way.

    Args:
        photographer: who looks.
        pose: of the camera in the world: x ahead, z up.
        camera: geometry of the image, without distortion.
        measured: between which distances.

    Returns:
        (height, width) float32 in m, NaN where there is nothing within the range.

    Raises:
        LabError: something in the world cannot be drawn.
    """
    near, far = measured.near, MARGIN * measured.farthest
    # Rounded to the nearest step.
    error = 0.5 * depth_step(measured.farthest, near, far)
    if photographer.renderer == EGL and error > GOOD_ENOUGH:
        middle = math.sqrt(near * far)
        depths = photographer.measure(pose, Shot(camera, near, MARGIN * middle))
        beyond = photographer.measure(pose, Shot(camera, middle, far))
        depths = np.where(np.isfinite(depths), depths, beyond)
    else:
        depths = photographer.measure(pose, Shot(camera, near, far))
    depths[(depths <= measured.closest) | (depths >= measured.farthest)] = np.nan
    return depths
