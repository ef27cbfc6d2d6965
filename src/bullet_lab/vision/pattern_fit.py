"""Corners of a marker, and their covariance, by the fit of its whole pattern to the grey levels.

The position follows from all edges between black and white cells, not only from the outline. The
fit finds pixels that do not match the pattern, a hand before it or a highlight, and leaves them
out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Tuple

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.images import NEXT, Picture, lengths_of, mean_side, right_of
from bullet_lab.vision.pattern_model import PatternModel, moves_of
from bullet_lab.vision.pattern_pixels import (
    LEAST_AROUND,
    LEAST_SHARE,
    Pixels,
    all_pixels,
    pixels_of,
)

# The blur's numbers: variances along u and v and their covariance beside a pixel's own extent, px²,
# the bend of the camera's response, and the part of each neighbour that a pixel has in it. They are
# the last ones of a fit.
_FIRST_SPREAD = (0.1, 0.1, 0.0, 0.0, 0.05)
_SPREAD = len(_FIRST_SPREAD)
# Before them are the coefficients of `moves_of`.
_SHAPE = slice(-8 - _SPREAD, -_SPREAD)
# The contrast's numbers, the last ones of the light.
_OF_CONTRAST = 3
# Limits of the variances, px², of what is shared: negative where an image was sharpened, and of the
# bend: 0.5 for a gamma of 2 and white that has 9 times the light of black.
_LEAST_VARIANCE = 0.005
_MOST_VARIANCE = 40.0
_LEAST_SHARED = -0.1
_LEAST_BEND = -0.5
_MOST_BEND = 0.75
_MOST_SHARED = 0.25
# Least certainty of the blur's numbers beforehand: variances to a px² or so. The bend is 0 to 0.5,
# which matters in a dark image, where noise hides it.
_BLUR_PRIOR = np.array((1.0, 1.0, 1.0, 4.0, 1.0))
_BEND = -2

_MOST_ROUNDS = 12
# Pixels in groups show only edges, for which the blur's equations are far from linear and may
# oscillate: a variance falls to no less than this part in a round, and after so many full steps
# only half steps are made.
_FALL = 1.0 / 3.0
_FULL_STEPS = 4
# The fit has converged when no corner moved by more, px (what is left is the square of that), and
# the blur changed by no more than the sum of a constant, px², and a part of itself.
_STILL = 0.05
_SAME_BLUR = 0.11
_SAME_PART = 0.1
# The same for the part that is shared.
_SAME_SHARED = 0.01
# The corners may move by so many cells.
_MOST_MOVED = 1.0
# Variance of the blur, px², above which all pixels of a large marker are used.
_SOFT = 1.0

# px within the quiet zone's outer edge that are influenced by what lies beyond, beside the blur.
_BLURRED_IN = 0.8
# Tukey's constant, in standard deviations: of Gaussian noise hardly anything is left out.
_TUKEY = 6.0
# Residuals beyond so many standard deviations are not the marker's.
_OUTLYING = 3.5
# A contrast of so many standard deviations of its noise is seen.
_SHOWN = 2.0
# Residuals along a line of edges are alike if their mean square is so many times that of others.
# Then the lines are not independent either: on four boards before real cameras, corners were off by
# twice the variance that the lines have.
_TOGETHER = 1.7
_ALIKE = 2.0
# Standard deviation of grey levels that were rounded to whole ones.
_LEAST_NOISE = 0.3
# Least number of pixels that must be the marker's, beside their share of all.
_LEAST_PIXELS = 40

# Variance of the blur, px², above which the true level of over-exposed white cannot be separated
# from the blur: the fit uses the levels that were cut off.
_MOST_CUT = 0.1
# Variance, px², that is added to such corners: an edge whose bright side is cut off looks steeper,
# and pixels are up to a quarter of one aside. More of it where only a part of the marker is so
# bright: its white is wider than in the other part.
_CUT_VARIANCE = 0.01
_PARTLY_CUT_VARIANCE = 0.03
# A side is inconsistent if an end of it is so many px from where all other edges have it, and so
# many standard deviations of that.
_ODD = 0.07
_ODD_DEVIATIONS = 3.0


@dataclass(frozen=True, eq=False)
class PatternFit:
    """Where a marker is.

    Attributes:
        corners: (4, 2) u, v in ideal px.
        covariance: (8, 8) of the corners' u0, v0, u1 ... in px².
        hidden: share of the pixels that do not match the pattern.
    """

    corners: ndarray
    covariance: ndarray
    hidden: float = 0.0


def fit_pattern(picture: Picture, corners: ndarray, pattern: ndarray) -> PatternFit | None:
    """Fit corners, light and blur to the grey levels by weighted least squares.

    A pixel is modelled as a + d · B, with a (of second order) and d (of first) its light over the
    marker, and B the pattern, 0 or 1, blurred by the lens and by motion, whose covariance in the
    image is fitted too. Of a small marker, so is the part that each pixel has of its neighbours:
    a filter applied after the exposure is no Gaussian, and moved corners by 0.01 px. Of a large
    marker, the pixels across each place of an edge have an a of their own, so that highlights and
    shadows do not matter.

    Weights are Tukey's, of each pixel and, of a large marker, of the contrast that each place of an
    edge shows. The covariance is that of least squares with the noise of the residuals. A side
    that is not where all other edges have it belongs to something before the marker and is left
    out.

    Over-exposed pixels do not count, unless the others do not separate the light from the blur:
    then the levels are fitted as they were cut off, with white that is wider than in the pattern by
    a number of the fit. Where the sun shines on a part of a large marker, the pixels across each
    place have a d of their own too, and white that was cut off there is wider than elsewhere.

    Args:
        picture: the image.
        corners: (4, 2) ideal px, clockwise from the marker's top left, to a fraction of a cell.
        pattern: (n, n) cells with the border, 1 for white.

    Returns:
        None where the pattern does not explain the image.
    """
    pixels = pixels_of(picture, corners, pattern)
    if len(pixels.levels) < _LEAST_PIXELS:
        return None
    first = _fit(pixels, picture, corners, pattern)
    fit, blur = first.fit, first.blur
    if pixels.over_exposed and not pixels.cut_off and (fit is None or blur > _MOST_CUT):
        pixels = pixels_of(picture, corners, pattern, cut_off=True)
        fit = _fit(pixels, picture, corners, pattern).fit or fit
    elif fit is not None and first.odd:
        fit = _without_odd_side(first, picture, pattern)
    more = _CUT_VARIANCE if pixels.cut_off else 0.0
    if pixels.any_flooded:
        more = _PARTLY_CUT_VARIANCE
    if fit is not None and more:
        fit = replace(fit, covariance=fit.covariance + more * np.eye(8))
    return fit


# A side that is not where the other edges have it: by how many standard deviations, and which
# pixels (n,) are at it.
_OddSide = Tuple[float, ndarray]


class _Fitted(NamedTuple):
    """The fit to a set of pixels.

    Attributes:
        fit: as of `fit_pattern`.
        blur: the greatest variance of its blur, px².
        pixels: those of the fit.
        odd: inconsistent sides, the worst first.
    """

    fit: PatternFit | None
    blur: float
    pixels: Pixels | None = None
    odd: tuple[_OddSide, ...] = ()

    @property
    def disagreement(self) -> float:
        """Standard deviations by which the worst side is off; 0 if none is."""
        return self.odd[0][0] if self.odd else 0.0


def _fit(pixels: Pixels, picture: Picture, corners: ndarray, pattern: ndarray) -> _Fitted:
    """Return the fit to a set of pixels, starting at corners."""
    start, most_moved = corners, _MOST_MOVED * mean_side(corners) / len(pattern)
    spread, light = np.array(_FIRST_SPREAD), None
    for done in range(_MOST_ROUNDS):
        linear = _Linearised(pixels, corners, spread, light, pattern)
        step = linear.step()
        light = linear.light + step[: len(linear.light)]
        moved = linear.to_corners @ step[_SHAPE]
        corners = corners + moved.reshape(4, 2)
        is_late = done >= _FULL_STEPS
        before, spread = spread, _next_spread(spread, step[-_SPREAD:], pixels.group != 1, is_late)
        blur = float(spread[:2].max())
        if not np.abs(corners - start).max() <= most_moved:
            return _Fitted(None, blur)
        if np.abs(moved).max() < _STILL and _is_same_blur(before, spread):
            break
        if pixels.group != 1 and spread.max() > _SOFT:
            # In so much blur the few pixels across each edge see little of it.
            pixels, light = all_pixels(picture, corners, len(pattern), pixels.cut_off), None
    judged = _Judged(linear, step, corners)
    fit, used = judged.fit(), linear.pixels
    if fit is None or used.cut_off or used.any_flooded:
        return _Fitted(fit, blur)
    return _Fitted(fit, blur, used, judged.odd_sides())


def _next_spread(spread: ndarray, step: ndarray, grouped: bool, is_late: bool) -> ndarray:
    """Return the blur's numbers after a step, within their limits."""
    least = np.full(2, _LEAST_VARIANCE)
    gain = 1.0
    if grouped:
        least = np.maximum(least, _FALL * spread[:2])
        gain = 0.5 if is_late else 1.0
    spread = spread + gain * step
    low, high = np.clip(spread[:2], least, _MOST_VARIANCE).tolist()
    # The variance in any direction is no less than the least.
    most = math.sqrt((low - 0.99 * _LEAST_VARIANCE) * (high - 0.99 * _LEAST_VARIANCE))
    bend = min(max(spread[3], _LEAST_BEND), _MOST_BEND)
    shared = min(max(spread[4], _LEAST_SHARED), _MOST_SHARED)
    return np.array([low, high, min(max(spread[2], -most), most), bend, shared])


