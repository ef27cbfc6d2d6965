"""Convex polygons in a plane, cut up by the shadows that fall on them. Lengths are metres."""

from __future__ import annotations

import itertools
import math
from typing import Dict, Iterable, Iterator, List, Optional, Sequence, Tuple

import cv2
import numpy as np

Point = Tuple[float, float]
Polygon = List[Point]
Line = Tuple[float, float, float]
# The least x and y and the greatest x and y.
Box = Tuple[float, float, float, float]

# What reaches over a line by less is not cut off.
THINNEST = 1e-4
# Corners that lie so close to the line between their neighbours are left out of an outline.
STRAIGHT = 1e-5
# Corners that are no farther apart are one.
SAME = 1e-9
# Corners sharper than this, as 1 + the cosine between the normals of their sides, are cut short.
BLUNT = 0.05
# A box is small if it covers less than this share.
SMALL = 0.25
# From so many points on, OpenCV finds those on the outline first; it counts in single precision.
MANY = 64


def outline(points: np.ndarray) -> Polygon:
    """Return the convex hull of points (n, 2), counterclockwise; [] if it has no area.

    By Andrew's monotone chain.
    """
    if len(points) > MANY:
        around = (points - points.mean(axis=0)).astype(np.float32)
        points = points[cv2.convexHull(around, returnPoints=False)[:, 0]]
    ordered = sorted(map(tuple, points.tolist()))
    chain = _half(ordered)[:-1] + _half(ordered[::-1])[:-1]
    return chain if len(chain) >= 3 else []


def _half(points: Sequence[Point]) -> Polygon:
    chain: Polygon = []
    for point in points:
        while len(chain) >= 2 and _beyond(chain[-2], point, chain[-1]) > -STRAIGHT:
            chain.pop()
        chain.append(point)
    return chain


def _beyond(start: Point, end: Point, point: Point) -> float:
    """Return how far a point lies to the left of a line."""
    x, y = end[0] - start[0], end[1] - start[1]
    length = math.hypot(x, y)
    if length == 0.0:
        return 0.0
    return (x * (point[1] - start[1]) - y * (point[0] - start[0])) / length


class Shadow:
    """The shadow of a convex body.

    Args:
        corners: of a convex polygon, counterclockwise.
        light: its number.

    Attributes:
        bit: that stands for the light.
        lines: of its sides; a point (x, y) lies a * x + b * y - c within each.
        box: around it.
    """

    __slots__ = ("bit", "lines", "box")

    def __init__(self, corners: Polygon, light: int):
        self.bit = 1 << light
        self.box = box_of(corners)
        self.lines: List[Line] = []
        for (ax, ay), (bx, by) in _sides(corners):
            length = math.hypot(bx - ax, by - ay)
            if length > SAME:
                a, b = (ay - by) / length, (bx - ax) / length
                self.lines.append((a, b, a * ax + b * ay))


class Piece:
    """A convex polygon, and the pieces that shadows have cut it into.

    Attributes:
        corners: counterclockwise.
        unseen: a bit for each light that does not reach it.
    """

    __slots__ = ("corners", "unseen", "_box", "_parts")

    def __init__(self, corners: Polygon, unseen: int = 0):
        self.corners = corners
        self.unseen = unseen
        self._box = box_of(corners)
        self._parts: List[Piece] = []

    def pieces(self) -> Iterator[Piece]:
        """Yield what is not cut any more."""
        waiting = [self]
        while waiting:
            piece = waiting.pop()
            if piece._parts:
                waiting.extend(piece._parts)
            else:
                yield piece

    def enclose(self, box: Box) -> None:
        """Cut off what lies outside a box, where that is most of it."""
        x0, y0, x1, y1 = (*map(max, box[:2], self._box[:2]), *map(min, box[2:], self._box[2:]))
        if SMALL * _extent(self._box) > _extent((x0, y0, x1, y1)):
            self._cut([(1.0, 0.0, x0), (-1.0, 0.0, -x1), (0.0, 1.0, y0), (0.0, -1.0, -y1)], 0)

    def darken(self, shadow: Shadow) -> None:
        """Take a light from what lies within a shadow."""
        waiting = [self]
        while waiting:
            piece = waiting.pop()
            if piece.unseen & shadow.bit or _apart(piece._box, shadow.box):
                continue
            if piece._parts:
                waiting.extend(piece._parts)
            else:
                piece._cut(shadow.lines, shadow.bit)

    def _cut(self, lines: Iterable[Line], bit: int) -> None:
        rest, outside = self.corners, []
        for a, b, c in lines:
            beyond = [a * x + b * y - c for x, y in rest]
            if max(beyond) <= THINNEST:
                return
            if min(beyond) < -THINNEST:
                outside.append(_kept(rest, [-distance for distance in beyond]))
                rest = _kept(rest, beyond)
        if outside:
            self._parts = [Piece(corners, self.unseen) for corners in outside]
            self._parts.append(Piece(rest, self.unseen | bit))
        else:
            self.unseen |= bit


