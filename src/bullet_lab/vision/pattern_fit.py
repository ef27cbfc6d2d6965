"""Corners of a marker by the fit of its whole pattern to the grey levels, with their covariance.

All edges between black and white cells tell where the marker is, not only its outline, and what
is not as the pattern says, a hand before it or a highlight, is told from it and left out.
"""

from __future__ import annotations

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
_FIRST_VARIANCE, _LEAST_VARIANCE, _MOST_VARIANCE = 0.2, 0.005, 40.0
_MOST_ROUNDS = 8
# px; when no corner moves by more any longer, the fit is there.
_STILL = 0.01
# Residuals beyond so many standard deviations are not the marker's.
_OUTLYING = 3.5
# Standard deviation of grey levels that were rounded to whole ones.
_LEAST_NOISE = 0.3
# So many pixels must be the marker's, and this part of all.
_LEAST_PIXELS, _LEAST_SHARE = 40, 0.5
# The corners may be moved by so many cells.
_MOST_MOVED = 1.0
_LIGHT, _SHAPE, _SPREAD = 9, 8, 3


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
    marker, and B the pattern, 0 or 1, blurred by a Gaussian whose covariance in the image is fitted
    too (lens, motion). Of a large marker the pixels across each place of an edge have an a of their
    own, so that highlights and shadows do not matter. Robust weights are Tukey's; the covariance is
    that of least squares with the noise that the residuals show.

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
    spread = _FIRST_VARIANCE * np.array([1.0, 1.0, 0.0])
    start, limit = corners, _MOST_MOVED * _cell(corners, cells)
    weights = np.ones(len(pixels.levels))
    for number in range(_MOST_ROUNDS):
        model = _Model(pixels.points, corners, spread, pattern)
        columns = pixels.centred(model.light)
        light = _Normal(columns, pixels.levels, weights).solution
        residuals = pixels.levels - columns @ light
        noise = _noise(residuals, model.steepness(light))
        # Blur brings in what lies beyond the quiet zone.
        reach = 2.0 * float(np.sqrt(spread[:2].max())) + _BLURRED_IN
        own = model.outside() < max(_LEAST_AROUND, 1.0 - reach / _cell(corners, cells))
        weights = np.where(own, _tukey(residuals / noise) / (noise * noise), 0.0)
        shape = pixels.centred(np.concatenate((model.shape(light), model.blur(light)), axis=1))
        columns = np.concatenate((columns, shape), axis=1)
        step = _Normal(columns, residuals, weights).solution[_LIGHT:]
        corners = corners + step[:_SHAPE].reshape(4, 2)
        spread = _allowed(spread + step[_SHAPE:])
        if not np.isfinite(corners).all() or np.abs(corners - start).max() > limit:
            return None
        if number and np.abs(step[:_SHAPE]).max() < _STILL:
            break
    residuals = np.where(own, residuals / noise, np.inf)
    return _judged(corners, residuals, columns / noise[:, None], pixels.group)