def _is_same_blur(before: ndarray, after: ndarray) -> bool:
    changed = np.abs(after - before)
    is_same = changed.max() - _SAME_PART * after.max() < _SAME_BLUR
    return is_same and changed[-1] < _SAME_SHARED


class _Linearised:
    """The model of a set of pixels, linearised about an estimate, and the residuals.

    Args:
        pixels: those of the fit.
        corners: (4, 2) ideal px.
        spread: the blur's numbers.
        light: its coefficients; None: those of least squares.
        pattern: (n, n) cells with the border, 1 for white.

    Attributes:
        light: as given, or as found.
        columns: (m, n) derivatives of the pixels by light, shape and blur.
        residuals: (n,) grey levels less the model's.
        weights: (n,) of the residuals; 0: not the marker's.
        own: (n,) which pixels belong to the marker and count.
        to_corners: (8, 8) of `moves_of`.
    """

    def __init__(
        self,
        pixels: Pixels,
        corners: ndarray,
        spread: ndarray,
        light: ndarray | None,
        pattern: ndarray,
    ):
        self.pixels = pixels
        self.model = model = PatternModel(pixels.points, corners, spread, pattern)
        self.to_corners = moves_of(corners, model.to_image)
        shared, value, self._bend = spread[-1], model.value, spread[_BEND]
        of_light = self._columns_of_light()
        columns, levels = pixels.seen(of_light, shared, value), pixels.seen_levels(value)
        if light is None:
            light = _Equations(_squares_of(columns, levels)).solution()
        self.light = light
        self.residuals = levels - light @ columns
        if pixels.flooded is None:
            contrast = model.contrast(light)
        else:
            contrast, _ = pixels.own_contrast(value)
        self._weigh(contrast, spread)
        shape = np.concatenate((model.shape(contrast), model.blur(contrast)))
        shape = pixels.seen(shape, shared, value)
        by_shared = pixels.by_shared(light @ of_light, shared)
        self.columns = np.concatenate((columns, shape, by_shared))

    def _columns_of_light(self) -> ndarray:
        pixels, light = self.pixels, self.model.light
        grouped = pixels.group != 1
        if pixels.flooded is None:
            return light(grouped, not (grouped and pixels.valid.all()), pixels.cut_off)
        # Each group has a contrast of its own.
        return light(True, False, pixels.flooded)[:-_OF_CONTRAST]

    def _weigh(self, contrast: ndarray, spread: ndarray) -> None:
        """Find the pixels that are the marker's, and the residuals' weights."""
        pixels, model = self.pixels, self.model
        margin, steepness = model.margin(), pixels.own(model.steepness(contrast))
        self._steep = steepness > _median(steepness)
        slope = _median(steepness[self._steep]) if self._steep.any() else 1.0
        self._steeper = np.square(steepness / max(slope, 1e-9))
        self._beyond = np.square(pixels.own(model.beyond(contrast, margin)))
        noise = self.noise(self.residuals)
        # Blur brings in what lies beyond the quiet zone.
        reach = 2.0 * math.sqrt(max(spread[:2])) + _BLURRED_IN
        own = pixels.own((margin > reach) | (model.outside() < LEAST_AROUND))
        self.own = own & pixels.valid
        shown = _shown(pixels, model.value, contrast, noise)
        weights = shown * _tukey(self.residuals / noise) / (noise * noise)
        self.weights = np.where(self.own, weights, 0.0)

    def noise(self, residuals: ndarray) -> ndarray:
        """Return the standard deviation (n,) of each residual.

        Besides the image's noise, residuals are larger where the image is steep, because of what
        the model does not know, such as an edge that was drawn from few samples; and where blur
        brings in what is beyond the quiet zone.
        """
        sizes, valid, steep = np.abs(residuals), self.pixels.valid, self._steep
        even = _scale(sizes[valid & ~steep]) ** 2
        more = max(0.0, _scale(sizes[valid & steep]) ** 2 - even)
        return np.sqrt(even + more * self._steeper + self._beyond)

    def step(self) -> ndarray:
        """Return the step (m,) of least squares."""
        squares = _squares_of(self.columns, self.residuals, np.sqrt(self.weights))
        equations = _Equations(squares, _BLUR_PRIOR)
        equations.right[_BEND] -= _BLUR_PRIOR[_BEND] * self._bend
        return equations.solution()


