"""Search for candidates: dark convex quadrilaterals that may be markers, to about a pixel."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Iterable, Iterator, NamedTuple, Sequence

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.images import (
    NEXT,
    UNIT_SQUARE,
    Picture,
    cross,
    homography,
    intersections,
    lengths_of,
    mapped,
    mean_side,
    right_of,
)

_NONE = np.empty((0, 4, 2))
# Least area of a quadrilateral, by the square of its outline's length: 1/16 of a square, a third
# of that of one that is seen at 80 degrees.
_LEAST_AREA = 0.018
# Most difference of a quadrilateral from its contour, as a share of the contour's length.
_OUTLINE_TOLERANCE = 0.035
# Shortest side, as a share of the contour's length.
_MIN_EDGE = 0.05
# Share of a side at either end that is left out of the line fit. The second pass leaves out more:
# something dark before a corner is a part of the contour.
_FIRST_TRIM = 0.15
_SECOND_TRIM = 0.32
# Product of two sides, px², below which they make no corner.
_LEAST_CORNER = 1.0
# An image with fewer dark pieces in the first pass is searched with more masks later.
_FEW_PIECES = 10
# Least side that is looked for in the image of half the size, px of the full size.
_COARSE_SIDE = 20.0
# Most points of a contour, by the width and height of the box around it. A convex one has 2.
_RAGGED = 2.2
# The first pass leaves out weak edges where so much of the image has stronger ones, but none of so
# many grey levels. The time that it takes is for edges.
_MOST_EDGES = 0.15
_STRONG = 30
# Borders with a gap have an inner side as well, and the cells beside it may hang on it.
_OPEN_RAGGED = 8.0
# Their least width and height together, px, and how many of a mask are tried, the largest first.
_LEAST_OPEN = 40
_MOST_OPEN = 12
# A hull is simplified by up to this share of its length and then has so many corners.
_HULL_TOLERANCE = 0.02
_HULL_CORNERS = (4, 5, 6)
# Most area of a quadrilateral over that of the hull, which lacks a corner.
_WITH_CORNER = 1.15
# Half widths of the strips in which points of a side are used, as shares of it, and the share of it
# that is left out at either end.
_STRIPS = (0.06, 0.03, 0.015)
_OPEN_TRIM = 0.16
_LEAST_POINTS = 8
# Most labels of 16 bits: OpenCV writes out of bounds with one more.
_MOST_LABELS = 65534


class _Mask(NamedTuple):
    """A threshold between dark and bright.

    Attributes:
        window: size of the neighbourhood, px.
        part: between its darkest (0) and its brightest pixel (1), up to which a pixel is dark.
        joined: pixels that touch at a corner are of one piece.
        coarse: of the image of half the size, for large markers.
        ceiling: grey level at which the image is cut off. Of a marker in the shade before a bright
            sky, white is nearer to black than to the sky.
    """

    window: int
    part: float
    joined: bool = True
    coarse: bool = False
    ceiling: int = 255


# A large part keeps a border whole that light, blur or noise has broken. A small part separates a
# marker with a narrow quiet zone from what is dark beside it.
_FIRST_PASS = (_Mask(3, 0.5), _Mask(9, 0.6, joined=False, coarse=True))
# The second pass searches an image of half the size: a quarter of the time, and what the first one
# misses in an image with much texture has little contrast, or blur.
_SECOND_PASS = (_Mask(3, 0.4, coarse=True),)
# Also in the second pass, of an image with few pieces.
_MORE_MASKS = (
    _Mask(13, 0.45, coarse=True),
    _Mask(3, 0.6, joined=False),
    _Mask(3, 0.6),
    _Mask(9, 0.65, joined=False),
    _Mask(5, 0.45, ceiling=36),
    _Mask(5, 0.45, ceiling=54),
)
# With narrow windows a border with a gap is a line that ends at either side of the gap.
_OPEN_PASS = (_Mask(3, 0.7), _Mask(5, 0.4), _Mask(3, 0.5, coarse=True))


class CandidateSearch:
    """Searches an image for dark quadrilaterals, in up to three passes.

    Each pass returns (n, 4, 2) corners u, v in px, clockwise in the image; the same quadrilateral
    may be there several times. `contrast` is the least difference of white and black, grey levels.

    Args:
        grey: (h, w) uint8.
        min_side: least mean length of the sides, px.
    """

    def __init__(self, grey: ndarray, min_side: float):
        self._grey, self._min_side = grey, min_side
        size = (grey.shape[1] // 2, grey.shape[0] // 2)
        self._half = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        self._count = 0
        self._is_clear = False

    def first_pass(self, contrast: float) -> ndarray:
        """Return the outlines with four corners that the usual masks show.

        In an image with much texture, `contrast` is only that of the stronger edges.
        """
        return self._outlines(_FIRST_PASS, max(contrast, _usual_rise(self._grey)), _FIRST_TRIM)

    def second_pass(self, contrast: float) -> ndarray:
        """Return those of other masks, of more of them in an image with few pieces."""
        self._is_clear = self._count < _FEW_PIECES
        masks = _SECOND_PASS + (_MORE_MASKS if self._is_clear else ())
        return self._outlines(masks, contrast, _SECOND_TRIM)

    def open_pass(self, contrast: float) -> ndarray:
        """Return borders with a gap or a hidden corner, in an image with few pieces.

        Something before a corner that is as dark as the wall behind joins the two: no threshold
        shows four corners then. The hull of the border still has four long sides.
        """
        if not self._is_clear:
            return _NONE
        quads, coarse = [], []
        for mask in _OPEN_PASS:
            contours = self._contours(mask, contrast, is_open=True)
            contours.sort(key=lambda contour: -np.ptp(contour[:, 0], axis=0).sum())
            quads += map(_hull_quad, contours[:_MOST_OPEN])
            coarse += [mask.coarse] * (len(quads) - len(coarse))
        return self._full_size(np.array(quads).reshape(-1, 4, 2), coarse)

    def _outlines(self, masks: Sequence[_Mask], contrast: float, trim: float) -> ndarray:
        outlines, coarse = [], []
        for mask in masks:
            contours = self._contours(mask, contrast)
            self._count += len(contours)
            outlines += _outlines_of(contours, self._least_side(mask))
            coarse += [mask.coarse] * (len(outlines) - len(coarse))
        return self._full_size(_outlined_quads(outlines, trim), coarse)

    def _contours(self, mask: _Mask, contrast: float, is_open: bool = False) -> list[ndarray]:
        """Return the contours of the pieces that are dark by a mask, px of the mask."""
        grey, least = self._half if mask.coarse else self._grey, self._least_side(mask)
        least = max(0.5 * _LEAST_OPEN, least) + 1.0 if is_open else least
        return list(_dark_contours(cv2.min(grey, mask.ceiling), mask, contrast, least, is_open))

    def _least_side(self, mask: _Mask) -> float:
        """Return the least side to look for in a mask, px of the mask."""
        return 0.5 * max(self._min_side, _COARSE_SIDE) if mask.coarse else self._min_side

    def _full_size(self, quads: ndarray, coarse: Sequence[bool]) -> ndarray:
        """Return the sound ones of quadrilaterals, px; `coarse` ones are of half the size."""
        scale = np.array(self._grey.shape[::-1]) / np.array(self._half.shape[::-1])
        # The centre of a pixel is a whole number.
        is_coarse = np.array(coarse, dtype=bool)
        quads[is_coarse] = (quads[is_coarse] + 0.5) * scale - 0.5
        return sound_quads(quads)


def _usual_rise(grey: ndarray) -> float:
    """Return the grey levels that edges rise by at most in most of an image; at most `_STRONG`."""
    last = len(grey) - 2
    rows = np.stack([grey[k : last + k : 8] for k in range(3)])
    rise = cv2.subtract(rows.max(axis=0), rows.min(axis=0))
    rises = np.cumsum(np.bincount(rise.ravel(), minlength=256))
    return float(min(_STRONG, np.searchsorted(rises, (1.0 - _MOST_EDGES) * rises[-1])))


def _dark_contours(
    grey: ndarray, mask: _Mask, contrast: float, min_side: float, is_open: bool
) -> Iterator[ndarray]:
    """Yield the outer contours (n, 1, 2) of the pieces of (h, w) grey levels that a mask shows.

    Those are large and broad enough. If `is_open`, a piece may be a line, of which the contour has
    two sides.
    """
    square = np.ones((mask.window, mask.window), np.uint8)
    darkest, brightest = cv2.erode(grey, square), cv2.dilate(grey, square)
    limit = cv2.addWeighted(darkest, 1.0 - mask.part, brightest, mask.part, 0.0)
    rise = cv2.subtract(brightest, darkest)
    enough = cv2.compare(rise, float(math.ceil(contrast)), cv2.CMP_GE)
    dark = cv2.bitwise_and(cv2.compare(grey, limit, cv2.CMP_LE), enough)
    # Labels of 16 bits are quicker. There are no more labels than runs of dark pixels in rows.
    runs = len(dark) + cv2.countNonZero(cv2.subtract(dark[:, 1:], dark[:, :-1]))
    kind = cv2.CV_16U if runs <= _MOST_LABELS else cv2.CV_32S
    neighbours = 8 if mask.joined else 4
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(
        dark, connectivity=neighbours, ltype=kind
    )
    # Most pieces are too small.
    large = boxes[:, 2] + boxes[:, 3] >= math.ceil(2.0 * min_side)
    # The background is no piece.
    large[0] = False
    numbers = large.nonzero()[0]
    u, v, width, height, area = boxes[numbers].T
    extent = width + height
    # A convex outline is no longer than that of the box around it; a border is some pixels wide.
    fits = area >= extent * (1.5 if is_open else np.clip(extent / 20.0, 1.5, 3.0))
    fits &= 8 * np.minimum(width, height) >= np.maximum(width, height)
    # A piece that reaches the edge of the image is cut off by it.
    fits &= np.minimum(u, v) > 0
    fits &= (u + width < labels.shape[1]) & (v + height < labels.shape[0])
    numbers = numbers[fits]
    longest = _OPEN_RAGGED if is_open else _RAGGED
    for number, box in zip(numbers.tolist(), boxes[numbers].tolist()):
        u, v, width, height, _ = box
        piece = (labels[v : v + height, u : u + width] == number).view(np.uint8)
        (contour, *_), _ = cv2.findContours(
            piece, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(u, v)
        )
        if len(contour) <= longest * (width + height):
            yield contour


def sound_quads(quads: ndarray) -> ndarray:
    """Return those of (n, 4, 2) quadrilaterals that have four corners, all finite, px.

    >>> side = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    >>> flat = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 5.0], [9.0, 9.0]])
    >>> len(sound_quads(np.stack((side, flat, side * np.nan))))
    1
    """
    with np.errstate(invalid="ignore"):
        sides = quads[:, NEXT] - quads
        corners = cross(sides, sides[:, NEXT])
    # The cross product of sides that are not finite is NaN, which is no greater.
    return quads[(np.abs(corners) > _LEAST_CORNER).all(axis=1)]


class _Outline(NamedTuple):
    """A contour with four corners.

    Attributes:
        first: (2,) px, one of its points.
        points: (2 n, 2) px from there, twice around: a side may run across the contour's end.
        corners: (4,) indices of the corners, clockwise.
    """

    first: ndarray
    points: ndarray
    corners: ndarray


def _outlines_of(contours: Iterable[ndarray], min_side: float) -> list[_Outline]:
    """Return the outlines of the contours with four corners."""
    outlines = (_outline(contour, min_side) for contour in contours)
    return [outline for outline in outlines if outline is not None]


def _outlined_quads(outlines: Sequence[_Outline], trim: float) -> ndarray:
    """Return the corners (n, 4, 2) at which the lines along the outlines' sides meet.

    Lines are of least squares, without the share `trim` of each side at either end.
    """
    if not outlines:
        return _NONE
    firsts, contours, places = zip(*outlines)
    lengths = np.array([len(contour) for contour in contours])
    x, y = points = np.concatenate(contours).T
    sums = np.zeros((5, len(x) + 1))
    np.cumsum((x, y, x * x, x * y, y * y), axis=1, out=sums[:, 1:])
    places = np.stack(places)
    steps = (places[:, NEXT] - places) % (lengths[:, None] // 2)
    places += (np.cumsum(lengths) - lengths)[:, None]
    trims = (trim * steps).astype(int)
    starts, counts = places + trims, steps - 2 * trims + 1
    x, y, xx, xy, yy = (sums[:, starts + counts] - sums[:, starts]) / counts
    angles = 0.5 * np.arctan2(2.0 * (xy - x * y), (xx - x * x) - (yy - y * y))
    normals = np.stack((np.sin(angles), -np.cos(angles)), axis=-1)
    corners = points.T[places]
    normals[cross(corners[:, NEXT] - corners, normals) > 0.0] *= -1.0
    # The contour runs through the centres of the outermost dark pixels.
    middles = np.stack((x, y), axis=-1) + np.stack(firsts)[:, None]
    return intersections(middles + 0.5 * normals, normals)


def _outline(contour: ndarray, min_side: float) -> _Outline | None:
    """Return the outline of a contour, or None if it has not four corners."""
    area, length = cv2.contourArea(contour), cv2.arcLength(contour, True)
    # The contour runs through the centres of pixels.
    if length < 4.0 * (min_side - 1.0) or area < _LEAST_AREA * length * length:
        return None
    simple = cv2.approxPolyDP(contour, max(1.0, _OUTLINE_TOLERANCE * length), True)
    if len(simple) != 4 or not cv2.isContourConvex(simple):
        return None
    # OpenCV runs around a dark piece counter-clockwise.
    corners, points = simple[::-1, 0].astype(float), contour[::-1, 0].astype(float)
    edges = corners[NEXT] - corners
    if lengths_of(edges).min() < _MIN_EDGE * length:
        return None
    # A complex number is compared at once, both coordinates.
    places = (points.view(complex) == corners.view(complex).T).argmax(axis=0)
    return _Outline(points[0], np.tile(points - points[0], (2, 1)), places)


def _hull_quad(contour: ndarray) -> ndarray:
    """Return (4, 2) where the lines along the hull's four longest sides meet; NaN if no marker."""
    hull = cv2.convexHull(contour)
    area, length = cv2.contourArea(hull), cv2.arcLength(hull, True)
    corners = cv2.approxPolyDP(hull, _HULL_TOLERANCE * length, True)[:, 0].astype(float)
    if area >= _LEAST_AREA * length * length and len(corners) in _HULL_CORNERS:
        sides = np.roll(corners, -1, axis=0) - corners
        longest = np.sort(np.argsort(-lengths_of(sides), kind="stable")[:4])
        points = contour[:, 0].astype(float)
        lines = [_line_along(points, corners[k], sides[k]) for k in longest]
        quad = intersections(*np.array(lines).swapaxes(0, 1))
        outline = quad.astype(np.float32)
        is_convex = np.isfinite(quad).all() and cv2.isContourConvex(outline)
        if is_convex and cv2.contourArea(outline) <= _WITH_CORNER * area:
            return quad
    return np.full((4, 2), np.nan)


