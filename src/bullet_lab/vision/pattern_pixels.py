"""Which pixels a marker's pattern is fitted to, and where its edges are seen.

These are all pixels of a small marker and those across the edges of a large one. An object before a
large marker has an edge that looks like the marker's own side. But then the edges between the
marker's cells are not where such an outline puts them, and the corners are corrected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.images import (
    UNIT_SQUARE,
    Picture,
    grid,
    homography,
    lengths_of,
    mapped,
    mean_side,
    solve_symmetric,
    unmapped,
)
from bullet_lab.vision.pattern_model import by_shape, moves_of

# Width around the outline that is used, in cells, at most and at least; the quiet zone is one cell,
# and blur carries what lies beyond it so many px into it.
_AROUND = 0.55
LEAST_AROUND = 0.1
_BEYOND = 1.3
# Mean side, px, up to which all pixels of a marker are used. Of a larger one, some hundreds beside
# its edges are.
_SMALL = 30.0
_MOST_PIXELS = 600
# So many px to either side of a place of an edge.
_REACH = 2
_GROUP = 2 * _REACH + 1
# All pixels of a large marker are used in an image with much blur; of one with a larger mean side,
# px, every other row and column, and so on.
_MANY = 60.0
# Grey levels that are cut off: the true one may be anything beyond.
_DARKEST = 0.0
_BRIGHTEST = 255.0
# Share of over-exposed pixels that may be noise.
_CLIPPED = 0.08
# Grey levels below the brightest from which the noise that was added after the cut-off is
# estimated, and standard deviations of it within which a pixel counts as over-exposed.
_NEARLY = 24.0
_SURELY = 3.0
# Least share of the pixels that must be the marker's.
LEAST_SHARE = 0.5
_ROOT_HALF = math.sqrt(0.5)
# The derivative of a pixel by what it shares with its neighbours along an axis.
_LESS_OWN = np.array((1.0, -2.0, 1.0))
# Sum of squares of the pattern below which a group has no contrast.
_FLAT = 1e-6
# A marker is partly in the sun if white beside some edges is brighter than beside others by this
# factor, and by so many standard deviations of the difference of neighbouring places.
_SUN = 1.2
_SUN_DEVIATIONS = 6.0
_SUN_SHARES = np.array((0.06, 0.94))


@dataclass(frozen=True, eq=False)
class Pixels:
    """Pixels of a marker.

    Of a small marker, they are a part of a grid, and may share light with their neighbours. Of a
    large one, they are groups of pixels across each place of an edge, with a mean of their own. The
    first of each group come first.

    Attributes:
        points: (2, m) ideal px at which the model is evaluated: the n pixels, or the whole grid.
        levels: (n,) grey levels; in groups, less their group's mean.
        valid: (n,) which of them count; over-exposed ones in groups do not.
        over_exposed: white is cut off at so many pixels that some edges have none left.
        cut_off: over-exposed pixels count.
        group: number of pixels in a group; 1: no groups.
        chosen: which of the grid without its outer rows and columns the n are; None: no grid.
        flooded: (n,) which pixels are in groups with white that was cut off; None: the marker is
            not partly in the sun. In the sun, each group has a contrast of its own.
    """

    points: ndarray
    levels: ndarray
    valid: ndarray
    over_exposed: bool
    cut_off: bool
    group: int = 1
    chosen: ndarray | None = None
    flooded: ndarray | None = None

    @property
    def any_flooded(self) -> bool:
        """Whether the marker is partly in the sun, with white that was cut off."""
        return self.flooded is not None and bool(self.flooded.any())

    def without(self, these: ndarray) -> Pixels:
        """Return the pixels without these (n,), and without the others of their groups."""
        left = ~np.tile(these.reshape(self.group, -1).any(axis=0), self.group)
        fewer = replace(self, levels=self.levels[left], valid=self.valid[left])
        if self.chosen is not None:
            chosen = self.chosen.copy()
            chosen[chosen] = left
            return replace(fewer, chosen=chosen)
        flooded = None if self.flooded is None else self.flooded[left]
        return replace(fewer, points=np.ascontiguousarray(self.points[:, left]), flooded=flooded)

    def own(self, values: ndarray) -> ndarray:
        """Return the values (n,) of the pixels from those (m,) of the points."""
        if self.chosen is None:
            return values
        return self._chosen_of(values)[0]

    def _chosen_of(self, columns: ndarray) -> ndarray:
        """Return the (k, n) chosen ones of columns (k, m) of the grid."""
        rows, width = self.chosen.shape
        return columns.reshape(-1, rows + 2, width + 2)[:, 1:-1, 1:-1][:, self.chosen]

    def _filtered(self, columns: ndarray, across: ndarray, down: ndarray) -> ndarray:
        """Return the (k, n) chosen ones of columns (k, m), filtered along rows and columns."""
        # One grid below the other: what comes from the next one is in rows that are not chosen.
        grids = columns.reshape(-1, self.chosen.shape[1] + 2)
        return self._chosen_of(cv2.sepFilter2D(grids, -1, across, down))

    def seen(self, columns: ndarray, shared: float, value: ndarray) -> ndarray:
        """Return columns (k, m) of the model as the pixels see them, (k, n).

        A pixel of a grid has the part `shared` of each neighbour. In groups the mean is left out,
        and in the sun the pattern's value (m,) too.
        """
        if self.chosen is not None:
            kernel = _with_neighbours(shared)
            return self._filtered(columns, kernel, kernel)
        if self.group != 1:
            columns = _less_mean(columns, self.valid)
        return columns if self.flooded is None else self._less_pattern(columns, value)

    def seen_levels(self, value: ndarray) -> ndarray:
        """Return the grey levels (n,) treated as `seen` treats the columns."""
        if self.flooded is None:
            return self.levels
        return self._less_pattern(self.levels[None], value)[0]

    def own_contrast(self, value: ndarray) -> tuple[ndarray, ndarray]:
        """Return white less black (n,) of each group, by its levels and the pattern's value.

        And the pattern's sum of squares in the group: a level's variance divided by it is that of
        the contrast.
        """
        pattern, squares = self._grouped_pattern(value)
        seen = (pattern * self.levels.reshape(pattern.shape)).sum(axis=0)
        contrast = np.maximum(seen / squares, 0.0)
        return np.tile(contrast, self.group), np.tile(squares, self.group)

    def _grouped_pattern(self, value: ndarray) -> tuple[ndarray, ndarray]:
        """Return the pattern less its mean in each group, and the sums of its squares."""
        pattern = _less_mean(value[None], self.valid).reshape(self.group, -1)
        return pattern, np.maximum(np.square(pattern).sum(axis=0), _FLAT)

    def _less_pattern(self, columns: ndarray, value: ndarray) -> ndarray:
        """Return columns (k, n) less their projection on the pattern in each group."""
        pattern, squares = self._grouped_pattern(value)
        pattern = pattern / np.sqrt(squares)
        grouped = columns.reshape(len(columns), *pattern.shape)
        shares = (grouped * pattern).sum(axis=1, keepdims=True)
        return (grouped - shares * pattern).reshape(columns.shape)

    def by_shared(self, values: ndarray, shared: float) -> ndarray:
        """Return the derivatives (1, n) of the pixels by `shared`; values are (m,)."""
        if self.chosen is None:
            return np.zeros((1, len(values)))
        kernel = _with_neighbours(shared)
        by_shared = self._filtered(values, _LESS_OWN, kernel)
        return by_shared + self._filtered(values, kernel, _LESS_OWN)


def _with_neighbours(shared: float) -> ndarray:
    """Return the weights of a pixel's neighbours and of itself along an axis."""
    return np.array((shared, 1.0 - 2.0 * shared, shared))


