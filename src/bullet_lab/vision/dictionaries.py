"""Dictionaries of markers, OpenCV's by name, and the decoding of a quadrilateral with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import List, Optional, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import homography
from bullet_lab.vision.images import Lens, VisionError, sample

_PREFIX = "DICT_"
# Number of ones in a byte.
_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)
# Where a cell is sampled, from its middle, in cells.
_SPREAD = np.array([-0.24, -0.08, 0.08, 0.24])
# How far each cell is pushed away from its neighbours, against blur.
_SHARPENING = 0.25
# A glance: places along each side of the border, and what part of them has to be darker than
# the place outside of it, of the border to be dark, of the surroundings to be bright, of the
# data cells to be bright. A hand or a highlight may be on the marker.
_GLANCES = 7
_FRAMED, _DARK, _BRIGHT, _FILLED = 0.8, 0.6, 0.75, 0.1
# Grey levels from black to white.
_LEAST_RISE = 4.0


@dataclass(frozen=True, eq=False)
class MarkerDictionary:
    """A set of markers.

    `codes` are (number of ids, 4, cells²) of ±1, white +1, row by row. The second axis counts
    quarter turns: the pattern as read from the corner that is k-th of the real ones, clockwise
    from the top left.
    """

    name: str  #: as OpenCV has it, such as DICT_APRILTAG_36h10
    cells: int  #: data cells along an edge; the black border is one cell more each way
    codes: np.ndarray
    packed: np.ndarray  #: (bytes, number of ids · 4): the same as bits, eight in a byte
    distance: int  #: least number of bits in which two markers differ, or one and itself turned

    def nearest(self, bits: np.ndarray) -> Tuple[int, int, int]:
        """Return the marker that differs least from (cells²,) bits, its turns, the difference."""
        # In bytes, as a product of matrices would start threads.
        different = _ONES[self.packed ^ np.packbits(bits > 0)[:, None]].sum(axis=0, dtype=np.uint8)
        best = int(different.argmin())
        return best // 4, best % 4, int(different[best])

    @property
    def max_correction(self) -> int:
        """How many wrong bits can be corrected without doubt."""
        return max(0, (self.distance - 1) // 2)

    def pattern(self, marker: int) -> np.ndarray:
        """Return the (cells + 2, cells + 2) cells of a marker with its border, 1 for white.

        Raises:
            VisionError: there is no such marker.
        """
        if not 0 <= marker < len(self.codes):
            raise VisionError(f"{self.name} has markers 0 to {len(self.codes) - 1}, not {marker}")
        return _pattern(self, marker)


@lru_cache(maxsize=256)
def _pattern(dictionary: MarkerDictionary, marker: int) -> np.ndarray:
    bits = dictionary.codes[marker, 0].reshape(dictionary.cells, dictionary.cells)
    pattern = np.pad((bits > 0).astype(np.uint8), 1)
    pattern.flags.writeable = False
    return pattern


def simple_name(name: str) -> str:
    """Return a dictionary's name in capitals and without DICT_.

    >>> simple_name("DICT_4x4_50")
    '4X4_50'
    """
    simple = name.strip().upper()
    return simple[len(_PREFIX) :] if simple.startswith(_PREFIX) else simple


# From OpenCV 4.7 on AprilTags are there twice, as 36H11 and as 36h11; the latter counts.
_NAMES = {simple_name(name): name for name in sorted(dir(cv2.aruco)) if name.startswith(_PREFIX)}
DICTIONARY_NAMES: Tuple[str, ...] = tuple(sorted(_NAMES.values()))


def dictionary_named(name: str) -> MarkerDictionary:
    """Return a dictionary by OpenCV's name, with or without DICT_, in any case of letters.

    `apriltag_36h10`, as the course code says it, is DICT_APRILTAG_36h10.

    Raises:
        VisionError: there is none of that name.
    """
    found = _NAMES.get(simple_name(name))
    if found is None:
        raise VisionError(f"there is no dictionary '{name}', only {', '.join(DICTIONARY_NAMES)}")
    return _load(found)


@lru_cache(maxsize=None)
def _load(name: str) -> MarkerDictionary:
    source = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    cells = source.markerSize
    codes = np.empty((len(source.bytesList), 4, cells * cells), dtype=np.float32)
    for marker, entry in enumerate(source.bytesList):
        bits = cv2.aruco.Dictionary.getBitsFromByteList(entry[None], cells)
        signs = 2.0 * bits.astype(np.float32) - 1.0
        for turns in range(4):
            codes[marker, turns] = np.rot90(signs, turns).ravel()
    packed = np.ascontiguousarray(np.packbits(codes.reshape(-1, cells * cells) > 0, axis=1).T)
    # Of ±1: equal bits less different ones. A marker as it is equals itself.
    bits, each = cells * cells, np.arange(len(codes))
    products = codes[:, 0] @ codes.reshape(-1, bits).T
    products[each, 4 * each] = -bits
    distance = int(round((bits - float(products.max())) / 2.0))
    return MarkerDictionary(name, cells, codes, packed, distance)


@dataclass(frozen=True, eq=False)
class Reading:
    """The cells of a quadrilateral, as a marker's."""

    bits: np.ndarray  #: (cells²,) ±1, white +1, row by row from the first corner
    border_errors: int  #: cells of the border that are not black
    levels: np.ndarray  #: (cells + 2, cells + 2) grey levels, border included


