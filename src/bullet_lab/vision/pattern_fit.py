"""Corners of a marker by the fit of its whole pattern to the grey levels, with their covariance.

All edges between black and white cells tell where the marker is, not only its outline, and what
is not as the pattern says, a hand before it or a highlight, is told from it and left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Optional, Tuple, Union

import cv2
import numpy as np

from bullet_lab.vision.images import Lens
from bullet_lab.vision.pattern_model import PatternModel, moves_of
from bullet_lab.vision.pattern_pixels import (
    LEAST_AROUND,
    LEAST_SHARE,
    Pixels,
    all_pixels,
    mean_cell,
    pixels_of,
)

# px within the quiet zone's outer edge that what lies beyond it is seen at most, beside the blur.
_BLURRED_IN = 0.8
# Variance of the blur beside a pixel's own extent, px²: at first, and its limits.
_FIRST_VARIANCE, _LEAST_VARIANCE, _MOST_VARIANCE = 0.1, 0.005, 40.0
# Part of a neighbour that a pixel has in it: at first, limits (below 0 where an image has been
# sharpened), and how near it is known where the fit is there.
_FIRST_SHARED, _LEAST_SHARED, _MOST_SHARED, _SHARED_TO = 0.05, -0.1, 0.25, 0.01
_MOST_ROUNDS = 12
# Where edges are all there is, the blur's equations are far from linear, and went to and fro: a
# variance falls to no less than this part of itself in a round, and after so many makes half steps.
_FALL, _FULL_STEPS = 1.0 / 3.0, 4
# px; when no corner moves by more, what is left to go is the square of that: the fit is there.
_STILL = 0.05
# px²; where the blur is what it was taken for, and nothing moved, once is enough.
_AS_SHARP, _ABOUT = 0.11, 0.1
# px²; in an image with more blur than that all pixels of a large marker are looked at as well.
_SOFT = 1.0
# Residuals beyond so many standard deviations are not the marker's.
_OUTLYING = 3.5
# Contrast is shown that is so many standard deviations of its noise.
_SHOWN = 2.0
# Standard deviation of grey levels that were rounded to whole ones.
_LEAST_NOISE = 0.3
# px²; where white was cut off and there is more blur than that, how white it would have been cannot
# be told from the blur: the fit is to what was cut off.
_MOST_CUT = 0.1
# Variance of such corners, px²: edges of which the bright side was cut off come out steeper than
# the lens drew them, and by where pixels are up to a quarter of one aside; more of it where only a
# part of the marker is so bright, whose white is wider than in the other part.
_CUT_VARIANCE, _PARTLY_CUT_VARIANCE = 0.01, 0.03
# A side is not the marker's if an end of it is so many px from where all other edges have it, and
# so many standard deviations of that.
_ODD, _ODD_BY = 0.07, 3.0
# So many pixels must be the marker's, beside their share of all.
_LEAST_PIXELS = 40
# The corners may be moved by so many cells.
_MOST_MOVED = 1.0
# So many numbers are the blur's, the last ones of a fit; before them are those of `moves_of`.
_SPREAD = 4
_SHAPE = slice(-8 - _SPREAD, -_SPREAD)
# So many are the contrast's, the last ones of the light.
_OF_CONTRAST = 3


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
    image is fitted too. Of a small marker so is the part that each pixel has of its neighbours:
    what filters a picture after it was taken is no Gaussian, and moved corners by 0.01 px. Of a
    large marker the pixels across each place of an edge have an a of their own, so that highlights
    and shadows do not matter. Robust weights are Tukey's, of each pixel and, of a large marker, of
    the contrast that each place of an edge shows; the covariance is that of least squares with the
    noise that the residuals show. A side that is not where all other edges have it is not the
    marker's, but of what stands before it: it is left out.

    Over-exposed pixels do not count, unless what is left does not tell the light from the blur:
    then the picture is fitted as it was cut off, with white that is wider than in the pattern, by
    as much as the fit says. Where the sun shines on a part of a large marker, the pixels across
    each place have a d of their own too, and white that was cut off there is wider than elsewhere.

    Args:
        image: (h, w) grey levels.
        corners: (4, 2) ideal px, clockwise from the marker's top left, to a fraction of a cell.
        pattern: (n, n) cells with the border, 1 for white.
        lens: where ideal pixels are seen.

    Returns:
        None where the pattern does not explain what is there.
    """
    pixels = pixels_of(image, corners, pattern, lens)
    if len(pixels.levels) < _LEAST_PIXELS:
        return None
    first = _fit(pixels, image, corners, pattern, lens)
    fit, blur = first.fit, first.blur
    if pixels.over_exposed and not pixels.cut_off and (fit is None or blur > _MOST_CUT):
        pixels = pixels_of(image, corners, pattern, lens, cut_off=True)
        fit = _fit(pixels, image, corners, pattern, lens).fit or fit
    elif fit is not None and first.odd:
        fit = _without_odd_side(first, image, pattern, lens)
    more = _CUT_VARIANCE if pixels.cut_off else 0.0
    if pixels.parted and pixels.flooded.any():
        more = _PARTLY_CUT_VARIANCE
    if fit is not None and more:
        fit = replace(fit, covariance=fit.covariance + more * np.eye(8))
    return fit


