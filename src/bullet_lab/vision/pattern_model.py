"""Model of a marker's image: its pattern in light, blurred by lens, pixels and motion."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.images import UNIT_SQUARE, homography, unmapped

# A shorter motion is modelled as a Gaussian, px.
_LEAST_MOTION = 1.5
# Most positions along a motion, and px between them.
_MOST_POSITIONS = 10
_POSITION_STEP = 1.5
# Variance of a pixel's own extent, a box of 1 px, px².
_BOX = 1.0 / 12.0
# Standard deviations of the blur beyond which a cell has no influence.
_SEEN = 3.0
# Table of the normal distribution: up to so many standard deviations, so many values for each.
_FAR = 5
_FINE = 512
_TABLE = np.linspace(-_FAR, _FAR, 2 * _FAR * _FINE + 1)
_BELOW = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in _TABLE.tolist()])
_DENSITY = np.exp(-0.5 * _TABLE**2) / np.sqrt(2.0 * np.pi)


class PatternModel:
    """Grey levels of the pixels of a marker with given corners and blur, and their derivatives.

    Args:
        points: (2, n) ideal px.
        corners: (4, 2) ideal px.
        spread: variances of the blur along u and v and their covariance, px², and the bend of
            the camera's response, see `_response`.
        pattern: (cells, cells), 1 for white.

    Attributes:
        value: (n,) of the blurred pattern as the camera renders it, B.
        to_image: (3, 3), from the unit square to ideal px.
    """

    def __init__(self, points: ndarray, corners: ndarray, spread: ndarray, pattern: ndarray):
        self._cells = cells = len(pattern)
        self.to_image = homography(corners)
        unit, by_pixel = unmapped(points, self.to_image)
        self._away = unit - 0.5
        self._planes = _planes(self._away)
        self._by_pixel = cells * by_pixel
        self._finest = np.hypot(self._by_pixel[:, 0], self._by_pixel[:, 1])
        self._deviation = math.sqrt(max(spread[:2]) + _BOX)
        # A motion makes a blur longer than wide.
        longer = math.hypot(0.5 * (spread[0] - spread[1]), spread[2])
        blurred = _blurred if math.sqrt(24.0 * longer) < _LEAST_MOTION else _moved
        light, slopes, by_blur = blurred(cells * unit, self._by_pixel, spread, pattern)
        self.value, by_light = _response(light, spread[3])
        self._slopes, self._by_blur = by_light * (cells * slopes), by_light * by_blur
        self._by_bend = self.value * (1.0 - self.value) * by_light

    def light(
        self,
        evenly: bool = False,
        bowed: bool = True,
        blooming: bool | ndarray = False,
    ) -> ndarray:
        """Return the columns (k, n) of the light's coefficients; the last 3 are the contrast's.

        Args:
            evenly: leave out the offset, and the light from beyond the quiet zone.
            bowed: include terms of second order.
            blooming: include white that is wider than in the pattern; (n,): where it is.
        """
        columns = []
        if blooming is not False:
            columns.append((blooming * self._steep())[None])
        columns += [self._away] if evenly else [self._tails(), self._planes]
        if bowed:
            columns += [self._away**2, (self._away[0] * self._away[1])[None]]
        return np.concatenate((*columns, self._planes * self.value))

    def _tails(self) -> ndarray:
        """Return the share of light from beyond the quiet zone on each side, (4, n)."""
        away = self._cells * np.concatenate((self._away, -self._away))
        within = (0.5 * self._cells + 1.0) - away
        tails, _ = _normal_at(within / (-self._deviation * np.tile(self._finest, (2, 1))))
        return tails

    def contrast(self, light: ndarray) -> ndarray:
        """Return white less black (n,) by the light's coefficients."""
        return light[-3:] @ self._planes

    def outside(self) -> ndarray:
        """Return the distance of pixels outside of the outline, (n,) in cells; negative within."""
        return self._cells * (np.abs(self._away).max(axis=0) - 0.5)

    def sides(self) -> ndarray:
        """Return which pixels are at each side, (4, n): the upper one, then clockwise."""
        right, below = self._away
        inner = 0.5 - 0.75 / self._cells
        return np.array((below < -inner, right > inner, below > inner, right < -inner))

    def lines(self) -> ndarray:
        """Return the number (n,) of the line between cells nearest to each pixel; outline: -1."""
        places = self._cells * (self._away + 0.5)
        nearest = np.rint(places)
        off = np.abs(places - nearest)
        line = np.where(off[1] < off[0], nearest[1], nearest[0])
        numbers = line + self._cells * (off[1] < off[0])
        return np.where((line > 0) & (line < self._cells), numbers, -1)

    def margin(self) -> ndarray:
        """Return how far pixels are within the quiet zone's outer edge, (n,) px."""
        within = self._cells * (0.5 - np.abs(self._away)) + 1.0
        return (within / self._finest).min(axis=0)

    def beyond(self, contrast: ndarray, margin: ndarray) -> ndarray:
        """Return the grey levels (n,) that blur may add from beyond the quiet zone."""
        tail, _ = _normal_at(margin / -self._deviation)
        return np.abs(contrast) * tail

    def steepness(self, contrast: ndarray) -> ndarray:
        """Return the change of the grey levels (n,) when the image moves by 1 px."""
        return np.abs(contrast) * self._steep()

    def _steep(self) -> ndarray:
        """Return the change of the pattern (n,) for 1 px across its edges."""
        x, y = self._slopes / self._cells
        slopes = x * self._by_pixel[0] + y * self._by_pixel[1]
        return np.hypot(slopes[0], slopes[1])

    def shape(self, contrast: ndarray) -> ndarray:
        """Return the derivatives (8, n) of the grey levels by the coefficients of `moves_of`."""
        return by_shape(-contrast * self._slopes, self._away)

    def blur(self, contrast: ndarray) -> ndarray:
        """Return derivatives (4, n) of the grey levels by the numbers of `spread`."""
        return contrast * np.concatenate((self._by_blur, self._by_bend[None]))


