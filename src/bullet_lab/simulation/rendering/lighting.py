"""How bright the lights of a world make a surface.

Neither of PyBullet's renderers knows more than one light, and each has a formula of its own.
So surfaces that stand still are lit once, here, with Lambert's law, and drawn as they are:

    brightness = ambient + sum over lights of intensity * max(0, normal . towards light) * fading

with fading 1 / (constant + linear * d + quadratic * d²) within the light's range, and the cone
of a spot. Colours of lights count by their mean; there are no highlights.
"""

from __future__ import annotations

import math
from typing import Iterable, Optional

import numpy as np

from bullet_lab.simulation.description import Light, World

# Headings over which the light on something that turns is averaged.
HEADINGS = 12


class Lighting:
    """The light in a world.

    Attributes:
        peak: no surface is brighter than this; 1 makes a white surface white in the picture.
    """

    def __init__(self, world: World):
        self._ambient = sum(world.ambient[:3]) / 3.0
        self._lights = world.lights
        self.peak = max(1e-6, self._ambient + sum(map(_intensity, world.lights)))

    @property
    def local(self) -> bool:
        """Whether it changes from place to place."""
        return any(light.kind != "directional" for light in self._lights)

    def shade(
        self, points: np.ndarray, normals: np.ndarray, unseen: Optional[np.ndarray] = None
    ) -> np.ndarray:
        """Return the brightness at points with unit normals, both (n, …, 3) in the world: (n, …).

        With shadows, `unseen` (n, lights) says which lights do not reach the points.
        """
        total = np.full(points.shape[:-1], self._ambient)
        for k, light in enumerate(self._lights):
            lit = _from_light(light, points, normals)
            if unseen is not None:
                lit[unseen[:, k]] = 0.0
            total += lit
        return total

    def mean_shade(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the brightness of what may have any heading: the mean over all of them."""
        return np.mean([self.shade(points, normals @ turn.T) for turn in _turns()], axis=0)


def _intensity(light: Light) -> float:
    return sum(light.diffuse[:3]) / 3.0


def _from_light(light: Light, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    along = np.asarray(light.pose.rotate(light.direction))
    if light.kind == "directional":
        return _intensity(light) * np.maximum(0.0, -(normals @ along))
    offsets = np.asarray(light.pose.position) - points
    distances = np.maximum(1e-9, np.linalg.norm(offsets, axis=-1))
    towards = offsets / distances[..., None]
    lit = _intensity(light) * np.maximum(0.0, np.sum(normals * towards, axis=-1))
    lit *= light.attenuation.at(distances)
    return lit if light.kind == "point" else lit * light.cone.at(-(towards @ along))


def _turns() -> Iterable[np.ndarray]:
    for angle in np.arange(HEADINGS) * (2.0 * math.pi / HEADINGS):
        cosine, sine = math.cos(angle), math.sin(angle)
        yield np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