class _Fitted(NamedTuple):
    """A fit to some pixels.

    Attributes:
        fit: as of `fit_pattern`.
        blur: the greatest variance of its blur, px².
        pixels: those of the fit.
        odd: of sides that are not where the others have them, the farthest first: by how many
            standard deviations, and which pixels (n,) are theirs.
    """

    fit: Optional[PatternFit]
    blur: float
    pixels: Optional[Pixels] = None
    odd: Tuple[Tuple[float, np.ndarray], ...] = ()

    @property
    def disagreement(self) -> float:
        """By how many standard deviations the farthest side is off; 0 if none is."""
        return self.odd[0][0] if self.odd else 0.0


def _fit(
    pixels: Pixels, image: np.ndarray, corners: np.ndarray, pattern: np.ndarray, lens: Lens
) -> _Fitted:
    """Return the fit to some pixels, from corners on; arguments as of `fit_pattern`."""
    cells = len(pattern)
    spread = np.array([_FIRST_VARIANCE, _FIRST_VARIANCE, 0.0, _FIRST_SHARED])
    start, cell, light = corners, mean_cell(corners, cells), None
    for left in reversed(range(_MOST_ROUNDS)):
        model = PatternModel(pixels.points, corners, spread, pattern)
        if pixels.parted:
            of_light = model.light(True, False, pixels.flooded)[:-_OF_CONTRAST]
        else:
            of_light = model.light(pixels.grouped, not pixels.whole, pixels.cut_off)
        shared, value = spread[3], model.value
        columns, levels = pixels.seen(of_light, shared, value), pixels.seen_levels(value)
        if light is None:
            light = _Equations(columns, levels, np.ones(columns.shape[1])).solution()
        residuals = levels - light @ columns
        contrast = pixels.own_contrast(value)[0] if pixels.parted else model.contrast(light)
        steepness = pixels.own(model.steepness(contrast))
        beyond = pixels.own(model.beyond(contrast))
        noise = _noise(residuals, steepness, beyond, pixels.told)
        # Blur brings in what lies beyond the quiet zone.
        reach = 2.0 * math.sqrt(max(spread[:2])) + _BLURRED_IN
        own = pixels.own((model.margin() > reach) | (model.outside() < LEAST_AROUND))
        own &= pixels.told
        shown = _shown(pixels, value, contrast, noise)
        weights = np.where(own, shown * _tukey(residuals / noise) / (noise * noise), 0.0)
        shape = np.concatenate((model.shape(contrast), model.blur(contrast)))
        shape = pixels.seen(shape, shared, value)
        columns = np.concatenate((columns, shape, pixels.by_shared(light @ of_light, shared)))
        step = _Equations(columns, residuals, weights, _BLUR_PRIOR).solution()
        light = light + step[: len(light)]
        to_corners = moves_of(corners, model.to_image)
        moved = to_corners @ step[len(light) : -_SPREAD]
        corners = corners + moved.reshape(4, 2)
        least, gain = 0.0, 1.0
        if pixels.grouped:
            least = _FALL * spread[:2]
            gain = 1.0 if left >= _MOST_ROUNDS - _FULL_STEPS else 0.5
        before, spread = spread, _allowed(spread + gain * step[-_SPREAD:], least)
        if not np.abs(corners - start).max() <= _MOST_MOVED * cell:
            return _Fitted(None, float(spread[:2].max()))
        changed = np.abs(spread - before)
        sharpened = changed.max() - _ABOUT * spread.max() < _AS_SHARP and changed[3] < _SHARED_TO
        if np.abs(moved).max() < _STILL and sharpened:
            break
        if left and pixels.grouped and spread.max() > _SOFT:
            # Few pixels across each edge see little of so much blur.
            pixels, light = all_pixels(image, corners, cells, lens, pixels.cut_off), None
    residuals = residuals - step @ columns
    noise = _noise(residuals, steepness, beyond, pixels.told)
    residuals = np.where(own & (weights > 0.0), residuals / noise, _TUKEY)
    told = int(pixels.told.sum())
    judged = _judged(corners, residuals, told, columns / noise, pixels.group, to_corners)
    blur = float(spread[:2].max())
    if judged is None:
        return _Fitted(None, blur)
    fit, squares = judged
    if pixels.cut_off or (pixels.parted and pixels.flooded.any()):
        return _Fitted(fit, blur)
    sides = np.stack([pixels.own(side) for side in model.sides()])
    odd = _odd_sides(corners, residuals, columns / noise, squares, to_corners, sides)
    return _Fitted(fit, blur, pixels, odd)


