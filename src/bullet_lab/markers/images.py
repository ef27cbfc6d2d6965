"""Pictures of ArUco and AprilTag markers, drawn cell by cell."""

from __future__ import annotations

from typing import Dict, Tuple

import cv2
import numpy as np

from bullet_lab.errors import LabError

BLACK = 0
WHITE = 255
PREFIX = "DICT_"
BORDER_CELLS = 1
"""Black cells around the bits on each side, part of the marker."""


class MarkerError(LabError):
    """A marker that does not exist or cannot be printed as asked."""


def dictionary_names() -> Tuple[str, ...]:
    """Return the names of all dictionaries of this OpenCV, without the prefix, in lower case."""
    return tuple(sorted(_codes()))


def marker_cells(dictionary: str, identifier: int) -> np.ndarray:
    """Return the cells of a marker as one sees it: (n, n) of bool, True is white.

    The black border of one cell is included; row 0 is the upper one.

    Args:
        dictionary: OpenCV's name of it, such as apriltag_36h10; `DICT_` before it and capitals
            make no difference.
        identifier: number of the marker in the dictionary.

    Raises:
        MarkerError: no such dictionary, or no such marker in it.
    """
    known = _dictionary(dictionary)
    count = len(known.bytesList)
    if not 0 <= identifier < count:
        raise MarkerError(f"{dictionary} has the ids 0 to {count - 1}, not {identifier}")
    side = known.markerSize + 2 * BORDER_CELLS
    return cv2.aruco.generateImageMarker(known, identifier, side, borderBits=BORDER_CELLS) > 0


def marker_image(cells: np.ndarray, pixels: int, quiet: int = 1) -> np.ndarray:
    """Return the picture of a marker with its quiet zone, (side, side) of uint8.

    Args:
        cells: (n, n) of bool, as of `marker_cells`.
        pixels: side of a cell.
        quiet: white cells around the marker on each side.

    Raises:
        MarkerError: no quiet zone, or cells without pixels. A marker whose border touches
            something dark has no outline that a detector could find.
    """
    if quiet < 1:
        raise MarkerError(f"the quiet zone must be at least one cell wide, not {quiet}")
    if pixels < 1:
        raise MarkerError(f"a cell must be at least one pixel wide, not {pixels}")
    framed = np.pad(np.asarray(cells, dtype=bool), quiet, constant_values=True)
    picture = np.where(framed, WHITE, BLACK).astype(np.uint8)
    return np.kron(picture, np.ones((pixels, pixels), dtype=np.uint8))


def paste(canvas: np.ndarray, patch: np.ndarray, column: int, row: int) -> None:
    """Draw a picture over another, its upper left pixel at a column and row.

    Raises:
        MarkerError: it does not fit there.
    """
    height, width = patch.shape
    if not (0 <= row <= canvas.shape[0] - height and 0 <= column <= canvas.shape[1] - width):
        raise MarkerError(
            f"a picture of {width} x {height} pixels does not fit at ({column}, {row}) "
            f"of {canvas.shape[1]} x {canvas.shape[0]}"
        )
    canvas[row : row + height, column : column + width] = patch


def _codes() -> Dict[str, int]:
    names = (name for name in dir(cv2.aruco) if name.startswith(PREFIX))
    return {name[len(PREFIX) :].lower(): getattr(cv2.aruco, name) for name in names}


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    codes = _codes()
    plain = name.lower()
    plain = plain[len(PREFIX) :] if plain.startswith(PREFIX.lower()) else plain
    if plain not in codes:
        raise MarkerError(f"no dictionary '{name}'; there are {', '.join(sorted(codes))}")
    return cv2.aruco.getPredefinedDictionary(codes[plain])
