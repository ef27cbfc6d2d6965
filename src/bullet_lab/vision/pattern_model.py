"""What a marker looks like: its pattern in light, blurred by a lens, by pixels and by motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple, Union

import cv2
import numpy as np
from scipy.special import ndtr

from bullet_lab.vision.algebra import homography


class PatternModel:
    """What pixels of a marker with these corners and this blur look like, and its derivatives.

    Args:
        points: (2, n) ideal px.
        corners: (4, 2) ideal px.
        spread: of the blur, variances along u and v and their covariance, px².
        pattern: (cells, cells), 1 for white.

    Attributes:
        value: (n,) of the blurred pattern, B.
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
        self._finest = np.hypot(self._by_pixel[:, 0], self._by_pixel[:, 1])
        self._deviation = math.sqrt(max(spread[:2]) + 1.0 / 12.0)
        motion = _motion_of(spread)
        if motion is None:
            parts = _blurred(cells * unit, self._by_pixel, spread, pattern)
            self.value, slopes = parts[0], parts[1:3]
            self._by_blur = _by_blur(parts[3:], self._by_pixel)
        else:
            self.value, slopes = self._moved(cells * unit, spread, motion, pattern)
        self._slopes = cells * slopes

    def _moved(
        self, places: np.ndarray, spread: np.ndarray, motion: _Motion, pattern: np.ndarray
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Return value (n,) and slopes (2, n) by cells as means over a way; set the derivatives."""
        ways, rest = motion.ways, motion.rest
        count = (len(ways), places.shape[1])
        shifts = np.einsum("m,k,akn->amn", ways, motion.along, self._by_pixel)
        by_pixel = np.broadcast_to(self._by_pixel[:, :, None], (2, 2, *count)).reshape(2, 2, -1)
        shifted = (places[:, None] + shifts).reshape(2, -1)
        parts = _blurred(shifted, by_pixel, np.array([rest, rest, 0.0]), pattern)
        parts = parts.reshape(6, *count)
        value, *means = np.einsum("m,kmn->kn", motion.weights, parts)
        slopes, bends = np.stack(means[:2]), np.stack(means[2:])
        # How a longer way, a way that is turned, and more of a Gaussian change the value.
        pulls = np.einsum("m,amn->an", motion.weights * ways, parts[1:3])
        pulls = np.einsum("an,akn->kn", pulls, self._by_pixel)
        variance = spread[0] + spread[1] - 2.0 * rest
        by_length = 0.5 / variance * (motion.along @ pulls)
        by_turn = (motion.across @ pulls) / variance
        by_rest = _by_blur(bends, self._by_pixel)[:2].sum(axis=0) - by_length
        (eu, ev), (fu, fv) = motion.along, motion.across
        self._by_blur = np.stack(
            (
                eu * eu * by_length + fu * fu * by_rest + eu * fu * by_turn,
                ev * ev * by_length + fv * fv * by_rest + ev * fv * by_turn,
                2.0 * (eu * ev * by_length + fu * fv * by_rest) + (eu * fv + ev * fu) * by_turn,
            )
        )
        return value, slopes

    def light(
        self,
        evenly: bool = False,
        bowed: bool = True,
        blooming: Union[bool, np.ndarray] = False,
    ) -> np.ndarray:
        """Return what the numbers of the light are multiplied with, (k, n); the last 3 with B.

        Args:
            evenly: without an offset, and what is beyond the quiet zone.
            bowed: with what is of second order.
            blooming: with white that is wider than it is in the pattern; (n,): where it is.
        """
        contrast = self._planes * self.value
        bowls = self._away**2, (self._away[0] * self._away[1])[None]
        bloom = () if blooming is False else ((blooming * self._steep())[None],)
        if evenly:
            return np.concatenate((*bloom, self._away, *(bowls if bowed else ()), contrast))
        return np.concatenate((*bloom, self._tails(), self._planes, *bowls, contrast))

    def _tails(self) -> np.ndarray:
        """Return what blur brings in from beyond the quiet zone on each side, (4, n)."""
        away = self._cells * np.concatenate((self._away, -self._away))
        within = (0.5 * self._cells + 1.0) - away
        tails, _ = _normal_at(within / (-self._deviation * np.tile(self._finest, (2, 1))))
        return tails

    def contrast(self, light: np.ndarray) -> np.ndarray:
        """Return white less black (n,) by the numbers of the light."""
        return light[-3:] @ self._planes

    def outside(self) -> np.ndarray:
        """Return how far outside of the outline pixels are, (n,) in cells; within it below 0."""
        return self._cells * (np.abs(self._away).max(axis=0) - 0.5)

    def sides(self) -> np.ndarray:
        """Return which pixels are at each side, (4, n): the one above, then clockwise."""
        right, below = self._away
        inner = 0.5 - 0.75 / self._cells
        return np.stack((below < -inner, right > inner, below > inner, right < -inner))

    def margin(self) -> np.ndarray:
        """Return by how many px pixels are within the quiet zone's outer edge, (n,)."""
        within = self._cells * (0.5 - np.abs(self._away)) + 1.0
        return (within / self._finest).min(axis=0)

    def beyond(self, contrast: np.ndarray) -> np.ndarray:
        """Return how many grey levels (n,) blur may bring in from beyond the quiet zone."""
        tail, _ = _normal_at(self.margin() / -self._deviation)
        return np.abs(contrast) * tail

    def steepness(self, contrast: np.ndarray) -> np.ndarray:
        """Return by how many grey levels a pixel changes with the image moved by 1 px, (n,)."""
        return np.abs(contrast) * self._steep()

    def _steep(self) -> np.ndarray:
        """Return by how much the pattern changes with 1 px across its edges, (n,)."""
        x, y = self._slopes / self._cells
        slopes = x * self._by_pixel[0] + y * self._by_pixel[1]
        return np.hypot(slopes[0], slopes[1])

    def shape(self, contrast: np.ndarray) -> np.ndarray:
        """Return derivatives (8, n) of the grey levels by the moves that `moves_of` tells."""
        steep = -contrast * self._slopes
        both = (steep * self._away).sum(axis=0)
        return np.concatenate((steep[0] * self._planes, steep[1] * self._planes, both * self._away))

    def blur(self, contrast: np.ndarray) -> np.ndarray:
        """Return derivatives (3, n) by the blur's variances and covariance."""
        return contrast * self._by_blur


def moves_of(corners: np.ndarray, to_image: np.ndarray) -> np.ndarray:
    """Return by how many px the corners u0, v0, u1 ... move with each number of a map, (8, 8).

    The map moves places of the unit square, of which x and y are counted from its middle, by
    (a + b x + c y + g x x + h x y, d + e x + f y + g x y + h y y), before they are seen where
    the homography (3, 3) has them.
    """
    third = (UNIT_SQUARE @ to_image[2, :2] + to_image[2, 2])[:, None, None]
    by_place = (to_image[:2, :2] - corners[:, :, None] * to_image[2, :2]) / third
    return (by_place @ _CORNER_MOVES).reshape(8, 8)


def _corner_moves() -> np.ndarray:
    moves = np.zeros((4, 2, 8))
    for move, (x, y) in zip(moves, UNIT_SQUARE - 0.5):
        move[0, :3] = move[1, 3:6] = 1.0, x, y
        move[:, 6:] = np.outer((x, y), (x, y))
    return moves


UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
_CORNER_MOVES = _corner_moves()


@dataclass(frozen=True, eq=False)
class _Motion:
    """A way in which the image moved while it was taken.

    Attributes:
        along, across: (2,) of length 1.
        ways: (m,) px along it, and what they count for, `weights` (m,).
        rest: variance of the Gaussian blur beside it, px².
    """

    along: np.ndarray
    across: np.ndarray
    ways: np.ndarray
    weights: np.ndarray
    rest: float


def _motion_of(spread: np.ndarray) -> Optional[_Motion]:
    """Return the motion that a blur is, by as much as it is longer than wide; None if by little."""
    mean, half = 0.5 * (spread[0] + spread[1]), 0.5 * (spread[0] - spread[1])
    longer = math.hypot(half, spread[2])
    length = math.sqrt(24.0 * longer)
    if length < _LEAST_MOTION:
        return None
    angle = 0.5 * math.atan2(spread[2], half)
    along = np.array([math.cos(angle), math.sin(angle)])
    ways, weights = np.polynomial.legendre.leggauss(min(_MOST_WAYS, 1 + math.ceil(length / 1.5)))
    across = np.array([-along[1], along[0]])
    return _Motion(along, across, 0.5 * length * ways, 0.5 * weights, mean - longer)


# px; a shorter motion is as good as a Gaussian. So many places on its way are looked at at most.
_LEAST_MOTION, _MOST_WAYS = 1.5, 10


def _blurred(
    places: np.ndarray, by_pixel: np.ndarray, spread: np.ndarray, pattern: np.ndarray
) -> np.ndarray:
    """Return the blurred pattern (6, n) with derivatives: by x, y, variances and covariance.

    Places (2, n) are in cells, their derivatives by pixels (2, 2, n).
    """
    first, edges = _edge_profiles(places, by_pixel, spread, len(pattern))
    shares = edges[:, :, :-1] - edges[:, :, 1:]
    around = _cells_around(pattern, first, shares.shape[2])
    along, down = shares[:, 0], shares[:, 1]
    rows = np.einsum("krn,rcn->kcn", down, around)
    value, slope_x, bend_x = np.einsum("cn,kcn->kn", rows[0], along)
    slope_y, bend_y = np.einsum("kcn,cn->kn", rows[1:], along[0])
    twist = np.einsum("cn,cn->n", rows[1], along[1])
    # Seen aslant, rows and columns are not blurred independently of each other.
    (xu, xv), (yu, yv) = by_pixel
    box = 1.0 / 12.0
    together = (spread[0] + box) * xu * yu + (spread[1] + box) * xv * yv
    together += spread[2] * (xu * yv + xv * yu)
    return np.stack((value + together * twist, slope_x, slope_y, bend_x, bend_y, twist))


def _by_blur(bends: np.ndarray, by_pixel: np.ndarray) -> np.ndarray:
    """Return derivatives (3, n) by the blur's variances and covariance along u and v.

    Of those by variances along x and y and by their covariance, (3, n).
    """
    (xu, xv), (yu, yv) = by_pixel
    bend_x, bend_y, twist = bends
    return np.stack(
        (
            bend_x * xu * xu + bend_y * yu * yu + twist * xu * yu,
            bend_x * xv * xv + bend_y * yv * yv + twist * xv * yv,
            2.0 * (bend_x * xu * xv + bend_y * yu * yv) + twist * (xu * yv + xv * yu),
        )
    )


def _edge_profiles(
    places: np.ndarray, by_pixel: np.ndarray, spread: np.ndarray, cells: int
) -> Tuple[np.ndarray, np.ndarray]:
    """Return how much of each blurred pixel is beyond the edges of cells next to it.

    Across an edge a pixel is a box, its own extent, blurred by a Gaussian.

    Args:
        places: (2, n) along either axis, in cells.
        by_pixel: (2, 2, n) cells along either axis for each px along u and v.
        spread: of the blur, variances along u and v and their covariance, px².
        cells: so many along an edge.

    Returns:
        The first of the cells looked at (2, n), and (3, 2, k + 1, n): what is beyond the first
        edge of each of k cells and the last edge, with its derivatives by place and by variance.
    """
    squares = np.square(by_pixel)
    steep, flat = squares.max(axis=1), squares.min(axis=1)
    variances = spread[0] * squares[:, 0] + spread[1] * squares[:, 1]
    variances += 2.0 * spread[2] * by_pixel[:, 0] * by_pixel[:, 1]
    # A pixel that lies aslant has slanting flanks, which are as good as blurred.
    deviations = np.sqrt(variances + flat / 12.0)
    widths = np.sqrt(np.maximum(steep, 1e-12))
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
    edges[0, :, 1:-1] = deviations / widths * (ends[0] - ends[1])
    edges[1, :, 1:-1] = (below[0] - below[1]) / widths
    # A Gaussian spreads as heat does: by its variance the value changes with half its bend.
    edges[2, :, 1:-1] = (0.5 * (density[0] - density[1])) / (widths * deviations)
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