def _less_mean(columns: ndarray, valid: ndarray) -> ndarray:
    """Return columns (m, n) less the mean of the valid pixels of each group; 0 for the others."""
    grouped = columns.reshape(len(columns), _GROUP, -1)
    if valid.all():
        return (grouped - grouped.sum(axis=1, keepdims=True) / _GROUP).reshape(columns.shape)
    valid = valid.reshape(grouped.shape[1:]).astype(float)
    grouped = valid * grouped
    means = grouped.sum(axis=1, keepdims=True) / np.maximum(valid.sum(axis=0), 1.0)
    return (grouped - valid * means).reshape(columns.shape)


def pixels_of(
    picture: Picture, corners: ndarray, pattern: ndarray, cut_off: bool = False
) -> Pixels:
    """Return the pixels to fit: all of a small marker, those at the edges of a large one.

    Args:
        picture: the image.
        corners: (4, 2) ideal px.
        pattern: (n, n) cells with the border, 1 for white.
        cut_off: over-exposed pixels count.
    """
    if mean_side(corners) <= _SMALL:
        return all_pixels(picture, corners, len(pattern), cut_off)
    return _edge_pixels(picture, corners, pattern, cut_off)


def all_pixels(picture: Picture, corners: ndarray, cells: int, cut_off: bool) -> Pixels:
    """Return the pixels of a marker with `cells` along a side, and of its quiet zone."""
    side = mean_side(corners)
    around = float(np.clip(1.0 - _BEYOND / (side / cells), LEAST_AROUND, _AROUND)) / cells
    to_image = homography(corners)
    outline = picture.seen(mapped(UNIT_SQUARE + around * (2.0 * UNIT_SQUARE - 1.0), to_image))
    columns, rows = _box(picture.levels, outline, max(1, math.ceil(side / _MANY)))
    levels = picture.levels[np.ix_(rows, columns)].astype(float)
    inner = _ideal_grid(picture, columns, rows)
    places, _ = unmapped(inner, to_image)
    chosen = (np.abs(places - 0.5).max(axis=0) < 0.5 + around).reshape(levels.shape)
    valid = chosen & (levels > _DARKEST) & (levels < _over_exposed(levels[chosen]))
    share = valid.sum() / max(1, chosen.sum())
    over_exposed = bool(share < 1.0 - _CLIPPED)
    cut_off = over_exposed and (cut_off or bool(share < LEAST_SHARE))
    chosen = chosen if cut_off else valid
    levels = levels[chosen]
    common = levels, np.ones(len(levels), dtype=bool), over_exposed, cut_off
    if side > _SMALL:
        return Pixels(np.ascontiguousarray(inner[:, chosen.ravel()]), *common)
    columns, rows = (np.arange(ends[0] - 1, ends[-1] + 2) for ends in (columns, rows))
    return Pixels(_ideal_grid(picture, columns, rows), *common, chosen=chosen)


