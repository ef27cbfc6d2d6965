"""Draw markers on plates and walls, and write models that bear them.

The models are in Gazebo's layout: model.config, model.sdf and meshes. The frame of each is the
dock's: the origin on the floor below the marker's face, x into the face. A docked robot looks
along x.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence, Tuple
from xml.sax.saxutils import escape

import numpy as np
from numpy import ndarray
from PIL import Image

from bullet_lab.core.files import make_folder, replace_file
from bullet_lab.core.pose import Vector
from bullet_lab.errors import LabError
from bullet_lab.vision.dictionaries import dictionary_named

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

DOCK_DEPTH = 2.0
WALL_THICKNESS = 0.2
PLATE_THICKNESS = 0.02
POST_WIDTH = 0.04

Rectangle = Tuple[float, float, float, float]

# Corners of a box: depth as 0 or 1, y (to the left) and z as -1 or 1.
_CORNERS = np.array(list(itertools.product((0, 1), (-1, 1), (-1, 1))))
# The normals of its sides, and their corners against the clock as one sees them, from the lower
# left one. The front is the first.
_SIDES = (
    ((-1, 0, 0), (2, 0, 1, 3)),
    ((1, 0, 0), (4, 6, 7, 5)),
    ((0, 1, 0), (6, 2, 3, 7)),
    ((0, -1, 0), (0, 4, 5, 1)),
    ((0, 0, 1), (3, 1, 5, 7)),
    ((0, 0, -1), (6, 4, 0, 2)),
)

_SDF = """<?xml version="1.0"?>
<sdf version="1.6">
  <model name="{name}">
    <static>true</static>
    <link name="link">{shapes}
    </link>
  </model>
</sdf>
"""
_SHAPES = """
      <collision name="{name}">{box}
      </collision>
      <visual name="{name}">{visual}
      </visual>"""
_BOX = """
        <pose>{place} 0 0 0</pose>
        <geometry>
          <box>
            <size>{size}</size>
          </box>
        </geometry>"""
_MESH = """
        <pose>{place} 0 0 0</pose>
        <geometry>
          <mesh>
            <uri>model://{model}/meshes/{name}.obj</uri>
          </mesh>
        </geometry>"""
_GREY = """
        <material>
          <ambient>{0} {0} {0} 1</ambient>
          <diffuse>{0} {0} {0} 1</diffuse>
        </material>"""
_MTL = "newmtl face\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd {name}.png\n"
_CONFIG = """<?xml version="1.0"?>
<model>
  <name>{name}</name>
  <version>1.0</version>
  <sdf version="1.6">model.sdf</sdf>
  <description>{about}</description>
</model>
"""


def paste(canvas: ndarray, patch: ndarray, column: int, row: int) -> None:
    """Draw a picture over another, its upper left pixel at a column and row.

    Raises:
        LabError: it does not fit there.
    """
    height, width = patch.shape
    rows, columns = canvas.shape
    if not (0 <= row <= rows - height and 0 <= column <= columns - width):
        place = f"({column}, {row}) of {columns} x {rows}"
        raise LabError(f"a picture of {width} x {height} pixels does not fit at {place}")
    canvas[row : row + height, column : column + width] = patch


def scatter_dots(
    width: float, height: float, keep_out: Rectangle, rng: np.random.Generator
) -> ndarray:
    """Return the centres of dots on a sheet, as dense as those of the report's figure 8.

    They are (n, 2), m from the upper left corner to the right and downwards. All dots are whole,
    and none touches `keep_out`: left, top, right and bottom, m.

    Raises:
        LabError: so many dots do not fit.
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
    raise LabError(f"no room for {amount} dots on {width:g} x {height:g} m")


def draw_dots(canvas: ndarray, centres: ndarray, metres_per_pixel: float) -> None:
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
        """Raise LabError or VisionError where there is no such marker."""
        if not 0.001 <= self.size <= 100.0:
            raise LabError(f"a marker's size is from 0.001 to 100 m, not {self.size:g}")
        if not 1 <= self.quiet <= LARGEST_QUIET:
            allowed = f"1 to {LARGEST_QUIET} cells"
            raise LabError(f"the quiet zone must be {allowed} wide, not {self.quiet}")
        self.cells()

    def cells(self) -> ndarray:
        """Return the cells as one sees them, with the border: (n, n) of bool, True is white.

        >>> Print("4x4_50", 0).cells().astype(int)[:3]
        array([[0, 0, 0, 0, 0, 0],
               [0, 1, 0, 1, 1, 0],
               [0, 0, 1, 0, 1, 0]])
        """
        return dictionary_named(self.dictionary).pattern(self.identifier) > 0

    def face_size(self) -> float:
        """Return the edge of the marker with its quiet zone, m."""
        count = len(self.cells())
        return self.size * (count + 2 * self.quiet) / count

    def image(self, pixels: int) -> ndarray:
        """Return the picture with the quiet zone, uint8, `pixels` for each cell.

        A marker whose border touches something dark has no outline that a detector could find.
        """
        framed = np.pad(self.cells(), self.quiet, constant_values=True)
        picture = np.where(framed, WHITE, BLACK).astype(np.uint8)
        return np.kron(picture, np.ones((pixels, pixels), dtype=np.uint8))


