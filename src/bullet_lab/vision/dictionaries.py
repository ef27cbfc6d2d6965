"""Dictionaries of markers: OpenCV's, by name, as arrays of bits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Dict, Tuple

import cv2
import numpy as np

from bullet_lab.vision.images import VisionError

_PREFIX = "DICT_"
# Number of ones in a byte.
_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class MarkerDictionary:
    """A set of markers.

    Attributes:
        name: as OpenCV has it, such as DICT_APRILTAG_36h10.
        cells: number of data cells along an edge; the black border is one cell more each way.
        codes: (number of ids, 4, cells²) of ±1, white +1, row by row. The second axis counts
            quarter turns: the pattern as read from the corner that is k-th of the real ones,
            clockwise from the top left.
        packed: (bytes, number of ids · 4): the same as bits, eight in a byte.
        distance: least number of bits in which two markers differ, or a marker and itself
            turned.
    """

    name: str
    cells: int
    codes: np.ndarray
    packed: np.ndarray
    distance: int

    def nearest(self, bits: np.ndarray) -> Tuple[int, int, int]:
        """Return the marker that differs least from (cells²,) bits, its turns, the difference.

        (In bytes, as a product of matrices would start threads.)
        """
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


def _names() -> Dict[str, str]:
    """Return OpenCV's names by their simplest spelling, each dictionary once."""
    names: Dict[str, str] = {}
    for name in sorted(dir(cv2.aruco)):
        # From OpenCV 4.7 on AprilTags are there twice, as 36H11 and as 36h11; the latter counts.
        if name.startswith(_PREFIX):
            names[simple_name(name)] = name
    return names


def simple_name(name: str) -> str:
    """Return a dictionary's name in capitals and without DICT_.

    >>> simple_name("DICT_4x4_50")
    '4X4_50'
    """
    simple = name.strip().upper()
    return simple[len(_PREFIX) :] if simple.startswith(_PREFIX) else simple


_NAMES = _names()
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
    return MarkerDictionary(name, cells, codes, packed, _distance(codes))


def _distance(codes: np.ndarray) -> int:
    """Return the least number of bits between two markers however turned."""
    count, _, bits = codes.shape
    # Of ±1: equal bits less different ones.
    products = codes[:, 0] @ codes.reshape(count * 4, bits).T
    # A marker as it is equals itself.
    products[np.arange(count), 4 * np.arange(count)] = -bits
    return int(round((bits - float(products.max())) / 2.0))
