"""Search for candidates: dark convex quadrilaterals that may be markers, to about a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterable, NamedTuple, Sequence

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.algebra import NEXT, intersections
from bullet_lab.vision.dark_pieces import (
    LEAST_AREA,
    DarkPieces,
    Placed,
    contours_of,
    dark_pieces,
    darker_part,
)

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
_FEW_PIECES = 12
# Least side that is looked for in the image of half the size, px of the full size.
_COARSE_SIDE = 20.0

# Borders with a gap: least width and height together, px.
_LEAST_OPEN = 40
# At most so many contours of a mask are tried, the largest first.
_MOST_OPEN = 12
# A hull is simplified by up to this share of its length and then has so many corners.
_HULL_TOLERANCE = 0.02
_HULL_CORNERS = (4, 5, 6)
# Most area of a quadrilateral over that of the hull, which lacks a corner.
_WITH_CORNER = 1.15
# Rounds of the line fit: half width of the strip in which points are used, as a share of the side,
# and iterations of the fit. Many iterations make it robust.
_STRIPS = ((0.06, 1), (0.03, 1), (0.015, 15))
# Share of a side that is left out at either end.
_OPEN_TRIM = 0.16
# Points nearer to the line than this have the same weight, px.
_ON_LINE = 0.05
# Least points of a line, and most of a contour.
_LEAST_POINTS = 8
_MOST_POINTS = 256


@dataclass(frozen=True)
class _Mask:
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
    joined: bool = False
    coarse: bool = False
    ceiling: int = 255


# A large part keeps a border whole that light, blur or noise has broken. A small part separates a
# marker with a narrow quiet zone from what is dark beside it.
_FIRST_PASS = (_Mask(3, 0.5, joined=True), _Mask(9, 0.6, coarse=True))
_SECOND_PASS = (_Mask(5, 0.25, joined=True), _Mask(13, 0.45, joined=True, coarse=True))
# Also in the second pass, of an image with few pieces.
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
# With narrow windows a border with a gap is a line that ends at either side of the gap.
_OPEN_PASS = (
    _Mask(3, 0.6, joined=True),
    _Mask(3, 0.7, joined=True),
    _Mask(5, 0.4, joined=True),
    _Mask(3, 0.5, joined=True, coarse=True),
)


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
        self._contours = 0
        self._is_clear = False
        # The third pass uses masks of the second one again.
        self._pieces: dict[_Mask, DarkPieces] = {}

    def first_pass(self, contrast: float) -> ndarray:
        """Return the outlines with four corners that the usual masks show."""
        return self._outlines(_FIRST_PASS, contrast, _FIRST_TRIM)

    def second_pass(self, contrast: float) -> ndarray:
        """Return those of other masks, of more of them in an image with few pieces."""
        self._is_clear = self._contours < _FEW_PIECES
        masks = _SECOND_PASS + _MORE_MASKS if self._is_clear else _SECOND_PASS
        return self._outlines(masks, contrast, _SECOND_TRIM)

    def open_pass(self, contrast: float) -> ndarray:
        """Return borders with a gap or a hidden corner, in an image with few pieces.

        Something before a corner that is as dark as the wall behind joins the two: no threshold
        shows four corners then. The hull of the border still has four long sides.
        """
        sides: list[_OpenSides] = []
        for mask in _OPEN_PASS if self._is_clear else ():
            least = max(0.5 * _LEAST_OPEN, self._least_side(mask)) + 1.0
            contours = contours_of(self._dark(mask, contrast), least, is_open=True)
            sides += _open_sides(list(contours), mask.coarse)
        return sound_quads(self._full_size(*_open_quads(sides)))

    def _outlines(self, masks: Sequence[_Mask], contrast: float, trim: float) -> ndarray:
        outlines: list[_Outline] = []
        for mask in masks:
            least = self._least_side(mask)
            contours = list(contours_of(self._dark(mask, contrast), least))
            self._contours += len(contours)
            outlines += _outlines_of(contours, least, mask.coarse)
        coarse = np.array([outline.coarse for outline in outlines], dtype=bool)
        return sound_quads(self._full_size(_fit_sides(outlines, trim), coarse))

    def _dark(self, mask: _Mask, contrast: float) -> DarkPieces:
        """Return the pieces that are dark by a mask."""
        if mask not in self._pieces:
            grey = self._half if mask.coarse else self._grey
            if mask.ceiling < 255:
                grey = cv2.min(grey, mask.ceiling)
            dark = darker_part(grey, mask.window, mask.part, math.ceil(contrast))
            self._pieces[mask] = dark_pieces(dark, mask.joined)
        return self._pieces[mask]

    def _least_side(self, mask: _Mask) -> float:
        """Return the least side to look for in a mask, px of the mask."""
        return 0.5 * max(self._min_side, _COARSE_SIDE) if mask.coarse else self._min_side

    def _full_size(self, quads: ndarray, coarse: ndarray) -> ndarray:
        """Return quadrilaterals in px of the image; `coarse` (n,) are those of half the size."""
        scale = np.array(self._grey.shape[::-1]) / np.array(self._half.shape[::-1])
        # The centre of a pixel is a whole number.
        quads[coarse] = (quads[coarse] + 0.5) * scale - 0.5
        return quads


def outlines_within(dark: ndarray, min_side: float) -> ndarray:
    """Return (n, 4, 2) outlines with four corners of dark pieces in a small mask (h, w)."""
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # OpenCV orients the contours of dark pieces and those of holes in them oppositely.
    outer = (contour for contour in contours if cv2.contourArea(contour, oriented=True) < 0.0)
    outlines = _outlines_of(((contour, (0, 0)) for contour in outer), min_side)
    return sound_quads(_fit_sides(outlines, _FIRST_TRIM))


def sound_quads(quads: ndarray) -> ndarray:
    """Return those of (n, 4, 2) quadrilaterals that have four corners, all finite, px.

    >>> side = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    >>> flat = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 5.0], [9.0, 9.0]])
    >>> len(sound_quads(np.stack((side, flat, side * np.nan))))
    1
    """
    with np.errstate(invalid="ignore"):
        sides = quads[:, NEXT] - quads
        corners = _cross(sides, sides[:, NEXT])
    # The cross product of sides that are not finite is NaN, which is no greater.
    return quads[(np.abs(corners) > _LEAST_CORNER).all(axis=1)]


def same_quads(quads: ndarray, sides: ndarray) -> ndarray:
    """Return which (n, n) of (n, 4, 2) quadrilaterals are the same to a fraction of a cell.

    Their middles and the mean lengths of their sides, `sides` (n,), agree.
    """
    middles = quads.mean(axis=1)
    away = np.abs(middles[:, None] - middles).max(axis=2)
    larger = np.abs(sides[:, None] - sides)
    # A marker's white surroundings on a bright ground are a dark square one cell larger.
    return np.maximum(away, larger) < (1.0 + 0.04 * sides)[:, None]


def mean_sides(quads: ndarray) -> ndarray:
    """Return the mean length (n,) of the sides of each of (n, 4, 2) corners, px."""
    return np.linalg.norm(quads[:, NEXT] - quads, axis=2).mean(axis=1)


def _cross(first: ndarray, second: ndarray) -> ndarray:
    """Return the cross products (...) of vectors (..., 2)."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def _line_angle(x, y, xx, xy, yy) -> ndarray:
    """Return the direction, rad, of lines by the means of points' x, y, x², x y and y²."""
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    return 0.5 * np.arctan2(2.0 * xy, xx - yy)


