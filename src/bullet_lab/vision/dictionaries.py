"""OpenCV's dictionaries of markers by name, and decoding a quadrilateral with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Tuple

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.images import Picture, VisionError, homography

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
_INSIDE = slice(2 * _RING, None)
# Least shares of the places that must pass: a hand or a highlight may be on the marker.
_FRAMED = 0.8  # the border is darker than the place outside of it
_DARK = 0.6  # the border is nearer to black
_BRIGHT = 0.75  # the surroundings are nearer to white
_FILLED = 0.1  # the data cells are nearer to white
# Least difference of white and black, grey levels.
_LEAST_RISE = 4.0
# A plane is fitted to at least as many levels; fewer are replaced by their mean.
_LEAST_OF_PLANE = 8


@dataclass(frozen=True, eq=False)
class MarkerDictionary:
    """A set of markers.

    `codes` are (number of ids, 4, cells²) of ±1, white +1, row by row. The second axis is the
    corner from which the pattern is read, clockwise from the top left.
    """

    name: str  #: OpenCV's, such as DICT_APRILTAG_36h10
    cells: int  #: data cells along an edge; the black border is one cell more each way
    codes: ndarray
    packed: ndarray  #: (bytes, number of ids · 4): the codes as bits, eight in a byte
    distance: int  #: least number of different bits of two markers, or of one and itself turned

    def nearest(self, bits: ndarray) -> tuple[int, int, int]:
        """Return the marker nearest to (cells²,) bits, its turns and the number of wrong bits."""
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
        return _pattern(self, marker)


@lru_cache(maxsize=256)
def _pattern(dictionary: MarkerDictionary, marker: int) -> ndarray:
    bits = dictionary.codes[marker, 0].reshape(dictionary.cells, dictionary.cells)
    pattern = np.pad((bits > 0).astype(np.uint8), 1)
    pattern.flags.writeable = False
    return pattern


def simple_name(name: str) -> str:
    """Return a dictionary's name in capitals, without DICT_.

    >>> simple_name("DICT_4x4_50")
    '4X4_50'
    """
    simple = name.strip().upper()
    return simple[len(_PREFIX) :] if simple.startswith(_PREFIX) else simple


# OpenCV from 4.7 on has each AprilTag dictionary twice, as 36H11 and 36h11; the latter is used.
_NAMES = {simple_name(name): name for name in sorted(dir(cv2.aruco)) if name.startswith(_PREFIX)}
DICTIONARY_NAMES: Tuple[str, ...] = tuple(sorted(_NAMES.values()))


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
    # A product of ±1 is the number of equal bits less that of different ones. Leave out the
    # product of each marker with itself.
    bits, each = cells * cells, np.arange(len(codes))
    products = codes[:, 0] @ codes.reshape(-1, bits).T
    products[each, 4 * each] = -bits
    distance = int(round((bits - float(products.max())) / 2.0))
    return MarkerDictionary(name, cells, codes, packed, distance)


@dataclass(frozen=True, eq=False)
class Reading:
    """The cells of a quadrilateral, read as those of a marker."""

    bits: ndarray  #: (cells²,) ±1, white +1, row by row from the first corner
    border_errors: int  #: cells of the border that are not black
    levels: ndarray  #: (cells + 2, cells + 2) grey levels, border included


@dataclass(frozen=True)
class Match:
    """The marker that a reading shows."""

    marker: int  #: its id
    turns: int  #: index of the marker's corner that the reading begins with, clockwise
    errors: int  #: bits that were read wrongly
    likeness: float  #: correlation of the grey levels with its pattern, at most 1


def may_be_markers(picture: Picture, quads: ndarray, cells: int) -> ndarray:
    """Return which (n,) of (n, 4, 2) rough corners, px of the image, may be of a marker.

    Those are dark just inside, bright just outside and not empty in the data `cells`.
    """
    # Sums of products, as a product of matrices would start threads.
    places = np.einsum("pk,nik->npi", _glance(cells), homography(picture.ideal(quads)))
    # Places on the horizon of a quadrilateral are infinite, so it is no marker.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        values = picture.at(places[..., :2] / places[..., 2:])
    parts = (_OUTSIDE, _BORDER, _INSIDE)
    outside, border, inside = (values[:, part] for part in parts)
    # Light may change evenly across a marker.
    grey = np.einsum("pk,nk->np", _half_planes(cells), values[:, : 2 * _RING])
    around, along, within = (grey[:, part] for part in parts)
    # The median, which is slower to call, of an even number of levels.
    half = _RING // 2
    ordered = np.sort(values[:, : 2 * _RING].reshape(-1, 2, _RING), axis=2)
    typical = 0.5 * (ordered[..., half - 1] + ordered[..., half])
    likely = typical[:, 0] - typical[:, 1] > _LEAST_RISE
    for is_right, share in (
        (outside > border, _FRAMED),
        (border < along, _DARK),
        (outside > around, _BRIGHT),
        (inside > within, _FILLED),
    ):
        likely &= is_right.sum(axis=1) >= share * is_right.shape[1]
    return likely


@lru_cache(maxsize=None)
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
    places.append(_grid(middles))
    return _homogeneous(np.vstack(places))


def _grid(line: ndarray) -> ndarray:
    """Return the (n², 2) points whose x and y are each of (n,) values, row by row."""
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def _homogeneous(points: ndarray) -> ndarray:
    return np.column_stack((points, np.ones(len(points))))


@lru_cache(maxsize=None)
def _half_planes(cells: int) -> ndarray:
    """Return (p, k): from levels outside and in the border to the grey half way between them.

    The grey is the mean of two planes (least squares) at all p places of the quick test.
    """
    places = _glance(cells)
    rings = places[_OUTSIDE], places[_BORDER]
    return 0.5 * np.concatenate([places @ np.linalg.pinv(ring) for ring in rings], axis=1)


def read_cells(picture: Picture, corners: ndarray, cells: int) -> ndarray:
    """Return (n, cells + 4, cells + 4) mean grey levels: data cells, border and one ring around.

    Args:
        picture: the image.
        corners: (n, 4, 2) of the black squares, ideal px.
        cells: data cells along an edge.
    """
    side, each = cells + 4, len(_OFFSETS)
    places = np.einsum("pk,nik->npi", _cell_places(cells), homography(corners))
    values = picture.at(places[..., :2] / places[..., 2:])
    return values.reshape(-1, side, each, side, each).mean(axis=(2, 4))


@lru_cache(maxsize=None)
def _cell_places(cells: int) -> ndarray:
    """Return (p, 3) places of the unit square: some in each cell, the border and a ring around."""
    middles = np.arange(cells + 4) - 0.5
    return _homogeneous(_grid((middles[:, None] + _OFFSETS).ravel() / (cells + 2)))


def interpret(levels: ndarray) -> list[Reading | None]:
    """Return the readings of the grey levels of `read_cells`; None where they are uniform.

    Light may change evenly across a marker: black and white levels are planes. That of black goes
    through the border, that of white through all that is brighter than the middle.
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
    sharp = _sharpened(soft)
    bits = np.where(sharp[:, 1:-1, 1:-1] > 0.0, 1.0, -1.0).astype(np.float32)
    border_errors = (sharp > 0.0)[:, border[1:-1, 1:-1]].sum(axis=1)
    readings: list[Reading | None] = []
    for k in range(count):
        is_uniform = not white[k] - black[k] >= 1.0
        reading = Reading(bits[k].ravel(), int(border_errors[k]), inner[k])
        readings.append(None if is_uniform else reading)
    return readings