def _box(image: ndarray, outline: ndarray, step: int) -> tuple[ndarray, ndarray]:
    """Return the columns and rows of the image around an outline (4, 2), every `step`-th."""
    ends = np.floor(outline.min(axis=0)), np.ceil(outline.max(axis=0))
    ends = np.clip(ends, 0, np.array(image.shape[::-1]) - 1).astype(int)
    columns, rows = (np.arange(low, high + 1, step) for low, high in ends.T)
    return columns, rows


def _ideal_grid(picture: Picture, columns: ndarray, rows: ndarray) -> ndarray:
    """Return the ideal px (2, m) of the pixels in columns and rows, row by row."""
    return np.ascontiguousarray(picture.ideal(grid(columns, rows).astype(float)).T)


def _over_exposed(levels: ndarray) -> float:
    """Return the grey level from which on pixels may be over-exposed.

    Noise that is added after the cut-off leaves half of the pixels there and puts the rest below.
    """
    off = _BRIGHTEST - levels
    if np.count_nonzero(off <= 0.0) <= _CLIPPED * len(off):
        return _BRIGHTEST
    return _BRIGHTEST - _SURELY * math.sqrt(2.0 * np.square(off[off < _NEARLY]).mean())


def _edge_pixels(
    picture: Picture, corners: ndarray, pattern: ndarray, cut_off: bool
) -> Pixels:
    """Return the pixels on either side of places along all edges in a pattern."""
    _, points, across = _edges_of(pattern, homography(corners))
    offsets = np.arange(-_REACH, _REACH + 1.0)[:, None, None]
    seen = np.rint(picture.seen(points + offsets * across)).astype(int)
    inside = ((seen >= 0) & (seen < picture.levels.shape[::-1])).all(axis=(0, 2))
    seen = seen[:, inside].reshape(-1, 2)
    levels = picture.levels[seen[:, 1], seen[:, 0]].astype(float)
    points = np.ascontiguousarray(picture.ideal(seen.astype(float)).T)
    by_group, valid, flooded = levels.reshape(_GROUP, -1), np.ones(len(levels), dtype=bool), None
    over_exposed = False
    if _is_sunlit(by_group):
        flooded = np.tile((by_group >= _BRIGHTEST).any(axis=0), _GROUP)
    elif (levels >= _BRIGHTEST).mean() >= _CLIPPED:
        valid = levels < _over_exposed(levels)
        of_groups = valid.reshape(by_group.shape)
        over_exposed = bool((of_groups.any(axis=0) & ~of_groups.all(axis=0)).any())
    cut_off = over_exposed and cut_off
    valid |= cut_off
    levels = _less_mean(levels[None], valid)[0]
    return Pixels(points, levels, valid, over_exposed, cut_off, _GROUP, flooded=flooded)