def _response(light: ndarray, bend: float) -> tuple[ndarray, ndarray]:
    """Return the grey level (n,), black 0 and white 1, of light (n,) likewise, and its derivative.

    Most cameras render half the light brighter than half way between black and white. The inverse
    is modelled: light = grey - bend · grey (1 - grey). It is exact for a gamma of 2, whatever the
    level of black, and off by less than 0.02 for 1.8 and 2.2.
    """
    linear = 1.0 - bend
    slope = np.sqrt(np.maximum(linear * linear + 4.0 * bend * light, 0.01))
    return 2.0 * light / (linear + slope), 1.0 / slope


def _planes(away: ndarray) -> ndarray:
    """Return 1, x and y (3, n) of places (2, n)."""
    return np.concatenate((np.ones((1, away.shape[1])), away))


def by_shape(slopes: ndarray, away: ndarray) -> ndarray:
    """Return the derivatives (8, n) of what changes with its place by coefficients of `moves_of`.

    Slopes are (2, n), places (2, n) of the unit square, from its middle.
    """
    planes, outward = _planes(away), (slopes * away).sum(axis=0)
    return np.concatenate((slopes[0] * planes, slopes[1] * planes, outward * away))


# (4, 2, 8): how a corner's x and y change.
_CORNER_MOVES = np.stack(
    [by_shape(np.repeat(axis, 4).reshape(2, 4), (UNIT_SQUARE - 0.5).T).T for axis in np.eye(2)],
    axis=1,
)


def moves_of(corners: ndarray, to_image: ndarray) -> ndarray:
    """Return the derivatives (8, 8) of the corners u0, v0, u1 ... by the coefficients of a map.

    The map moves places of the unit square, with x and y from its middle, by
    (a + b x + c y + g x x + h x y, d + e x + f y + g x y + h y y), before the homography (3, 3)
    maps them to the image.
    """
    third = (UNIT_SQUARE @ to_image[2, :2] + to_image[2, 2])[:, None, None]
    by_place = (to_image[:2, :2] - corners[:, :, None] * to_image[2, :2]) / third
    return (by_place @ _CORNER_MOVES).reshape(8, 8)


