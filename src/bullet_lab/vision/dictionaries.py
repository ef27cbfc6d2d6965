"""Dictionaries of markers, OpenCV's by name, and the decoding of a quadrilateral with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Optional, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import homography, solve_symmetric
from bullet_lab.vision.images import Lens, VisionError, sample

_PREFIX = "DICT_"
# Number of ones in a byte.
_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)
# Where a cell is sampled, from its middle, in cells.
_SPREAD = np.array([-0.24, -0.08, 0.08, 0.24])
# How far each cell is pushed away from its neighbours, against blur.
_SHARPENING = 0.25
# A glance: places along each side, the part of them that has to be brighter outside, and what
# the brightest data cell has to have of that rise.
_GLANCES = 7
_FRAMED = 0.7
_NOT_EMPTY = 0.25


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
        bits = self.codes[marker, 0].reshape(self.cells, self.cells)
        return np.pad((bits > 0).astype(np.uint8), 1)


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


@dataclass(frozen=True)
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


def may_be_marker(image: np.ndarray, quad: np.ndarray, cells: int, lens: Lens) -> bool:
    """Return whether (4, 2) rough corners, px, in (h, w) grey levels are worth a closer look.

    That is where it is dark just inside, brighter outside and, in the data `cells`, not empty.
    """
    places = _glance(cells) @ homography(lens.ideal(quad)).T
    values = sample(image, lens.seen(places[:, :2] / places[:, 2:]))
    outside, border, inside = np.split(values, (4 * _GLANCES, 8 * _GLANCES))
    if float((outside > border).mean()) < _FRAMED:
        return False
    rise = float(np.sort(outside)[len(outside) // 2] - np.sort(border)[len(border) // 2])
    return float(inside.max() - border.min()) > _NOT_EMPTY * rise


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


def read_cells(image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens) -> np.ndarray:
    """Return (cells + 4, cells + 4) mean grey levels: data cells, the border and one ring around.

    Args:
        image: (h, w) grey levels.
        corners: (4, 2) of the black square, ideal px.
        cells: data cells along an edge.
        lens: where ideal pixels are seen.
    """
    side = cells + 4
    middles = (np.arange(side) - 0.5)[:, None] + _SPREAD
    line = middles.ravel() / (cells + 2)
    x, y = np.meshgrid(line, line)
    points = np.column_stack((x.ravel(), y.ravel(), np.ones(x.size))) @ homography(corners).T
    values = sample(image, lens.seen(points[:, :2] / points[:, 2:]))
    each = len(_SPREAD)
    return values.reshape(side, each, side, each).mean(axis=(1, 3))


def interpret(levels: np.ndarray) -> Optional[Reading]:
    """Tell black from white in the grey levels that `read_cells` returns; None if they are even.

    Light may change evenly across a marker: black and white levels are planes, black's through
    the border, white's through all that is brighter than the middle.
    """
    side = len(levels)
    inner = levels[1:-1, 1:-1]
    border = np.ones((side, side), dtype=bool)
    border[[0, -1]] = border[:, [0, -1]] = False
    border[2:-2, 2:-2] = False
    black = float(np.median(levels[border]))
    white = float(np.sort(inner, axis=None)[int(0.95 * inner.size)])
    if white - black < 1.0:
        return None
    bright = levels > 0.5 * (black + white)
    dark_plane = _plane(levels, border & ~bright)
    bright_plane = _plane(levels, bright)
    half = 0.5 * (bright_plane - dark_plane)
    half = np.maximum(half, 0.2 * 0.5 * (white - black))
    soft = np.clip((levels - 0.5 * (bright_plane + dark_plane)) / half, -1.5, 1.5)
    neighbours = soft[:-2, 1:-1] + soft[2:, 1:-1] + soft[1:-1, :-2] + soft[1:-1, 2:]
    sharp = soft[1:-1, 1:-1] + _SHARPENING * (4.0 * soft[1:-1, 1:-1] - neighbours)
    bits = np.where(sharp[1:-1, 1:-1] > 0.0, 1.0, -1.0).astype(np.float32)
    border_errors = int((sharp > 0.0)[border[1:-1, 1:-1]].sum())
    return Reading(bits.ravel(), border_errors, inner)


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


def _plane(levels: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the plane through the chosen levels, everywhere; their mean if they are few."""
    values = levels[chosen]
    if len(values) < 8:
        return np.full(levels.shape, values.mean() if len(values) else levels.mean())
    row, column = np.indices(levels.shape, dtype=float)
    middle = (len(levels) - 1) / 2.0
    terms = np.stack((np.ones(levels.shape), row - middle, column - middle), axis=-1)
    a = terms[chosen]
    solution = solve_symmetric(a.T @ a + 1e-6 * np.eye(3), a.T @ values)
    return terms @ solution