@dataclass(frozen=True, eq=False)
class _Outline:
    """A contour (n, 2) with four corners, and the indices of these, clockwise."""

    contour: ndarray
    places: list[int]
    coarse: bool


def _outlines_of(
    contours: Iterable[Placed], min_side: float, coarse: bool = False
) -> list[_Outline]:
    outlines = []
    for contour, offset in contours:
        corners = _corners_of(contour, min_side)
        if corners is not None:
            # OpenCV runs around a dark piece counter-clockwise.
            points = contour[::-1, 0].astype(float)
            # A complex number is compared at once, both coordinates.
            places = (points.view(complex) == corners.view(complex).T).argmax(axis=0)
            outlines.append(_Outline(points + offset, places.tolist(), coarse))
    return outlines


def _corners_of(contour: ndarray, min_side: float) -> ndarray | None:
    """Return the (4, 2) points of a contour that are its corners, or None if it has not four."""
    # A diagonal step counts as one pixel; the contour runs through the centres of pixels.
    count = len(contour)
    if count < 2.8 * (min_side - 1.0):
        return None
    # The length of a contour is at least the number of its points, which is quicker to compare.
    area = cv2.contourArea(contour)
    if area < LEAST_AREA * count * count:
        return None
    length = cv2.arcLength(contour, True)
    if length < 4.0 * (min_side - 1.0) or area < LEAST_AREA * length * length:
        return None
    outline = cv2.approxPolyDP(contour, max(1.0, _OUTLINE_TOLERANCE * length), True)
    if len(outline) != 4 or not cv2.isContourConvex(outline):
        return None
    corners = outline[::-1, 0].astype(float)
    edges = corners[NEXT] - corners
    if np.hypot(edges[:, 0], edges[:, 1]).min() < _MIN_EDGE * length:
        return None
    return corners