def box_of(corners: Polygon) -> Box:
    """Return the least x and y and the greatest x and y."""
    x, y = zip(*corners)
    return min(x), min(y), max(x), max(y)


def _extent(box: Box) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


def _apart(one: Box, other: Box) -> bool:
    return one[0] > other[2] or one[1] > other[3] or other[0] > one[2] or other[1] > one[3]


def _kept(corners: Polygon, beyond: List[float]) -> Polygon:
    """Return what of a polygon lies beyond a line, from how far its corners do."""
    kept: Polygon = []
    for k, (corner, distance) in enumerate(zip(corners, beyond)):
        before, other = corners[k - 1], beyond[k - 1]
        if distance * other < 0.0:
            share = other / (other - distance)
            kept.append(tuple(a + share * (b - a) for a, b in zip(before, corner)))
        if distance >= 0.0:
            kept.append(corner)
    return kept


def joined(polygons: Iterable[Polygon]) -> List[Polygon]:
    """Return convex polygons with neighbours made one where that is convex too."""
    waiting = list(polygons)
    found: Dict[int, Polygon] = {}
    sides: Dict[Tuple[Point, Point], int] = {}
    for name in itertools.count():
        if not waiting:
            return list(found.values())
        polygon = waiting.pop()
        for side in _sides(polygon):
            other = sides.get(side[::-1])
            both = None if other is None else _union(polygon, found[other], side)
            if both is not None:
                for gone in _sides(found.pop(other)):
                    sides.pop(gone, None)
                waiting.append(both)
                break
        else:
            found[name] = polygon
            sides.update(dict.fromkeys(_sides(polygon), name))
    return []


def _sides(polygon: Polygon) -> List[Tuple[Point, Point]]:
    return list(zip(polygon, polygon[1:] + polygon[:1]))


def _union(one: Polygon, other: Polygon, side: Tuple[Point, Point]) -> Optional[Polygon]:
    """Return two polygons on both sides of a side as one; None if it is not convex."""
    start, end = side
    k, m = one.index(end), other.index(start)
    # From the side's end around to its start, and on around the other one.
    around = one[k:] + one[:k] + (other[m:] + other[:m])[1:-1]
    corners = []
    for before, corner, after in zip(around[-1:] + around[:-1], around, around[1:] + around[:1]):
        outside = -_beyond(before, after, corner)
        if outside < -SAME:
            return None
        if outside > STRAIGHT or corner not in side:
            corners.append(corner)
    return corners


def grown(polygon: Polygon, width: float) -> Polygon:
    """Return a convex polygon with its sides moved out; very sharp corners are cut short."""
    corners = [c for c, after in _sides(polygon) if math.dist(c, after) > SAME]
    normals = []
    for (ax, ay), (bx, by) in _sides(corners):
        length = math.hypot(bx - ax, by - ay)
        normals.append(((by - ay) / length, (ax - bx) / length))
    moved = []
    for k, (x, y) in enumerate(corners):
        (ax, ay), (bx, by) = normals[k - 1], normals[k]
        far = width / max(BLUNT, 1.0 + ax * bx + ay * by)
        moved.append((x + far * (ax + bx), y + far * (ay + by)))
    return moved
