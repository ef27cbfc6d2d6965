"""Pictures of a simulation from anywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.simulation import Simulation


class ViewError(LabError):
    """A picture that cannot be taken."""


@dataclass(frozen=True)
class View:
    """An ideal pinhole camera in the world that looks from `eye` at `target` (both in m), upright.

    Width and height are in pixels, the field of view in rad; `near` and `far` (m) limit what is
    drawn.
    """

    eye: Vector
    target: Vector
    width: int = 640
    height: int = 480
    horizontal_fov: float = math.radians(65.0)
    near: float = 0.1
    far: float = 100.0


def take_picture(simulation: Simulation, view: View, samples: int = 1) -> np.ndarray:
    """Draw the world as it is now.

    Args:
        simulation: what to draw.
        view: from where.
        samples: of each pixel: 1, 2 or 4.

    Returns:
        (height, width, 3) array of uint8, RGB. The same world and view give the same bytes.

    Raises:
        ViewError: the picture has no area or depth, a number is not finite, or the target is
            straight above or below the eye.
        LabError: nothing can be drawn here.
    """
    if not all(map(math.isfinite, (*view.eye, *view.target, view.near, view.far))):
        raise ViewError("the view has a number that is not finite")
    if not 0.0 < view.near < view.far:
        raise ViewError(f"no view reaches from {view.near:g} m to {view.far:g} m")
    if view.width < 1 or view.height < 1 or not 0.0 < view.horizontal_fov < math.pi:
        raise ViewError(f"no picture has {view.width} x {view.height} pixels and such an angle")
    if math.dist(view.eye[:2], view.target[:2]) == 0.0:
        raise ViewError("the view is vertical: the picture has no upper side")
    focal = 0.5 * view.width / math.tan(0.5 * view.horizontal_fov)
    centre = (0.5 * (view.width - 1), 0.5 * (view.height - 1))
    camera = PinholeCamera(view.width, view.height, focal, focal, *centre)
    shot = Shot(camera, view.near, view.far, samples)
    # Along its x axis at the target, without roll.
    dx, dy, dz = np.subtract(view.target, view.eye)
    rpy = (0.0, -math.atan2(dz, math.hypot(dx, dy)), math.atan2(dy, dx))
    return simulation.renderer().picture(Pose.from_rpy(view.eye, rpy), shot)
