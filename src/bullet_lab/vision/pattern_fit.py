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
from scipy.special import ndtr

from bullet_lab.vision.algebra import homography
from bullet_lab.vision.images import Lens

# What is looked at beyond the outline, in cells, at most and at least; the quiet zone is one cell,
# and what lies beyond it is seen so many px within it.
_AROUND, _LEAST_AROUND, _BEYOND, _BLURRED_IN = 0.55, 0.1, 1.3, 0.8
# Of a marker up to so many px all pixels are looked at, of a larger one some hundreds at its edges:
# at so many places of each cell's edge at most, and so far to either side, px.
_SMALL, _MOST_PIXELS = 30.0, 600
_PLACES, _REACH = 5, 2
# Variance of the blur beside a pixel's own extent, px²: at first, and its limits.
_FIRST_VARIANCE, _LEAST_VARIANCE, _MOST_VARIANCE = 0.1, 0.005, 40.0
_MOST_ROUNDS = 8
# px; when no corner moves by more, what is left to go is the square of that: the fit is there.
_STILL = 0.05
# px²; where the blur is what it was taken for, and nothing moved, once is enough.
_AS_SHARP = 0.11
# Residuals beyond so many standard deviations are not the marker's.
_OUTLYING = 3.5
# Standard deviation of grey levels that were rounded to whole ones.
_LEAST_NOISE = 0.3
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
    for number in range(_MOST_ROUNDS):
        model = Model(pixels.points, corners, spread, pattern)
        columns = pixels.centred(model.light(pixels.grouped))
        if light is None:
            light = _Equations(columns, pixels.levels, np.ones(columns.shape[1])).solution()
        residuals = pixels.levels - light @ columns
        noise = _noise(residuals, model.steepness(light))
        # Blur brings in what lies beyond the quiet zone.
        reach = 2.0 * math.sqrt(max(spread[:2])) + _BLURRED_IN
        own = model.outside() < max(_LEAST_AROUND, 1.0 - reach / cell)
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
        sharpened = np.abs(spread - before).max()
        if np.abs(moved).max() < _STILL and (number or sharpened < _AS_SHARP):
            break
    residuals = residuals - step @ columns
    noise = _noise(residuals, model.steepness(light))
    residuals = np.where(own, residuals / noise, _TUKEY)
    return _judged(corners, residuals, columns / noise, pixels.group, to_corners)


class Model:
    """What pixels of a marker with these corners and this blur look like, and its derivatives.

    Args:
        points: (2, n) ideal px.
        corners: (4, 2) ideal px.
        spread: of the blur, variances along u and v and their covariance, px².
        pattern: (cells, cells), 1 for white.
    """

    def __init__(
        self, points: np.ndarray, corners: np.ndarray, spread: np.ndarray, pattern: np.ndarray
    ):
        self._cells = cells = len(pattern)
        self.to_image = homography(corners)
        unit, by_pixel = unit_square(points, self.to_image)
        self._away = unit - 0.5
        self._planes = np.concatenate((np.ones((1, len(unit[0]))), self._away))
        self._by_pixel = cells * by_pixel
        first, edges = _edge_profiles(cells * unit, self._by_pixel, spread, cells)
        shares = edges[:, :, :-1] - edges[:, :, 1:]
        around = _cells_around(pattern, first, shares.shape[2])
        along, down = shares[:, 0], shares[:, 1]
        rows = np.einsum("krn,rcn->kcn", down, around)
        self._value, slope_x, self._bend_x = np.einsum("cn,kcn->kn", rows[0], along)
        slope_y, self._bend_y = np.einsum("kcn,cn->kn", rows[1:], along[0])
        self._slopes = cells * np.stack((slope_x, slope_y))

    def light(self, evenly: bool = False) -> np.ndarray:
        """Return what the numbers of the light are multiplied with, (k, n); the last 3 with B.

        Args:
            evenly: without an offset and what is of second order.
        """
        contrast = self._planes * self._value
        if evenly:
            return np.concatenate((self._away, contrast))
        bowls = self._away**2, (self._away[0] * self._away[1])[None]
        return np.concatenate((self._planes, *bowls, contrast))

    def contrast(self, light: np.ndarray) -> np.ndarray:
        """Return white less black (n,) by the numbers of the light."""
        return light[-3:] @ self._planes

    def outside(self) -> np.ndarray:
        """Return how far outside of the outline pixels are, (n,) in cells; within it below 0."""
        return self._cells * (np.abs(self._away).max(axis=0) - 0.5)

    def steepness(self, light: np.ndarray) -> np.ndarray:
        """Return by how many grey levels a pixel changes with the image moved by 1 px, (n,)."""
        x, y = self._slopes / self._cells
        slopes = x * self._by_pixel[0] + y * self._by_pixel[1]
        return np.abs(self.contrast(light)) * np.hypot(slopes[0], slopes[1])

    def shape(self, light: np.ndarray) -> np.ndarray:
        """Return derivatives (8, n) of the grey levels by the moves that `moves_of` tells."""
        steep = -self.contrast(light) * self._slopes
        both = (steep * self._away).sum(axis=0)
        return np.concatenate((steep[0] * self._planes, steep[1] * self._planes, both * self._away))

    def blur(self, light: np.ndarray) -> np.ndarray:
        """Return derivatives (3, n) by the blur's variances and covariance."""
        contrast = self.contrast(light)
        (xu, xv), (yu, yv) = self._by_pixel
        bend_x, bend_y = contrast * self._bend_x, contrast * self._bend_y
        both = 2.0 * (bend_x * xu * xv + bend_y * yu * yv)
        by_u, by_v = bend_x * xu * xu + bend_y * yu * yu, bend_x * xv * xv + bend_y * yv * yv
        return np.stack((by_u, by_v, both))