def _is_sunlit(levels: ndarray) -> bool:
    """Return whether a part of the marker has much more light, by groups' levels (group, n)."""
    white = np.maximum(levels[:_REACH].sum(axis=0), levels[-_REACH:].sum(axis=0)) / _REACH
    # As np.percentile, which takes ten times as long.
    each, (low, high) = np.arange(len(white)), _SUN_SHARES * (len(white) - 1.0)
    black = np.interp(low, each, np.sort(levels.min(axis=0)))
    low, high = np.interp((low, high), each, np.sort(white)) - black
    if high <= _SUN * low:
        return False
    noise = 1.4826 * _ROOT_HALF * np.median(np.abs(np.diff(white)))
    return bool(high - low > _SUN_DEVIATIONS * noise)


def _edges_of(
    pattern: ndarray, to_image: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Return places where black meets white, in the unit square and in px, and normals in px.

    All are (n, 2). A normal is 1 px long and points to white.
    """
    places, normals = _unit_edges(pattern.tobytes(), len(pattern))
    points, beside = mapped(places, to_image), mapped(places + 1e-3 * normals, to_image)
    across = beside - points
    return places, points, across / lengths_of(across)[:, None]


@lru_cache(maxsize=64)
def _unit_edges(pattern: bytes, cells: int) -> tuple[ndarray, ndarray]:
    """Return places (n, 2) of the unit square where black meets white, and normals to white."""
    white = np.frombuffer(pattern, np.uint8).reshape(cells, cells) > 0
    white = np.pad(white, 1, constant_values=True).astype(float)
    # 1 where white is beyond the edge, for those across each row and across each column.
    changes = np.diff(white[1:-1], axis=1), np.diff(white[:, 1:-1].T, axis=1)
    edges = np.count_nonzero(changes)
    each = max(2, _MOST_PIXELS // (_GROUP * edges))
    along = (np.arange(each) + 0.5) / each
    points, normals = [], []
    for change, order in zip(changes, (1, -1)):
        row, column = np.nonzero(change)
        x = np.repeat(column.astype(float), each)
        y = (row[:, None] + along).ravel()
        points.append(np.column_stack((x, y))[:, ::order])
        to_white = np.repeat(change[row, column], each)
        normals.append(np.column_stack((to_white, np.zeros(len(x))))[:, ::order])
    return np.concatenate(points) / cells, np.concatenate(normals)


# Reach to either side within which an edge is searched: in cells, and at most in px.
_SEARCHED = 0.45
_FARTHEST = 16.0
# Least rise of an edge, as a share of the median rise.
_LEAST_EDGE_RISE = 0.35
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
        to_image: (3, 3), from the unit square to px.
        places: (n, 2) of the unit square.
        points: (n, 2) px where they should be.
        across: (n, 2) px, normals towards white.
        off: (n,) px towards white from where they should be.
    """

    to_image: ndarray
    places: ndarray
    points: ndarray
    across: ndarray
    off: ndarray

    def moves(self) -> ndarray:
        """Return the derivatives (n, 8) of `off` by the coefficients of `moves_of`."""
        linear, last = self.to_image[:2, :2], self.to_image[2]
        third = (self.places @ last[:2] + last[2])[:, None]
        along = self.across @ linear - (self.across * self.points).sum(axis=1)[:, None] * last[:2]
        return np.ascontiguousarray(by_shape((along / third).T, (self.places - 0.5).T).T)

    def fit_without(self, side: tuple[int, float]) -> ndarray:
        """Return the coefficients (8,) of least distances to the edges that are not at a side."""
        used = self.places[:, side[0]] != side[1]
        columns, off = self.moves()[used], self.off[used]
        left, coefficients = off, np.zeros(8)
        for _ in range(_ROUNDS):
            weighted = columns / np.maximum(np.abs(left), _LEAST_LEFT)[:, None]
            coefficients = solve_symmetric(weighted.T @ columns, weighted.T @ off)
            left = off - columns @ coefficients
        return coefficients


def without_hidden_side(picture: Picture, corners: ndarray, pattern: ndarray) -> ndarray:
    """Return the corners (4, 2) of a large marker in ideal px, corrected for a hidden side.

    They are those given, unless many edges are misplaced and fewer are if one side is left out.

    Args:
        picture: the image.
        corners: (4, 2) ideal px, clockwise from the marker's top left, to half a cell.
        pattern: (n, n) cells with the border, 1 for white.
    """
    seen = _edges_seen(picture, corners, pattern) if mean_side(corners) > _SMALL else None
    if seen is None:
        return corners
    cell = mean_side(corners) / len(pattern)
    near = max(_NEAR, _NEAR_CELLS * cell)
    misplaced = _share_beyond(near, seen.off)
    if misplaced <= _MISPLACED:
        return corners
    fits = [seen.fit_without(side) for side in _SIDES]
    shares = [_share_beyond(near, seen.off - seen.moves() @ fit) for fit in fits]
    hidden = int(np.argmin(shares))
    if not shares[hidden] < misplaced - _FEWER:
        return corners
    moved = _moved(corners, fits[hidden])
    again = _edges_seen(picture, moved, pattern)
    if again is not None:
        moved = _moved(moved, again.fit_without(_SIDES[hidden]))
    is_near = np.abs(moved - corners).max() <= cell
    return moved if is_near else corners


def _share_beyond(near: float, off: ndarray) -> float:
    """Return the share of distances (n,) that are not within `near` px; NaN is not."""
    return 1.0 - float((np.abs(off) <= near).mean())


def _moved(corners: ndarray, coefficients: ndarray) -> ndarray:
    """Return corners (4, 2) moved by coefficients (8,) of `moves_of`."""
    return corners + (moves_of(corners, homography(corners)) @ coefficients).reshape(4, 2)


def _edges_seen(picture: Picture, corners: ndarray, pattern: ndarray) -> _Edges | None:
    """Return the edges that are seen near to where they should be; None if they are few."""
    reach = math.floor(min(_FARTHEST, _SEARCHED * (mean_side(corners) / len(pattern))))
    to_image = homography(corners)
    places, points, across = _edges_of(pattern, to_image)
    offsets = np.arange(-reach - 2.0, reach + 3.0)[:, None, None]
    levels = picture.at(points + offsets * across)
    rises = levels[3:-1] + levels[4:] - levels[:-4] - levels[1:-3]
    most = rises.max(axis=0)
    shown = most > _LEAST_EDGE_RISE * np.median(most)
    if np.count_nonzero(shown) < _LEAST_PLACES:
        return None
    off = rises.argmax(axis=0)[shown] - float(reach)
    return _Edges(to_image, places[shown], points[shown], across[shown], off)
