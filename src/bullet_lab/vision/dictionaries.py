"""OpenCV's dictionaries of markers by name, and decoding quadrilaterals with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Iterator

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.images import (
    NEXT,
    PREVIOUS,
    Picture,
    VisionError,
    grid,
    homography,
    intersections,
    lengths_of,
    right_of,
)

_PREFIX = "DICT_"
# Number of ones in a byte.
_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)
# Offsets from a cell's middle, in cells, at which it is sampled.
_OFFSETS = np.array([-0.24, -0.08, 0.08, 0.24])
# Weight of a cell's difference from its neighbours that is added to it, against blur.
_SHARPENING = 0.25
# A quick test samples as many places along each side of the border, in the border and just
# outside of it, and each data cell once.
_GLANCES = 7
_RING = 4 * _GLANCES
_OUTSIDE = slice(0, _RING)
_BORDER = slice(_RING, 2 * _RING)
# Least shares of the places that must pass: a hand or a highlight may be on the marker.
_FRAMED = 0.8  # the border is darker than the place outside of it
_DARK = 0.6  # the border is nearer to black
_BRIGHT = 0.75  # the surroundings are nearer to white
_FILLED = 0.1  # the data cells are nearer to white
# Least difference of white and black, grey levels.
_LEAST_TYPICAL_RISE = 4.0
# Reach to either side of a line within which its edge is looked for, and sampling step, px: first
# coarsely, then centred on the line found.
_ROUNDS = ((2.5, 0.5), (1.5, 0.25))
_LEAST_REACH = 1.25
# Most reach, as a share of a cell: the border is black one cell deep, and white outside as deep.
_BORDER_PART = 0.9
# Shortest side that is refined, px.
_LEAST_SIDE = 3.0
# Places at which a side is crossed, and share of the side at either end that is left out.
_CROSSINGS = 16
_TRIM = 0.08
_PLACES = np.linspace(_TRIM, 1.0 - _TRIM, _CROSSINGS)
# Least share of the places at which an edge must be seen.
_LEAST_SEEN = 0.5
# Grey levels by which an edge must rise, and the same as a share of the mean rise.
_LEAST_RISE = 4.0
_LEAST_OF_MEAN = 0.25
# An edge is no outlier within so many mean distances from the line, and px more.
_OUTLYING = 3.0
_LEAST_OUTLYING = 0.02


@dataclass(frozen=True, eq=False)
class MarkerDictionary:
    """A set of markers."""

    name: str  #: OpenCV's, such as DICT_APRILTAG_36h10
    cells: int  #: data cells along an edge; the black border is one cell more each way
    codes: ndarray  #: (number of ids, cells + 2, cells + 2) of uint8 with the border, 1 for white
    packed: ndarray  #: (bytes, number of ids · 4): data cells from each corner on, as bits
    distance: int  #: least number of different bits of two markers, or of one and itself turned

    def nearest(self, bits: ndarray) -> tuple[int, int, int]:
        """Return the marker nearest to (cells²,) bits, its turns and the number of wrong bits.

        Turns are the number of the corner that the bits begin with, clockwise from the top left.
        """
        # On bytes: a product of matrices would start threads.
        different = _ONES[self.packed ^ np.packbits(bits > 0)[:, None]].sum(axis=0, dtype=np.uint8)
        best = int(different.argmin())
        return best // 4, best % 4, int(different[best])

    @property
    def max_correction(self) -> int:
        """Number of wrong bits that can be corrected unambiguously."""
        return max(0, (self.distance - 1) // 2)

    def pattern(self, marker: int) -> ndarray:
        """Return the (cells + 2, cells + 2) cells of a marker and its border, 1 for white.

        Raises:
            VisionError: there is no such marker.
        """
        if not 0 <= marker < len(self.codes):
            raise VisionError(f"{self.name} has markers 0 to {len(self.codes) - 1}, not {marker}")
        return self.codes[marker]


def simple_name(name: str) -> str:
    """Return a dictionary's name in capitals, without DICT_.

    >>> simple_name("DICT_4x4_50")
    '4X4_50'
    """
    simple = name.strip().upper()
    return simple[len(_PREFIX) :] if simple.startswith(_PREFIX) else simple


# OpenCV from 4.7 on has each AprilTag dictionary twice, as 36H11 and 36h11; the latter is used.
_NAMES = {simple_name(name): name for name in sorted(dir(cv2.aruco)) if name.startswith(_PREFIX)}
DICTIONARY_NAMES = tuple(sorted(_NAMES.values()))


def dictionary_named(name: str) -> MarkerDictionary:
    """Return a dictionary by OpenCV's name; DICT_ may be left out, and letters have any case.

    `apriltag_36h10`, as in the course code, is DICT_APRILTAG_36h10.

    Raises:
        VisionError: there is no dictionary of that name.
    """
    found = _NAMES.get(simple_name(name))
    if found is None:
        raise VisionError(f"there is no dictionary '{name}', only {', '.join(DICTIONARY_NAMES)}")
    return _load(found)


@lru_cache
def _load(name: str) -> MarkerDictionary:
    source = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    cells = source.markerSize
    bits_of = cv2.aruco.Dictionary.getBitsFromByteList
    data = np.stack([bits_of(entry[None], cells) for entry in source.bytesList])
    turned = np.stack([np.rot90(data, turns, axes=(1, 2)) for turns in range(4)], axis=1)
    bits = turned.reshape(4 * len(data), cells * cells)
    # A product of ±1 is the number of equal bits less that of different ones. Leave out the
    # product of each marker with itself.
    signs = 2.0 * bits.astype(np.float32) - 1.0
    products = signs[::4] @ signs.T
    each = np.arange(len(data))
    products[each, 4 * each] = -bits.shape[1]
    distance = int(round((bits.shape[1] - float(products.max())) / 2.0))
    codes = np.pad(data, ((0, 0), (1, 1), (1, 1)))
    packed = np.ascontiguousarray(np.packbits(bits, axis=1).T)
    return MarkerDictionary(name, cells, codes, packed, distance)


@dataclass(frozen=True, eq=False)
class Match:
    """The marker that a quadrilateral shows."""

    marker: int  #: its id
    corners: ndarray  #: (4, 2) ideal px, clockwise from its top left
    errors: int  #: bits that were read wrongly
    likeness: float  #: correlation of the grey levels with its pattern, at most 1


def may_be_markers(picture: Picture, quads: ndarray, cells: int) -> ndarray:
    """Return which (n,) of (n, 4, 2) rough corners, px of the image, may be of a marker.

    Those are dark just inside, bright just outside and not empty in the data `cells`.
    """
    # Places on the horizon of a quadrilateral are infinite, so it is no marker.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        levels = _levels(picture, picture.ideal(quads), _glance(cells))
    # Light may change evenly across a marker.
    grey = np.einsum("pk,nk->np", _half_planes(cells), levels[:, : 2 * _RING])
    is_bright = levels > grey
    outside, border = levels[:, _OUTSIDE], levels[:, _BORDER]
    likely = np.median(outside, axis=1) - np.median(border, axis=1) > _LEAST_TYPICAL_RISE
    for is_right, share in (
        (outside > border, _FRAMED),
        (border < grey[:, _BORDER], _DARK),
        (is_bright[:, _OUTSIDE], _BRIGHT),
        (is_bright[:, 2 * _RING :], _FILLED),
    ):
        likely &= is_right.sum(axis=1) >= share * is_right.shape[1]
    return likely


def _levels(picture: Picture, corners: ndarray, places: ndarray) -> ndarray:
    """Return the grey levels (n, p) at homogeneous places (p, 3) of (n, 4, 2) unit squares."""
    # Sums of products, as a product of matrices would start threads.
    there = np.einsum("pk,nik->npi", places, homography(corners))
    return picture.at(there[..., :2] / there[..., 2:])


@lru_cache
def _glance(cells: int) -> ndarray:
    """Return (p, 3) places of the unit square: outside the border, in it, in the data cells."""
    cell = 1.0 / (cells + 2)
    along = np.linspace(cell, 1.0 - cell, _GLANCES)
    places = []
    for ring in (-0.5 * cell, 0.5 * cell):
        low, high = np.full(_GLANCES, ring), np.full(_GLANCES, 1.0 - ring)
        for pair in ((along, low), (along, high), (low, along), (high, along)):
            places.append(np.column_stack(pair))
    middles = (np.arange(cells) + 1.5) * cell
    places.append(grid(middles, middles))
    return _homogeneous(np.vstack(places))


def _homogeneous(points: ndarray) -> ndarray:
    return np.column_stack((points, np.ones(len(points))))


@lru_cache
def _half_planes(cells: int) -> ndarray:
    """Return (p, k): from levels outside and in the border to the grey half way between them.

    The grey is the mean of two planes (least squares) at all p places of the quick test.
    """
    places = _glance(cells)
    rings = places[_OUTSIDE], places[_BORDER]
    return 0.5 * np.concatenate([places @ np.linalg.pinv(ring) for ring in rings], axis=1)


def refined(picture: Picture, quads: ndarray, cells: int) -> ndarray:
    """Return the corners of dark quadrilaterals where the lines along their sides meet.

    Each side is crossed at many places; the edge is where the grey level rises, on average. The
    second round is centred on the line found in the first, so that what lies on either side of the
    line does not bias it.

    Args:
        picture: the image.
        quads: (n, 4, 2) corners in px of the image, clockwise, to about two pixels.
        cells: number of cells of the marker along an edge, with its border.

    Returns:
        (n, 4, 2) corners u, v in ideal px; NaN where there are no four edges.
    """
    corners = picture.ideal(quads)
    # What has no edge is NaN.
    with np.errstate(invalid="ignore", divide="ignore"):
        for reach, step in _ROUNDS:
            corners = _refine_once(picture, corners, cells, reach, step)
    return corners


def _refine_once(
    picture: Picture, corners: ndarray, cells: int, reach: float, step: float
) -> ndarray:
    edges = corners[:, NEXT] - corners
    lengths = lengths_of(edges)
    outward = right_of(edges) / lengths[..., None]
    cell = 0.5 * (lengths[:, PREVIOUS] + lengths[:, NEXT]) / cells
    reaches = np.minimum(reach, np.maximum(_LEAST_REACH, _BORDER_PART * cell))
    steps = int(np.ceil(reach / step))
    offsets = np.arange(-steps, steps + 1) / steps * reaches[..., None]
    base = corners[:, :, None] + edges[:, :, None] * _PLACES[:, None]
    points = base[:, :, :, None] + outward[:, :, None, None] * offsets[:, :, None, :, None]
    heights, weights = _edge_heights(picture.at(points), offsets)
    level, slope = _robust_lines(heights, weights)
    # Two points of each line: beside the old corners.
    first = corners + outward * level[..., None]
    second = corners + edges + outward * (level + slope)[..., None]
    met = intersections(first, right_of(second - first))
    seen = np.count_nonzero(weights, axis=-1) >= _LEAST_SEEN * _CROSSINGS
    met[~(seen & (lengths >= _LEAST_SIDE)).all(axis=1)] = np.nan
    return met


def _edge_heights(levels: ndarray, offsets: ndarray) -> tuple[ndarray, ndarray]:
    """Return the mean offset of the rises at each crossing, and its weight; 0 without an edge.

    Grey levels are (n, 4, places, offsets), offsets (n, 4, offsets) px.
    """
    rises = np.maximum(levels[..., 1:] - levels[..., :-1], 0.0)
    weights = rises.sum(axis=-1)
    middles = 0.5 * (offsets[..., 1:] + offsets[..., :-1])
    heights = (rises * middles[:, :, None]).sum(axis=-1) / weights
    mean = weights.mean(axis=-1, keepdims=True)
    seen = weights > np.maximum(_LEAST_RISE, _LEAST_OF_MEAN * mean)
    return np.where(seen, heights, 0.0), np.where(seen, weights, 0.0)


def _robust_lines(heights: ndarray, weights: ndarray) -> tuple[ndarray, ndarray]:
    """Fit height = level + slope · place along the last axis, the second time without outliers.

    Without an edge both are NaN.
    """
    for _ in range(2):
        total = weights.sum(axis=-1)
        mean_place = (weights * _PLACES).sum(axis=-1) / total
        mean_height = (weights * heights).sum(axis=-1) / total
        centred = _PLACES - mean_place[..., None]
        spread = (weights * centred**2).sum(axis=-1)
        product = weights * centred * (heights - mean_height[..., None])
        slope = product.sum(axis=-1) / spread
        level = mean_height - slope * mean_place
        residuals = np.abs(heights - level[..., None] - slope[..., None] * _PLACES)
        typical = (weights * residuals).sum(axis=-1, keepdims=True) / total[..., None]
        own = residuals <= _OUTLYING * typical + _LEAST_OUTLYING
        weights = np.where(own, weights, 0.0)
    return level, slope


def decode(
    picture: Picture,
    corners: ndarray,
    dictionary: MarkerDictionary,
    correction: int,
    border_errors: int,
) -> Iterator[tuple[int, Match]]:
    """Yield the markers among dark quadrilaterals, each after the quadrilateral's index.

    Args:
        picture: the image.
        corners: (n, 4, 2) ideal px, clockwise.
        dictionary: of the markers.
        correction: most bits that are corrected.
        border_errors: most cells of the border that are not black.
    """
    side, each = dictionary.cells + 4, len(_OFFSETS)
    samples = _levels(picture, corners, _cell_places(dictionary.cells))
    # Data cells, border and one ring around.
    levels = samples.reshape(len(corners), side, each, side, each).mean(axis=(2, 4))
    on_border = _second_ring(side)[1:-1, 1:-1]
    for index, cells in enumerate(_sharpened_cells(levels)):
        # The cells of a uniform square are NaN.
        if np.isnan(cells[0, 0]) or (cells[on_border] > 0.0).sum() > border_errors:
            continue
        marker, turns, errors = dictionary.nearest(cells[1:-1, 1:-1].ravel())
        if errors <= correction:
            pattern = np.rot90(dictionary.pattern(marker), turns)
            likeness = _likeness(pattern, levels[index, 1:-1, 1:-1])
            yield index, Match(marker, np.roll(corners[index], turns, axis=0), errors, likeness)


def _likeness(pattern: ndarray, levels: ndarray) -> float:
    """Return the correlation of a pattern and the grey levels of its cells."""
    pattern, levels = pattern.ravel() - pattern.mean(), levels.ravel() - levels.mean()
    return float(pattern @ levels / np.sqrt((pattern @ pattern) * (levels @ levels)))


@lru_cache
def _cell_places(cells: int) -> ndarray:
    """Return (p, 3) places of the unit square: some in each cell, the border and a ring around."""
    middles = np.arange(cells + 4) - 0.5
    line = (middles[:, None] + _OFFSETS).ravel() / (cells + 2)
    return _homogeneous(grid(line, line))


def _sharpened_cells(levels: ndarray) -> ndarray:
    """Return the cells (n, k, k) of grey levels with a ring around, above 0 if white.

    Light may change evenly across a marker: black and white levels are planes. That of black goes
    through the border, that of white through all that is brighter than the middle. Uniform levels
    give NaN.
    """
    count, side = levels.shape[:2]
    border = _second_ring(side)
    black = np.median(levels[:, border], axis=1)
    order = np.sort(levels[:, 1:-1, 1:-1].reshape(count, (side - 2) ** 2), axis=1)
    white = order[:, int(0.95 * order.shape[1])]
    contrast = white - black
    bright = levels > (0.5 * (black + white))[:, None, None]
    planes = _planes(np.concatenate((levels, levels)), np.concatenate((border & ~bright, bright)))
    dark_plane, bright_plane = planes[:count], planes[count:]
    half = 0.5 * (bright_plane - dark_plane)
    half = np.maximum(half, np.maximum(0.1 * contrast, 1e-3)[:, None, None])
    soft = np.clip((levels - 0.5 * (bright_plane + dark_plane)) / half, -1.5, 1.5)
    soft[~(contrast >= 1.0)] = np.nan
    own = soft[:, 1:-1, 1:-1]
    neighbours = soft[:, :-2, 1:-1] + soft[:, 2:, 1:-1] + soft[:, 1:-1, :-2] + soft[:, 1:-1, 2:]
    return own + _SHARPENING * (4.0 * own - neighbours)


@lru_cache
def _second_ring(side: int) -> ndarray:
    """Return which of (side, side) cells are the border: the second ring."""
    border = np.ones((side, side), dtype=bool)
    border[[0, -1]] = border[:, [0, -1]] = False
    border[2:-2, 2:-2] = False
    return border


def _planes(levels: ndarray, chosen: ndarray) -> ndarray:
    """Return the plane (n, k, k) fitted to the chosen levels of each."""
    count, side = levels.shape[:2]
    terms, products = _plane_terms(side)
    flat = levels.reshape(count, side * side)
    weights = chosen.reshape(flat.shape).astype(float)
    matrix = np.einsum("np,qp->nq", weights, products).reshape(count, 3, 3) + 1e-6 * np.eye(3)
    right = np.einsum("np,qp->nq", weights * flat, terms)
    numbers = np.linalg.solve(matrix, right[..., None])[..., 0]
    return np.einsum("nq,qp->np", numbers, terms).reshape(levels.shape)


@lru_cache
def _plane_terms(side: int) -> tuple[ndarray, ndarray]:
    """Return 1, row, column (3, side²), and their products (9, side²)."""
    row, column = np.indices((side, side), dtype=float).reshape(2, side * side)
    terms = np.stack((np.ones_like(row), row, column))
    return terms, (terms[:, None] * terms).reshape(9, side * side)
