"""Dark convex quadrilaterals in an image, which may be markers, to about a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

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
# Parts of a side's length beside its line, in which its points are, and in how many rounds the line
# is fitted: the last time with little regard for those that are far off.
_BESIDE = ((0.06, 1), (0.03, 1), (0.015, 15))
# px; points nearer to a line than this count alike.
_ON_LINE = 0.05
# So many make a line.
_LEAST_POINTS = 8
# Of a whole contour.
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
        # What the second look has of the masks of the last one.
        self._kept: Dict[_Mask, _Labelled] = {}

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
        sides: List[_OpenSides] = []
        for mask in _LAST_LOOK if self._is_clear else ():
            labelled = self._kept.get(mask) or self._labelled(mask, contrast)
            sides += _open_sides(labelled, self._least(mask), mask.coarse)
        return sound_quads(self._full_size(*_open_quads(sides)))

    def _look(self, masks: Sequence[_Mask], contrast: float, trim: float) -> np.ndarray:
        outlines: List[_Outline] = []
        for mask in masks:
            labelled, least = self._labelled(mask, contrast), self._least(mask)
            if mask in _LAST_LOOK:
                self._kept[mask] = labelled
            contours = list(_pieces(labelled, least))
            self._pieces += len(contours)
            outlines += _outlines_of(contours, least, mask.coarse)
        coarse = np.array([outline.coarse for outline in outlines], dtype=bool)
        return sound_quads(self._full_size(_fit_sides(outlines, trim), coarse))

    def _labelled(self, mask: _Mask, contrast: float) -> _Labelled:
        """Return the pieces of what a mask holds dark."""
        grey = self._half if mask.coarse else self._grey
        if mask.ceiling < 255:
            grey = cv2.min(grey, mask.ceiling)
        dark = darker_part(grey, mask.window, mask.part, math.ceil(contrast))
        return _labelled(dark, mask.joined)

    def _least(self, mask: _Mask) -> float:
        """Return the least side to look for in a mask, px."""
        return 0.5 * max(self._min_side, _COARSE_SIDE) if mask.coarse else self._min_side

    def _full_size(self, quads: np.ndarray, coarse: np.ndarray) -> np.ndarray:
        """Return quadrilaterals with those (n,) of the image of half the size where they are."""
        scale = np.array(self._grey.shape[::-1]) / np.array(self._half.shape[::-1])
        # Pixels are numbered at their centres.
        quads[coarse] = (quads[coarse] + 0.5) * scale - 0.5
        return quads


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


class _Labelled(NamedTuple):
    """The pieces of a mask: labels (h, w), and (n, 5) u, v, width, height, area by label.

    Label 0 is what is not dark, without an area.
    """

    labels: np.ndarray
    stats: np.ndarray


def _pieces(labelled: _Labelled, min_side: float, is_open: bool = False) -> Iterator[_Placed]:
    """Yield the outer contours of the pieces of a mask that are large and broad enough.

    Those of what `is_open` may be lines with two sides.
    """
    labels, stats = labelled
    # Most are small, and need no closer look.
    large = (stats[:, 2] + stats[:, 3] >= math.ceil(2.0 * min_side)).nonzero()[0]
    u, v, width, height, area = stats[large].T
    extent = width + height
    # The outline of what is convex is no longer than that of the box around it; a border is some
    # pixels wide.
    fits = area >= extent * (1.5 if is_open else np.clip(extent / 20.0, 1.5, 3.0))
    fits &= 8 * np.minimum(width, height) >= np.maximum(width, height)
    # What reaches the edge of the image is cut off by it.
    fits &= np.minimum(u, v) > 0
    fits &= (u + width < labels.shape[1]) & (v + height < labels.shape[0])
    ragged = _OPEN_RAGGED if is_open else _RAGGED
    large, most = large[fits], (ragged * extent[fits]).tolist()
    for placed, longest in zip(_contours(labels, large, stats[large, :4]), most):
        if len(placed[0]) <= longest:
            yield placed


def _labelled(dark: np.ndarray, joined: bool) -> _Labelled:
    """Return the pieces of what is dark.

    They hang together by the edges of pixels and, if `joined`, by their corners.
    """
    # Labels of 16 bits take less time. One is given only where a run of pixels begins in a row.
    runs = len(dark) * ((dark.shape[1] + 1) // 2)
    if runs > _MOST_LABELS:
        runs = len(dark) + cv2.countNonZero(cv2.subtract(dark[:, 1:], dark[:, :-1]))
    few = runs <= _MOST_LABELS
    # Either is the quicker one with its labels; both number the pieces alike.
    joining = cv2.CCL_SPAGHETTI if few else cv2.CCL_BBDT
    how = (8, joining) if joined else (4, cv2.CCL_DEFAULT)
    kind = cv2.CV_16U if few else cv2.CV_32S
    labels, stats = cv2.connectedComponentsWithStatsWithAlgorithm(dark, how[0], kind, how[1])[1:3]
    stats[0] = 0
    return _Labelled(labels, stats)


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


class _OpenSides(NamedTuple):
    """The four longest sides of a contour's hull.

    Attributes:
        contour: (n, 2) some of its points.
        first: (4, 2) where the sides begin.
        along: (4, 2) to where they end.
        area: of the hull.
        coarse: of the image of half the size.
    """

    contour: np.ndarray
    first: np.ndarray
    along: np.ndarray
    area: float
    coarse: bool


def _open_sides(labelled: _Labelled, min_side: float, coarse: bool) -> List[_OpenSides]:
    """Return the sides of what is dark and may be square but for a gap, or a hidden corner.

    What is as dark as the marker's surroundings and lies on a corner joins the two: no threshold
    shows an outline with four corners then. The hull of the border still has four long sides.
    """
    contours = _pieces(labelled, max(0.5 * _LEAST_OPEN, min_side) + 1.0, is_open=True)
    large = sorted(contours, key=lambda placed: -float(np.ptp(placed[0][:, 0], axis=0).sum()))
    sides = (_sides_of_hull(contour, offset, coarse) for contour, offset in large[:_MOST_OPEN])
    return [of_one for of_one in sides if of_one is not None]


def _sides_of_hull(
    contour: np.ndarray, offset: Tuple[int, int], coarse: bool
) -> Optional[_OpenSides]:
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
    return _OpenSides(some + offset, simple[longest] + offset, edges[longest], area, coarse)


def _open_quads(sides: Sequence[_OpenSides]) -> Tuple[np.ndarray, np.ndarray]:
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


def _lines_along(sides: Sequence[_OpenSides]) -> Tuple[np.ndarray, np.ndarray]:
    """Return points and normals (n, 4, 2) of lines through what of a contour is beside its sides.

    What sticks out at one end of a side turns it, so what is beside its line is chosen anew, more
    narrowly each time.
    """
    contours = np.concatenate([of_one.contour for of_one in sides])
    owners = np.repeat(np.arange(len(sides)), [len(of_one.contour) for of_one in sides])
    along = np.stack([of_one.along for of_one in sides])
    points = np.stack([of_one.first for of_one in sides]) + 0.5 * along
    lengths = np.hypot(along[..., 0], along[..., 1])
    along /= lengths[..., None]
    for beside, rounds in _BESIDE:
        away = contours[:, None] - points[owners]
        ahead, across = _in_frame(away, along[owners])
        near = np.abs(across) < np.maximum(1.0, beside * lengths)[owners]
        near &= np.abs(ahead) < ((0.5 - _SECOND_TRIM / 2) * lengths)[owners]
        of_point, side = near.nonzero()
        side += 4 * owners[of_point]
        moved, turned = _lines_through(away[near], side, 4 * len(sides), rounds)
        enough = (np.bincount(side, minlength=4 * len(sides)) >= _LEAST_POINTS).reshape(-1, 4, 1)
        points = points + np.where(enough, moved.reshape(-1, 4, 2), 0.0)
        along = np.where(enough, turned.reshape(-1, 4, 2), along)
    return points, np.stack((along[..., 1], -along[..., 0]), axis=-1)


def _in_frame(away: np.ndarray, along: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return how far points (…, 2) are along unit vectors (…, 2), and across them."""
    ahead = away[..., 0] * along[..., 0] + away[..., 1] * along[..., 1]
    return ahead, away[..., 0] * along[..., 1] - away[..., 1] * along[..., 0]


def _lines_through(
    points: np.ndarray, line: np.ndarray, count: int, rounds: int
) -> Tuple[np.ndarray, np.ndarray]:
    """Return a point and the unit vector (count, 2) along each line through points (n, 2).

    Of least squares and, the more rounds there are, of least distances: each round gives points
    the weight that makes their squares distances. NaN where there are no points.

    Args:
        points: px.
        line: (n,) which line a point is of.
        count: how many lines there are.
        rounds: of the fit.
    """
    x, y = points.T
    weights = np.ones(len(points))
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(rounds):
            parts = (weights, weights * x, weights * y)
            parts += (parts[1] * x, parts[1] * y, parts[2] * y)
            total, *sums = (np.bincount(line, part, count) for part in parts)
            mean_x, mean_y, xx, xy, yy = (part / total for part in sums)
            xx, xy, yy = xx - mean_x * mean_x, xy - mean_x * mean_y, yy - mean_y * mean_y
            angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
            middle = np.stack((mean_x, mean_y), axis=-1)
            along = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
            across = _in_frame(points - middle[line], along[line])[1]
            weights = 1.0 / np.maximum(np.abs(across), _ON_LINE)
    return middle, along


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