def _without_odd_side(
    first: _Fitted, image: np.ndarray, pattern: np.ndarray, lens: Lens
) -> PatternFit:
    """Return the fit without the side without which all others agree best.

    As uncertain as they still disagree.
    """
    best = first
    for _, side in first.odd:
        fewer = first.pixels.without(side)
        if len(fewer.levels) < _LEAST_PIXELS:
            continue
        fitted = _fit(fewer, image, first.fit.corners, pattern, lens)
        if fitted.fit is not None and fitted.disagreement < best.disagreement:
            best = fitted
        if not best.odd:
            return best.fit
    by = best.disagreement
    return replace(best.fit, covariance=by * by * best.fit.covariance)


def _allowed(spread: np.ndarray, least: Union[float, np.ndarray]) -> np.ndarray:
    """Return the nearest blur that there can be, with variances of `least` at least."""
    least = np.maximum(_LEAST_VARIANCE, least)
    low, high = np.clip(spread[:2], least, _MOST_VARIANCE).tolist()
    # What it is across is no less than the least.
    most = math.sqrt((low - 0.99 * _LEAST_VARIANCE) * (high - 0.99 * _LEAST_VARIANCE))
    shared = min(max(spread[3], _LEAST_SHARED), _MOST_SHARED)
    return np.array([low, high, min(max(spread[2], -most), most), shared])


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


def _noise(
    residuals: np.ndarray, steepness: np.ndarray, beyond: np.ndarray, told: np.ndarray
) -> np.ndarray:
    """Return the standard deviation (n,) of each residual: of noise, and of edges out of place.

    And of what is `beyond` the quiet zone, of which the model knows nothing.

    Where the picture is steep, what the model knows nothing of, such as an edge that was drawn
    from few samples, makes larger residuals than where it is even.
    """
    sizes, steep = np.abs(residuals), steepness > _median(steepness)
    even = _scale(sizes[told & ~steep])
    more = max(0.0, _scale(sizes[told & steep]) ** 2 - even * even)
    slope = _median(steepness[steep]) if steep.any() else 1.0
    steeper = steepness / max(slope, 1e-9)
    return np.sqrt(even * even + more * steeper * steeper + beyond * beyond)


def _median(values: np.ndarray) -> float:
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


def _scale(sizes: np.ndarray) -> float:
    """Return the standard deviation of most residuals, by the median of their sizes."""
    return max(_LEAST_NOISE, 1.4826 * _median(sizes)) if len(sizes) else _LEAST_NOISE


