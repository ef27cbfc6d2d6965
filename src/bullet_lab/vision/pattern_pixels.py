"""The pixels of an image that tell where a marker is: all, or those across its edges."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Optional, Tuple

import numpy as np

from bullet_lab.vision.algebra import homography
from bullet_lab.vision.images import Lens
from bullet_lab.vision.pattern_model import UNIT_SQUARE, unit_square

# What is looked at beyond the outline, in cells, at most and at least; the quiet zone is one cell,
# and what lies beyond it is seen so many px within it.
_AROUND, LEAST_AROUND, _BEYOND = 0.55, 0.1, 1.3
# Of a marker up to so many px all pixels are looked at, of a larger one some hundreds at its edges:
# at so many places of each cell's edge at most, and so far to either side, px.
SMALL, _MOST_PIXELS = 30.0, 600
_PLACES, _REACH = 5, 2
# In an image with much blur all pixels of a large marker are looked at as well, but for every other
# row and column, and so on, where it is larger than so many px.
_MANY = 60.0
# Grey levels between which a pixel tells how bright it is, and the part of over-exposed ones that
# may be noise. Of more of them, those within so many grey levels are looked at for the noise that
# was added afterwards, and what is nearer than so many of its standard deviations is one of them.
_TOLD = 0.0, 255.0
_CLIPPED = 0.08
_NEARLY, _SURELY = 24.0, 3.0
# This part of the pixels must be the marker's.
LEAST_SHARE = 0.5
# A highlight: what is dark differs by so much of what is left to the brightest.
_UNEVEN = 0.2
_ROOT_HALF = math.sqrt(0.5)
# Square of a pattern in which there is none.
_FLAT = 1e-6
# Partly in the sun: white beside some edges is so many times as bright as beside others, and by so
# many standard deviations of what differs between places next to each other.
_PARTED, _PARTED_BY, _PARTS = 1.2, 6.0, (6.0, 94.0)


def mean_cell(corners: np.ndarray, cells: int) -> float:
    """Return the mean length in px of so many equal parts of a marker's sides."""
    sides = corners[[1, 2, 3, 0]] - corners
    return float(np.hypot(sides[:, 0], sides[:, 1]).mean()) / cells


