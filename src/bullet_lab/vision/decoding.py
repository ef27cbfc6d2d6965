"""Decoding of a quadrilateral: the bits of its cells, and the marker that they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Optional

import numpy as np

from bullet_lab.vision.algebra import homography, solve_symmetric
from bullet_lab.vision.dictionaries import MarkerDictionary
from bullet_lab.vision.images import Lens, sample

# Where a cell is sampled, from its middle, in cells.
_SPREAD = np.array([-0.24, -0.08, 0.08, 0.24])
# How far each cell is pushed away from its neighbours, against blur.
_SHARPENING = 0.25
# A glance: places along each side, the part of them that has to be brighter outside, and what
# the brightest data cell has to have of that rise.
_GLANCES = 7
_FRAMED = 0.7
_NOT_EMPTY = 0.25


@dataclass(frozen=True)
class Reading:
    """The cells of a quadrilateral, as a marker's.

    Attributes:
        bits: (cells²,) ±1, white +1, row by row from the first corner.
        border_errors: cells of the border that are not black.
        contrast: grey levels between black and white.
        levels: (cells + 2, cells + 2) grey levels, border included.
    """

    bits: np.ndarray
    border_errors: int
    contrast: float
    levels: np.ndarray


@dataclass(frozen=True)
class Match:
    """The marker that a reading is.

    Attributes:
        marker: its id.
        turns: the first corner of the reading is this one of the marker's, clockwise from its
            top left.
        errors: bits that were read wrongly.
        likeness: correlation of the grey levels with the marker's pattern, at most 1.
    """

    marker: int
    turns: int
    errors: int
    likeness: float


def may_be_marker(image: np.ndarray, quad: np.ndarray, cells: int, lens: Lens) -> bool:
    """Return whether it is worth looking closer: dark just inside, brighter outside, not empty.

    Args:
        image: (h, w) grey levels.
        quad: (4, 2) corners, px, roughly.
        cells: data cells along an edge.
        lens: straightens edges.
    """
    places = _glance(cells) @ homography(lens.ideal(quad)).T
    values = sample(image, lens.seen(places[:, :2] / places[:, 2:]))
    outside, border, inside = np.split(values, (4 * _GLANCES, 8 * _GLANCES))
    if float((outside > border).mean()) < _FRAMED:
        return False
    rise = float(np.sort(outside)[len(outside) // 2] - np.sort(border)[len(border) // 2])
    return float(inside.max() - border.min()) > _NOT_EMPTY * rise


@lru_cache(maxsize=None)
def _glance(cells: int) -> np.ndarray:
    """Return (n, 3) places of the unit square: outside the border, in it, in the data cells."""
    cell = 1.0 / (cells + 2)
    along = np.linspace(cell, 1.0 - cell, _GLANCES)
    places = []
    for ring in (-0.5 * cell, 0.5 * cell):
        low, high = np.full(_GLANCES, ring), np.full(_GLANCES, 1.0 - ring)
        for pair in ((along, low), (along, high), (low, along), (high, along)):
            places.append(np.column_stack(pair))
    middles = (np.arange(cells) + 1.5) * cell
    places.append(np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2))
    points = np.vstack(places)
    return np.column_stack((points, np.ones(len(points))))


def read_cells(image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens) -> np.ndarray:
    """Return the mean grey levels of a marker's cells and of one ring around it.

    Args:
        image: (h, w) grey levels.
        corners: (4, 2) of the black square, ideal px.
        cells: data cells along an edge; the border adds one each way, the ring another.
        lens: where ideal pixels are seen.

    Returns:
        (cells + 4, cells + 4) grey levels.
    """
    side = cells + 4
    middles = (np.arange(side) - 0.5)[:, None] + _SPREAD
    line = middles.ravel() / (cells + 2)
    x, y = np.meshgrid(line, line)
    points = np.column_stack((x.ravel(), y.ravel(), np.ones(x.size))) @ homography(corners).T
    values = sample(image, lens.seen(points[:, :2] / points[:, 2:]))
    each = len(_SPREAD)
    return values.reshape(side, each, side, each).mean(axis=(1, 3))


def interpret(levels: np.ndarray) -> Optional[Reading]:
    """Tell black from white in the grey levels that `read_cells` returns; None if they are even.

    Light may change evenly across a marker: black and white levels are planes, black's through
    the border, white's through all that is brighter than the middle.
    """
    side = len(levels)
    inner = levels[1:-1, 1:-1]
    border = np.ones((side, side), dtype=bool)
    border[[0, -1]] = border[:, [0, -1]] = False
    border[2:-2, 2:-2] = False
    black = float(np.median(levels[border]))
    white = float(np.sort(inner, axis=None)[int(0.95 * inner.size)])
    if white - black < 1.0:
        return None
    bright = levels > 0.5 * (black + white)
    dark_plane = _plane(levels, border & ~bright)
    bright_plane = _plane(levels, bright)
    half = 0.5 * (bright_plane - dark_plane)
    half = np.maximum(half, 0.2 * 0.5 * (white - black))
    soft = np.clip((levels - 0.5 * (bright_plane + dark_plane)) / half, -1.5, 1.5)
    neighbours = soft[:-2, 1:-1] + soft[2:, 1:-1] + soft[1:-1, :-2] + soft[1:-1, 2:]
    sharp = soft[1:-1, 1:-1] + _SHARPENING * (4.0 * soft[1:-1, 1:-1] - neighbours)
    bits = np.where(sharp[1:-1, 1:-1] > 0.0, 1.0, -1.0).astype(np.float32)
    border_errors = int((sharp > 0.0)[border[1:-1, 1:-1]].sum())
    return Reading(bits.ravel(), border_errors, white - black, inner)


def match(reading: Reading, dictionary: MarkerDictionary, correction: int) -> Optional[Match]:
    """Return the marker of a dictionary that differs in at most `correction` bits, or None."""
    marker, turns, errors = dictionary.nearest(reading.bits)
    if errors > correction:
        return None
    return Match(marker, turns, errors, _likeness(reading, dictionary, marker, turns))


def _likeness(reading: Reading, dictionary: MarkerDictionary, marker: int, turns: int) -> float:
    pattern = (
        np.rot90(dictionary.pattern(marker), turns).ravel() - dictionary.pattern(marker).mean()
    )
    levels = reading.levels.ravel() - reading.levels.mean()
    return float(pattern @ levels / np.sqrt((pattern @ pattern) * (levels @ levels)))


def _plane(levels: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the plane through the chosen levels, everywhere; their mean if they are few."""
    values = levels[chosen]
    if len(values) < 8:
        return np.full(levels.shape, values.mean() if len(values) else levels.mean())
    row, column = np.indices(levels.shape, dtype=float)
    middle = (len(levels) - 1) / 2.0
    terms = np.stack((np.ones(levels.shape), row - middle, column - middle), axis=-1)
    a = terms[chosen]
    solution = solve_symmetric(a.T @ a + 1e-6 * np.eye(3), a.T @ values)
    return terms @ solution
