"""Pictures of ArUco and AprilTag markers, drawn cell by cell, and of dots about them."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, dictionary_named, simple_name
from bullet_lab.vision.images import VisionError

BLACK = 0
WHITE = 255

# Measured in the report's figure 8, whose sheet, 309 pixels wide, is taken to be 1 m wide: 1187
# dots on 309 x 259 pixels, 5.5 pixels of ink each, one in twenty nearer than 3.9 pixels to another.
DOTS_PER_SQUARE_METRE = 1420.0
DOT_RADIUS = 0.0043
CLOSEST = 0.0126
TRIES_PER_DOT = 100

Rectangle = Tuple[float, float, float, float]


class MarkerError(LabError):
    """A marker that does not exist or cannot be printed as asked."""


def dictionary_names() -> Tuple[str, ...]:
    """Return the names of all dictionaries of this OpenCV, without the prefix, in lower case."""
    return tuple(sorted(simple_name(name).lower() for name in DICTIONARY_NAMES))


def marker_cells(dictionary: str, identifier: int) -> np.ndarray:
    """Return the cells of a marker as one sees it: (n, n) of bool, True is white.

    The black border of one cell is included; row 0 is the upper one.

    Args:
        dictionary: OpenCV's name of it, such as apriltag_36h10; `DICT_` before it and capitals
            make no difference.
        identifier: number of the marker in the dictionary.

    Raises:
        MarkerError: no such dictionary, or no such marker in it.

    >>> marker_cells("4x4_50", 0).astype(int)[:3]
    array([[0, 0, 0, 0, 0, 0],
           [0, 1, 0, 1, 1, 0],
           [0, 0, 1, 0, 1, 0]])
    """
    try:
        known = dictionary_named(dictionary)
    except VisionError:
        names = ", ".join(dictionary_names())
        raise MarkerError(f"no dictionary '{dictionary}'; there are {names}") from None
    count = len(known.codes)
    if not 0 <= identifier < count:
        raise MarkerError(f"{dictionary} has the ids 0 to {count - 1}, not {identifier}")
    return known.pattern(identifier) > 0


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


def scatter_dots(
    width: float, height: float, keep_out: Rectangle, rng: np.random.Generator
) -> np.ndarray:
    """Return the centres of dots on a sheet, as dense as those of the report's figure 8.

    Args:
        width: of the sheet, m.
        height: of the sheet, m.
        keep_out: left, top, right and bottom of the part that no dot may touch, m.
        rng: source of the places.

    Returns:
        (n, 2) array in metres from the upper left corner, to the right and downwards. All dots
        are whole.

    Raises:
        MarkerError: so many dots do not fit.
    """
    left, top, right, bottom = keep_out
    free_area = width * height - (right - left) * (bottom - top)
    amount = int(round(DOTS_PER_SQUARE_METRE * free_area))
    margin = np.array([DOT_RADIUS, DOT_RADIUS])
    kept = np.empty((amount, 2))
    count = 0
    for _ in range(TRIES_PER_DOT * amount):
        if count == amount:
            return kept
        dot = rng.uniform(margin, np.array([width, height]) - margin)
        outside = np.maximum(np.array([left, top]) - dot, dot - np.array([right, bottom]))
        clear = np.linalg.norm(np.maximum(outside, 0.0)) > DOT_RADIUS and outside.max() > 0.0
        near = np.linalg.norm(kept[:count] - dot, axis=1) < CLOSEST
        if clear and not near.any():
            kept[count] = dot
            count += 1
    raise MarkerError(f"no room for {amount} dots on {width:g} x {height:g} m")


def draw_dots(canvas: np.ndarray, centres: np.ndarray, metres_per_pixel: float) -> None:
    """Draw black dots with soft edges onto a picture, (h, w) of uint8, in place."""
    radius = DOT_RADIUS / metres_per_pixel
    reach = int(np.ceil(radius + 1.0))
    for x, y in np.asarray(centres) / metres_per_pixel - 0.5:
        rows = _pixels_about(y, reach, canvas.shape[0])
        columns = _pixels_about(x, reach, canvas.shape[1])
        distance = np.hypot(*np.meshgrid(columns - x, rows - y))
        ink = np.clip(radius + 0.5 - distance, 0.0, 1.0)
        patch = canvas[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        patch[...] = np.rint(patch * (1.0 - ink))


def _pixels_about(centre: float, reach: int, size: int) -> np.ndarray:
    """Return the pixels about a centre that are in a picture."""
    middle = int(round(centre))
    return np.arange(max(middle - reach, 0), min(middle + reach + 1, size))
