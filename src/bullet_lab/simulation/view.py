"""Pictures of a simulation, drawn by PyBullet's software renderer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.engine import pybullet
from bullet_lab.simulation.pose import Vector
from bullet_lab.simulation.simulation import Simulation


class ViewError(LabError):
    """A picture that cannot be taken."""


@dataclass(frozen=True)
class View:
    """An ideal pinhole camera somewhere in the world.

    Attributes:
        eye: where the camera is, in metres in the world's frame.
        target: the point that it looks at; the world's z axis is up in the picture.
        width: of the picture, in pixels.
        height: of the picture, in pixels.
        horizontal_fov: opening angle in radians.
        near: closest distance drawn, in metres.
        far: farthest distance drawn, in metres.
    """

    eye: Vector
    target: Vector
    width: int = 640
    height: int = 480
    horizontal_fov: float = math.radians(65.0)
    near: float = 0.1
    far: float = 100.0


def take_picture(simulation: Simulation, view: View) -> np.ndarray:
    """Draw the world as it is now.

    Returns:
        (height, width, 3) array of uint8, RGB. The same world and view give the same bytes.

    Raises:
        ViewError: the picture has no area or depth, a number is not finite, or the target is
            straight above or below the eye.
    """
    if not all(map(math.isfinite, (*view.eye, *view.target, view.near, view.far))):
        raise ViewError("the view has a number that is not finite")
    if not 0.0 < view.near < view.far:
        raise ViewError(f"no view reaches from {view.near:g} m to {view.far:g} m")
    if view.width < 1 or view.height < 1 or not 0.0 < view.horizontal_fov < math.pi:
        raise ViewError(f"no picture has {view.width} x {view.height} pixels and such an angle")
    if math.dist(view.eye[:2], view.target[:2]) == 0.0:
        raise ViewError("the view is vertical: the picture has no upper side")
    aspect = view.width / view.height
    vertical_fov = 2.0 * math.atan(math.tan(0.5 * view.horizontal_fov) / aspect)
    ambient = sum(simulation.world.ambient[:3]) / 3.0
    _, _, pixels, _, shown = pybullet.getCameraImage(
        view.width,
        view.height,
        pybullet.computeViewMatrix(view.eye, view.target, (0.0, 0.0, 1.0)),
        pybullet.computeProjectionMatrixFOV(
            math.degrees(vertical_fov), aspect, view.near, view.far
        ),
        lightDirection=_light_direction(simulation),
        lightAmbientCoeff=ambient,
        lightDiffuseCoeff=0.6,
        lightSpecularCoeff=0.0,
        shadow=0,
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=simulation.client,
    )
    shape = (view.height, view.width)
    picture = np.array(pixels, dtype=np.uint8).reshape(*shape, 4)[:, :, :3]
    background = np.round(255.0 * np.asarray(simulation.world.background[:3]))
    picture[np.asarray(shown).reshape(shape) < 0] = background
    return picture


def _light_direction(simulation: Simulation) -> Vector:
    """Return the direction towards the world's first light (from above if there is none)."""
    for light in simulation.world.lights:
        if light.kind == "directional":
            return tuple(-value for value in light.pose.rotate(light.direction))
        return light.pose.position
    return (0.3, -0.4, 1.0)