def moves_of(corners: np.ndarray, to_image: np.ndarray) -> np.ndarray:
    """Return by how many px the corners u0, v0, u1 ... move with each number of a map, (8, 8).

    The map moves places of the unit square, of which x and y are counted from its middle, by
    (a + b x + c y + g x x + h x y, d + e x + f y + g x y + h y y), before they are seen where
    the homography (3, 3) has them.
    """
    third = (_CORNERS @ to_image[2, :2] + to_image[2, 2])[:, None, None]
    by_place = (to_image[:2, :2] - corners[:, :, None] * to_image[2, :2]) / third
    return (by_place @ _CORNER_MOVES).reshape(8, 8)


def _corner_moves() -> np.ndarray:
    moves = np.zeros((4, 2, 8))
    for move, (x, y) in zip(moves, _CORNERS - 0.5):
        move[0, :3] = move[1, 3:6] = 1.0, x, y
        move[:, 6:] = np.outer((x, y), (x, y))
    return moves


_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
_CORNER_MOVES = _corner_moves()


def _edge_profiles(
    places: np.ndarray, by_pixel: np.ndarray, spread: np.ndarray, cells: int
) -> Tuple[np.ndarray, np.ndarray]:
    """Return how much of each blurred pixel is beyond the edges of cells next to it.

    Across an edge a pixel is a box, its own extent, blurred: by a Gaussian, and by a way in which
    the image moved, which is a box again. Of two boxes the smaller is as good as a Gaussian.

    Args:
        places: (2, n) along either axis, in cells.
        by_pixel: (2, 2, n) cells along either axis for each px along u and v.
        spread: of the blur, variances along u and v and their covariance, px². As far as the blur
            is longer than wide, it is a motion.
        cells: so many along an edge.

    Returns:
        The first of the cells looked at (2, n), and (3, 2, k + 1, n): what is beyond the first
        edge of each of k cells and the last edge, with its derivatives by place and by variance.
    """
    mean, half = 0.5 * (spread[0] + spread[1]), 0.5 * (spread[0] - spread[1])
    longer = math.hypot(half, spread[2])
    along, across = by_pixel[:, 0], by_pixel[:, 1]
    squares = np.square(by_pixel)
    steep, flat = squares.max(axis=1), squares.min(axis=1)
    moved = (longer + half) * squares[:, 0] + (longer - half) * squares[:, 1]
    moved = 12.0 * np.maximum(moved + 2.0 * spread[2] * along * across, 0.0)
    boxes = np.maximum(steep, moved)
    # A pixel that lies aslant has slanting flanks, which are as good as blurred.
    rest = (np.minimum(steep, moved) + flat) / 12.0
    deviations = np.sqrt((mean - longer) * (steep + flat) + rest)
    widths = np.sqrt(np.maximum(boxes, 1e-12))
    # So far a pixel sees.
    reach = max(1, math.ceil(min(float(cells), (0.5 * widths + _SEEN * deviations).max())))
    first = np.clip(np.floor(places), -1.0, float(cells))
    away = (places - first + (reach - 1))[:, None] - np.arange(2.0 * reach)[:, None]
    widths, deviations = widths[:, None], deviations[:, None]
    ends = away + np.stack((0.5 * widths, -0.5 * widths))
    ends /= deviations
    below, density = _normal_at(ends)
    ends *= below
    ends += density
    edges = np.zeros((3, 2, 2 * reach + 2, places.shape[1]))
    edges[0, :, 0] = 1.0
    beyond = edges[0, :, 1:-1] = deviations / widths * (ends[0] - ends[1])
    edges[1, :, 1:-1] = (below[0] - below[1]) / widths
    # A Gaussian spreads as heat does: by its variance the value changes with half its bend.
    by_variance = (0.5 * (density[0] - density[1])) / (widths * deviations)
    if moved.max() > steep.min():
        by_box = (6.0 * (0.5 * (below[0] + below[1]) - beyond)) / boxes[:, None]
        by_variance = np.where((moved > steep)[:, None], by_box, by_variance)
    edges[2, :, 1:-1] = by_variance
    return first.astype(np.intp) - reach, edges


