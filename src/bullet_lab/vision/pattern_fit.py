"""Corners of a marker by the fit of its whole pattern to the grey levels, with their covariance.

All edges between black and white cells tell where the marker is, not only its outline, and what
is not as the pattern says, a hand before it or a highlight, is told from it and left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Optional, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import homography
from bullet_lab.vision.images import Lens
from bullet_lab.vision.pattern_model import UNIT_SQUARE, PatternModel, moves_of, unit_square

# What is looked at beyond the outline, in cells, at most and at least; the quiet zone is one cell,
# and what lies beyond it is seen so many px within it.
_AROUND, _LEAST_AROUND, _BEYOND, _BLURRED_IN = 0.55, 0.1, 1.3, 0.8
# Of a marker up to so many px all pixels are looked at, of a larger one some hundreds at its edges:
# at so many places of each cell's edge at most, and so far to either side, px.
_SMALL, _MOST_PIXELS = 30.0, 600
_PLACES, _REACH = 5, 2
# Variance of the blur beside a pixel's own extent, px²: at first, and its limits.
_FIRST_VARIANCE, _LEAST_VARIANCE, _MOST_VARIANCE = 0.1, 0.005, 40.0
_MOST_ROUNDS = 12
# px; when no corner moves by more, what is left to go is the square of that: the fit is there.
_STILL = 0.05
# px²; where the blur is what it was taken for, and nothing moved, once is enough.
_AS_SHARP, _ABOUT = 0.11, 0.1
# px²; in an image with more blur than that all pixels of a large marker are looked at as well, but
# for every other row and column, and so on, where it is larger than so many px.
_SOFT, _MANY = 1.0, 60.0
# Residuals beyond so many standard deviations are not the marker's.
_OUTLYING = 3.5
# Standard deviation of grey levels that were rounded to whole ones.
_LEAST_NOISE = 0.3
# Grey levels between which a pixel tells how bright it is.
_TOLD = 0.0, 255.0
# So many pixels must be the marker's, and this part of all.
_LEAST_PIXELS, _LEAST_SHARE = 40, 0.5
# The corners may be moved by so many cells.
_MOST_MOVED = 1.0
_SHAPE, _SPREAD = 8, 3


@dataclass(frozen=True, eq=False)
class PatternFit:
    """Where a marker is.

    Attributes:
        corners: (4, 2) u, v in ideal px.
        covariance: (8, 8) of the corners' u0, v0, u1 ... in px².
        hidden: share of the pixels that are not as the pattern says.
    """

    corners: np.ndarray
    covariance: np.ndarray
    hidden: float


def fit_pattern(
    image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens
) -> Optional[PatternFit]:
    """Fit corners, light and blur to the grey levels by weighted least squares.

    A pixel is modelled as a + d · B, with a (of second order) and d (of first) its light over the
    marker, and B the pattern, 0 or 1, blurred by the lens and by motion, whose covariance in the
    image is fitted too. Of a large marker the pixels across each place of an edge have an a of
    their own, so that highlights and shadows do not matter. Robust weights are Tukey's; the
    covariance is that of least squares with the noise that the residuals show.

    Args:
        image: (h, w) grey levels.
        corners: (4, 2) ideal px, clockwise from the marker's top left, to a fraction of a cell.
        pattern: (n, n) cells with the border, 1 for white.
        lens: where ideal pixels are seen.

    Returns:
        None where the pattern does not explain what is there.
    """
    cells = len(pattern)
    pixels = _pixels(image, corners, pattern, lens)
    if len(pixels.levels) < _LEAST_PIXELS:
        return None
    spread = np.array([_FIRST_VARIANCE, _FIRST_VARIANCE, 0.0])
    start, cell, light = corners, _cell(corners, cells), None
    for left in reversed(range(_MOST_ROUNDS)):
        model = PatternModel(pixels.points, corners, spread, pattern)
        columns = pixels.centred(model.light(pixels.grouped))
        if light is None:
            light = _Equations(columns, pixels.levels, np.ones(columns.shape[1])).solution()
        residuals = pixels.levels - light @ columns
        noise = _noise(residuals, model.steepness(light), model.beyond(light))
        # Blur brings in what lies beyond the quiet zone.
        reach = 2.0 * math.sqrt(max(spread[:2])) + _BLURRED_IN
        own = (model.margin() > reach) | (model.outside() < _LEAST_AROUND)
        weights = np.where(own, _tukey(residuals / noise) / (noise * noise), 0.0)
        shape = pixels.centred(np.concatenate((model.shape(light), model.blur(light))))
        columns = np.concatenate((columns, shape))
        step = _Equations(columns, residuals, weights, _BLUR_PRIOR).solution()
        light = light + step[: len(light)]
        to_corners = moves_of(corners, model.to_image)
        moved = to_corners @ step[len(light) : -_SPREAD]
        corners = corners + moved.reshape(4, 2)
        before, spread = spread, _allowed(spread + step[-_SPREAD:])
        if not np.abs(corners - start).max() <= _MOST_MOVED * cell:
            return None
        sharpened = np.abs(spread - before).max() - _ABOUT * spread.max()
        if np.abs(moved).max() < _STILL and sharpened < _AS_SHARP:
            break
        if left and pixels.grouped and spread.max() > _SOFT:
            # Few pixels across each edge see little of so much blur.
            pixels, light = _all_pixels(image, corners, cells, lens), None
    residuals = residuals - step @ columns
    noise = _noise(residuals, model.steepness(light), model.beyond(light))
    residuals = np.where(own, residuals / noise, _TUKEY)
    return _judged(corners, residuals, columns / noise, pixels.group, to_corners)


def _allowed(spread: np.ndarray) -> np.ndarray:
    """Return the nearest blur that there can be."""
    low, high = np.clip(spread[:2], _LEAST_VARIANCE, _MOST_VARIANCE).tolist()
    # What it is across is no less than the least.
    most = math.sqrt((low - 0.99 * _LEAST_VARIANCE) * (high - 0.99 * _LEAST_VARIANCE))
    return np.array([low, high, min(max(spread[2], -most), most)])


def _cell(corners: np.ndarray, cells: int) -> float:
    sides = corners[[1, 2, 3, 0]] - corners
    return float(np.hypot(sides[:, 0], sides[:, 1]).mean()) / cells


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Pixels of a marker.

    Attributes:
        points: (2, n) ideal px.
        levels: (n,) grey levels; less their group's mean where there are groups.
        group: so many have an offset of their own; 1: none. The first of each group come first.
    """

    points: np.ndarray
    levels: np.ndarray
    group: int = 1

    @property
    def grouped(self) -> bool:
        """Whether there are groups."""
        return self.group > 1

    def centred(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (m, n) less the mean of each group."""
        return _less_mean(columns, self.group) if self.grouped else columns


def _less_mean(columns: np.ndarray, group: int) -> np.ndarray:
    grouped = columns.reshape(len(columns), group, -1)
    means = grouped.sum(axis=1, keepdims=True) / group
    return (grouped - means).reshape(len(columns), -1)


def _pixels(image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens) -> _Pixels:
    if _cell(corners, 1) <= _SMALL:
        return _all_pixels(image, corners, len(pattern), lens)
    return _edge_pixels(image, corners, pattern, lens)


def _all_pixels(image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens) -> _Pixels:
    within = 1.0 - _BEYOND / _cell(corners, cells)
    around = float(np.clip(within, _LEAST_AROUND, _AROUND)) / cells
    to_image = homography(corners)
    outline = lens.seen(_mapped(UNIT_SQUARE + around * (2.0 * UNIT_SQUARE - 1.0), to_image))
    limits = np.array(image.shape[::-1]) - 1.0
    each = max(1, math.ceil(_cell(corners, 1) / _MANY))
    low, high = (np.clip(ends, 0.0, limits) for ends in (outline.min(axis=0), outline.max(axis=0)))
    columns, rows = (np.arange(int(low[k]), int(np.ceil(high[k])) + 1, each) for k in (0, 1))
    seen = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    points = np.ascontiguousarray(lens.ideal(seen.astype(float)).T)
    places, _ = unit_square(points, to_image)
    levels = image[seen[:, 1], seen[:, 0]].astype(float)
    chosen = np.abs(places - 0.5).max(axis=0) < 0.5 + around
    # What is over-exposed, or too dark, may be anything beyond.
    told = chosen & (levels > _TOLD[0]) & (levels < _TOLD[1])
    chosen = told if told.sum() > _LEAST_SHARE * chosen.sum() else chosen
    return _Pixels(points[:, chosen], levels[chosen])


def _edge_pixels(
    image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens
) -> _Pixels:
    """Return the pixels on either side of places along all edges in a pattern."""
    places, normals = _edges(pattern.tobytes(), len(pattern))
    to_image = homography(corners)
    points, beside = _mapped(places, to_image), _mapped(places + 1e-3 * normals, to_image)
    across = beside - points
    across /= np.hypot(across[:, 0], across[:, 1])[:, None]
    offsets = np.arange(-_REACH, _REACH + 1.0)[:, None, None]
    seen = np.rint(lens.seen(points + offsets * across)).astype(int)
    inside = ((seen >= 0) & (seen < image.shape[::-1])).all(axis=(0, 2))
    seen = seen[:, inside].reshape(-1, 2)
    levels = image[seen[:, 1], seen[:, 0]].astype(float)
    group = 2 * _REACH + 1
    points = np.ascontiguousarray(lens.ideal(seen.astype(float)).T)
    return _Pixels(points, _less_mean(levels[None], group)[0], group)


@lru_cache(maxsize=64)
def _edges(pattern: bytes, cells: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return places (n, 2) of the unit square where black meets white, and what is across there."""
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
        normals.append(np.tile(np.array([1.0, 0.0])[::order], (len(x), 1)))
    return np.concatenate(points) / cells, np.concatenate(normals)


def _mapped(places: np.ndarray, to_image: np.ndarray) -> np.ndarray:
    """Return where (n, 2) places of the unit square are, in ideal px."""
    there = places @ to_image[:, :2].T + to_image[:, 2]
    return there[:, :2] / there[:, 2:]


# Least certainty of the blur's numbers before anything is seen: variances to a px² or so.
_BLUR_PRIOR = 1.0


class _Equations:
    """Normal equations of weighted least squares of columns (m, n) to levels (n,)."""

    def __init__(
        self, columns: np.ndarray, levels: np.ndarray, weights: np.ndarray, prior: float = 0.0
    ):
        both = np.concatenate((columns, levels[None]))
        both *= np.sqrt(weights)
        squares = cv2.mulTransposed(both, False)
        self._normal, self._right = squares[:-1, :-1].copy(), squares[:-1, -1]
        diagonal = np.einsum("ii->i", self._normal)
        diagonal[-_SPREAD:] += prior
        # The numbers are of unlike size, and some of the light's may not be told at all.
        self._size = 1.0 / np.sqrt(np.maximum(diagonal, 1e-9))
        self._normal *= self._size[:, None] * self._size
        diagonal += 1e-9

    def solution(self) -> np.ndarray:
        """Return the numbers (m,); NaN if there are none."""
        solved, found = cv2.solve(self._normal, self._size * self._right)
        return self._size * found.ravel() if solved else np.full(len(self._right), np.nan)

    def inverse(self) -> np.ndarray:
        """Return the inverse (m, m) of the equations' matrix."""
        return cv2.invert(self._normal)[1] * (self._size[:, None] * self._size)


# Tukey's constant, in standard deviations: of Gaussian noise hardly anything is passed over.
_TUKEY = 6.0


def _noise(residuals: np.ndarray, steepness: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    """Return the standard deviation (n,) of each residual: of noise, and of edges out of place.

    And of what is `beyond` the quiet zone, of which the model knows nothing.

    Where the picture is steep, what the model knows nothing of, such as an edge that was drawn
    from few samples, makes larger residuals than where it is even.
    """
    sizes, steep = np.abs(residuals), steepness > _median(steepness)
    even = _scale(sizes[~steep])
    more = max(0.0, _scale(sizes[steep]) ** 2 - even * even)
    slope = _median(steepness[steep]) if steep.any() else 1.0
    steeper = steepness / max(slope, 1e-9)
    return np.sqrt(even * even + more * steeper * steeper + beyond * beyond)


def _median(values: np.ndarray) -> float:
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


def _scale(sizes: np.ndarray) -> float:
    """Return the standard deviation of most residuals, by the median of their sizes."""
    return max(_LEAST_NOISE, 1.4826 * _median(sizes)) if len(sizes) else _LEAST_NOISE


def _tukey(ratios: np.ndarray) -> np.ndarray:
    """Return Tukey's biweights (n,) of residuals in standard deviations."""
    rest = np.maximum(1.0 - np.square(ratios / _TUKEY), 0.0)
    return rest * rest


def _judged(
    corners: np.ndarray,
    residuals: np.ndarray,
    columns: np.ndarray,
    group: int,
    to_corners: np.ndarray,
) -> Optional[PatternFit]:
    """Return the fit with its covariance, if the pattern explains most of what is seen.

    Residuals (n,) and columns (m, n) are in standard deviations; `to_corners` is of `moves_of`.
    """
    own = np.abs(residuals) < _OUTLYING
    count = int(own.sum())
    if count < max(_LEAST_PIXELS, _LEAST_SHARE * len(own)):
        return None
    free = count * (1.0 - 1.0 / group if group > 1 else 1.0) - len(columns)
    squares = float(np.square(residuals[own]).sum()) / max(1.0, free)
    shape = slice(-_SHAPE - _SPREAD, -_SPREAD)
    inverse = _Equations(columns, residuals, own.astype(float), _BLUR_PRIOR).inverse()[shape, shape]
    covariance = squares * (to_corners @ inverse @ to_corners.T)
    return PatternFit(corners, 0.5 * (covariance + covariance.T), 1.0 - count / len(own))