@dataclass(frozen=True)
class Face:
    """A square picture, (n, n) of uint8, grey, and its edge in metres."""

    image: ndarray
    size: float


def plate_face(marker: Print) -> Face:
    """Return a marker with nothing but its quiet zone around it."""
    return Face(marker.image(PIXELS_PER_CELL), marker.face_size())


def wall_face(marker: Print) -> Face:
    """Return the dock's bare back wall with a marker in its middle; raises LabError."""
    return _with_marker(_wall(WALL_GREY), marker)


def dots_face(marker: Print, seed: int) -> Face:
    """Return a back wall with dots around a marker; raises LabError."""
    if seed < 0:
        raise LabError(f"the seed must be an integer >= 0, not {seed}")
    edge = marker.face_size()
    low, high = 0.5 * (WALL_SIZE - edge), 0.5 * (WALL_SIZE + edge)
    rng = np.random.default_rng(seed)
    centres = scatter_dots(WALL_SIZE, WALL_SIZE, (low, low, high, high), rng)
    canvas = _wall(WHITE)
    draw_dots(canvas, centres, WALL_SIZE / WALL_PIXELS)
    return _with_marker(canvas, marker)


def nested_face(marker: Print, around: Print) -> Face:
    """Return a white back wall with a marker in its middle, as one white cell of a larger one.

    The white cell of the larger marker that is nearest to its middle is taken; ties go to the
    upper, then to the left one.

    Raises:
        LabError: the marker does not fit into a cell, the larger one does not fit on the
            wall, or it has no white cell.
    """
    canvas = _wall(WHITE)
    pixels = _pixels(around)
    cells = around.cells()
    white = np.argwhere(cells)
    if len(white) == 0:
        raise LabError("the larger marker has no white cell")
    row, column = white[np.argmin(np.abs(white - 0.5 * (len(cells) - 1)).max(axis=1))]
    # Its cell's centre is the wall's; the larger one's quiet zone is the white wall.
    corner = [int(round(0.5 * WALL_PIXELS - (k + 0.5) * pixels)) for k in (column, row)]
    edge = around.quiet * pixels
    paste(canvas, around.image(pixels)[edge:-edge, edge:-edge], *corner)
    if len(marker.image(_pixels(marker))) > pixels:
        cell = pixels * WALL_SIZE / WALL_PIXELS
        raise LabError(
            f"a marker of {marker.face_size():g} m does not fit into a cell of {cell:g} m"
        )
    return _with_marker(canvas, marker)


def _wall(grey: int) -> ndarray:
    return np.full((WALL_PIXELS, WALL_PIXELS), grey, dtype=np.uint8)


def _with_marker(canvas: ndarray, marker: Print) -> Face:
    """Return a wall with a marker in its middle."""
    patch = marker.image(_pixels(marker))
    corner = (len(canvas) - len(patch)) // 2
    paste(canvas, patch, corner, corner)
    return Face(canvas, WALL_SIZE)


def _pixels(marker: Print) -> int:
    """Return how many of the wall's pixels a cell is wide."""
    # It must be a whole number, and the marker's middle on a corner of pixels, or the marker
    # would not have exactly the place and size that were asked for.
    count = len(marker.cells())
    step = count * (1 + count % 2) * WALL_SIZE / WALL_PIXELS
    steps = int(round(marker.size / step))
    if steps < 4 or abs(marker.size - steps * step) > 1e-6 * marker.size:
        allowed = f"a multiple of {step:g} m, of four or more"
        raise LabError(f"on a wall the size must be {allowed}, not {marker.size:g}")
    return steps * (1 + count % 2)