def _fit_sides(outlines: Sequence[_Outline], trim: float) -> ndarray:
    """Return the corners (n, 4, 2) at which the lines fitted to the outlines' sides meet.

    The fit is of least squares, without the share `trim` of each side at either end.
    """
    if not outlines:
        return np.empty((0, 4, 2))
    contours = [outline.contour for outline in outlines]
    places = np.array([outline.places for outline in outlines])
    counts = np.array([len(contour) for contour in contours])
    middles = np.array([contour[0] for contour in contours])
    # A side may run across a contour's end, so each contour is there twice.
    doubled = [part for contour, first in zip(contours, middles) for part in [contour - first] * 2]
    sums = _running_sums(np.concatenate(doubled))
    steps = (places[:, NEXT] - places) % counts[:, None]
    trims = (trim * steps).astype(int)
    starts = places + np.concatenate(([0], np.cumsum(2 * counts)[:-1]))[:, None]
    number = steps - 2 * trims + 1
    of_sides = sums[:, starts + steps - trims + 1] - sums[:, starts + trims]
    x, y, xx, xy, yy = of_sides / number
    angle = _line_angle(x, y, xx, xy, yy)
    normals = np.stack((np.sin(angle), -np.cos(angle)), axis=-1)
    corners = np.stack([contour[at] for contour, at in zip(contours, places)])
    inward = _cross(corners[:, NEXT] - corners, normals) > 0.0
    normals[inward] *= -1.0
    # The contour runs through the centres of the outermost dark pixels.
    points = np.stack((x, y), axis=-1) + middles[:, None] + 0.5 * normals
    return intersections(points, normals)


def _running_sums(points: ndarray) -> ndarray:
    """Return the sums (5, n + 1) of x, y, x², x y and y² of the points (n, 2) before each."""
    x, y = points.T
    sums = np.zeros((5, len(x) + 1))
    for row, part in zip(sums, (x, y, x * x, x * y, y * y)):
        part.cumsum(out=row[1:])
    return sums


class _OpenSides(NamedTuple):
    """The four longest sides of a contour's hull.

    Attributes:
        contour: (n, 2) some of its points.
        first: (4, 2) where the sides begin.
        along: (4, 2) from there to where they end.
        area: of the hull.
        coarse: of the image of half the size.
    """

    contour: ndarray
    first: ndarray
    along: ndarray
    area: float
    coarse: bool


def _open_sides(contours: list[Placed], coarse: bool) -> list[_OpenSides]:
    """Return the sides of the largest contours whose hull may be square but for a corner."""
    contours.sort(key=lambda placed: -float(np.ptp(placed[0][:, 0], axis=0).sum()))
    sides = (_sides_of_hull(contour, offset, coarse) for contour, offset in contours[:_MOST_OPEN])
    return [of_one for of_one in sides if of_one is not None]


