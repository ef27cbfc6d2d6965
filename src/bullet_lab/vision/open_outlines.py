"""Outlines of what is dark and square but for a gap, or a hidden corner, to about a pixel."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import intersections
from bullet_lab.vision.dark_pieces import LEAST_AREA, DarkPieces, contours_of

# px, width and height together, from which on borders with a gap are looked for; at most so many
# of an image's pieces, the largest first.
_LEAST_OPEN, _MOST_OPEN = 40, 12
# Part of a hull's length by which what is simpler may differ from it, and its corners then.
_HULL_TOLERANCE = 0.02
_HULL_CORNERS = (4, 5, 6)
# Most by which a quadrilateral may be larger than such a hull, which lacks a corner.
_WITH_CORNER = 1.15
# Parts of a side's length beside its line, in which its points are, and in how many rounds the line
# is fitted: the last time with little regard for those that are far off.
_BESIDE = ((0.06, 1), (0.03, 1), (0.015, 15))
# Part of a side's length that is left out at either end.
_TRIM = 0.16
# px; points nearer to a line than this count alike.
_ON_LINE = 0.05
# So many make a line.
_LEAST_POINTS = 8
# Of a whole contour.
_MOST_POINTS = 256


class OpenSides(NamedTuple):
    """The four longest sides of a contour's hull.

    Attributes:
        contour: (n, 2) some of its points.
        first: (4, 2) where the sides begin.
        along: (4, 2) to where they end.
        area: of the hull.
        coarse: of the image of half the size.
    """

    contour: np.ndarray
    first: np.ndarray
    along: np.ndarray
    area: float
    coarse: bool


def open_sides(pieces: DarkPieces, min_side: float, coarse: bool) -> List[OpenSides]:
    """Return the sides of what is dark and may be square but for a gap, or a hidden corner.

    What is as dark as the marker's surroundings and lies on a corner joins the two: no threshold
    shows an outline with four corners then. The hull of the border still has four long sides.
    """
    contours = contours_of(pieces, max(0.5 * _LEAST_OPEN, min_side) + 1.0, is_open=True)
    large = sorted(contours, key=lambda placed: -float(np.ptp(placed[0][:, 0], axis=0).sum()))
    sides = (_sides_of_hull(contour, offset, coarse) for contour, offset in large[:_MOST_OPEN])
    return [of_one for of_one in sides if of_one is not None]


def _sides_of_hull(
    contour: np.ndarray, offset: Tuple[int, int], coarse: bool
) -> Optional[OpenSides]:
    hull = cv2.convexHull(contour)
    area, length = cv2.contourArea(hull), cv2.arcLength(hull, True)
    if area < LEAST_AREA * length * length:
        return None
    simple = cv2.approxPolyDP(hull, _HULL_TOLERANCE * length, True)[:, 0].astype(float)
    if len(simple) not in _HULL_CORNERS:
        return None
    edges = np.roll(simple, -1, axis=0) - simple
    longest = np.sort(np.argsort(-np.hypot(edges[:, 0], edges[:, 1]), kind="stable")[:4])
    some = contour[:: 1 + len(contour) // _MOST_POINTS, 0].astype(float)
    return OpenSides(some + offset, simple[longest] + offset, edges[longest], area, coarse)


def open_quads(sides: Sequence[OpenSides]) -> Tuple[np.ndarray, np.ndarray]:
    """Return (n, 4, 2) where the lines along four sides meet, and which (n,) of it are coarse."""
    if not sides:
        return np.empty((0, 4, 2)), np.empty(0, dtype=bool)
    quads = intersections(*_lines_along(sides))
    own = np.isfinite(quads).all(axis=(1, 2))
    for k in np.flatnonzero(own):
        quad = quads[k].astype(np.float32)
        own[k] = cv2.isContourConvex(quad)
        own[k] &= cv2.contourArea(quad) <= _WITH_CORNER * sides[k].area
    coarse = np.array([of_one.coarse for of_one in sides])
    return quads[own], coarse[own]


def _lines_along(sides: Sequence[OpenSides]) -> Tuple[np.ndarray, np.ndarray]:
    """Return points and normals (n, 4, 2) of lines through what of a contour is beside its sides.

    What sticks out at one end of a side turns it, so what is beside its line is chosen anew, more
    narrowly each time.
    """
    contours = np.concatenate([of_one.contour for of_one in sides])
    owners = np.repeat(np.arange(len(sides)), [len(of_one.contour) for of_one in sides])
    along = np.stack([of_one.along for of_one in sides])
    points = np.stack([of_one.first for of_one in sides]) + 0.5 * along
    lengths = np.hypot(along[..., 0], along[..., 1])
    along /= lengths[..., None]
    for beside, rounds in _BESIDE:
        away = contours[:, None] - points[owners]
        ahead, across = _in_frame(away, along[owners])
        near = np.abs(across) < np.maximum(1.0, beside * lengths)[owners]
        near &= np.abs(ahead) < ((0.5 - _TRIM) * lengths)[owners]
        of_point, side = near.nonzero()
        side += 4 * owners[of_point]
        moved, turned = _lines_through(away[near], side, 4 * len(sides), rounds)
        enough = (np.bincount(side, minlength=4 * len(sides)) >= _LEAST_POINTS).reshape(-1, 4, 1)
        points = points + np.where(enough, moved.reshape(-1, 4, 2), 0.0)
        along = np.where(enough, turned.reshape(-1, 4, 2), along)
    return points, np.stack((along[..., 1], -along[..., 0]), axis=-1)


def _in_frame(away: np.ndarray, along: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return how far points (…, 2) are along unit vectors (…, 2), and across them."""
    ahead = away[..., 0] * along[..., 0] + away[..., 1] * along[..., 1]
    return ahead, away[..., 0] * along[..., 1] - away[..., 1] * along[..., 0]


def _lines_through(
    points: np.ndarray, line: np.ndarray, count: int, rounds: int
) -> Tuple[np.ndarray, np.ndarray]:
    """Return a point and the unit vector (count, 2) along each line through points (n, 2).

    Of least squares and, the more rounds there are, of least distances: each round gives points
    the weight that makes their squares distances. NaN where there are no points.

    Args:
        points: px.
        line: (n,) which line a point is of.
        count: how many lines there are.
        rounds: of the fit.
    """
    x, y = points.T
    weights = np.ones(len(points))
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(rounds):
            parts = (weights, weights * x, weights * y)
            parts += (parts[1] * x, parts[1] * y, parts[2] * y)
            total, *sums = (np.bincount(line, part, count) for part in parts)
            mean_x, mean_y, xx, xy, yy = (part / total for part in sums)
            xx, xy, yy = xx - mean_x * mean_x, xy - mean_x * mean_y, yy - mean_y * mean_y
            angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
            middle = np.stack((mean_x, mean_y), axis=-1)
            along = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
            across = _in_frame(points - middle[line], along[line])[1]
            weights = 1.0 / np.maximum(np.abs(across), _ON_LINE)
    return middle, along
