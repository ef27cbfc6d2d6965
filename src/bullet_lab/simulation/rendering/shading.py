"""Lighting the shapes of a link, in a form that PyBullet's renderers draw as it is.

The renderers' own light has to be constant for that. TinyRenderer's is, by its coefficients.
EGL's is 0.75 + 0.25 c for normals at the cosine c < 0 to the light, without a highlight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Optional, Tuple

import numpy as np

from bullet_lab.simulation.description import Colour
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.lighting import Lighting
from bullet_lab.simulation.rendering.shadows import Cut, Shadows
from bullet_lab.simulation.rendering.surfaces import Surface
from bullet_lab.simulation.rendering.texture_map import TextureMap

STANDING, TURNING, TUMBLING = "standing", "turning", "tumbling"

# Levels of the grey ramp that brightness is read from as from a picture.
RAMP = 256
# Steps of brightness that parts with a picture are told apart by.
SHADES = 128
# EGL's brightness at the cosine -1 and close to 0, and what lies between for normals all around.
DARKEST, BRIGHTEST, EGL_MEAN = 0.5, 0.745, 0.75
# Parts are told apart by so large steps of brightness; within one, EGL's light can show it.
BAND = 1.2
# Below this share of the world's peak, differences are not seen.
BLACK = 1e-3
# Across a triangle, brightness may fall to this share, unless it is dim anyway.
STEEPEST = 0.8
DIM = 0.02
# Triangles under lamps are cut until an edge is no longer than this, in m, or so many times.
FINEST_EDGE = 0.25
MOST_CUTS = 5


@dataclass(frozen=True)
class Part:
    """Triangles of one colour, with the cosines (n, 3) of their normals to EGL's light.

    Without cosines the normals are the shape's own.
    """

    surface: Surface
    colour: Colour
    cosines: Optional[np.ndarray] = None


class Shader:
    """Lights shapes.

    Args:
        lighting: of the world.
        egl: whether EGL draws.
        texture_map: what EGL finds the places in pictures with, see there; None for the
            coordinates of the surfaces.
        shadows: on what stands still.
    """

    def __init__(
        self,
        lighting: Lighting,
        egl: bool,
        texture_map: Optional[TextureMap] = None,
        shadows: Optional[Shadows] = None,
    ):
        self._lighting = lighting
        self._egl = egl
        self._map = texture_map
        self._shadows = shadows

    def parts(
        self, surface: Surface, colour: Colour, pose: Pose, motion: str, shape: int = 0
    ) -> List[Part]:
        """Return a surface of a link in lit parts.

        Args:
            surface: in the link's frame.
            colour: of the shape.
            pose: of the link in the world now.
            motion: "standing" things are lit where they are; "turning" ones may have any
                heading, "tumbling" ones, such as wheels, any attitude.
            shape: the number by which its shadows are known.
        """
        colour = tuple(a * b for a, b in zip(colour, surface.tint)) + (colour[3],)
        if self._lighting.local and motion == STANDING:
            surface = _cut_up(surface)
        if surface.texture is not None and self._map is not None:
            surface = replace(surface, texture=self._map.image(surface.moved(pose)))
        cut = None
        if self._shadows is not None and motion == STANDING:
            cut = self._shadows.on(surface.moved(pose), shape)
        surface = surface if cut is None else cut.of(surface)
        shades = self._shades(surface.moved(pose), pose, motion, cut) / self._lighting.peak
        if surface.texture is not None:
            return self._with_picture(surface, shades, colour)
        if motion == TUMBLING and self._egl:
            return [Part(surface, _scaled(colour, shades.mean() / EGL_MEAN))]
        if self._map is not None:
            return self._in_bands(surface, shades, colour)
        return [Part(_on_ramp(surface, shades), self._even(colour), -np.ones(shades.shape))]

    def _shades(self, world: Surface, pose: Pose, motion: str, cut: Optional[Cut]) -> np.ndarray:
        if motion == STANDING:
            unseen = None if cut is None else cut.unseen
            return self._lighting.shade(world.corners, world.normals, unseen)
        if motion == TURNING:
            return self._lighting.mean_shade(world.corners, world.normals)
        points = np.broadcast_to(np.asarray(pose.position), _ALL_WAYS.shape)
        mean = float(self._lighting.shade(points, _ALL_WAYS).mean())
        return np.full(world.corners.shape[:2], mean)

    def _even(self, colour: Colour) -> Colour:
        """Return the colour that comes out as this one for normals at the cosine -1."""
        return _scaled(colour, 1.0 / DARKEST) if self._egl else colour

    def _with_picture(self, surface: Surface, shades: np.ndarray, colour: Colour) -> List[Part]:
        steps = np.round(shades.mean(axis=1) * SHADES).astype(int)
        parts = []
        for step in np.unique(steps):
            chosen = surface.select(steps == step)
            tinted = self._even(_scaled(colour, step / SHADES))
            parts.append(Part(chosen, tinted, -np.ones(chosen.corners.shape[:2])))
        return parts

    def _in_bands(self, surface: Surface, shades: np.ndarray, colour: Colour) -> List[Part]:
        """Return parts by brightness, which is shown by colour and, within each, by normals."""
        surface, shades = _evened(surface, shades)
        brightest = np.maximum(BLACK, shades.max(axis=1))
        bands = np.ceil(np.log(brightest) / np.log(BAND) - 1e-9).astype(int)
        parts = []
        for band in np.unique(bands):
            chosen = bands == band
            # All of one brightness need no more than their own.
            top = min(BAND**band, brightest[chosen].max())
            wanted = np.clip(BRIGHTEST * shades[chosen] / top, DARKEST, BRIGHTEST)
            parts.append(
                Part(
                    surface.select(chosen),
                    _scaled(colour, top / BRIGHTEST),
                    4.0 * (wanted - 0.75),
                )
            )
        return parts


def _scaled(colour: Colour, factor: float) -> Colour:
    return tuple(factor * value for value in colour[:3]) + (colour[3],)


def _on_ramp(surface: Surface, shades: np.ndarray) -> Surface:
    """Return the surface with places in a ramp that goes up and down again.

    So coarse copies of the ramp wrap around without a seam.
    """
    along = (np.clip(shades, 0.0, 1.0) * (RAMP - 1) + 0.5) / (2 * RAMP)
    return replace(surface, picture=np.stack((along, np.full_like(along, 0.5)), axis=-1))


def _cut_up(surface: Surface) -> Surface:
    """Cut triangles into four until their edges are short, for light that changes over them."""
    arrays = [surface.corners, surface.normals, surface.picture]
    for _ in range(MOST_CUTS):
        sides = np.linalg.norm(arrays[0] - np.roll(arrays[0], 1, axis=1), axis=-1)
        if sides.max() <= FINEST_EDGE:
            break
        arrays = [None if array is None else _quarter(array) for array in arrays]
    corners, normals, picture = arrays
    return replace(surface, corners=corners, normals=normals, picture=picture)


def _evened(surface: Surface, shades: np.ndarray) -> Tuple[Surface, np.ndarray]:
    """Cut those triangles into four over which the brightness changes too much to be shown."""
    corners, normals = surface.corners, surface.normals
    for _ in range(MOST_CUTS):
        least, most = shades.min(axis=1), shades.max(axis=1)
        uneven = (least < STEEPEST * most) & (most > DIM)
        if not uneven.any():
            break
        corners, normals, shades = (
            np.concatenate((array[~uneven], _quarter(array[uneven])))
            for array in (corners, normals, shades)
        )
    return replace(surface, corners=corners, normals=normals), shades


def _quarter(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _directions() -> np.ndarray:
    """Return directions spread evenly over all ways (a spiral from pole to pole)."""
    count = 64
    heights = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angles = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.sqrt(1.0 - heights**2)
    return np.column_stack((flat * np.cos(angles), flat * np.sin(angles), heights))


_ALL_WAYS = _directions()