def _sides_of_hull(
    contour: ndarray, offset: tuple[int, int], coarse: bool
) -> _OpenSides | None:
    hull = cv2.convexHull(contour)
    area, length = cv2.contourArea(hull), cv2.arcLength(hull, True)
    if area < LEAST_AREA * length * length:
        return None
    simple = cv2.approxPolyDP(hull, _HULL_TOLERANCE * length, True)[:, 0].astype(float)
    if len(simple) not in _HULL_CORNERS:
        return None
    edges = np.roll(simple, -1, axis=0) - simple
    longest = np.sort(np.argsort(-np.hypot(edges[:, 0], edges[:, 1]), kind="stable")[:4])
    some = contour[:: 1 + len(contour) // _MOST_POINTS, 0].astype(float)
    return _OpenSides(some + offset, simple[longest] + offset, edges[longest], area, coarse)


def _open_quads(sides: Sequence[_OpenSides]) -> tuple[ndarray, ndarray]:
    """Return (n, 4, 2) where the lines along four sides meet, and which (n,) of it are coarse."""
    if not sides:
        return np.empty((0, 4, 2)), np.empty(0, dtype=bool)
    quads = intersections(*_lines_along(sides))
    own = np.isfinite(quads).all(axis=(1, 2))
    for k in np.flatnonzero(own):
        quad = quads[k].astype(np.float32)
        own[k] = cv2.isContourConvex(quad)
        own[k] &= cv2.contourArea(quad) <= _WITH_CORNER * sides[k].area
    coarse = np.array([of_one.coarse for of_one in sides])
    return quads[own], coarse[own]


def _lines_along(sides: Sequence[_OpenSides]) -> tuple[ndarray, ndarray]:
    """Return points and normals (n, 4, 2) of the lines through the contours' points beside sides.

    A bulge at one end of a side turns its line, so points are chosen anew in narrower strips.
    """
    contours = np.concatenate([of_one.contour for of_one in sides])
    owners = np.repeat(np.arange(len(sides)), [len(of_one.contour) for of_one in sides])
    along = np.stack([of_one.along for of_one in sides])
    points = np.stack([of_one.first for of_one in sides]) + 0.5 * along
    lengths = np.hypot(along[..., 0], along[..., 1])
    along /= lengths[..., None]
    for half_width, rounds in _STRIPS:
        away = contours[:, None] - points[owners]
        own = along[owners]
        ahead = away[..., 0] * own[..., 0] + away[..., 1] * own[..., 1]
        across = _cross(away, own)
        near = np.abs(across) < np.maximum(1.0, half_width * lengths)[owners]
        near &= np.abs(ahead) < ((0.5 - _OPEN_TRIM) * lengths)[owners]
        of_point, side = near.nonzero()
        side += 4 * owners[of_point]
        moved, turned = _lines_through(away[near], side, 4 * len(sides), rounds)
        enough = (np.bincount(side, minlength=4 * len(sides)) >= _LEAST_POINTS).reshape(-1, 4, 1)
        points = points + np.where(enough, moved.reshape(-1, 4, 2), 0.0)
        along = np.where(enough, turned.reshape(-1, 4, 2), along)
    return points, np.stack((along[..., 1], -along[..., 0]), axis=-1)


def _lines_through(
    points: ndarray, line: ndarray, count: int, rounds: int
) -> tuple[ndarray, ndarray]:
    """Return a point and the unit vector (count, 2) of each line fitted to points (n, 2).

    The first round is least squares. Each further one weights points by the inverse of their
    distance, which approaches least distances. Lines without points are NaN.

    Args:
        points: px.
        line: (n,) index of each point's line.
        count: number of lines.
        rounds: of the fit.
    """
    x, y = points.T
    weights = np.ones(len(points))
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(rounds):
            parts = (weights, weights * x, weights * y)
            parts += (parts[1] * x, parts[1] * y, parts[2] * y)
            total, *sums = (np.bincount(line, part, count) for part in parts)
            means = [part / total for part in sums]
            angle = _line_angle(*means)
            middle = np.stack(means[:2], axis=-1)
            along = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
            across = _cross(points - middle[line], along[line])
            weights = 1.0 / np.maximum(np.abs(across), _ON_LINE)
    return middle, along