def _line_along(points: ndarray, first: ndarray, side: ndarray) -> tuple[ndarray, ndarray]:
    """Return a point and the normal of the line through the points (n, 2) beside a side.

    A bulge at one end of a side turns its line, so points are chosen anew in narrower strips.
    """
    length = lengths_of(side)
    middle, along = first + 0.5 * side, side / length
    for half_width in _STRIPS:
        away = points - middle
        near = np.abs(cross(away, along)) < max(1.0, half_width * length)
        near &= np.abs(away @ along) < (0.5 - _OPEN_TRIM) * length
        if np.count_nonzero(near) >= _LEAST_POINTS:
            line = cv2.fitLine(points[near], cv2.DIST_L2, 0.0, 0.01, 0.01).ravel()
            middle, along = line[2:], line[:2]
    return middle, right_of(along)


# Samples of a cell along each edge, and the part of the edge that they cover.
_SAMPLES = 7
_COVERED = 0.8
# A cell is not empty if this share of its samples is darker than white by this part of the
# contrast.
_DARK_SHARE = 0.2
_DARKER = 0.25
# Shares of the black and of the white samples that are darker than the levels of black and white.
_BLACK_SHARE = 0.5
_WHITE_SHARE = 0.75
# At most so many cells are searched, the darkest first.
_MOST_CELLS = 3
# A cell is enlarged to about so many px, at most by this factor.
_ENLARGED = 160.0
_LARGEST_SCALE = 6
# Thresholds, as parts of the contrast, and the grey levels of black and of the contrast then.
_THRESHOLDS = (0.4, 0.55, 0.7, 0.82)
_BLACK_LEVEL = 25.0
_CONTRAST = 200.0
# Standard deviation of the smoothing before, px.
_SMOOTHING = 0.8


