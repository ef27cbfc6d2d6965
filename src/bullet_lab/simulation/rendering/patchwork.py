"""Triangles in one plane, cut into pieces by the shadows on it. Lengths are metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Tuple

import numpy as np

from bullet_lab.simulation.rendering.polygons import (
    Piece,
    Polygon,
    Shadow,
    box_of,
    grown,
    joined,
)
from bullet_lab.simulation.rendering.surfaces import Surface

# Planes whose normals and distances differ by less are one.
SAME_PLANE = 1e-5
# Pieces reach over the lines between them by so much: corners that the renderer moves by parts of
# a pixel open no cracks.
OVERLAP = 1e-4
# Two triangles are one piece where normals and places in the picture differ by no more.
EVEN = 1e-6


@dataclass(frozen=True)
class FlatSide:
    """A plane with unit axes x and y in it."""

    origin: np.ndarray
    x: np.ndarray
    y: np.ndarray
    normal: np.ndarray

    def flat(self, points: np.ndarray) -> np.ndarray:
        """Return points (…, 3) as (…, 2) in the plane."""
        away = points - self.origin
        return np.stack((away @ self.x, away @ self.y), axis=-1)

    def height(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (…, 3) lie above the plane, on its normal's side."""
        return (points - self.origin) @ self.normal


@dataclass(frozen=True)
class Pieces:
    """A triangle's pieces that see the same lights.

    Attributes:
        triangle: its number.
        weights: (m, 3, 3) the corners of the pieces, by rows, as means of those of the triangle.
        unseen: a bit for each light that does not reach them.
    """

    triangle: int
    weights: np.ndarray
    unseen: int


class Patchwork:
    """Triangles of a surface that lie in one plane, and the shadows on them.

    Args:
        plane: in which they lie.
        surface: in the world.
        numbers: of the triangles in the surface.
    """

    def __init__(self, plane: FlatSide, surface: Surface, numbers: np.ndarray):
        self.plane = plane
        self.numbers = numbers
        self._flat = plane.flat(surface.corners[numbers])
        # What is cut: triangles, and those pairs that are a convex and even whole.
        self._wholes = self._paired(surface)
        boxes = np.array([box_of(corners) for corners, _ in self._wholes])
        self._low, self._high = boxes[:, :2], boxes[:, 2:]
        self._shadows: Dict[int, List[Shadow]] = {}

    def _paired(self, surface: Surface) -> List[Tuple[Polygon, List[int]]]:
        wholes: List[Tuple[Polygon, List[int]]] = []
        k = 0
        while k < len(self.numbers):
            corners = _polygon(self._flat[k])
            quad = self._with_next(surface, k)
            wholes.append((quad, [k, k + 1]) if quad else (corners, [k]))
            k += len(wholes[-1][1])
        return wholes

    def _with_next(self, surface: Surface, k: int) -> Polygon:
        """Return a triangle and the next one as one polygon, [] where they are not even."""
        if k + 1 == len(self.numbers) or self.numbers[k + 1] != self.numbers[k] + 1:
            return []
        one, other = self._flat[k], self._flat[k + 1]
        if not (np.array_equal(one[0], other[0]) and np.array_equal(one[2], other[1])):
            return []
        whole = joined([_polygon(one), _polygon(other)])
        weights = _weights(one, other[2])
        for values in (surface.normals, surface.picture):
            if values is not None:
                first, second = values[self.numbers[k]], values[self.numbers[k + 1]]
                told = np.stack((first[0], first[2], weights @ first))
                if np.abs(told - second).max() > EVEN:
                    return []
        return whole[0] if len(whole) == 1 else []

    def darken(self, shadow: Shadow, lit: np.ndarray) -> None:
        """Throw a shadow on what lies in it; `lit` (n,): which triangles look to the light."""
        box = np.array(shadow.box)
        near = (self._low < box[2:]) & (self._high > box[:2])
        for k in np.flatnonzero(near.all(axis=1)):
            if lit[self._wholes[k][1]].any():
                self._shadows.setdefault(k, []).append(shadow)

    def changed(self) -> Tuple[List[int], List[Pieces]]:
        """Return the numbers of triangles that are cut or in a shadow, and their pieces."""
        gone: List[int] = []
        found: List[Pieces] = []
        for k, shadows in self._shadows.items():
            corners, members = self._wholes[k]
            by_lights = _pieces(corners, shadows)
            if set(by_lights) == {0}:
                continue
            gone += [int(self.numbers[member]) for member in members]
            flat = self._flat[members[0]]
            for unseen, polygons in by_lights.items():
                fans = [_fan(polygon, _area(flat) > 0.0) for polygon in polygons]
                weights = _weights(flat, np.concatenate(fans))
                found.append(Pieces(int(self.numbers[members[0]]), weights, unseen))
        return gone, found


def _pieces(corners: Polygon, shadows: List[Shadow]) -> Dict[int, List[Polygon]]:
    """Return the pieces of a polygon by the lights that they do not see, as bits."""
    whole = Piece(corners)
    # So the lines do not run across large polygons.
    boxes = np.array([shadow.box for shadow in shadows])
    whole.enclose((*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)))
    for shadow in shadows:
        whole.darken(shadow)
    found: Dict[int, List[Polygon]] = {}
    for piece in whole.pieces():
        found.setdefault(piece.unseen, []).append(piece.corners)
    return {unseen: joined(polygons) for unseen, polygons in found.items()}


def patchworks(surface: Surface, chosen: np.ndarray) -> List[Patchwork]:
    """Return chosen triangles of a surface in the world, given by number, by planes."""
    corners = surface.corners
    sides = np.cross(
        corners[chosen, 1] - corners[chosen, 0], corners[chosen, 2] - corners[chosen, 0]
    )
    lengths = np.linalg.norm(sides, axis=1)
    chosen, normals = chosen[lengths > 1e-12], sides[lengths > 1e-12]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances = np.sum(normals * corners[chosen, 0], axis=1)
    keys = np.round(np.column_stack((normals, distances)) / SAME_PLANE)
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    found = []
    for k, start in enumerate(first):
        normal = normals[start]
        x = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        x /= np.linalg.norm(x)
        plane = FlatSide(corners[chosen[start], 0], x, np.cross(normal, x), normal)
        found.append(Patchwork(plane, surface, chosen[group == k]))
    return found


def _polygon(triangle: np.ndarray) -> Polygon:
    corners = [tuple(corner) for corner in triangle.tolist()]
    return corners if _area(triangle) > 0.0 else corners[::-1]


def _area(triangle: np.ndarray) -> float:
    """Return twice the area of a triangle (3, 2), negative if it runs clockwise."""
    (ax, ay), (bx, by) = triangle[1] - triangle[0], triangle[2] - triangle[0]
    return float(ax * by - ay * bx)


def _fan(polygon: Polygon, ahead: bool) -> np.ndarray:
    """Return triangles (m, 3, 2) that make up a convex polygon and reach a little further."""
    corners = np.array(grown(polygon, OVERLAP))[:: 1 if ahead else -1]
    first = np.broadcast_to(corners[0], corners[1:-1].shape)
    return np.stack((first, corners[1:-1], corners[2:]), axis=1)


def _weights(triangle: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points (…, 2) as means (…, 3) of a triangle's corners (3, 2)."""
    (ax, ay), (bx, by) = triangle[1:] - triangle[0]
    x, y = np.moveaxis(points - triangle[0], -1, 0)
    area = ax * by - ay * bx
    second, third = (x * by - y * bx) / area, (ax * y - ay * x) / area
    return np.stack((1.0 - second - third, second, third), axis=-1)