def _sharpened(soft: ndarray) -> ndarray:
    """Return cells (n, k, k) without the outer ring, less a part of their neighbours."""
    own = soft[:, 1:-1, 1:-1]
    neighbours = soft[:, :-2, 1:-1] + soft[:, 2:, 1:-1] + soft[:, 1:-1, :-2] + soft[:, 1:-1, 2:]
    return own + _SHARPENING * (4.0 * own - neighbours)


def match(reading: Reading, dictionary: MarkerDictionary, correction: int) -> Match | None:
    """Return the marker that differs from a reading in at most `correction` bits, or None."""
    marker, turns, errors = dictionary.nearest(reading.bits)
    if errors > correction:
        return None
    cells = dictionary.pattern(marker)
    pattern = np.rot90(cells, turns).ravel() - cells.mean()
    levels = reading.levels.ravel() - reading.levels.mean()
    likeness = float(pattern @ levels / np.sqrt((pattern @ pattern) * (levels @ levels)))
    return Match(marker, turns, errors, likeness)


@lru_cache(maxsize=None)
def _border(side: int) -> ndarray:
    """Return which of (side, side) cells are the border: the second ring."""
    border = np.ones((side, side), dtype=bool)
    border[[0, -1]] = border[:, [0, -1]] = False
    border[2:-2, 2:-2] = False
    return border


def _planes(levels: ndarray, chosen: ndarray) -> ndarray:
    """Return the plane (n, k, k) fitted to the chosen levels of each; their mean if few."""
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
def _plane_terms(side: int) -> tuple[ndarray, ndarray]:
    """Return 1, row, column (3, side²), from the middle, and their products (6, side²)."""
    row, column = np.indices((side, side), dtype=float).reshape(2, -1) - (side - 1) / 2.0
    one = np.ones_like(row)
    products = one, row, column, row * row, row * column, column * column
    return np.stack((one, row, column)), np.stack(products)