def quads_in_cells(
    picture: Picture, corners: ndarray, pattern: ndarray, min_side: float, known: ndarray
) -> ndarray:
    """Return the dark quadrilaterals in the white cells of a marker, where a smaller one may be.

    Where it is small or the light is poor, thresholds of the whole image miss it. The marker around
    a cell shows how bright black and white are there.

    Args:
        picture: the image.
        corners: (4, 2) of the marker, ideal px, clockwise from its top left.
        pattern: (n, n) its cells with the border, 1 for white.
        min_side: px, least mean length of the sides that are looked for.
        known: (k, 4, 2) of markers; a cell with a smaller one in it is left out.

    Returns:
        (m, 4, 2) corners u, v in px of the image, clockwise.
    """
    cells = len(pattern)
    if lengths_of(corners[NEXT] - corners).min() < cells * min_side:
        return _NONE
    to_image = homography(corners)
    levels = picture.at(mapped(_cell_samples(cells), to_image)).reshape(cells * cells, _SAMPLES**2)
    is_white = (pattern > 0).ravel()
    black = _quantile(levels[~is_white], _BLACK_SHARE)
    white = _quantile(levels[is_white], _WHITE_SHARE)
    contrast = white - black
    # Light that falls off strongly across a marker of little contrast.
    if contrast < 1.0:
        return _NONE
    dark = int(_DARK_SHARE * levels.shape[1])
    darkness = (white - np.partition(levels, dark, axis=1)[:, dark]) / contrast
    darkness[~is_white] = 0.0
    darkest = np.argsort(-darkness, kind="stable")
    darkest = darkest[: np.count_nonzero(darkness > _DARKER)]
    if not len(darkest):
        return _NONE
    others = known[mean_side(known) < mean_side(corners)].mean(axis=1)
    column, row = (cells * mapped(others, cv2.invert(to_image)[1])).T
    within = (np.minimum(column, row) >= 0.0) & (np.maximum(column, row) < cells)
    taken = cells * row[within].astype(int) + column[within].astype(int)
    darkest = darkest[~np.isin(darkest, taken)][:_MOST_CELLS]
    found = [_NONE]
    for index in darkest.tolist():
        row, column = divmod(index, cells)
        outline = picture.seen(mapped((UNIT_SQUARE + (column, row)) / cells, to_image))
        found.append(_quads_within(picture.levels, outline, black, contrast, min_side))
    return np.concatenate(found)


