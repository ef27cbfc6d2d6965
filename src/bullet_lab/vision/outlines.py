"""Dark convex quadrilaterals in an image, which may be markers, to about a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Dict, Iterable, Iterator, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import intersections

# Part of its outline's length by which a quadrilateral may differ from a contour.
_OUTLINE_TOLERANCE = 0.035
# Corners nearer than this part of the outline's length are one.
_MIN_EDGE = 0.05
# A side's line is fitted to its contour without so much at either end, at the second look more: a
# dark thing before a corner is a part of the contour.
_FIRST_TRIM, _SECOND_TRIM = 0.15, 0.32
# px²; sides whose product is less make no corner.
_LEAST_CORNER = 1.0
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
# Narrow ones show a border that is open as a line that ends at either side of the gap.
_LAST_LOOK = (
    _Mask(3, 0.6, joined=True),
    _Mask(3, 0.7, joined=True),
    _Mask(5, 0.4, joined=True),
    _Mask(3, 0.5, joined=True, coarse=True),
)
_FEW_PIECES = 12
# The points of an outline by the box around it, of which what is convex has two at most.
_RAGGED = 2.2
# A border with a gap has an inner side as well, and the cells beside it may hang on it.
_OPEN_RAGGED = 8.0
# px, width and height together, from which on borders with a gap are looked for; at most so many
# of an image's pieces, the largest first.
_LEAST_OPEN, _MOST_OPEN = 40, 12
# Part of a hull's length by which what is simpler may differ from it, and its corners then.
_HULL_TOLERANCE = 0.02
_HULL_CORNERS = (4, 5, 6)
# Most by which a quadrilateral may be larger than such a hull, which lacks a corner.
_WITH_CORNER = 1.15
# Parts of a side's length beside its line, in which its points are, and how the line is fitted: the
# last time with little regard for those that are far off, which takes 30 times as long.
_BESIDE = ((0.06, cv2.DIST_L2), (0.03, cv2.DIST_L2), (0.015, cv2.DIST_L1))
# So many make a line.
_LEAST_POINTS = 8
# Of a whole contour: OpenCV goes through those of a line up to 600 times.
_MOST_POINTS = 256
# Half the size shows markers from this side on, px.
_COARSE_SIDE = 20.0
# Of 16 bits, without that of what is not dark and the one that OpenCV would give next: with more,
# it writes to where it must not.
_MOST_LABELS = 65534
# px; pieces that are smaller each way are traced together.
_TILE = 24
_OUTER = cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
# A contour (n, 1, 2), and what is to be added to its u and v.
_Placed = Tuple[np.ndarray, Tuple[int, int]]


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
        quads = [np.empty((0, 4, 2))]
        for mask in _LAST_LOOK if self._is_clear else ():
            dark, least = self._dark(mask, contrast)
            found = _open_quads(_pieces(dark, least, mask.joined, is_open=True), least)
            quads.append(self._full_size(found) if mask.coarse else found)
        return sound_quads(np.concatenate(quads))

    def _look(self, masks: Sequence[_Mask], contrast: float, trim: float) -> np.ndarray:
        outlines: List[_Outline] = []
        for mask in masks:
            dark, least = self._dark(mask, contrast)
            contours = list(_pieces(dark, least, mask.joined))
            self._pieces += len(contours)
            outlines += _outlines_of(contours, least, mask.coarse)
        quads = _fit_sides(outlines, trim)
        coarse = np.array([outline.coarse for outline in outlines], dtype=bool)
        quads[coarse] = self._full_size(quads[coarse])
        return sound_quads(quads)

    def _dark(self, mask: _Mask, contrast: float) -> Tuple[np.ndarray, float]:
        """Return what a mask holds dark, 255, and the least side to look for in it, px."""
        grey, least = self._grey, self._min_side
        if mask.coarse:
            grey, least = self._half, 0.5 * max(least, _COARSE_SIDE)
        if mask.ceiling < 255:
            grey = cv2.min(grey, mask.ceiling)
        return darker_part(grey, mask.window, mask.part, math.ceil(contrast)), least

    def _full_size(self, quads: np.ndarray) -> np.ndarray:
        """Return where points of the image of half the size are in the whole one."""
        scale = np.array(self._grey.shape[::-1]) / np.array(self._half.shape[::-1])
        # Pixels are numbered at their centres.
        return (quads + 0.5) * scale - 0.5


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


def _pieces(
    dark: np.ndarray, min_side: float, joined: bool, is_open: bool = False
) -> Iterator[_Placed]:
    """Yield the outer contours of the pieces of a mask that are large and broad enough.

    Pieces hang together by the edges of pixels and, if `joined`, by their corners. Those of what
    `is_open` may be lines with two sides.
    """
    labels, stats = _labelled(dark, joined)
    stats[0] = 0
    # Most are small, and need no closer look.
    labelled = (stats[:, 2] + stats[:, 3] >= math.ceil(2.0 * min_side)).nonzero()[0]
    u, v, width, height, area = stats[labelled].T
    extent = width + height
    # The outline of what is convex is no longer than that of the box around it; a border is some
    # pixels wide.
    fits = area >= extent * (1.5 if is_open else np.clip(extent / 20.0, 1.5, 3.0))
    fits &= 8 * np.minimum(width, height) >= np.maximum(width, height)
    # What reaches the edge of the image is cut off by it.
    fits &= np.minimum(u, v) > 0
    fits &= (u + width < dark.shape[1]) & (v + height < dark.shape[0])
    ragged = _OPEN_RAGGED if is_open else _RAGGED
    labelled, most = labelled[fits], (ragged * extent[fits]).tolist()
    for placed, longest in zip(_contours(labels, labelled, stats[labelled, :4]), most):
        if len(placed[0]) <= longest:
            yield placed


def _labelled(dark: np.ndarray, joined: bool) -> Tuple[np.ndarray, np.ndarray]:
    """Return (h, w) labels of a mask's pieces, and (n, 5) u, v, width, height, area of each."""
    # Labels of 16 bits take less time. One is given only where a run of pixels begins in a row.
    runs = len(dark) * ((dark.shape[1] + 1) // 2)
    if runs > _MOST_LABELS:
        runs = len(dark) + cv2.countNonZero(cv2.subtract(dark[:, 1:], dark[:, :-1]))
    few = runs <= _MOST_LABELS
    # Either is the quicker one with its labels; both number the pieces alike.
    joining = cv2.CCL_SPAGHETTI if few else cv2.CCL_BBDT
    how = (8, joining) if joined else (4, cv2.CCL_DEFAULT)
    kind = cv2.CV_16U if few else cv2.CV_32S
    return cv2.connectedComponentsWithStatsWithAlgorithm(dark, how[0], kind, how[1])[1:3]


def _contours(labels: np.ndarray, labelled: np.ndarray, boxes: np.ndarray) -> List[_Placed]:
    """Return the outer contours of pieces that do not reach the edge of the image, in order.

    Args:
        labels: (h, w), which piece a pixel is of.
        labelled: (n,) labels of the pieces.
        boxes: (n, 4) u, v, width, height of each.
    """
    contours: Dict[int, _Placed] = {}
    is_small = boxes[:, 2:].max(axis=1, initial=0) < _TILE
    small, large = np.flatnonzero(is_small), np.flatnonzero(~is_small)
    if len(small):
        traced = _small_contours(labels, labelled[small], boxes[small, :2])
        contours.update(zip(small.tolist(), traced))
    for k, label, box in zip(large.tolist(), labelled[large].tolist(), boxes[large].tolist()):
        u, v, width, height = box
        piece = (labels[v : v + height, u : u + width] == label).view(np.uint8)
        contours[k] = cv2.findContours(piece, *_OUTER)[0][0], (u, v)
    return [contours[k] for k in range(len(labelled))]


def _small_contours(labels: np.ndarray, labelled: np.ndarray, corners: np.ndarray) -> List[_Placed]:
    """Return the contours of pieces smaller than a tile, with (n, 2) u, v of their boxes.

    All are put into one image, below one another: a call of OpenCV's for each takes longer than
    its work.
    """
    height, width = labels.shape
    rows, columns = min(_TILE, height), min(_TILE, width)
    # The last row of a tile is empty, as no piece reaches the last one of the image.
    corners = np.minimum(corners, (width - columns, height - rows))
    shape = (height - rows + 1, width - columns + 1, rows, columns)
    windows = np.ndarray(shape, labels.dtype, labels, strides=labels.strides * 2)
    tiles = windows[corners[:, 1], corners[:, 0]] == labelled.astype(labels.dtype)[:, None, None]
    below = cv2.findContours(tiles.reshape(-1, columns).view(np.uint8), *_OUTER)[0]
    contours = {int(contour[0, 0, 1]) // rows: contour for contour in below}
    return [(contours[k], (u, v - rows * k)) for k, (u, v) in enumerate(corners.tolist())]


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
    contours: Iterable[_Placed], min_side: float, coarse: bool = False
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
    if area < _LEAST_AREA * count * count:
        return None
    length = cv2.arcLength(contour, True)
    if length < 4.0 * (min_side - 1.0) or area < _LEAST_AREA * length * length:
        return None
    outline = cv2.approxPolyDP(contour, max(1.0, _OUTLINE_TOLERANCE * length), True)
    if len(outline) != 4 or not cv2.isContourConvex(outline):
        return None
    corners = outline[::-1, 0].astype(float)
    edges = corners[_NEXT] - corners
    if np.hypot(edges[:, 0], edges[:, 1]).min() < _MIN_EDGE * length:
        return None
    return corners


def _open_quads(contours: Iterable[_Placed], min_side: float) -> np.ndarray:
    """Return (n, 4, 2) corners of what is dark and square but for a gap, or a hidden corner.

    What is as dark as the marker's surroundings and lies on a corner joins the two: no threshold
    shows an outline with four corners then. The hull of the border still has four long sides.
    """
    sized = ((contour, offset, _extent(contour)) for contour, offset in contours)
    large = [one for one in sized if one[2] >= max(_LEAST_OPEN, 2.0 * min_side)]
    large.sort(key=lambda one: -one[2])
    quads = (_open_quad(contour, offset) for contour, offset, _ in large[:_MOST_OPEN])
    found = [quad for quad in quads if quad is not None]
    return np.stack(found) if found else np.empty((0, 4, 2))


def _extent(contour: np.ndarray) -> float:
    return float(np.ptp(contour[:, 0], axis=0).sum())


def _open_quad(contour: np.ndarray, offset: Tuple[int, int]) -> Optional[np.ndarray]:
    """Return where the lines along the four longest sides of a contour's hull meet, or None."""
    hull = cv2.convexHull(contour)
    area, length = cv2.contourArea(hull), cv2.arcLength(hull, True)
    if area < _LEAST_AREA * length * length:
        return None
    simple = cv2.approxPolyDP(hull, _HULL_TOLERANCE * length, True)[:, 0].astype(float)
    if len(simple) not in _HULL_CORNERS:
        return None
    edges = np.roll(simple, -1, axis=0) - simple
    longest = np.sort(np.argsort(-np.hypot(edges[:, 0], edges[:, 1]), kind="stable")[:4])
    some = contour[:: 1 + len(contour) // _MOST_POINTS, 0].astype(float)
    points, normals = _lines_along(some, simple[longest], edges[longest])
    quad = intersections(points, normals).astype(np.float32)
    if not np.isfinite(quad).all() or not cv2.isContourConvex(quad):
        return None
    if cv2.contourArea(quad) > _WITH_CORNER * area:
        return None
    return quad.astype(float) + offset


def _lines_along(
    contour: np.ndarray, first: np.ndarray, along: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Return points and normals (4, 2) of lines through what of a contour (n, 2) is beside sides.

    These begin at `first` (4, 2) and go `along` (4, 2). What sticks out at one end of a side turns
    it, so what is beside its line is chosen anew, more narrowly each time.
    """
    lengths = np.hypot(along[:, 0], along[:, 1])
    points = first + 0.5 * along
    along = along / lengths[:, None]
    for beside, kind in _BESIDE:
        for k in range(4):
            away = contour - points[k]
            across = away[:, 0] * along[k, 1] - away[:, 1] * along[k, 0]
            near = np.abs(across) < max(1.0, beside * lengths[k])
            near &= np.abs(away @ along[k]) < (0.5 - _SECOND_TRIM / 2) * lengths[k]
            if near.sum() >= _LEAST_POINTS:
                beside_it = contour[near].astype(np.float32)
                line = cv2.fitLine(beside_it, kind, 0, 0.01, 0.01).ravel()
                along[k], points[k] = line[:2], line[2:]
    return points, np.stack((along[:, 1], -along[:, 0]), axis=-1)


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
