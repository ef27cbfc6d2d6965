"""Faces: pictures of markers, drawn cell by cell, on a plate or on the back wall of a dock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, dictionary_named, simple_name
from bullet_lab.vision.images import VisionError

PIXELS_PER_CELL = 32
"""Of a plate. A power of two: a renderer that filters with halved copies of a picture then finds
the cells' edges between pixels in all of them. Measured with EGL, the corners of a 0.20 m marker
are off by 0.02 to 0.05 px from 2 to 8 m with 8, 16, 32 and 64, and by up to 0.23 px with 20; at
0.4 m by 0.7 px with 4, 0.02 px with 8 and 16, and 0.01 px with 32 and 64."""

WALL_SIZE = 1.0
WALL_PIXELS = 1280
"""These make a cell of a 0.20 m marker with eight cells as fine as that of a plate."""

WALL_GREY = 150
"""The bare wall's value in the picture; its other parts have this colour, too."""

LARGEST_QUIET = 20

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


def dictionary_names() -> tuple[str, ...]:
    """Return the names of all dictionaries of this OpenCV, without the prefix, in lower case."""
    return tuple(sorted(simple_name(name).lower() for name in DICTIONARY_NAMES))


def marker_cells(dictionary: str, identifier: int) -> np.ndarray:
    """Return the cells of a marker as one sees it: (n, n) of bool, True is white.

    The black border of one cell is included; row 0 is the upper one. The dictionary is one of
    OpenCV's, such as apriltag_36h10; `DICT_` before it and capitals make no difference.

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

    Its `cells` are as of `marker_cells`, `pixels` wide, with `quiet` white ones on each side.

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
    rows, columns = canvas.shape
    if not (0 <= row <= rows - height and 0 <= column <= columns - width):
        place = f"({column}, {row}) of {columns} x {rows}"
        raise MarkerError(f"a picture of {width} x {height} pixels does not fit at {place}")
    canvas[row : row + height, column : column + width] = patch


def scatter_dots(
    width: float, height: float, keep_out: Rectangle, rng: np.random.Generator
) -> np.ndarray:
    """Return the centres of dots on a sheet, as dense as those of the report's figure 8.

    They are (n, 2), m from the upper left corner to the right and downwards. All dots are whole,
    and none touches `keep_out`: left, top, right and bottom, m.

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
        column, row = int(round(x)), int(round(y))
        left, top = max(column - reach, 0), max(row - reach, 0)
        patch = canvas[top : row + reach + 1, left : column + reach + 1]
        rows, columns = np.indices(patch.shape)
        distance = np.hypot(columns + left - x, rows + top - y)
        ink = np.clip(radius + 0.5 - distance, 0.0, 1.0)
        patch[...] = np.rint(patch * (1.0 - ink))


@dataclass(frozen=True)
class Print:
    """A marker to be printed."""

    dictionary: str = "apriltag_36h10"  #: OpenCV's name of it
    identifier: int = 0  #: number of the marker in it
    size: float = 0.20  #: edge of the black square, m
    quiet: int = 1  #: width of the white quiet zone, in cells

    def __post_init__(self) -> None:
        """Raise MarkerError where there is no such marker."""
        if not 0.001 <= self.size <= 100.0:
            raise MarkerError(f"a marker's size is from 0.001 to 100 m, not {self.size:g}")
        if not 1 <= self.quiet <= LARGEST_QUIET:
            allowed = f"1 to {LARGEST_QUIET} cells"
            raise MarkerError(f"the quiet zone must be {allowed} wide, not {self.quiet}")
        self.cells()

    def cells(self) -> np.ndarray:
        """Return the cells, see `marker_cells`."""
        return marker_cells(self.dictionary, self.identifier)

    def face_size(self) -> float:
        """Return the edge of the marker with its quiet zone, m."""
        count = len(self.cells())
        return self.size * (count + 2 * self.quiet) / count

    def image(self, pixels: int) -> np.ndarray:
        """Return the picture with the quiet zone, `pixels` for each cell."""
        return marker_image(self.cells(), pixels, self.quiet)


