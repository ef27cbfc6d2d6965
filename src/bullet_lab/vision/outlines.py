"""Dark convex quadrilaterals in an image, which may be markers, to about a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Iterable, Iterator, List, Optional, Sequence

import cv2
import numpy as np

from bullet_lab.vision.algebra import intersections

# Part of its outline's length by which a quadrilateral may differ from a contour.
_OUTLINE_TOLERANCE = 0.035
# Corners nearer than this part of the outline's length are one.
_MIN_EDGE = 0.05
# A side's line is fitted to its contour without so much at either end.
_FIT_TRIM = 0.15
# Least area of a quadrilateral by the square of its outline: of a square 1/16, of one that is
# seen at 80 degrees a third of that.
_LEAST_AREA = 0.018


@dataclass(frozen=True)
class _Mask:
    """A way to tell dark from bright.

    Attributes:
        window: size of the neighbourhood, px.
        part: of the way from its darkest to its brightest pixel, up to which a pixel is dark.
        joined: pieces hang together by the corners of pixels as well.
        coarse: of the image of half the size, for what is large.
        ceiling: grey level; what is brighter counts as this. Of a marker in the shade before a
            bright sky, white is nearer to black than to the sky.
    """

    window: int
    part: float
    joined: bool = False
    coarse: bool = False
    ceiling: int = 255


# With a large part, a border that light, blur or noise has broken holds; with a small one, what
# is dark beside a narrow quiet zone does not run together with it.
_FIRST_LOOK = (_Mask(3, 0.5, joined=True), _Mask(9, 0.6, coarse=True))
_SECOND_LOOK = (_Mask(5, 0.25, joined=True), _Mask(13, 0.45, joined=True, coarse=True))
# Where an image has few dark pieces, more masks cost little.
_MORE_MASKS = (
    _Mask(3, 0.6),
    _Mask(5, 0.6, joined=True),
    _Mask(3, 0.55, joined=True),
    _Mask(3, 0.7, joined=True),
    _Mask(9, 0.65),
    _Mask(9, 0.4, joined=True, coarse=True),
    _Mask(3, 0.5, joined=True, coarse=True),
    _Mask(5, 0.45, joined=True, ceiling=36),
    _Mask(5, 0.45, joined=True, ceiling=54),
)
_FEW_PIECES = 12
# The points of an outline by the box around it, of which what is convex has two at most.
_RAGGED = 2.2
# Half the size shows markers from this side on, px.
_COARSE_SIDE = 20.0


class OutlineSearch:
    """Looks for the outlines of dark quadrilaterals in an image, to about a pixel.

    Args:
        grey: (h, w) uint8.
        min_side: least mean length of the sides, px.
    """

    def __init__(self, grey: np.ndarray, min_side: float):
        self._grey, self._min_side = grey, min_side
        size = (grey.shape[1] // 2, grey.shape[0] // 2)
        self._half = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        self._pieces = 0

    def first_look(self, contrast: float) -> np.ndarray:
        """Return (n, 4, 2) corners u, v in px, clockwise as one looks at the image.

        The same quadrilateral may be there several times.

        Args:
            contrast: grey levels between black and white.
        """
        return self._look(_FIRST_LOOK, contrast)

    def second_look(self, contrast: float) -> np.ndarray:
        """Return what other thresholds show, likewise; more of them where they cost little."""
        masks = list(_SECOND_LOOK)
        if self._pieces < _FEW_PIECES:
            masks += _MORE_MASKS
        return self._look(masks, contrast)

    def _look(self, masks: Sequence[_Mask], contrast: float) -> np.ndarray:
        outlines: List[_Outline] = []
        for mask in masks:
            grey, least = self._grey, self._min_side
            if mask.coarse:
                grey, least = self._half, 0.5 * max(least, _COARSE_SIDE)
            if mask.ceiling < 255:
                grey = cv2.min(grey, mask.ceiling)
            dark = darker_part(grey, mask.window, mask.part, math.ceil(contrast))
            contours = list(_pieces(dark, least, mask.joined))
            self._pieces += len(contours)
            outlines += _outlines_of(contours, least, mask.coarse)
        quads = _fit_sides(outlines)
        # Pixels are numbered at their centres.
        scale = np.array(self._grey.shape[::-1]) / np.array(self._half.shape[::-1])
        coarse = np.array([outline.coarse for outline in outlines], dtype=bool)
        quads[coarse] = (quads[coarse] + 0.5) * scale - 0.5
        return quads[np.isfinite(quads).all(axis=(1, 2))]


def darker_part(grey: np.ndarray, window: int, part: float, contrast: int) -> np.ndarray:
    """Return, as 255, what is in the darker part of the grey levels of its neighbourhood.

    Args:
        grey: (h, w) uint8.
        window: size of the neighbourhood, px.
        part: of the way from its darkest to its brightest level, up to which a pixel is dark.
        contrast: levels between the two; where they are nearer, nothing is dark.
    """
    darkest, brightest = cv2.erode(grey, _square(window)), cv2.dilate(grey, _square(window))
    limit = cv2.addWeighted(darkest, 1.0 - part, brightest, part, 0.0)
    enough = cv2.compare(cv2.subtract(brightest, darkest), float(contrast), cv2.CMP_GE)
    return cv2.bitwise_and(cv2.compare(grey, limit, cv2.CMP_LE), enough)


@lru_cache(maxsize=None)
def _square(window: int) -> np.ndarray:
    return np.ones((window, window), np.uint8)


def _pieces(dark: np.ndarray, min_side: float, joined: bool) -> Iterator[np.ndarray]:
    """Yield the outer contours of the pieces of a mask that are large and broad enough.

    Pieces hang together by the edges of pixels and, if `joined`, by their corners.
    """
    how = (8, cv2.CV_32S, cv2.CCL_BBDT) if joined else (4, cv2.CV_32S, cv2.CCL_DEFAULT)
    _, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(dark, *how)
    width, height, area = stats[:, 2], stats[:, 3], stats[:, 4]
    extent = width + height
    # The outline of what is convex is no longer than that of the box around it; a border is some
    # pixels wide.
    fits = (extent >= 2.0 * min_side) & (area >= extent * np.clip(extent / 20.0, 1.5, 3.0))
    fits &= 8 * np.minimum(width, height) >= np.maximum(width, height)
    # What reaches the edge of the image is cut off by it.
    fits &= (stats[:, :2] > 0).all(axis=1)
    fits &= (stats[:, :2] + stats[:, 2:4] < dark.shape[::-1]).all(axis=1)
    fits[0] = False
    labelled = np.flatnonzero(fits)
    for label, (u, v, wide, high, _) in zip(labelled.tolist(), stats[labelled].tolist()):
        piece = cv2.inRange(labels[v : v + high, u : u + wide], label, label)
        how = cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        contour = cv2.findContours(piece, *how, offset=(u, v))[0][0]
        if len(contour) <= _RAGGED * (wide + high):
            yield contour


def outlines_within(dark: np.ndarray, min_side: float) -> np.ndarray:
    """Return (n, 4, 2) outlines of what is dark and has four corners in a small mask (h, w)."""
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # OpenCV runs around what is dark in one sense, around the holes in it in the other.
    outer = (contour for contour in contours if cv2.contourArea(contour, oriented=True) < 0.0)
    quads = _fit_sides(_outlines_of(outer, min_side))
    return quads[np.isfinite(quads).all(axis=(1, 2))]


def same_quads(quads: np.ndarray) -> np.ndarray:
    """Return which (n, n) of (n, 4, 2) quadrilaterals are the same, to a fraction of a cell.

    These have the same middle and are as large.
    """
    sides = np.linalg.norm(quads[:, _NEXT] - quads, axis=2).mean(axis=1)
    middles = quads.mean(axis=1)
    away = np.abs(middles[:, None] - middles).max(axis=2)
    larger = np.abs(sides[:, None] - sides)
    # A marker's white surroundings on a bright ground are a dark square one cell larger.
    return np.maximum(away, larger) < (1.0 + 0.04 * sides)[:, None]


def mean_side(quad: np.ndarray) -> float:
    """Return the mean length of the sides of (4, 2) corners, px.

    >>> mean_side(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]]))
    2.0
    """
    sides = np.roll(quad, -1, axis=0) - quad
    return float(np.hypot(sides[:, 0], sides[:, 1]).mean())


@dataclass(frozen=True, eq=False)
class _Outline:
    """A contour (n, 2) that has four corners, at these places, clockwise."""

    contour: np.ndarray
    places: List[int]
    coarse: bool


def _outlines_of(
    contours: Iterable[np.ndarray], min_side: float, coarse: bool = False
) -> List[_Outline]:
    outlines = []
    for contour in contours:
        corners = _outline_of(contour, min_side)
        if corners is not None:
            # OpenCV runs around what is dark counter-clockwise.
            points = contour[::-1, 0].astype(float)
            places = [int(np.abs(points - corner).sum(axis=1).argmin()) for corner in corners]
            outlines.append(_Outline(points, places, coarse))
    return outlines


def _outline_of(contour: np.ndarray, min_side: float) -> Optional[np.ndarray]:
    """Return the (4, 2) points of a contour that are its corners, or None if it has not four."""
    # A diagonal step counts as one pixel; the contour runs through the centres of pixels.
    if len(contour) < 2.8 * (min_side - 1.0):
        return None
    length = cv2.arcLength(contour, True)
    if length < 4.0 * (min_side - 1.0) or cv2.contourArea(contour) < _LEAST_AREA * length * length:
        return None
    outline = cv2.approxPolyDP(contour, max(1.0, _OUTLINE_TOLERANCE * length), True)
    if len(outline) != 4 or not cv2.isContourConvex(outline):
        return None
    corners = outline[::-1, 0].astype(float)
    edges = corners[_NEXT] - corners
    if np.hypot(edges[:, 0], edges[:, 1]).min() < _MIN_EDGE * length:
        return None
    return corners


_NEXT = [1, 2, 3, 0]


def _fit_sides(outlines: Sequence[_Outline]) -> np.ndarray:
    """Return corners (n, 4, 2) where lines (least squares) through the outlines' sides meet."""
    if not outlines:
        return np.empty((0, 4, 2))
    contours = [outline.contour for outline in outlines]
    places = np.array([outline.places for outline in outlines])
    counts = np.array([len(contour) for contour in contours])
    middles = np.array([contour[0] for contour in contours])
    # Sums of x, y, x², xy, y² up to each place, twice around each contour.
    doubled = [part for contour, first in zip(contours, middles) for part in [contour - first] * 2]
    x, y = np.concatenate(doubled).T
    parts = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y))
    sums = np.concatenate((np.zeros((6, 1)), parts.cumsum(axis=1)), axis=1)
    steps = (places[:, _NEXT] - places) % counts[:, None]
    trims = (_FIT_TRIM * steps).astype(int)
    starts = places + np.concatenate(([0], np.cumsum(2 * counts)[:-1]))[:, None]
    number, x, y, xx, xy, yy = sums[:, starts + steps - trims + 1] - sums[:, starts + trims]
    x, y = x / number, y / number
    xx, xy, yy = xx / number - x * x, xy / number - x * y, yy / number - y * y
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    normals = np.stack((np.sin(angle), -np.cos(angle)), axis=-1)
    corners = np.stack([contour[at] for contour, at in zip(contours, places)])
    edges = corners[:, _NEXT] - corners
    inward = edges[..., 0] * normals[..., 1] - edges[..., 1] * normals[..., 0] > 0.0
    normals[inward] *= -1.0
    # The contour runs through the centres of the outermost dark pixels.
    points = np.stack((x, y), axis=-1) + middles[:, None] + 0.5 * normals
    return intersections(points, normals)
