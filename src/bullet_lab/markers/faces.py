"""What is printed on the back wall of a dock or on a plate, and the plate as a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Tuple

import numpy as np
from PIL import Image

from bullet_lab.core.files import make_folder, replace_file
from bullet_lab.markers.dots import draw_dots, scatter_dots
from bullet_lab.markers.images import WHITE, MarkerError, marker_cells, marker_image, paste

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


CORNERS = ((0, 1, -1), (0, -1, -1), (0, -1, 1), (0, 1, 1))
"""Of the front as one sees it, from the lower left one against the clock; y is to the left."""

SIDES = (
    ((1, 0, 0), ((1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1))),
    ((0, 1, 0), ((1, 1, -1), (0, 1, -1), (0, 1, 1), (1, 1, 1))),
    ((0, -1, 0), ((0, -1, -1), (1, -1, -1), (1, -1, 1), (0, -1, 1))),
    ((0, 0, 1), ((0, 1, 1), (0, -1, 1), (1, -1, 1), (1, 1, 1))),
    ((0, 0, -1), ((1, 1, -1), (1, -1, -1), (0, -1, -1), (0, 1, -1))),
)
"""The other sides, normal and corners: depth as 0 or 1, y and z as -1 or 1."""


def write_plate(face: Face, thickness: float, folder: Path, name: str) -> Tuple[Path, ...]:
    """Write <name>.obj, <name>.mtl and <name>.png of a box that shows a picture on its front.

    The origin is the middle of the front, which looks along -x with z up; the box reaches
    `thickness` metres to +x. The other sides have the colour of the picture's corner. The box
    is whole, so that nothing has to stand close behind the picture: in a depth buffer of 16
    bits things some millimetres apart fight for the pixels.

    Returns:
        The three files.

    Raises:
        FileError: the folder cannot be written to.
    """
    make_folder(folder)
    obj, mtl, png = (folder / f"{name}.{kind}" for kind in ("obj", "mtl", "png"))
    replace_file(obj, lambda part: part.write_text(_obj(face, thickness, name)))
    replace_file(mtl, lambda part: part.write_text(_mtl(name)))
    image = Image.fromarray(np.ascontiguousarray(face.image))
    replace_file(png, lambda part: image.save(part, optimize=True))
    return obj, mtl, png


def _obj(face: Face, thickness: float, name: str) -> str:
    lines = [f"mtllib {name}.mtl", f"o {name}", "usemtl face"]
    lines += [_vertex(corner, face.size, thickness) for corner in CORNERS]
    for _, corners in SIDES:
        lines += [_vertex(corner, face.size, thickness) for corner in corners]
    # The picture's corners, and the middle of its corner pixel for all other sides.
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines.append(f"vt {0.5 / len(face.image):.9g} {0.5 / len(face.image):.9g}")
    lines.append("vn -1 0 0")
    lines += ["vn {} {} {}".format(*normal) for normal, _ in SIDES]
    lines += _quad(1, (1, 2, 3, 4), 1)
    for index in range(len(SIDES)):
        lines += _quad(5 + 4 * index, (5, 5, 5, 5), 2 + index)
    return "\n".join(lines) + "\n"


def _vertex(corner: Tuple[int, int, int], size: float, thickness: float) -> str:
    x, y, z = corner[0] * thickness, 0.5 * size * corner[1], 0.5 * size * corner[2]
    return f"v {x:.9g} {y:.9g} {z:.9g}"


def _quad(first: int, texture: Tuple[int, int, int, int], normal: int) -> List[str]:
    corners = [f"{first + k}/{texture[k]}/{normal}" for k in range(4)]
    return [f"f {corners[0]} {corners[b]} {corners[c]}" for b, c in ((1, 2), (2, 3))]


def _mtl(name: str) -> str:
    lines = ("newmtl face", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", f"map_Kd {name}.png")
    return "\n".join(lines) + "\n"