@dataclass(frozen=True)
class Match:
    """The marker that a reading is."""

    marker: int  #: its id
    turns: int  #: the reading's first corner is this one of its, clockwise from its top left
    errors: int  #: bits that were read wrongly
    likeness: float  #: correlation of the grey levels with its pattern, at most 1


def may_be_markers(image: np.ndarray, quads: np.ndarray, cells: int, lens: Lens) -> np.ndarray:
    """Return which (n, 4, 2) rough corners, px, in (h, w) grey levels are worth a closer look.

    That is where it is dark just inside, bright outside and, in the data `cells`, not empty.
    """
    # Sums of products, as a product of matrices would start threads.
    places = np.einsum("pk,nik->npi", _glance(cells), homography(lens.ideal(quads)))
    # On the horizon of a quadrilateral there is nothing, and so no marker.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        values = sample(image, lens.seen(places[..., :2] / places[..., 2:]))
    ring = slice(0, 4 * _GLANCES), slice(4 * _GLANCES, 8 * _GLANCES), slice(8 * _GLANCES, None)
    outside, border, inside = (values[:, part] for part in ring)
    # Light may change evenly across a marker.
    middle = np.einsum("pk,nk->np", _half_planes(cells), values[:, : 8 * _GLANCES])
    around, along, within = (middle[:, part] for part in ring)
    # Of an even number of levels, the median is the mean of the two in the middle.
    half = 2 * _GLANCES
    sorted_levels = np.sort(values[:, : 4 * half].reshape(-1, 2, 2 * half), axis=2)
    typical = 0.5 * (sorted_levels[..., half - 1] + sorted_levels[..., half])
    likely = typical[:, 0] - typical[:, 1] > _LEAST_RISE
    for truth, part in (
        (outside > border, _FRAMED),
        (border < along, _DARK),
        (outside > around, _BRIGHT),
        (inside > within, _FILLED),
    ):
        likely &= truth.sum(axis=1) >= part * truth.shape[1]
    return likely


@lru_cache(maxsize=None)
def _glance(cells: int) -> np.ndarray:
    """Return (n, 3) places of the unit square: outside the border, in it, in the data cells."""
    cell = 1.0 / (cells + 2)
    along = np.linspace(cell, 1.0 - cell, _GLANCES)
    places = []
    for ring in (-0.5 * cell, 0.5 * cell):
        low, high = np.full(_GLANCES, ring), np.full(_GLANCES, 1.0 - ring)
        for pair in ((along, low), (along, high), (low, along), (high, along)):
            places.append(np.column_stack(pair))
    middles = (np.arange(cells) + 1.5) * cell
    places.append(np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2))
    points = np.vstack(places)
    return np.column_stack((points, np.ones(len(points))))


@lru_cache(maxsize=None)
def _half_planes(cells: int) -> np.ndarray:
    """Return (p, k): from levels outside and in the border, what is half way from black to white.

    Both are planes (least squares) over all of the glance's p places.
    """
    places = _glance(cells)
    parts = places[: 4 * _GLANCES], places[4 * _GLANCES : 8 * _GLANCES]
    return 0.5 * np.concatenate([places @ np.linalg.pinv(part) for part in parts], axis=1)


def read_cells(image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens) -> np.ndarray:
    """Return (n, cells + 4, cells + 4) mean grey levels: data cells, border and one ring around.

    Args:
        image: (h, w) grey levels.
        corners: (n, 4, 2) of the black squares, ideal px.
        cells: data cells along an edge.
        lens: where ideal pixels are seen.
    """
    side, each = cells + 4, len(_SPREAD)
    places = np.einsum("pk,nik->npi", _cell_places(cells), homography(corners))
    values = sample(image, lens.seen(places[..., :2] / places[..., 2:]))
    return values.reshape(-1, side, each, side, each).mean(axis=(2, 4))