def _moved(
    places: ndarray, by_pixel: ndarray, spread: ndarray, pattern: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Return what `_blurred` returns, as means over a motion during the exposure."""
    mean, half = 0.5 * (spread[0] + spread[1]), 0.5 * (spread[0] - spread[1])
    longer = math.hypot(half, spread[2])
    angle = 0.5 * math.atan2(spread[2], half)
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    length = math.sqrt(24.0 * longer)
    count = min(_MOST_POSITIONS, 1 + math.ceil(length / _POSITION_STEP))
    positions, weights = _legendre(count)
    positions, weights = 0.5 * length * positions, 0.5 * weights
    # The variance of the Gaussian blur beside the motion.
    rest = mean - longer
    shape = (count, places.shape[1])
    shifts = np.einsum("m,k,akn->amn", positions, along, by_pixel)
    everywhere = np.broadcast_to(by_pixel[:, :, None], (2, 2, *shape)).reshape(2, 2, -1)
    shifted = (places[:, None] + shifts).reshape(2, -1)
    parts = _parts(shifted, everywhere, np.array([rest, rest, 0.0]), pattern).reshape(6, *shape)
    means = np.einsum("m,kmn->kn", weights, parts)
    # Derivatives by the motion's length and direction, and by the Gaussian blur beside it.
    pulls = np.einsum("m,amn->an", weights * positions, parts[1:3])
    pulls = np.einsum("an,akn->kn", pulls, by_pixel)
    variance = spread[0] + spread[1] - 2.0 * rest
    by_length = 0.5 / variance * (along @ pulls)
    by_turn = (across @ pulls) / variance
    by_rest = _by_blur(means[3:], by_pixel)[:2].sum(axis=0) - by_length
    (eu, ev), (fu, fv) = along, across
    by_blur = (
        eu * eu * by_length + fu * fu * by_rest + eu * fu * by_turn,
        ev * ev * by_length + fv * fv * by_rest + ev * fv * by_turn,
        2.0 * (eu * ev * by_length + fu * fv * by_rest) + (eu * fv + ev * fu) * by_turn,
    )
    return means[0], means[1:3], np.stack(by_blur)


_legendre = lru_cache(np.polynomial.legendre.leggauss)


def _blurred(
    places: ndarray, by_pixel: ndarray, spread: ndarray, pattern: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Return the blurred pattern and its derivatives.

    Args:
        places: (2, n) in cells.
        by_pixel: (2, 2, n), their derivatives by pixels.
        spread: variances of the blur along u and v and their covariance, px².
        pattern: (cells, cells), 1 for white.

    Returns:
        (n,), and derivatives (2, n) by place and (3, n) by the numbers of the blur.
    """
    parts = _parts(places, by_pixel, spread, pattern)
    return parts[0], parts[1:3], _by_blur(parts[3:], by_pixel)


def _parts(places: ndarray, by_pixel: ndarray, spread: ndarray, pattern: ndarray) -> ndarray:
    """Return the blurred pattern and its derivatives by x, y, variances and covariance, (6, n)."""
    first, edges = _edge_profiles(places, by_pixel, spread, len(pattern))
    shares = edges[:, :, :-1] - edges[:, :, 1:]
    around = _cells_around(pattern, first, shares.shape[2])
    along, down = shares[:, 0], shares[:, 1]
    rows = np.einsum("krn,rcn->kcn", down, around)
    value, slope_x, bend_x = np.einsum("cn,kcn->kn", rows[0], along)
    slope_y, bend_y = np.einsum("kcn,cn->kn", rows[1:], along[0])
    twist = np.einsum("cn,cn->n", rows[1], along[1])
    # Seen aslant, the blurs of rows and columns are correlated.
    (xu, xv), (yu, yv) = by_pixel
    covariance = (spread[0] + _BOX) * xu * yu + (spread[1] + _BOX) * xv * yv
    covariance += spread[2] * (xu * yv + xv * yu)
    return np.array((value + covariance * twist, slope_x, slope_y, bend_x, bend_y, twist))


def _by_blur(bends: ndarray, by_pixel: ndarray) -> ndarray:
    """Return derivatives (3, n) by the blur's variances and covariance along u and v.

    `bends` (3, n) are those by the variances and covariance along x and y.
    """
    (xu, xv), (yu, yv) = by_pixel
    bend_x, bend_y, twist = bends
    return np.array(
        (
            bend_x * xu * xu + bend_y * yu * yu + twist * xu * yu,
            bend_x * xv * xv + bend_y * yv * yv + twist * xv * yv,
            2.0 * (bend_x * xu * xv + bend_y * yu * yv) + twist * (xu * yv + xv * yu),
        )
    )


def _edge_profiles(
    places: ndarray, by_pixel: ndarray, spread: ndarray, cells: int
) -> tuple[ndarray, ndarray]:
    """Return the share of each blurred pixel that is beyond the edges of the cells around it.

    Across an edge, a pixel is a box of its own extent, blurred by a Gaussian.

    Args:
        places: (2, n) along either axis, in cells.
        by_pixel: (2, 2, n) cells along either axis for each px along u and v.
        spread: variances of the blur along u and v and their covariance, px².
        cells: number of cells along an edge.

    Returns:
        Index of the first of k cells (2, n), and (3, 2, k + 1, n): shares beyond the first edge of
        each cell and beyond the last edge, with their derivatives by place and by variance.
    """
    squares = np.square(by_pixel)
    steep, flat = squares.max(axis=1), squares.min(axis=1)
    variances = spread[0] * squares[:, 0] + spread[1] * squares[:, 1]
    variances += 2.0 * spread[2] * by_pixel[:, 0] * by_pixel[:, 1]
    # A pixel that lies aslant has slanting flanks, which act like blur.
    deviations = np.sqrt(variances + flat / 12.0)
    widths = np.sqrt(np.maximum(steep, 1e-12))
    reach = math.ceil(min(float(cells), (0.5 * widths + _SEEN * deviations).max()))
    first = np.clip(np.floor(places), -1.0, float(cells))
    away = (places - first + (reach - 1))[:, None] - np.arange(2.0 * reach)[:, None]
    widths, deviations = widths[:, None], deviations[:, None]
    ends = away + np.array((0.5 * widths, -0.5 * widths))
    ends /= deviations
    below, density = _normal_at(ends)
    ends *= below
    ends += density
    edges = np.zeros((3, 2, 2 * reach + 2, places.shape[1]))
    edges[0, :, 0] = 1.0
    edges[0, :, 1:-1] = deviations / widths * (ends[0] - ends[1])
    edges[1, :, 1:-1] = (below[0] - below[1]) / widths
    # As for heat, the derivative by the variance is half the second derivative by the place.
    edges[2, :, 1:-1] = (0.5 * (density[0] - density[1])) / (widths * deviations)
    return first.astype(np.intp) - reach, edges


def _cells_around(pattern: ndarray, first: ndarray, count: int) -> ndarray:
    """Return `count` rows and columns of cells from the first (2, n) on: (count, count, n)."""
    pad = count // 2 + 1
    white = cv2.copyMakeBorder(pattern, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=1)
    side = len(white)
    columns, rows = first + pad
    each = np.arange(count)
    index = (rows * side + columns) + (each[:, None] * side + each)[:, :, None]
    return white.astype(float).ravel().take(index)


def _normal_at(places: ndarray) -> tuple[ndarray, ndarray]:
    """Return the normal distribution function and density at places."""
    index = (_FINE * places + (_FAR * _FINE + 0.5)).astype(np.intp)
    return _BELOW.take(index, mode="clip"), _DENSITY.take(index, mode="clip")