@dataclass(frozen=True, eq=False)
class Pixels:
    """Pixels of a marker.

    Attributes:
        points: (2, m) ideal px where the model is asked: as many, or a grid and what is around it.
        levels: (n,) grey levels; less their group's mean where there are groups.
        told: (n,) which of them count; over-exposed ones in groups do not.
        group: so many have an offset of their own; 1: none. The first of each group come first.
        over_exposed: whether there is so much white that was cut off that edges are without theirs.
        cut_off: whether it counts.
        parted: whether each group has a light of its own.
        flooded: (n,) which groups have white that was cut off, where each has its own light.
        grid: (rows, columns) that are pixels; what they share with their neighbours is told then.
        chosen: which of a grid without its outer rows and columns the n are.
    """

    points: np.ndarray
    levels: np.ndarray
    told: np.ndarray
    group: int = 1
    over_exposed: bool = False
    cut_off: bool = False
    parted: bool = False
    flooded: Optional[np.ndarray] = None
    grid: Optional[Tuple[int, int]] = None
    chosen: Optional[np.ndarray] = None

    @property
    def grouped(self) -> bool:
        """Whether there are groups."""
        return self.group > 1

    @property
    def whole(self) -> bool:
        """Whether there are groups, of which all pixels count."""
        return self.grouped and bool(self.told.all())

    def without(self, these: np.ndarray) -> Pixels:
        """Return those without these (n,), and without the others of their groups."""
        left = ~np.tile(these.reshape(self.group, -1).any(axis=0), self.group)
        fewer = replace(self, levels=self.levels[left], told=self.told[left])
        if self.grid is not None:
            chosen = self.chosen.copy()
            chosen[chosen] = left
            return replace(fewer, chosen=chosen)
        flooded = None if self.flooded is None else self.flooded[left]
        return replace(fewer, points=np.ascontiguousarray(self.points[:, left]), flooded=flooded)

    def own(self, values: np.ndarray) -> np.ndarray:
        """Return those of values (m,) that are the pixels', (n,)."""
        if self.grid is None:
            return values
        return values.reshape(self.grid)[1:-1, 1:-1][self.chosen]

    def seen(self, columns: np.ndarray, shared: float, value: np.ndarray) -> np.ndarray:
        """Return columns (k, m) as pixels have them that share so much with each neighbour.

        Where each group has a light of its own, less what the pattern's value (m,) makes of it.
        """
        if self.grid is not None:
            columns = columns.reshape(-1, *self.grid)
            return _mixed(_mixed(columns, shared, 2), shared, 1)[:, self.chosen]
        if not self.grouped:
            return columns
        columns = _less_mean(columns, self.told, self.group)
        return self._less_pattern(columns, value) if self.parted else columns

    def seen_levels(self, value: np.ndarray) -> np.ndarray:
        """Return the grey levels (n,), as `seen`."""
        return self._less_pattern(self.levels[None], value)[0] if self.parted else self.levels

    def own_contrast(self, value: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return white less black (n,) of each group, by its levels and the pattern's value.

        And the pattern's sum of squares there, by which the variance of a level is divided.
        """
        pattern = _less_mean(value[None], self.told, self.group).reshape(self.group, -1)
        seen = (pattern * self.levels.reshape(pattern.shape)).sum(axis=0)
        squares = np.maximum(np.square(pattern).sum(axis=0), _FLAT)
        contrast = np.maximum(seen / squares, 0.0)
        return np.tile(contrast, self.group), np.tile(squares, self.group)

    def _less_pattern(self, columns: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Return columns (k, n) less the pattern (n,), as much of it as each group has."""
        pattern = _less_mean(value[None], self.told, self.group).reshape(self.group, -1)
        pattern = pattern / np.sqrt(np.maximum(np.square(pattern).sum(axis=0), _FLAT))
        grouped = columns.reshape(len(columns), *pattern.shape)
        shares = (grouped * pattern).sum(axis=1, keepdims=True)
        return (grouped - shares * pattern).reshape(columns.shape)

    def by_shared(self, values: np.ndarray, shared: float) -> np.ndarray:
        """Return derivatives (1, n) of values (m,) by what is shared."""
        if self.grid is None:
            return np.zeros((1, len(values)))
        values = values.reshape(1, *self.grid)
        across, down = (_mixed(_less_own(values, 3 - axis), shared, axis) for axis in (1, 2))
        return (across + down)[:, self.chosen]


def _mixed(grids: np.ndarray, shared: float, axis: int) -> np.ndarray:
    """Return grids (k, rows, columns), each pixel with a part of both neighbours along an axis."""
    inner = grids[:, 1:-1] if axis == 1 else grids[:, :, 1:-1]
    return inner + shared * _less_own(grids, axis)


def _less_own(grids: np.ndarray, axis: int) -> np.ndarray:
    """Return both neighbours of each pixel along an axis, less twice its own value."""
    if axis == 1:
        return grids[:, :-2] + grids[:, 2:] - 2.0 * grids[:, 1:-1]
    return grids[:, :, :-2] + grids[:, :, 2:] - 2.0 * grids[:, :, 1:-1]


def _less_mean(columns: np.ndarray, told: np.ndarray, group: int) -> np.ndarray:
    """Return columns (m, n) less the mean of those of each group that count; 0 for the others."""
    told = told.reshape(group, -1).astype(float)
    grouped = told * columns.reshape(len(columns), group, -1)
    means = grouped.sum(axis=1, keepdims=True) / np.maximum(told.sum(axis=0), 1.0)
    return (grouped - told * means).reshape(len(columns), -1)


def pixels_of(
    image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens, cut_off: bool = False
) -> Pixels:
    """Return all pixels of a small marker (as for `fit_pattern`), those at its edges of a large.

    Over-exposed ones count where that is asked for by `cut_off`.
    """
    if mean_cell(corners, 1) <= SMALL:
        return all_pixels(image, corners, len(pattern), lens, cut_off)
    return _edge_pixels(image, corners, pattern, lens, cut_off)


def all_pixels(
    image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens, cut_off: bool
) -> Pixels:
    """Return the pixels of a marker of so many cells along a side, and of its quiet zone."""
    within = 1.0 - _BEYOND / mean_cell(corners, cells)
    around = float(np.clip(within, LEAST_AROUND, _AROUND)) / cells
    to_image = homography(corners)
    outline = lens.seen(_mapped(UNIT_SQUARE + around * (2.0 * UNIT_SQUARE - 1.0), to_image))
    limits = np.array(image.shape[::-1]) - 1.0
    each = max(1, math.ceil(mean_cell(corners, 1) / _MANY))
    low, high = (np.clip(ends, 0.0, limits) for ends in (outline.min(axis=0), outline.max(axis=0)))
    columns, rows = (np.arange(int(low[k]), int(np.ceil(high[k])) + 1, each) for k in (0, 1))
    seen = np.stack(np.meshgrid(columns, rows), axis=-1)
    levels = image[seen[..., 1], seen[..., 0]].astype(float)
    inner = np.ascontiguousarray(lens.ideal(seen.reshape(-1, 2).astype(float)).T)
    places, _ = unit_square(inner, to_image)
    chosen = (np.abs(places - 0.5).max(axis=0) < 0.5 + around).reshape(levels.shape)
    told = _told(levels, chosen)
    share = told.sum() / max(1, chosen.sum())
    over_exposed = bool(share < 1.0 - _CLIPPED)
    cut_off = over_exposed and (cut_off or bool(share < LEAST_SHARE))
    chosen = chosen if cut_off else told
    if mean_cell(corners, 1) > SMALL:
        inner = np.ascontiguousarray(inner[:, chosen.ravel()])
        return Pixels(inner, levels[chosen], chosen[chosen], 1, over_exposed, cut_off)
    wider = [np.arange(ends[0] - 1, ends[-1] + 2) for ends in (columns, rows)]
    asked = np.stack(np.meshgrid(*wider), axis=-1).reshape(-1, 2).astype(float)
    asked = np.ascontiguousarray(lens.ideal(asked).T)
    grid = len(wider[1]), len(wider[0])
    told = chosen[chosen]
    return Pixels(asked, levels[chosen], told, 1, over_exposed, cut_off, grid=grid, chosen=chosen)


def _told(levels: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return which of those chosen tell how bright they are.

    What is over-exposed, or too dark, may be anything beyond.
    """
    return chosen & (levels > _TOLD[0]) & (levels < _over_exposed(levels[chosen]))


def _over_exposed(levels: np.ndarray) -> float:
    """Return the grey level from which on pixels may be over-exposed.

    Noise that is added to what was cut off leaves half of it there, and has the rest below.
    """
    off = _TOLD[1] - levels
    if np.count_nonzero(off <= 0.0) <= _CLIPPED * len(off):
        return _TOLD[1]
    return _TOLD[1] - _SURELY * math.sqrt(2.0 * np.square(off[off < _NEARLY]).mean())


def _edge_pixels(
    image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens, cut_off: bool
) -> Pixels:
    """Return the pixels on either side of places along all edges in a pattern."""
    _, points, across = edges_of(pattern, homography(corners))
    offsets = np.arange(-_REACH, _REACH + 1.0)[:, None, None]
    seen = np.rint(lens.seen(points + offsets * across)).astype(int)
    inside = ((seen >= 0) & (seen < image.shape[::-1])).all(axis=(0, 2))
    seen = seen[:, inside].reshape(-1, 2)
    levels = image[seen[:, 1], seen[:, 0]].astype(float)
    group = 2 * _REACH + 1
    points = np.ascontiguousarray(lens.ideal(seen.astype(float)).T)
    if _is_parted(levels, group):
        told = np.ones(len(levels), dtype=bool)
        flooded = np.tile((levels.reshape(group, -1) >= _TOLD[1]).any(axis=0), group)
        levels = _less_mean(levels[None], told, group)[0]
        return Pixels(points, levels, told, group, parted=True, flooded=flooded)
    told = _told_in_groups(levels, group)
    by_group = told.reshape(group, -1)
    over_exposed = bool((by_group.any(axis=0) & ~by_group.all(axis=0)).any())
    cut_off = over_exposed and (cut_off or _uneven(levels, group))
    told |= cut_off
    levels = _less_mean(levels[None], told, group)[0]
    return Pixels(points, levels, told, group, over_exposed, cut_off)


def _is_parted(levels: np.ndarray, group: int) -> bool:
    """Return whether a part of the marker has much more light than another."""
    by_place = levels.reshape(group, -1)
    white = np.maximum(by_place[:_REACH].mean(axis=0), by_place[-_REACH:].mean(axis=0))
    low, high = np.percentile(white, _PARTS) - np.percentile(by_place.min(axis=0), _PARTS[0])
    noise = 1.4826 * _ROOT_HALF * np.median(np.abs(np.diff(white)))
    return bool(high > _PARTED * low and high - low > _PARTED_BY * noise)


def _told_in_groups(levels: np.ndarray, group: int) -> np.ndarray:
    """Return which levels (n,) tell how bright it is: those of groups without over-exposed pixels.

    Where these are few, it is what is not over-exposed.
    """
    if (levels >= _TOLD[1]).mean() < _CLIPPED:
        return np.ones(len(levels), dtype=bool)
    told = levels < _over_exposed(levels)
    whole = np.tile(told.reshape(group, -1).all(axis=0), group)
    return whole if whole.mean() >= LEAST_SHARE else told


def _uneven(levels: np.ndarray, group: int) -> bool:
    """Return whether what is dark beside edges differs, as under a highlight or by much blur.

    Half a group takes its slope for an edge out of place; all of it makes large residuals under a
    highlight, as it should.
    """
    darkest = levels.reshape(group, -1).min(axis=0)
    low, high = np.percentile(darkest, (10.0, 90.0))
    return bool(high - low > _UNEVEN * (_TOLD[1] - low))


def edges_of(
    pattern: np.ndarray, to_image: np.ndarray
) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return places where black meets white, in the unit square and in px, and what is across.

    All are (n, 2); the last are of 1 px, towards white.
    """
    places, normals = _edges(pattern.tobytes(), len(pattern))
    points, beside = _mapped(places, to_image), _mapped(places + 1e-3 * normals, to_image)
    across = beside - points
    return places, points, across / np.hypot(across[:, 0], across[:, 1])[:, None]


@lru_cache(maxsize=64)
def _edges(pattern: bytes, cells: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return places (n, 2) of the unit square where black meets white, and the way to white."""
    white = np.frombuffer(pattern, np.uint8).reshape(cells, cells) > 0
    white = np.pad(white, 1, constant_values=True)
    edges = int((white[:, 1:] != white[:, :-1]).sum() + (white[1:] != white[:-1]).sum())
    each = int(np.clip(_MOST_PIXELS / ((2 * _REACH + 1) * edges), 2, _PLACES))
    along = (np.arange(each) + 0.5) / each
    points, normals = [], []
    # Between the cells of a row, then, with rows and columns exchanged, of a column.
    for order, cells_of in ((1, white), (-1, white.T)):
        row, column = np.nonzero(cells_of[1:-1, 1:] != cells_of[1:-1, :-1])
        x = np.repeat(column.astype(float), each)
        y = (row[:, None] + along).ravel()
        points.append(np.column_stack((x, y))[:, ::order])
        to_white = np.where(cells_of[1:-1, 1:][row, column], 1.0, -1.0)
        normals.append(np.outer(np.repeat(to_white, each), np.array([1.0, 0.0])[::order]))
    return np.concatenate(points) / cells, np.concatenate(normals)


def _mapped(places: np.ndarray, to_image: np.ndarray) -> np.ndarray:
    """Return where (n, 2) places of the unit square are, in ideal px."""
    there = places @ to_image[:, :2].T + to_image[:, 2]
    return there[:, :2] / there[:, 2:]