def _shown(pixels: Pixels, value: ndarray, contrast: ndarray, noise: ndarray) -> ndarray:
    """Return weights (n,) by how much of the contrast the pixels across each place of an edge show.

    Where something hides an edge there is none. In a noisy image no pixel shows that by itself. If
    each place has a contrast of its own, all that can be tested is whether there is any.
    """
    if pixels.group == 1:
        return np.ones(len(noise))
    own, squares = pixels.own_contrast(value)
    deviation = noise / np.sqrt(squares)
    if pixels.flooded is not None:
        return np.where(own > _SHOWN * deviation, 1.0, 0.0)
    deviation = np.maximum(deviation, contrast / _TUKEY)
    return _tukey((own - contrast) / np.maximum(deviation, 1e-9))


class _Judged:
    """The residuals after the last step, and how certain they make the corners.

    `_rows` (m + 1, n) are the columns and the residuals, in standard deviations of the noise; 0 for
    pixels that do not match the pattern.
    """

    def __init__(self, linear: _Linearised, step: ndarray, corners: ndarray):
        residuals = linear.residuals - step @ linear.columns
        noise = linear.noise(residuals)
        used = linear.own & (linear.weights > 0.0)
        own = used & (np.abs(residuals) < _OUTLYING * noise)
        self._count = np.count_nonzero(own)
        self._rows = np.concatenate((linear.columns, residuals[None])) * (own / noise)
        self._squares = cv2.mulTransposed(self._rows, False)
        self._linear, self._corners = linear, corners

    def fit(self) -> PatternFit | None:
        """Return the fit with its covariance, or None if the pattern explains too few pixels."""
        pixels, to_corners = self._linear.pixels, self._linear.to_corners
        valid = np.count_nonzero(pixels.valid)
        if self._count < max(_LEAST_PIXELS, LEAST_SHARE * valid):
            return None
        inverse = _Equations(self._squares, _BLUR_PRIOR).inverse()
        own, of_lines = self._mean_squares(inverse)
        alike = of_lines > _TOGETHER * own
        self._square = of_lines if alike else own
        square = _ALIKE * self._square if alike else self._square
        covariance = 0.5 * square * (to_corners @ inverse[_SHAPE, _SHAPE] @ to_corners.T)
        return PatternFit(self._corners, covariance + covariance.T, 1.0 - self._count / valid)

    def odd_sides(self) -> tuple[_OddSide, ...]:
        """Return the sides that are not where all other edges have them, after `fit`."""
        odd: list[_OddSide] = []
        to_corners = self._linear.to_corners.reshape(4, 2, 8)
        along = self._corners[NEXT] - self._corners
        outward = right_of(along) / lengths_of(along)[:, None]
        for side, points in enumerate(self._linear.model.sides()):
            at_side = self._linear.pixels.own(points)
            of_side = cv2.mulTransposed(self._rows[:, at_side], False)
            others = _Equations(self._squares - of_side, _BLUR_PRIOR)
            to_ends = outward[side] @ to_corners[[side, NEXT[side]]]
            inverse = others.inverse()[_SHAPE]
            off = np.abs(to_ends @ (inverse @ others.right))
            variances = self._square * ((to_ends @ inverse[:, _SHAPE]) * to_ends).sum(axis=1)
            deviations = off / np.sqrt(np.maximum(variances, 1e-12))
            if ((off > _ODD) & (deviations > _ODD_DEVIATIONS)).any():
                odd.append((float(deviations.max()), at_side))
        return tuple(sorted(odd, key=lambda one: -one[0]))

    def _mean_squares(self, inverse: ndarray) -> tuple[float, float]:
        """Return the mean squares of the residuals of two kinds of pixels that may err together.

        These are the pixels of each group: what the model does not know, a blur that is no
        Gaussian, is alike on both sides of an edge. It makes the residuals of a group large, and
        hardly moves the edge. And they are the pixels along each line of edges: where a camera has
        left out rows or sharpened, all edges of a line are off together. Those of the outline do
        not tell: there may be something before a side. Of independent residuals both are 1, so that
        of lines counts only if it is clearly larger.

        What counts is how residuals move the corners together: their sum of squares is divided by
        its expectation for independent residuals of 1, less what the fit took.

        Args:
            inverse: (m, m) of the fit's normal equations.
        """
        pixels, rows = self._linear.pixels, self._rows
        _, values, vectors = cv2.eigen(np.ascontiguousarray(inverse[_SHAPE, _SHAPE]))
        scales = np.sqrt(np.maximum(values, 1e-12 * values.max()))
        pulls = (vectors / scales) @ inverse[_SHAPE] @ rows[:-1]

        def mean_square(sums: ndarray, pulls: ndarray) -> float:
            """Return that of sets with these sums of products (k, 8, m + 1) of pulls and rows."""
            taken = sums[:, :, :-1].reshape(-1, len(inverse))
            expected = np.square(pulls).sum() - np.vdot(taken @ inverse, taken)
            return float(np.square(sums[:, :, -1]).sum() / max(expected, 1.0))

        lines = pixels.own(self._linear.model.lines())
        lines = np.tile(lines.reshape(pixels.group, -1)[pixels.group // 2], pixels.group)
        order = np.argsort(lines, kind="stable")[np.count_nonzero(lines < 0) :]
        starts = np.flatnonzero(np.diff(lines[order], prepend=-1)).tolist()
        pulled, ordered = pulls[:, order], rows[:, order].T
        sums = [pulled[:, a:b] @ ordered[a:b] for a, b in zip(starts, (*starts[1:], None))]
        of_lines = mean_square(np.array(sums).reshape(-1, 8, len(rows)), pulled)
        if pixels.group == 1:
            return self._squares[-1, -1] / max(1.0, self._count - len(inverse)), of_lines
        pulls = np.ascontiguousarray(pulls.reshape(8, pixels.group, -1).T)
        rows = np.ascontiguousarray(rows.reshape(len(rows), pixels.group, -1).T)
        return mean_square(pulls.swapaxes(1, 2) @ rows, pulls), of_lines


def _without_odd_side(first: _Fitted, picture: Picture, pattern: ndarray) -> PatternFit:
    """Return the fit without the side without which all others agree best.

    Its covariance is scaled by the disagreement that is left.
    """
    best = first
    for _, side in first.odd:
        fewer = first.pixels.without(side)
        if len(fewer.levels) < _LEAST_PIXELS:
            continue
        fitted = _fit(fewer, picture, first.fit.corners, pattern)
        if fitted.fit is not None and fitted.disagreement < best.disagreement:
            best = fitted
        if not best.odd:
            return best.fit
    by = best.disagreement
    return replace(best.fit, covariance=by * by * best.fit.covariance)


class _Equations:
    """Normal equations of least squares.

    Args:
        squares: (m + 1, m + 1) sums of products of m columns and, the last, of the levels.
        prior: certainty beforehand of the blur's numbers.
    """

    def __init__(self, squares: ndarray, prior: float | ndarray = 0.0):
        self._normal, self.right = squares[:-1, :-1].copy(), squares[:-1, -1]
        diagonal = np.einsum("ii->i", self._normal)
        diagonal[-_SPREAD:] += prior
        # Scaled, as the numbers are of unlike size, and some of the light's may be undetermined.
        self._size = 1.0 / np.sqrt(np.maximum(diagonal, 1e-9))
        self._normal *= self._size[:, None] * self._size
        diagonal += 1e-9

    def solution(self) -> ndarray:
        """Return the numbers (m,); NaN if there are none."""
        solved, found = cv2.solve(self._normal, self._size * self.right)
        return self._size * found.ravel() if solved else np.full(len(self.right), np.nan)

    def inverse(self) -> ndarray:
        """Return the inverse (m, m) of the equations' matrix."""
        return cv2.invert(self._normal)[1] * (self._size[:, None] * self._size)


def _squares_of(columns: ndarray, levels: ndarray, scales: float | ndarray = 1.0) -> ndarray:
    """Return the sums of products (m + 1, m + 1) of columns (m, n) and levels (n,), both scaled."""
    return cv2.mulTransposed(scales * np.concatenate((columns, levels[None])), False)


def _median(values: ndarray) -> float:
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


def _scale(sizes: ndarray) -> float:
    """Return the standard deviation of most residuals, by the median of their sizes."""
    return max(_LEAST_NOISE, 1.4826 * _median(sizes)) if len(sizes) else _LEAST_NOISE


def _tukey(ratios: ndarray) -> ndarray:
    """Return Tukey's biweights (n,) of residuals in standard deviations."""
    rest = np.maximum(1.0 - np.square(ratios / _TUKEY), 0.0)
    return rest * rest