class _Model:
    """What pixels of a marker with these corners and this blur look like, and its derivatives.

    Args:
        points: (n, 2) ideal px.
        corners: (4, 2) ideal px.
        spread: of the blur, variances along u and v and their covariance, px².
        pattern: (cells, cells), 1 for white.
    """

    def __init__(
        self, points: np.ndarray, corners: np.ndarray, spread: np.ndarray, pattern: np.ndarray
    ):
        cells = len(pattern)
        self._points, self._cells = points, cells
        self._unit, by_pixel = unit_square(points, corners)
        self._to_shape = _by_corners(corners)
        self._by_pixel = cells * by_pixel
        across, down = self._by_pixel[:, 0], self._by_pixel[:, 1]
        columns = _Steps(cells * self._unit[:, 0], across, spread, cells)
        rows = _Steps(cells * self._unit[:, 1], down, spread, cells)
        white = np.pad(pattern.astype(float), 1, constant_values=1.0)
        along_rows = cv2.gemm(rows.shares, white, 1.0, None, 0.0)
        self._value = (along_rows * columns.shares).sum(axis=1)
        slope_x = (along_rows * columns.slopes).sum(axis=1)
        self._bend_x = (along_rows * columns.bends).sum(axis=1)
        slope_y = (cv2.gemm(rows.slopes, white, 1.0, None, 0.0) * columns.shares).sum(axis=1)
        self._bend_y = (cv2.gemm(rows.bends, white, 1.0, None, 0.0) * columns.shares).sum(axis=1)
        self._slopes = slope_x[:, None] * across + slope_y[:, None] * down
        away = self._unit - 0.5
        planes = np.column_stack((np.ones(len(points)), away))
        self._planes = planes
        bowls = np.column_stack((away**2, away[:, 0] * away[:, 1]))
        self.light = np.concatenate((planes, bowls, planes * self._value[:, None]), axis=1)

    def contrast(self, light: np.ndarray) -> np.ndarray:
        """Return white less black (n,) by the numbers of the light."""
        return self._planes @ light[-3:]

    def outside(self) -> np.ndarray:
        """Return how far outside of the outline pixels are, (n,) in cells; within it below 0."""
        return self._cells * (np.abs(self._unit - 0.5).max(axis=1) - 0.5)

    def steepness(self, light: np.ndarray) -> np.ndarray:
        """Return by how many grey levels a pixel changes with the image moved by 1 px, (n,)."""
        return np.abs(self.contrast(light)) * np.hypot(self._slopes[:, 0], self._slopes[:, 1])

    def shape(self, light: np.ndarray) -> np.ndarray:
        """Return derivatives (n, 8) of the grey levels by the corners' u0, v0, u1 ..."""
        steep = -self.contrast(light)[:, None] * self._slopes
        (x, y), (u, v) = self._unit.T, self._points.T
        by_u, by_v = steep.T / _third(self._unit, self._to_shape[0])
        rest = -(by_u * u + by_v * v)
        by_map = np.stack((by_u * x, by_u * y, by_u, by_v * x, by_v * y, by_v, rest * x, rest * y))
        return cv2.gemm(by_map, self._to_shape[1], 1.0, None, 0.0, flags=cv2.GEMM_1_T)

    def blur(self, light: np.ndarray) -> np.ndarray:
        """Return derivatives (n, 3) by the blur's variances and covariance.

        A Gaussian spreads as heat does: by its variance the value changes with half its bend.
        """
        half = 0.5 * self.contrast(light)
        across, down = self._by_pixel[:, 0].T, self._by_pixel[:, 1].T
        bend_x, bend_y = half * self._bend_x, half * self._bend_y
        parts = [bend_x * across[k] * across[i] + bend_y * down[k] * down[i] for k, i in _PAIRS]
        parts[2] = 2.0 * parts[2]
        return np.stack(parts, axis=1)


_PAIRS = ((0, 0), (1, 1), (0, 1))


class _Steps:
    """Shares of each row, or column, of cells in blurred pixels, and derivatives by the place.

    Across an edge a pixel is a box, its own extent, blurred by a Gaussian.

    Args:
        places: (n,) along the axis, in cells.
        by_pixel: (n, 2) cells along the axis for each px along u and v.
        spread: of the blur, variances along u and v and their covariance, px².
        cells: so many.
    """

    def __init__(self, places: np.ndarray, by_pixel: np.ndarray, spread: np.ndarray, cells: int):
        steep, flat = np.abs(by_pixel).max(axis=1), np.abs(by_pixel).min(axis=1)
        along, across = by_pixel.T
        variances = spread[0] * along**2 + spread[1] * across**2 + 2.0 * spread[2] * along * across
        # A pixel that lies aslant has slanting flanks, which are as good as blurred.
        deviations = np.sqrt(variances + flat * flat / 12.0)[:, None]
        width = np.maximum(steep, 1e-6)[:, None]
        away = places[:, None] - np.arange(cells + 1.0)
        high, low = (away + 0.5 * width) / deviations, (away - 0.5 * width) / deviations
        (below_high, dense_high), (below_low, dense_low) = _normal_at(high), _normal_at(low)
        below, density, falling = np.zeros((3, len(places), cells + 3))
        below[:, 0] = 1.0
        rise = high * below_high + dense_high - low * below_low - dense_low
        below[:, 1:-1] = deviations / width * rise
        density[:, 1:-1] = (below_high - below_low) / width
        falling[:, 1:-1] = (dense_high - dense_low) / (width * deviations)
        self.shares, self.slopes, self.bends = (
            values[:, :-1] - values[:, 1:] for values in (below, density, falling)
        )


# The normal distribution by table, up to so many standard deviations, so many values for each.
_FAR, _FINE = 5, 512
_TABLE = np.linspace(-_FAR, _FAR, 2 * _FAR * _FINE + 1)
_BELOW, _DENSITY = ndtr(_TABLE), np.exp(-0.5 * _TABLE**2) / np.sqrt(2.0 * np.pi)