# Standard deviations of the blur beyond which nothing is seen.
_SEEN = 3.0


def _cells_around(pattern: np.ndarray, first: np.ndarray, count: int) -> np.ndarray:
    """Return `count` rows and columns of cells from the first on, (2, n): (count, count, n)."""
    pad = count // 2 + 1
    white = cv2.copyMakeBorder(pattern, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=1)
    side = len(white)
    columns, rows = first + pad
    each = np.arange(count)
    index = (rows * side + columns) + (each[:, None] * side + each)[:, :, None]
    return white.astype(float).ravel().take(index)


# The normal distribution by table, up to so many standard deviations, so many values for each.
_FAR, _FINE = 5, 512
_TABLE = np.linspace(-_FAR, _FAR, 2 * _FAR * _FINE + 1)
_BELOW, _DENSITY = ndtr(_TABLE), np.exp(-0.5 * _TABLE**2) / np.sqrt(2.0 * np.pi)


def _normal_at(places: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the normal distribution's share below places, and its density there."""
    index = np.clip(_FINE * places + (_FAR * _FINE + 0.5), 0.0, 2.0 * _FAR * _FINE).astype(np.intp)
    return _BELOW.take(index), _DENSITY.take(index)


def unit_square(points: np.ndarray, to_image: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return what of the unit square a homography maps to points (2, n), and derivatives (2, 2, n).

    >>> corners = np.array([[2.0, 1.0], [4.0, 1.0], [4.0, 3.0], [2.0, 3.0]])
    >>> unit_square(np.array([[3.0], [2.0]]), homography(corners))[0].ravel().tolist()
    [0.5, 0.5]
    """
    back = cv2.invert(to_image)[1]
    one = 1.0 / (back[2, 0] * points[0] + back[2, 1] * points[1] + back[2, 2])
    places = (back[:2, :1] * points[0] + back[:2, 1:2] * points[1] + back[:2, 2:]) * one
    return places, (back[:2, :2, None] - places[:, None] * back[2, :2, None]) * one


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
    outline = lens.seen(_mapped(_CORNERS + around * (2.0 * _CORNERS - 1.0), to_image))
    limits = np.array(image.shape[::-1]) - 1.0
    low, high = (np.clip(ends, 0.0, limits) for ends in (outline.min(axis=0), outline.max(axis=0)))
    columns, rows = (np.arange(int(low[k]), int(np.ceil(high[k])) + 1) for k in (0, 1))
    seen = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    points = np.ascontiguousarray(lens.ideal(seen.astype(float)).T)
    places, _ = unit_square(points, to_image)
    chosen = np.flatnonzero(np.abs(places - 0.5).max(axis=0) < 0.5 + around)
    seen = seen[chosen]
    return _Pixels(points[:, chosen], image[seen[:, 1], seen[:, 0]].astype(float))


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


def _noise(residuals: np.ndarray, steepness: np.ndarray) -> np.ndarray:
    """Return the standard deviation (n,) of each residual: of noise, and of edges out of place.

    Where the picture is steep, what the model knows nothing of, such as an edge that was drawn
    from few samples, makes larger residuals than where it is even.
    """
    sizes, steep = np.abs(residuals), steepness > _median(steepness)
    even = _scale(sizes[~steep])
    more = max(0.0, _scale(sizes[steep]) ** 2 - even * even)
    slope = _median(steepness[steep]) if steep.any() else 1.0
    return np.sqrt(even * even + more * (steepness / max(slope, 1e-9)) ** 2)


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
