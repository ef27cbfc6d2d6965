"""Sharp shadows that things which stand still throw on one another, as cuts of triangles.

On the plane of a triangle, the shadow of a convex body is the hull of its corners, projected from
the light: each triangle is cut along the outlines of the shadows that cross it. The pieces know
which lights they do not see.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.simulation.description import Light, World
from bullet_lab.simulation.rendering.casters import Bounds, Caster
from bullet_lab.simulation.rendering.patchwork import FlatSide, Patchwork, Pieces, patchworks
from bullet_lab.simulation.rendering.polygons import Polygon, Shadow, outline
from bullet_lab.simulation.rendering.surfaces import Surface

# What rises less above a triangle throws no shadow on it, in m: bodies that touch.
LOWEST = 1e-5
# A light that is less above a triangle's plane, in m or as a cosine, grazes it.
GRAZING = 1e-4
# Of a lamp's height above a plane; what rises higher throws its shadow very far away.
HIGHEST = 0.999


@dataclass(frozen=True)
class Cut:
    """Triangles cut into pieces.

    Attributes:
        triangles: (m,) the number of each piece's triangle.
        weights: (m, 3, 3) the corners of the pieces, by rows, as means of those of the triangle.
        unseen: (m, lights) which lights do not reach them.
    """

    triangles: np.ndarray
    weights: np.ndarray
    unseen: np.ndarray

    def of(self, surface: Surface) -> Surface:
        """Return the pieces of a surface that has these triangles."""
        corners, normals, picture = (
            None if array is None else self.weights @ array[self.triangles]
            for array in (surface.corners, surface.normals, surface.picture)
        )
        normals = normals / np.maximum(1e-12, np.linalg.norm(normals, axis=-1, keepdims=True))
        return surface.with_triangles(corners, normals, picture)


class Shadows:
    """The shadows in a world.

    Args:
        world: for its lights.
        casters: all that throws shadows.
    """

    def __init__(self, world: World, casters: Sequence[Caster]):
        self.casters = list(casters)
        self._count = len(world.lights)
        self._beams = [
            _Beam(number, light, self.casters) for number, light in casting_lights(world).items()
        ]

    def reaching(self, corners: np.ndarray, shape: int) -> List[Tuple[int, Caster]]:
        """Return, by the number of the light, what may shade corners (n, 3, 3) in the world."""
        points = corners.reshape(-1, 3)
        return [(b.number, caster) for b in self._beams for caster in b.in_front(points, shape)]

    def on(self, surface: Surface, shape: int) -> Optional[Cut]:
        """Cut a surface, given in the world, of the shape with this number.

        Returns:
            The pieces, or None if no shadow falls on it.
        """
        beams = [b for b in self._beams if b.in_front(surface.corners.reshape(-1, 3), shape)]
        lit = {beam: beam.light_on(surface) for beam in beams}
        chosen = np.any([*lit.values(), np.zeros(len(surface.corners), bool)], axis=0)
        works = patchworks(surface, np.flatnonzero(chosen))
        for work in works:
            for beam in beams:
                beam.darken(work, surface.corners[work.numbers], lit[beam][work.numbers], shape)
        return self._assembled(len(surface.corners), works)

    def _assembled(self, count: int, works: Sequence[Patchwork]) -> Optional[Cut]:
        kept = np.ones(count, dtype=bool)
        found: List[Pieces] = []
        for work in works:
            gone, pieces = work.changed()
            kept[gone] = False
            found += pieces
        if kept.all():
            return None
        counts = [len(pieces.weights) for pieces in found]
        bits = [[pieces.unseen >> k & 1 for k in range(self._count)] for pieces in found]
        same = np.flatnonzero(kept)
        as_they_are = np.broadcast_to(np.eye(3), (len(same), 3, 3))
        seen = np.zeros((len(same), self._count), dtype=bool)
        return Cut(
            np.concatenate((same, np.repeat([pieces.triangle for pieces in found], counts))),
            np.concatenate([as_they_are] + [pieces.weights for pieces in found]),
            np.concatenate((seen, np.repeat(np.array(bits, dtype=bool), counts, axis=0))),
        )


def casting_lights(world: World) -> Dict[int, Light]:
    """Return the lights that throw shadows, by their numbers."""
    if not world.shadows:
        return {}
    return {k: light for k, light in enumerate(world.lights) if light.casts_shadows}


class _Beam:
    """A light, and the bodies in its way."""

    def __init__(self, number: int, light: Light, casters: Sequence[Caster]):
        self.number = number
        self._light = light
        self._along = np.asarray(light.pose.rotate(light.direction))
        self._place = np.asarray(light.pose.position)
        self._sun = light.kind == "directional"
        # The ball that shows where a lamp is does not hide it.
        self._casters = [c for c in casters if self._sun or not c.holds(self._place)]
        self._bounds = Bounds(light, [caster.points for caster in self._casters])

    def in_front(self, points: np.ndarray, shape: int) -> List[Caster]:
        """Return what may stand between the light and points (n, 3) of a shape."""
        found = (self._casters[k] for k in self._bounds.between(points))
        return [caster for caster in found if caster.shape != shape]

    def light_on(self, surface: Surface) -> np.ndarray:
        """Return which triangles look towards the light, (n,)."""
        towards = -self._along if self._sun else self._place - surface.corners
        return (np.sum(surface.normals * towards, axis=-1) > 0.0).any(axis=1)

    def darken(self, work: Patchwork, corners: np.ndarray, lit: np.ndarray, shape: int) -> None:
        """Throw shadows on triangles (n, 3, 3) of a shape; `lit` (n,): which see the light."""
        if lit.any():
            for caster in self.in_front(corners[lit].reshape(-1, 3), shape):
                shadow = self.shadow(caster, work.plane)
                if shadow:
                    work.darken(Shadow(shadow, self.number), lit)

    def shadow(self, caster: Caster, plane: FlatSide) -> Polygon:
        """Return the shadow of a body on a plane, counterclockwise; [] if there is none."""
        above = -self._along @ plane.normal if self._sun else plane.height(self._place)
        if abs(above) < GRAZING:
            return []
        # Heights count towards the light.
        heights = plane.height(caster.points) * np.sign(above)
        top = np.inf if self._sun else HIGHEST * abs(above)
        within = (heights >= LOWEST) & (heights <= top)
        points, heights = caster.points[within], heights[within]
        if not within.all():
            points, heights = self._clipped(caster, plane, np.sign(above), top)
        if len(points) == 0:
            return []
        if self._sun:
            return outline(plane.flat(points + self._along * (heights / abs(above))[:, None]))
        stretch = abs(above) / (abs(above) - heights)
        return outline(plane.flat(self._place + (points - self._place) * stretch[:, None]))

    def _clipped(
        self, caster: Caster, plane: FlatSide, side: float, top: float
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Return the corners, with heights, of what is left of a body above the plane."""
        heights = plane.height(caster.points) * side
        within = (heights >= LOWEST) & (heights <= top)
        points, levels = [caster.points[within]], [heights[within]]
        start, end = caster.edges.T
        for level in (LOWEST, top):
            crossing = (heights[start] < level) != (heights[end] < level)
            a, b = start[crossing], end[crossing]
            share = ((level - heights[a]) / (heights[b] - heights[a]))[:, None]
            points.append(caster.points[a] + share * (caster.points[b] - caster.points[a]))
            levels.append(np.full(len(a), level))
        return np.concatenate(points), np.concatenate(levels)