def write_panel(face: Face, height: float, folder: Path, about: str) -> None:
    """Write a model of a plate on a post; its name is that of the folder, which is made.

    The middle of the plate is at `height` above the floor, m.

    Raises:
        LabError: the plate would reach into the floor.
        FileError: the folder cannot be written to.
    """
    below = height - 0.5 * face.size
    if below < 0.0:
        raise LabError(f"a plate of {face.size:g} m at a height of {height:g} m is in the floor")
    middle = 0.5 * PLATE_THICKNESS
    plate = (PLATE_THICKNESS, face.size, face.size)
    shapes = [_picture("plate", plate, (middle, 0.0, height), folder)]
    if below > 0.0:
        post = (PLATE_THICKNESS, POST_WIDTH, below)
        shapes.append(_box("post", post, (middle, 0.0, 0.5 * below)))
    write_plate(face, PLATE_THICKNESS, folder / "meshes", "plate")
    _write_model(folder, shapes, about)


def write_dock(face: Face, folder: Path, about: str) -> None:
    """Write a model of the docking station, whose back wall shows a picture.

    Three boxes as a U, open towards -x; arguments and errors as of `write_panel`.
    """
    size, half = WALL_SIZE, 0.5 * WALL_SIZE
    back = (WALL_THICKNESS, size, size)
    side = (DOCK_DEPTH + WALL_THICKNESS, WALL_THICKNESS, size)
    x = 0.5 * (WALL_THICKNESS - DOCK_DEPTH)
    y = half + 0.5 * WALL_THICKNESS
    shapes = (
        _picture("back_wall", back, (0.5 * WALL_THICKNESS, 0.0, half), folder),
        _box("left_wall", side, (x, y, half)),
        _box("right_wall", side, (x, -y, half)),
    )
    write_plate(face, WALL_THICKNESS, folder / "meshes", "back_wall")
    _write_model(folder, shapes, about)


def write_plate(face: Face, thickness: float, folder: Path, name: str) -> tuple[Path, ...]:
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
    replace_file(mtl, lambda part: part.write_text(_MTL.format(name=name)))
    image = Image.fromarray(np.ascontiguousarray(face.image))
    replace_file(png, lambda part: image.save(part, optimize=True))
    return obj, mtl, png


def _obj(face: Face, thickness: float, name: str) -> str:
    lines = [f"mtllib {name}.mtl", f"o {name}", "usemtl face"]
    places = _CORNERS * [thickness, 0.5 * face.size, 0.5 * face.size]
    lines += [f"v {_numbers(places[corner])}" for _, corners in _SIDES for corner in corners]
    # The picture's corners, and the middle of its corner pixel for all other sides.
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines.append(f"vt {0.5 / len(face.image):.9g} {0.5 / len(face.image):.9g}")
    lines += ["vn {} {} {}".format(*normal) for normal, _ in _SIDES]
    for index in range(len(_SIDES)):
        lines += _quad(1 + 4 * index, (5, 5, 5, 5) if index else (1, 2, 3, 4), 1 + index)
    return "\n".join(lines) + "\n"


def _quad(first: int, texture: tuple[int, int, int, int], normal: int) -> list[str]:
    corners = [f"{first + k}/{texture[k]}/{normal}" for k in range(4)]
    return [f"f {corners[0]} {corners[b]} {corners[c]}" for b, c in ((1, 2), (2, 3))]


def _write_model(folder: Path, shapes: Sequence[str], about: str) -> None:
    make_folder(folder)
    name = folder.absolute().name
    sdf = _SDF.format(name=name, shapes="".join(shapes))
    config = _CONFIG.format(name=name, about=escape(about))
    replace_file(folder / "model.sdf", lambda path: path.write_text(sdf))
    replace_file(folder / "model.config", lambda path: path.write_text(config))


def _box(name: str, size: Vector, centre: Vector) -> str:
    """Return a grey box of a model."""
    box = _BOX.format(place=_numbers(centre), size=_numbers(size))
    visual = box + _GREY.format(f"{WALL_GREY / 255.0:.3f}")
    return _SHAPES.format(name=name, box=box, visual=visual)


def _picture(name: str, size: Vector, centre: Vector, model: Path) -> str:
    """Return a box of a model that is drawn as the mesh of its name."""
    box = _BOX.format(place=_numbers(centre), size=_numbers(size))
    # No <material>: Gazebo would paint it over the texture. The mesh begins at the front.
    place = _numbers((0.0, *centre[1:]))
    visual = _MESH.format(place=place, model=model.absolute().name, name=name)
    return _SHAPES.format(name=name, box=box, visual=visual)


def _numbers(values: Vector) -> str:
    return " ".join(f"{value:.9g}" for value in values)