def _shown(
    pixels: Pixels, value: np.ndarray, contrast: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Return weights (n,) by how much of the contrast the pixels across each place of an edge show.

    What hides an edge has none there. In a noisy picture no pixel tells that by itself. Where each
    place has a light of its own, all that is told is whether there is any.
    """
    if not pixels.grouped:
        return np.ones(len(noise))
    own, squares = pixels.own_contrast(value)
    deviation = noise / np.sqrt(squares)
    if pixels.parted:
        return np.where(own > _SHOWN * deviation, 1.0, 0.0)
    deviation = np.maximum(deviation, contrast / _TUKEY)
    return _tukey((own - contrast) / np.maximum(deviation, 1e-9))


def _tukey(ratios: np.ndarray) -> np.ndarray:
    """Return Tukey's biweights (n,) of residuals in standard deviations."""
    rest = np.maximum(1.0 - np.square(ratios / _TUKEY), 0.0)
    return rest * rest


def _judged(
    corners: np.ndarray,
    residuals: np.ndarray,
    told: int,
    columns: np.ndarray,
    group: int,
    to_corners: np.ndarray,
) -> Optional[Tuple[PatternFit, float]]:
    """Return the fit with its covariance, if the pattern explains most of what is seen.

    And the mean square of its residuals, of which 1 was expected.

    Residuals (n,) and columns (m, n) are in standard deviations; `told` of them are of pixels that
    tell how bright it is, and `to_corners` is of `moves_of`.
    """
    own = np.abs(residuals) < _OUTLYING
    count = int(own.sum())
    if count < max(_LEAST_PIXELS, LEAST_SHARE * told):
        return None
    inverse = _Equations(columns, residuals, own.astype(float), _BLUR_PRIOR).inverse()
    if group > 1:
        squares = _squares(residuals * own, columns * own, inverse, group)
    else:
        squares = float(np.square(residuals[own]).sum()) / max(1.0, count - len(columns))
    covariance = squares * (to_corners @ inverse[_SHAPE, _SHAPE] @ to_corners.T)
    return PatternFit(corners, 0.5 * (covariance + covariance.T), 1.0 - count / told), squares


def _odd_sides(
    corners: np.ndarray,
    residuals: np.ndarray,
    columns: np.ndarray,
    squares: float,
    to_corners: np.ndarray,
    sides: np.ndarray,
) -> Tuple[Tuple[float, np.ndarray], ...]:
    """Return the sides that are not where all others have them, as `_Fitted.odd`.

    Arguments as of `_judged`, with the mean square that it found, and which pixels are on each
    side, (4, n).
    """
    own, odd = np.abs(residuals) < _OUTLYING, []
    along = corners[[1, 2, 3, 0]] - corners
    for side, pixels in enumerate(sides):
        others = _Equations(columns, residuals, (own & ~pixels).astype(float), _BLUR_PRIOR)
        ends = [side, (side + 1) % 4]
        across = np.array([-along[side, 1], along[side, 0]]) / np.hypot(*along[side])
        to_ends = np.einsum("k,ekm->em", across, to_corners.reshape(4, 2, 8)[ends])
        off = np.abs(to_ends @ others.solution()[_SHAPE])
        by_shape = others.inverse()[_SHAPE, _SHAPE]
        variances = squares * np.einsum("ek,kl,el->e", to_ends, by_shape, to_ends)
        by = off / np.sqrt(np.maximum(variances, 1e-12))
        if ((off > _ODD) & (by > _ODD_BY)).any():
            odd.append((float(by.max()), pixels))
    return tuple(sorted(odd, key=lambda one: -one[0]))


def _squares(residuals: np.ndarray, columns: np.ndarray, inverse: np.ndarray, group: int) -> float:
    """Return the mean square of residuals (n,) by what those of a group together move the corners.

    What the model knows nothing of, a blur that is no Gaussian, is alike on both sides of an edge:
    it makes the residuals of a group large, and hardly moves the edge. The sum of squares is
    divided by its expectation for independent residuals of 1, less what the fit took from them.

    Args:
        residuals: in standard deviations; 0 where they do not count.
        columns: (m, n) of the fit.
        inverse: (m, m) of the fit's normal equations.
        group: of so many pixels.
    """
    _, values, vectors = cv2.eigen(np.ascontiguousarray(inverse[_SHAPE, _SHAPE]))
    scales = np.sqrt(np.maximum(values, 1e-12 * values.max()))
    pulls = (vectors / scales) @ inverse[_SHAPE] @ columns
    of_groups = pulls.reshape(len(pulls), group, -1)
    found = np.square((pulls * residuals).reshape(of_groups.shape).sum(axis=1)).sum()
    taken = np.einsum("qgk,mgk->kqm", of_groups, columns.reshape(len(columns), group, -1))
    expected = np.square(pulls).sum() - ((taken @ inverse) * taken).sum()
    return float(found / max(expected, 1.0))
