"""Dark convex quadrilaterals in an image, which may be markers, to about a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Iterable, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import intersections
from bullet_lab.vision.dark_pieces import (
    LEAST_AREA,
    DarkPieces,
    Placed,
    contours_of,
    dark_pieces,
    darker_part,
)
from bullet_lab.vision.open_outlines import OpenSides, open_quads, open_sides

# Part of its outline's length by which a quadrilateral may differ from a contour.
_OUTLINE_TOLERANCE = 0.035
# Corners nearer than this part of the outline's length are one.
_MIN_EDGE = 0.05
# A side's line is fitted to its contour without so much at either end, at the second look more: a
# dark thing before a corner is a part of the contour.
_FIRST_TRIM, _SECOND_TRIM = 0.15, 0.32
# px²; sides whose product is less make no corner.
_LEAST_CORNER = 1.0


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
# Narrow ones show a border that is open as a line that ends at either side of the gap.
_LAST_LOOK = (
    _Mask(3, 0.6, joined=True),
    _Mask(3, 0.7, joined=True),
    _Mask(5, 0.4, joined=True),
    _Mask(3, 0.5, joined=True, coarse=True),
)
_FEW_PIECES = 12
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
        self._is_clear = False
        # What the second look has of the masks of the last one.
        self._kept: Dict[Tuple[_Mask, float], DarkPieces] = {}

    def first_look(self, contrast: float) -> np.ndarray:
        """Return (n, 4, 2) corners u, v in px, clockwise as one looks at the image.

        The same quadrilateral may be there several times.

        Args:
            contrast: grey levels between black and white.
        """
        return self._look(_FIRST_LOOK, contrast, _FIRST_TRIM)

    def second_look(self, contrast: float) -> np.ndarray:
        """Return what other thresholds show, likewise; more of them where they cost little."""
        masks = list(_SECOND_LOOK)
        self._is_clear = self._pieces < _FEW_PIECES
        if self._is_clear:
            masks += _MORE_MASKS
        return self._look(masks, contrast, _SECOND_TRIM)

    def last_look(self, contrast: float) -> np.ndarray:
        """Return what is square but for a gap or a hidden corner, likewise, after a second look.

        Only where it costs little.
        """
        sides: List[OpenSides] = []
        for mask in _LAST_LOOK if self._is_clear else ():
            sides += open_sides(self._dark(mask, contrast), self._least(mask), mask.coarse)
        return sound_quads(self._full_size(*open_quads(sides)))

    def _look(self, masks: Sequence[_Mask], contrast: float, trim: float) -> np.ndarray:
        outlines: List[_Outline] = []
        for mask in masks:
            least = self._least(mask)
            contours = list(contours_of(self._dark(mask, contrast), least))
            self._pieces += len(contours)
            outlines += _outlines_of(contours, least, mask.coarse)
        coarse = np.array([outline.coarse for outline in outlines], dtype=bool)
        return sound_quads(self._full_size(_fit_sides(outlines, trim), coarse))

    def _dark(self, mask: _Mask, contrast: float) -> DarkPieces:
        """Return the pieces of what a mask holds dark."""
        if (mask, contrast) in self._kept:
            return self._kept[mask, contrast]
        grey = self._half if mask.coarse else self._grey
        if mask.ceiling < 255:
            grey = cv2.min(grey, mask.ceiling)
        dark = darker_part(grey, mask.window, mask.part, math.ceil(contrast))
        pieces = dark_pieces(dark, mask.joined)
        if mask in _LAST_LOOK:
            self._kept[mask, contrast] = pieces
        return pieces

    def _least(self, mask: _Mask) -> float:
        """Return the least side to look for in a mask, px."""
        return 0.5 * max(self._min_side, _COARSE_SIDE) if mask.coarse else self._min_side

    def _full_size(self, quads: np.ndarray, coarse: np.ndarray) -> np.ndarray:
        """Return quadrilaterals with those (n,) of the image of half the size where they are."""
        scale = np.array(self._grey.shape[::-1]) / np.array(self._half.shape[::-1])
        # Pixels are numbered at their centres.
        quads[coarse] = (quads[coarse] + 0.5) * scale - 0.5
        return quads


def outlines_within(dark: np.ndarray, min_side: float) -> np.ndarray:
    """Return (n, 4, 2) outlines of what is dark and has four corners in a small mask (h, w)."""
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # OpenCV runs around what is dark in one sense, around the holes in it in the other.
    outer = (contour for contour in contours if cv2.contourArea(contour, oriented=True) < 0.0)
    outlines = _outlines_of(((contour, (0, 0)) for contour in outer), min_side)
    quads = _fit_sides(outlines, _FIRST_TRIM)
    return sound_quads(quads)


def sound_quads(quads: np.ndarray) -> np.ndarray:
    """Return those of (n, 4, 2) quadrilaterals that have four corners, at finite places, px.

    >>> side = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    >>> flat = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 5.0], [9.0, 9.0]])
    >>> len(sound_quads(np.stack((side, flat, side * np.nan))))
    1
    """
    with np.errstate(invalid="ignore"):
        sides = quads[:, _NEXT] - quads
        following = sides[:, _NEXT]
        corners = sides[..., 0] * following[..., 1] - sides[..., 1] * following[..., 0]
    # Of what is not finite it is NaN, which is no greater.
    return quads[(np.abs(corners) > _LEAST_CORNER).all(axis=1)]


def same_quads(quads: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return which (n, n) of (n, 4, 2) quadrilaterals are the same, to a fraction of a cell.

    These have the same middle and are as large: `sides` (n,) are the mean lengths of their sides.
    """
    middles = quads.mean(axis=1)
    away = np.abs(middles[:, None] - middles).max(axis=2)
    larger = np.abs(sides[:, None] - sides)
    # A marker's white surroundings on a bright ground are a dark square one cell larger.
    return np.maximum(away, larger) < (1.0 + 0.04 * sides)[:, None]


