"""A marker's corners where something hides a side of it: by the edges between its cells.

What stands before a marker has an edge of its own, and an outline that ends there looks as good as
one that ends at the marker's. But then the edges within it are not where such an outline has them.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from bullet_lab.vision.algebra import homography, solve_symmetric
from bullet_lab.vision.images import Lens, sample
from bullet_lab.vision.pattern_model import moves_of
from bullet_lab.vision.pattern_pixels import SMALL, edges_of, mean_cell

# Edges are looked for so many cells to either side, but no further than so many px.
_REACH, _FARTHEST = 0.45, 16.0
# What rises by less than this part of what most of them rise by is no edge.
_LEAST_RISE = 0.35
# Where it should be is within so many px, or cells, whichever is more.
_NEAR, _NEAR_CELLS = 1.2, 0.06
# Share of the edges that may be elsewhere before a side is suspected, and by how much of them
# fewer must be without it.
_ELSEWHERE, _FEWER = 0.1, 0.05
# Rounds of the fit, with weights by the distance that is left, px at least.
_ROUNDS, _LEAST_LEFT = 4, 0.3
# So many places tell eight numbers well.
_LEAST_PLACES = 24
_SIDES = (0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0)


class _Edges(NamedTuple):
    """Edges that are seen.

    Attributes:
        places: (n, 2) of the unit square.
        off: (n,) px towards white by which they are not where they should be.
        moves: (n, 8) px by which they move so with the numbers of `moves_of`.
    """

    places: np.ndarray
    off: np.ndarray
    moves: np.ndarray


def without_hidden_side(
    image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens
) -> np.ndarray:
    """Return a large marker's corners (4, 2) in ideal px as its edges have them, to about a pixel.

    They are those given, unless many edges are not where these have them, and fewer if one of the
    sides is not looked at.

    Args:
        image: (h, w) grey levels.
        corners: (4, 2) ideal px, clockwise from the marker's top left, to half a cell.
        pattern: (n, n) cells with the border, 1 for white.
        lens: where ideal pixels are seen.
    """
    if mean_cell(corners, 1) <= SMALL:
        return corners
    near = max(_NEAR, _NEAR_CELLS * mean_cell(corners, len(pattern)))
    seen = _edges_seen(image, corners, pattern, lens)
    if seen is None:
        return corners
    misplaced = _share_beyond(near, seen.off)
    if misplaced <= _ELSEWHERE:
        return corners
    least, side = misplaced - _FEWER, None
    for axis, end in _SIDES:
        left = seen.off - seen.moves @ _moves(seen, seen.places[:, axis] != end)
        misplaced = _share_beyond(near, left)
        if misplaced < least:
            least, side = misplaced, (axis, end)
    if side is None:
        return corners
    moved = _without(side, image, corners, pattern, lens)
    is_near = np.abs(moved - corners).max() <= mean_cell(corners, len(pattern))
    return moved if is_near else corners


def _share_beyond(near: float, off: np.ndarray) -> float:
    """Return how many of (n,) are not within so many px, as a share; what is no number is not."""
    return 1.0 - float((np.abs(off) <= near).mean())


def _without(
    side: Tuple[int, float], image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens
) -> np.ndarray:
    """Return the corners by the edges of all sides but one, an axis and its end."""
    for _ in range(2):
        seen = _edges_seen(image, corners, pattern, lens)
        if seen is None:
            break
        moved = _moves(seen, seen.places[:, side[0]] != side[1])
        corners = corners + (moves_of(corners, homography(corners)) @ moved).reshape(4, 2)
    return corners


def _edges_seen(
    image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens
) -> Optional[_Edges]:
    """Return the edges that are seen about where they should be; None if they are few."""
    reach = max(1, math.floor(min(_FARTHEST, _REACH * mean_cell(corners, len(pattern)))))
    to_image = homography(corners)
    places, points, across = edges_of(pattern, to_image)
    offsets = np.arange(-reach - 2.0, reach + 3.0)[:, None, None]
    levels = sample(image, lens.seen(points + offsets * across))
    rises = levels[3:-1] + levels[4:] - levels[:-4] - levels[1:-3]
    most = rises.max(axis=0)
    shown = most > _LEAST_RISE * np.median(most)
    if np.count_nonzero(shown) < _LEAST_PLACES:
        return None
    places, points, across = places[shown], points[shown], across[shown]
    off = rises.argmax(axis=0)[shown] - float(reach)
    # As in `moves_of`.
    third = (places @ to_image[2, :2] + to_image[2, 2])[:, None]
    along = (across @ to_image[:2, :2] - (across * points).sum(axis=1)[:, None] * to_image[2, :2])
    along /= third
    x, y = (places - 0.5).T
    planes = np.stack((np.ones(len(x)), x, y), axis=1)
    both = (along * np.stack((x, y), axis=1)).sum(axis=1)[:, None]
    moves = np.concatenate(
        (along[:, :1] * planes, along[:, 1:] * planes, both * planes[:, 1:]), axis=1
    )
    return _Edges(places, off, moves)


def _moves(seen: _Edges, used: np.ndarray) -> np.ndarray:
    """Return the numbers (8,) with which the sum of distances is least for the edges used."""
    columns, off = seen.moves[used], seen.off[used]
    left, numbers = off, np.zeros(8)
    for _ in range(_ROUNDS):
        weighted = columns / np.maximum(np.abs(left), _LEAST_LEFT)[:, None]
        numbers = solve_symmetric(weighted.T @ columns, weighted.T @ off)
        left = off - columns @ numbers
    return numbers