@lru_cache(maxsize=None)
def _cell_places(cells: int) -> np.ndarray:
    """Return (n, 3) places of the unit square: some in each cell, the border and a ring around."""
    line = ((np.arange(cells + 4) - 0.5)[:, None] + _SPREAD).ravel() / (cells + 2)
    x, y = np.meshgrid(line, line)
    return np.column_stack((x.ravel(), y.ravel(), np.ones(x.size)))


def interpret(levels: np.ndarray) -> List[Optional[Reading]]:
    """Tell black from white in the grey levels that `read_cells` returns; None if they are even.

    Light may change evenly across a marker: black and white levels are planes, black's through
    the border, white's through all that is brighter than the middle.
    """
    count, side = levels.shape[:2]
    inner = levels[:, 1:-1, 1:-1]
    border = _border(side)
    black = np.median(levels[:, border], axis=1)
    order = np.sort(inner.reshape(count, (side - 2) ** 2), axis=1)
    white = order[:, int(0.95 * order.shape[1])]
    bright = levels > (0.5 * (black + white))[:, None, None]
    planes = _planes(np.concatenate((levels, levels)), np.concatenate((border & ~bright, bright)))
    dark_plane, bright_plane = planes[:count], planes[count:]
    half = 0.5 * (bright_plane - dark_plane)
    half = np.maximum(half, np.maximum(0.1 * (white - black), 1e-3)[:, None, None])
    soft = np.clip((levels - 0.5 * (bright_plane + dark_plane)) / half, -1.5, 1.5)
    sharp = soft[:, 1:-1, 1:-1]
    neighbours = soft[:, :-2, 1:-1] + soft[:, 2:, 1:-1] + soft[:, 1:-1, :-2] + soft[:, 1:-1, 2:]
    sharp = sharp + _SHARPENING * (4.0 * sharp - neighbours)
    bits = np.where(sharp[:, 1:-1, 1:-1] > 0.0, 1.0, -1.0).astype(np.float32)
    border_errors = (sharp > 0.0)[:, border[1:-1, 1:-1]].sum(axis=1)
    return [
        Reading(bits[k].ravel(), int(border_errors[k]), inner[k])
        if white[k] - black[k] >= 1.0
        else None
        for k in range(count)
    ]


def match(reading: Reading, dictionary: MarkerDictionary, correction: int) -> Optional[Match]:
    """Return the marker of a dictionary that differs in at most `correction` bits, or None."""
    marker, turns, errors = dictionary.nearest(reading.bits)
    if errors > correction:
        return None
    cells = dictionary.pattern(marker)
    pattern = np.rot90(cells, turns).ravel() - cells.mean()
    levels = reading.levels.ravel() - reading.levels.mean()
    likeness = float(pattern @ levels / np.sqrt((pattern @ pattern) * (levels @ levels)))
    return Match(marker, turns, errors, likeness)


@lru_cache(maxsize=None)
def _border(side: int) -> np.ndarray:
    """Return which of (side, side) cells are the border: the second ring."""
    border = np.ones((side, side), dtype=bool)
    border[[0, -1]] = border[:, [0, -1]] = False
    border[2:-2, 2:-2] = False
    return border


# Fewer levels than this make a mean, no plane.
_LEAST_OF_PLANE = 8


def _planes(levels: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the plane (n, k, k) through the chosen levels of each; their mean if they are few."""
    count, side = levels.shape[:2]
    terms, products = _plane_terms(side)
    flat = levels.reshape(count, side * side)
    weights = chosen.reshape(flat.shape).astype(float)
    # By Cramer's rule: the equations' matrix is ((a, b, c), (b, d, e), (c, e, f)).
    a, b, c, d, e, f = np.einsum("np,qp->qn", weights, products)
    a, d, f = a + 1e-6, d + 1e-6, f + 1e-6
    x, y, z = right = np.einsum("np,qp->qn", weights * flat, terms)
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    s, t, u = a * f - c * c, b * c - a * e, a * d - b * b
    numbers = np.stack((p * x + q * y + r * z, q * x + s * y + t * z, r * x + t * y + u * z))
    numbers /= a * p + b * q + c * r
    plane = np.einsum("qn,qp->np", numbers, terms)
    few = np.rint(a) < _LEAST_OF_PLANE
    if few.any():
        mean = np.where(a > 0.5, right[0] / np.maximum(a, 1.0), flat.mean(axis=1))
        plane[few] = mean[few, None]
    return plane.reshape(levels.shape)


@lru_cache(maxsize=None)
def _plane_terms(side: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return 1, row, column (3, side²), from the middle, and their products (6, side²)."""
    row, column = np.indices((side, side), dtype=float).reshape(2, -1) - (side - 1) / 2.0
    one = np.ones_like(row)
    products = one, row, column, row * row, row * column, column * column
    return np.stack((one, row, column)), np.stack(products)