def _normal_at(places: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the normal distribution's share below places, and its density there."""
    index = np.clip(_FINE * (places + _FAR) + 0.5, 0.0, 2.0 * _FAR * _FINE).astype(np.intp)
    return _BELOW.take(index), _DENSITY.take(index)


def unit_square(points: np.ndarray, corners: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return where points (n, 2) lie in the unit square that a quad is, and derivatives (n, 2, 2).

    >>> corners = np.array([[2.0, 1.0], [4.0, 1.0], [4.0, 3.0], [2.0, 3.0]])
    >>> unit_square(np.array([[3.0, 2.0]]), corners)[0].tolist()
    [[0.5, 0.5]]
    """
    back = cv2.invert(homography(corners))[1]
    third = points @ back[2, :2] + back[2, 2]
    places = (points @ back[:2, :2].T + back[:2, 2]) / third[:, None]
    return places, (back[:2, :2] - places[:, :, None] * back[2, :2]) / third[:, None, None]


def _by_corners(corners: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the homography of a quad, and how its numbers (8,) follow its corners, (8, 8)."""
    to_image = homography(corners)
    x, y = _CORNERS.T
    u, v = corners.T / _third(_CORNERS, to_image)
    one = 1.0 / _third(_CORNERS, to_image)
    by_map = np.zeros((4, 2, 8))
    by_map[:, 0, :3] = by_map[:, 1, 3:6] = np.stack((x, y, np.ones(4)), axis=1) * one[:, None]
    by_map[:, 0, 6], by_map[:, 0, 7] = -u * x, -u * y
    by_map[:, 1, 6], by_map[:, 1, 7] = -v * x, -v * y
    return to_image, cv2.invert(by_map.reshape(8, 8))[1]


_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def _third(places: np.ndarray, to_image: np.ndarray) -> np.ndarray:
    return places @ to_image[2, :2] + to_image[2, 2]


def _allowed(spread: np.ndarray) -> np.ndarray:
    """Return the nearest blur that there can be."""
    low, high = np.clip(spread[:2], _LEAST_VARIANCE, _MOST_VARIANCE)
    most = 0.9 * float(np.sqrt(low * high))
    return np.array([low, high, np.clip(spread[2], -most, most)])


def _cell(corners: np.ndarray, cells: int) -> float:
    sides = np.roll(corners, -1, axis=0) - corners
    return float(np.hypot(sides[:, 0], sides[:, 1]).mean()) / cells


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Pixels of a marker.

    Attributes:
        points: (n, 2) ideal px.
        levels: (n,) grey levels; less their group's mean where there are groups.
        group: so many that follow each other have an offset of their own; 1: none.
    """

    points: np.ndarray
    levels: np.ndarray
    group: int = 1

    def centred(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (n, m) less the mean of each group."""
        return _less_mean(columns, self.group)


def _less_mean(columns: np.ndarray, group: int) -> np.ndarray:
    if group == 1:
        return columns
    grouped = columns.reshape(-1, group, *columns.shape[1:])
    return (grouped - grouped.mean(axis=1, keepdims=True)).reshape(columns.shape)


def _pixels(image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens) -> _Pixels:
    if _cell(corners, 1) <= _SMALL:
        return _all_pixels(image, corners, len(pattern), lens)
    return _edge_pixels(image, corners, pattern, lens)


def _all_pixels(image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens) -> _Pixels:
    within = 1.0 - _BEYOND / _cell(corners, cells)
    around = float(np.clip(within, _LEAST_AROUND, _AROUND)) / cells
    outline = lens.seen(_mapped(_CORNERS + around * (2.0 * _CORNERS - 1.0), corners))
    limits = np.array(image.shape[::-1]) - 1.0
    low, high = (np.clip(ends, 0.0, limits) for ends in (outline.min(axis=0), outline.max(axis=0)))
    columns, rows = (np.arange(int(low[k]), int(np.ceil(high[k])) + 1) for k in (0, 1))
    seen = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    points = lens.ideal(seen.astype(float))
    places, _ = unit_square(points, corners)
    chosen = np.flatnonzero(((places > -around) & (places < 1.0 + around)).all(axis=1))
    return _Pixels(points[chosen], image[seen[chosen, 1], seen[chosen, 0]].astype(float))


def _edge_pixels(
    image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens
) -> _Pixels:
    """Return the pixels on either side of places along all edges in a pattern."""
    places, normals = _edges(pattern.tobytes(), len(pattern))
    points, beside = _mapped(places, corners), _mapped(places + 1e-3 * normals, corners)
    across = (beside - points) / np.linalg.norm(beside - points, axis=1)[:, None]
    offsets = np.arange(-_REACH, _REACH + 1.0)[:, None]
    seen = np.rint(lens.seen(points[:, None] + offsets * across[:, None])).astype(int)
    inside = ((seen >= 0) & (seen < image.shape[::-1])).all(axis=(1, 2))
    seen = seen[inside].reshape(-1, 2)
    levels = image[seen[:, 1], seen[:, 0]].astype(float)
    group = 2 * _REACH + 1
    return _Pixels(lens.ideal(seen.astype(float)), _less_mean(levels, group), group)


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


def _mapped(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return where (n, 2) places of the unit square are, in ideal px."""
    to_image = homography(corners)
    return (places @ to_image[:2, :2].T + to_image[:2, 2]) / _third(places, to_image)[:, None]


class _Normal:
    """Weighted least squares of columns (n, m) to levels (n,)."""

    def __init__(self, columns: np.ndarray, levels: np.ndarray, weights: np.ndarray):
        self.columns = columns
        weighted = columns * weights[:, None]
        normal = cv2.gemm(weighted, columns, 1.0, None, 0.0, flags=cv2.GEMM_1_T)
        right = cv2.gemm(weighted, levels[:, None], 1.0, None, 0.0, flags=cv2.GEMM_1_T)
        if len(normal) > _LIGHT:
            blur = np.arange(_LIGHT + _SHAPE, len(normal))
            normal[blur, blur] += 1.0 / _BLUR_PRIOR**2
        # The numbers are of unlike size, and some of the light's may not be told at all.
        self._size = np.sqrt(np.maximum(np.diag(normal), 1e-9))
        self._scaled = normal / self._size / self._size[:, None] + 1e-9 * np.eye(len(normal))
        solved, found = cv2.solve(self._scaled, right / self._size[:, None])
        self.solution = found.ravel() / self._size if solved else np.full(len(normal), np.nan)

    def inverse(self) -> np.ndarray:
        """Return the inverse (m, m) of the equations' matrix."""
        return cv2.invert(self._scaled)[1] / self._size / self._size[:, None]


# Least certainty of the blur's numbers before anything is seen: variances to a px² or so.
_BLUR_PRIOR = 1.0
# Tukey's constant, in standard deviations: of Gaussian noise hardly anything is passed over.
_TUKEY = 6.0


def _noise(residuals: np.ndarray, steepness: np.ndarray) -> np.ndarray:
    """Return the standard deviation (n,) of each residual: of noise, and of edges out of place.

    Where the picture is steep, what the model knows nothing of, such as an edge that was drawn
    from few samples, makes larger residuals than where it is even.
    """
    steep = steepness > np.median(steepness)
    even = _scale(residuals[~steep])
    more = max(0.0, _scale(residuals[steep]) ** 2 - even * even)
    slope = float(np.median(steepness[steep])) if steep.any() else 1.0
    return np.sqrt(even * even + more * (steepness / max(slope, 1e-9)) ** 2)


def _tukey(ratios: np.ndarray) -> np.ndarray:
    """Return Tukey's biweights (n,) of residuals in standard deviations."""
    ratios = ratios / _TUKEY
    return np.where(np.abs(ratios) < 1.0, (1.0 - ratios * ratios) ** 2, 0.0)


def _scale(residuals: np.ndarray) -> float:
    """Return the standard deviation of most residuals, by their median."""
    if not len(residuals):
        return _LEAST_NOISE
    return max(_LEAST_NOISE, 1.4826 * float(np.median(np.abs(residuals))))


def _judged(
    corners: np.ndarray, residuals: np.ndarray, columns: np.ndarray, group: int
) -> Optional[PatternFit]:
    """Return the fit with its covariance, if the pattern explains most of what is seen.

    Residuals (n,) and columns (n, m) are in standard deviations.
    """
    own = np.abs(residuals) < _OUTLYING
    residuals = np.where(own, residuals, 0.0)
    count = int(own.sum())
    if count < max(_LEAST_PIXELS, _LEAST_SHARE * len(own)):
        return None
    free = count * (1.0 - 1.0 / group if group > 1 else 1.0) - columns.shape[1]
    squares = float(residuals[own] @ residuals[own]) / max(1.0, free)
    shape = slice(_LIGHT, _LIGHT + _SHAPE)
    inverse = _Normal(columns, residuals, own.astype(float)).inverse()[shape, shape]
    return PatternFit(corners, squares * 0.5 * (inverse + inverse.T), 1.0 - count / len(own))