@dataclass(frozen=True)
class Face:
    """A square picture, (n, n) of uint8, grey, and its edge in metres."""

    image: np.ndarray
    size: float


def plate_face(marker: Print) -> Face:
    """Return a marker with nothing but its quiet zone around it."""
    return Face(marker.image(PIXELS_PER_CELL), marker.face_size())


def wall_face(marker: Print) -> Face:
    """Return the dock's bare back wall with a marker in its middle; raises MarkerError."""
    canvas = np.full((WALL_PIXELS, WALL_PIXELS), WALL_GREY, dtype=np.uint8)
    _paste_middle(canvas, marker)
    return Face(canvas, WALL_SIZE)


def dots_face(marker: Print | None, seed: int) -> Face:
    """Return a back wall strewn with dots, with a marker if there is one; raises MarkerError."""
    if seed < 0:
        raise MarkerError(f"the seed must be an integer >= 0, not {seed}")
    edge = 0.0 if marker is None else marker.face_size()
    low, high = 0.5 * (WALL_SIZE - edge), 0.5 * (WALL_SIZE + edge)
    rng = np.random.default_rng(seed)
    centres = scatter_dots(WALL_SIZE, WALL_SIZE, (low, low, high, high), rng)
    canvas = np.full((WALL_PIXELS, WALL_PIXELS), WHITE, dtype=np.uint8)
    draw_dots(canvas, centres, WALL_SIZE / WALL_PIXELS)
    if marker is not None:
        _paste_middle(canvas, marker)
    return Face(canvas, WALL_SIZE)


def nested_face(marker: Print, around: Print) -> Face:
    """Return a white back wall with a marker in its middle, as one white cell of a larger one.

    The white cell of the larger marker that is nearest to its middle is taken; ties go to the
    upper, then to the left one.

    Raises:
        MarkerError: the marker does not fit into a cell, the larger one does not fit on the
            wall, or it has no white cell.
    """
    canvas = np.full((WALL_PIXELS, WALL_PIXELS), WHITE, dtype=np.uint8)
    pixels = _pixels(around)
    cells = around.cells()
    white = np.argwhere(cells)
    if len(white) == 0:
        raise MarkerError("the larger marker has no white cell")
    row, column = white[np.argmin(np.abs(white - 0.5 * (len(cells) - 1)).max(axis=1))]
    # Its cell's centre is the wall's; the larger one's quiet zone is the white wall.
    corner = [int(round(0.5 * WALL_PIXELS - (k + 0.5) * pixels)) for k in (column, row)]
    edge = around.quiet * pixels
    paste(canvas, around.image(pixels)[edge:-edge, edge:-edge], *corner)
    if len(marker.image(_pixels(marker))) > pixels:
        cell = pixels * WALL_SIZE / WALL_PIXELS
        raise MarkerError(
            f"a marker of {marker.face_size():g} m does not fit into a cell of {cell:g} m"
        )
    _paste_middle(canvas, marker)
    return Face(canvas, WALL_SIZE)


def _paste_middle(canvas: np.ndarray, marker: Print) -> None:
    patch = marker.image(_pixels(marker))
    corner = (len(canvas) - len(patch)) // 2
    paste(canvas, patch, corner, corner)


def _pixels(marker: Print) -> int:
    """Return how many of the wall's pixels a cell is wide."""
    # It must be a whole number, and the marker's middle on a corner of pixels, or the marker
    # would not have exactly the place and size that were asked for.
    count = len(marker.cells())
    step = count * (1 + count % 2) * WALL_SIZE / WALL_PIXELS
    steps = int(round(marker.size / step))
    if steps < 4 or abs(marker.size - steps * step) > 1e-6 * marker.size:
        allowed = f"a multiple of {step:g} m, of four or more"
        raise MarkerError(f"on a wall the size must be {allowed}, not {marker.size:g}")
    return steps * (1 + count % 2)
