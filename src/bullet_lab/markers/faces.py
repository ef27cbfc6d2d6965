"""Faces: what is printed on the back wall of a dock or on a plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from bullet_lab.markers.images import (
    WHITE,
    MarkerError,
    draw_dots,
    marker_cells,
    marker_image,
    paste,
    scatter_dots,
)

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


@dataclass(frozen=True)
class Print:
    """A marker to be printed.

    Attributes:
        dictionary: OpenCV's name of it.
        identifier: number of the marker in it.
        size: edge of the black square, m.
        quiet: width of the white quiet zone, in cells.
    """

    dictionary: str = "apriltag_36h10"
    identifier: int = 0
    size: float = 0.20
    quiet: int = 1

    def __post_init__(self) -> None:
        """Raise MarkerError where there is no such marker."""
        if not 0.001 <= self.size <= 100.0:
            raise MarkerError(f"a marker's size is from 0.001 to 100 m, not {self.size:g}")
        if not 1 <= self.quiet <= LARGEST_QUIET:
            raise MarkerError(
                f"the quiet zone must be 1 to {LARGEST_QUIET} cells wide, not {self.quiet}"
            )
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
    """Return the dock's bare back wall with a marker in its middle.

    Raises:
        MarkerError: the marker does not fit, or is too small to be drawn.
    """
    canvas = np.full((WALL_PIXELS, WALL_PIXELS), WALL_GREY, dtype=np.uint8)
    _paste_middle(canvas, marker)
    return Face(canvas, WALL_SIZE)


def dots_face(marker: Optional[Print], seed: int) -> Face:
    """Return a back wall strewn with dots, with a marker in its middle if there is one.

    Raises:
        MarkerError: as `wall_face`, or a seed below 0.
    """
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
    row, column = _middle_white_cell(around.cells())
    # Its cell's centre is the wall's; the larger one's quiet zone is the white wall.
    corner = [int(round(0.5 * WALL_PIXELS - (k + 0.5) * pixels)) for k in (column, row)]
    edge = around.quiet * pixels
    paste(canvas, around.image(pixels)[edge:-edge, edge:-edge], *corner)
    if len(marker.image(_pixels(marker))) > pixels:
        raise MarkerError(
            f"a marker of {marker.face_size():g} m does not fit into a cell of "
            f"{pixels * WALL_SIZE / WALL_PIXELS:g} m"
        )
    _paste_middle(canvas, marker)
    return Face(canvas, WALL_SIZE)


def _paste_middle(canvas: np.ndarray, marker: Print) -> None:
    patch = marker.image(_pixels(marker))
    corner = (len(canvas) - len(patch)) // 2
    paste(canvas, patch, corner, corner)


def _pixels(marker: Print) -> int:
    """Return how many of the wall's pixels a cell is wide.

    It must be a whole number, and the marker's middle on a corner of pixels, or the marker
    would not be quite where and as large as it is said to be.
    """
    count = len(marker.cells())
    step = count * (1 + count % 2) * WALL_SIZE / WALL_PIXELS
    steps = int(round(marker.size / step))
    if steps < 4 or abs(marker.size - steps * step) > 1e-6 * marker.size:
        raise MarkerError(
            f"on a wall the size must be a multiple of {step:g} m, of four or more, "
            f"not {marker.size:g}"
        )
    return steps * (1 + count % 2)


def _middle_white_cell(cells: np.ndarray) -> Tuple[int, int]:
    white = np.argwhere(cells)
    if len(white) == 0:
        raise MarkerError("the larger marker has no white cell")
    offsets = np.abs(white - 0.5 * (len(cells) - 1)).max(axis=1)
    row, column = white[np.argmin(offsets)]
    return int(row), int(column)