def mean_sides(quads: np.ndarray) -> np.ndarray:
    """Return the mean length (n,) of the sides of each of (n, 4, 2) corners, px."""
    return np.linalg.norm(quads[:, _NEXT] - quads, axis=2).mean(axis=1)


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
    contours: Iterable[Placed], min_side: float, coarse: bool = False
) -> List[_Outline]:
    outlines = []
    for contour, offset in contours:
        corners = _outline_of(contour, min_side)
        if corners is not None:
            # OpenCV runs around what is dark counter-clockwise.
            points = contour[::-1, 0].astype(float)
            # As complex numbers, whole points are compared.
            places = (points.view(complex) == corners.view(complex).T).argmax(axis=0)
            outlines.append(_Outline(points + offset, places.tolist(), coarse))
    return outlines


def _outline_of(contour: np.ndarray, min_side: float) -> Optional[np.ndarray]:
    """Return the (4, 2) points of a contour that are its corners, or None if it has not four."""
    # A diagonal step counts as one pixel; the contour runs through the centres of pixels.
    count = len(contour)
    if count < 2.8 * (min_side - 1.0):
        return None
    # A contour is as long as it has points, at least.
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
    edges = corners[_NEXT] - corners
    if np.hypot(edges[:, 0], edges[:, 1]).min() < _MIN_EDGE * length:
        return None
    return corners


_NEXT = [1, 2, 3, 0]


def _fit_sides(outlines: Sequence[_Outline], trim: float) -> np.ndarray:
    """Return corners (n, 4, 2) where lines (least squares) through the outlines' sides meet.

    Without so large a part of each side at either end.
    """
    if not outlines:
        return np.empty((0, 4, 2))
    contours = [outline.contour for outline in outlines]
    places = np.array([outline.places for outline in outlines])
    counts = np.array([len(contour) for contour in contours])
    middles = np.array([contour[0] for contour in contours])
    # Sums of x, y, x², xy, y² up to each place, twice around each contour.
    doubled = [part for contour, first in zip(contours, middles) for part in [contour - first] * 2]
    x, y = np.concatenate(doubled).T
    sums = np.zeros((5, len(x) + 1))
    for row, part in zip(sums, (x, y, x * x, x * y, y * y)):
        part.cumsum(out=row[1:])
    steps = (places[:, _NEXT] - places) % counts[:, None]
    trims = (trim * steps).astype(int)
    starts = places + np.concatenate(([0], np.cumsum(2 * counts)[:-1]))[:, None]
    number = steps - 2 * trims + 1
    x, y, xx, xy, yy = sums[:, starts + steps - trims + 1] - sums[:, starts + trims]
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
