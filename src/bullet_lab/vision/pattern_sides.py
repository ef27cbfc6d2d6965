"""Corrects a marker's corners where something hides one of its sides.

An object before a marker has an edge that looks like the marker's own side. But then the edges
between the marker's cells are not where such an outline puts them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from bullet_lab.vision.images import Picture, homography, mean_side, solve_symmetric
from bullet_lab.vision.pattern_model import moves_of
from bullet_lab.vision.pattern_pixels import SMALL, edges_of

# Reach to either side within which an edge is searched: in cells, and at most in px.
_REACH = 0.45
_FARTHEST = 16.0
# Least rise of an edge, as a share of the median rise.
_LEAST_RISE = 0.35
# An edge is in its place within so many px, or cells, whichever is more.
_NEAR = 1.2
_NEAR_CELLS = 0.06
# Share of misplaced edges above which a side is suspected, and by which the share must fall
# without that side.
_MISPLACED = 0.1
_FEWER = 0.05
# Rounds of the fit; each weights edges by the inverse of the distance that is left, px at least.
_ROUNDS = 4
_LEAST_LEFT = 0.3
# Least places that determine eight coefficients well.
_LEAST_PLACES = 24
# Sides of the unit square: axis and coordinate.
_SIDES = (0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0)


class _Edges(NamedTuple):
    """Edges that are seen.

    Attributes:
        places: (n, 2) of the unit square.
        off: (n,) px towards white from where they should be.
        moves: (n, 8) derivatives of `off`, px, by the coefficients of `moves_of`.
    """

    places: ndarray
    off: ndarray
    moves: ndarray

    def fit(self, used: ndarray) -> ndarray:
        """Return the coefficients (8,) of least distances to the edges that are used, (n,)."""
        columns, off = self.moves[used], self.off[used]
        left, coefficients = off, np.zeros(8)
        for _ in range(_ROUNDS):
            weighted = columns / np.maximum(np.abs(left), _LEAST_LEFT)[:, None]
            coefficients = solve_symmetric(weighted.T @ columns, weighted.T @ off)
            left = off - columns @ coefficients
        return coefficients

    def not_at(self, side: tuple[int, float]) -> ndarray:
        """Return which edges (n,) are not at a side of `_SIDES`."""
        return self.places[:, side[0]] != side[1]


def without_hidden_side(picture: Picture, corners: ndarray, pattern: ndarray) -> ndarray:
    """Return the corners (4, 2) of a large marker in ideal px, corrected for a hidden side.

    They are those given, unless many edges are misplaced and fewer are if one side is left out.

    Args:
        picture: the image.
        corners: (4, 2) ideal px, clockwise from the marker's top left, to half a cell.
        pattern: (n, n) cells with the border, 1 for white.
    """
    if mean_side(corners) <= SMALL:
        return corners
    cell = mean_side(corners) / len(pattern)
    near = max(_NEAR, _NEAR_CELLS * cell)
    seen = _edges_seen(picture, corners, pattern)
    if seen is None:
        return corners
    misplaced = _share_beyond(near, seen.off)
    if misplaced <= _MISPLACED:
        return corners
    least, hidden = misplaced - _FEWER, None
    for side in _SIDES:
        left = seen.off - seen.moves @ seen.fit(seen.not_at(side))
        misplaced = _share_beyond(near, left)
        if misplaced < least:
            least, hidden = misplaced, side
    if hidden is None:
        return corners
    moved = _without(hidden, picture, corners, pattern)
    is_near = np.abs(moved - corners).max() <= cell
    return moved if is_near else corners


def _share_beyond(near: float, off: ndarray) -> float:
    """Return the share of distances (n,) that are not within `near` px; NaN is not."""
    return 1.0 - float((np.abs(off) <= near).mean())


def _without(
    side: tuple[int, float], picture: Picture, corners: ndarray, pattern: ndarray
) -> ndarray:
    """Return the corners by the edges at all sides but one."""
    for _ in range(2):
        seen = _edges_seen(picture, corners, pattern)
        if seen is None:
            break
        moved = seen.fit(seen.not_at(side))
        corners = corners + (moves_of(corners, homography(corners)) @ moved).reshape(4, 2)
    return corners


def _edges_seen(picture: Picture, corners: ndarray, pattern: ndarray) -> _Edges | None:
    """Return the edges that are seen near to where they should be; None if they are few."""
    cell = mean_side(corners) / len(pattern)
    reach = max(1, math.floor(min(_FARTHEST, _REACH * cell)))
    to_image = homography(corners)
    places, points, across = edges_of(pattern, to_image)
    offsets = np.arange(-reach - 2.0, reach + 3.0)[:, None, None]
    levels = picture.at(points + offsets * across)
    rises = levels[3:-1] + levels[4:] - levels[:-4] - levels[1:-3]
    most = rises.max(axis=0)
    shown = most > _LEAST_RISE * np.median(most)
    if np.count_nonzero(shown) < _LEAST_PLACES:
        return None
    off = rises.argmax(axis=0)[shown] - float(reach)
    places = places[shown]
    return _Edges(places, off, _moves(places, points[shown], across[shown], to_image))


def _moves(
    places: ndarray, points: ndarray, across: ndarray, to_image: ndarray
) -> ndarray:
    """Return the moves (n, 8) of edges along their normals, by the coefficients of `moves_of`."""
    third = (places @ to_image[2, :2] + to_image[2, 2])[:, None]
    along = across @ to_image[:2, :2] - (across * points).sum(axis=1)[:, None] * to_image[2, :2]
    along /= third
    x, y = (places - 0.5).T
    planes = np.stack((np.ones(len(x)), x, y), axis=1)
    outward = (along * np.stack((x, y), axis=1)).sum(axis=1)[:, None]
    return np.concatenate(
        (along[:, :1] * planes, along[:, 1:] * planes, outward * planes[:, 1:]), axis=1
    )