def _quantile(levels: ndarray, part: float) -> float:
    index = int(part * levels.size)
    return float(np.partition(levels, index, axis=None)[index])


def _quads_within(
    image: ndarray, outline: ndarray, black: float, contrast: float, min_side: float
) -> ndarray:
    """Return the dark quadrilaterals within an outline (4, 2)."""
    height, width = image.shape
    left, top = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, (width, height))
    if min(right - left, bottom - top) < min_side:
        return _NONE
    cell = image[top:bottom, left:right].astype(np.float32)
    scale = int(np.clip(_ENLARGED / max(cell.shape), 1, _LARGEST_SCALE))
    cell = cv2.GaussianBlur(cell, (0, 0), _SMOOTHING)
    cell = cv2.resize(cell, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    # Beyond the cell all is white, so that black neighbours do not join what is in it.
    inside = np.zeros(cell.shape, dtype=np.uint8)
    polygon = scale * (outline - (left, top) + 0.5) - 0.5
    cv2.fillConvexPoly(inside, np.rint(polygon).astype(np.int32), 255)
    spread = np.clip((cell - black) * (_CONTRAST / contrast) + _BLACK_LEVEL, 0.0, 255.0)
    grey = np.where(inside, np.rint(spread), 255.0).astype(np.uint8)
    outlines = []
    for threshold in _THRESHOLDS:
        limit = _BLACK_LEVEL + _CONTRAST * threshold
        _, dark = cv2.threshold(grey, limit, 255, cv2.THRESH_BINARY_INV)
        contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        # OpenCV orients the contours of dark pieces and those of holes in them oppositely.
        outer = [one for one in contours if cv2.contourArea(one, oriented=True) < 0.0]
        outlines += _outlines_of(outer, scale * min_side)
    quads = sound_quads(_outlined_quads(outlines, _FIRST_TRIM))
    return (quads + 0.5) / scale - 0.5 + (left, top)


@lru_cache
def _cell_samples(cells: int) -> ndarray:
    """Return (n, 2) points of the unit square, cell by cell, row by row."""
    within = 0.5 + _COVERED * (np.arange(_SAMPLES) / (_SAMPLES - 1.0) - 0.5)
    each = np.arange(cells)
    row, column, down, right = np.meshgrid(each, each, within, within, indexing="ij")
    return np.column_stack(((column + right).ravel(), (row + down).ravel())) / cells
