"""Makes marker images, textured meshes, and models of panels and docks that bear a marker.

Examples:
    rosrun bullet_lab make_marker.py my_marker --id 7 --size 0.1
    rosrun bullet_lab make_marker.py ~/.gazebo/models/my_panel --on panel --dictionary 4x4_50
    rosrun bullet_lab make_marker.py models/docking_station_dots --on dock --dots
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, NoReturn, Sequence, Tuple
from xml.sax.saxutils import escape

import numpy as np
from numpy import ndarray
from PIL import Image

from bullet_lab.core.files import make_folder, replace_file, write_text
from bullet_lab.core.parameters import ArgumentParser
from bullet_lab.core.pose import Vector
from bullet_lab.errors import LabError
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, dictionary_named, simple_name

STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130
NAME = re.compile(r"[A-Za-z0-9_.-]+")
# Of a plate. A power of two: a renderer that filters with halved copies of a picture then finds
# the cells' edges between pixels in all of them. Measured with EGL, the corners of a 0.20 m marker
# are off by 0.02 to 0.05 px from 2 to 8 m with 8, 16, 32 and 64, and by up to 0.23 px with 20; at
# 0.4 m by 0.7 px with 4, 0.02 px with 8 and 16, and 0.01 px with 32 and 64.
PIXELS_PER_CELL = 32
# These make a cell of a 0.20 m marker with eight cells as fine as that of a plate.
WALL_SIZE = 1.0
WALL_PIXELS = 1280
# The bare wall's value in the picture; its other parts have this colour, too.
WALL_GREY = 150
WHITE = 255
LARGEST_QUIET = 20
# Measured in the report's figure 8, whose sheet, 309 pixels wide, is taken to be 1 m wide: 1187
# dots on 309 x 259 pixels, 5.5 pixels of ink each, one in twenty nearer than 3.9 pixels to another.
DOTS_PER_SQUARE_METRE = 1420.0
DOT_RADIUS = 0.0043
CLOSEST = 0.0126
TRIES_PER_DOT = 100
# m.
DOCK_DEPTH = 2.0
WALL_THICKNESS = 0.2
PLATE_THICKNESS = 0.02
POST_WIDTH = 0.04

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

    Raises LabError if it does not fit there.
    """
    height, width = patch.shape
    rows, columns = canvas.shape
    if not (0 <= row <= rows - height and 0 <= column <= columns - width):
        place = f"({column}, {row}) of {columns} x {rows}"
        raise LabError(f"a picture of {width} x {height} pixels does not fit at {place}")
    canvas[row : row + height, column : column + width] = patch


def scatter_dots(side: float, free: float, rng: np.random.Generator) -> ndarray:
    """Return the centres of dots on a square sheet, as dense as those of the report's figure 8.

    They are (n, 2), m from the upper left corner to the right and downwards. All dots are whole,
    and none touches the square of the edge `free` (m) in the middle of the sheet. Raises LabError
    if so many dots do not fit.
    """
    amount = round(DOTS_PER_SQUARE_METRE * (side * side - free * free))
    kept, count = np.empty((amount, 2)), 0
    for _ in range(TRIES_PER_DOT * amount):
        if count == amount:
            return kept
        dot = rng.uniform(DOT_RADIUS, side - DOT_RADIUS, 2)
        beyond = np.maximum(np.abs(dot - 0.5 * side) - 0.5 * free, 0.0)
        apart = np.linalg.norm(kept[:count] - dot, axis=1)
        if np.linalg.norm(beyond) > DOT_RADIUS and not (apart < CLOSEST).any():
            kept[count] = dot
            count += 1
    raise LabError(f"no room for {amount} dots on {side:g} x {side:g} m")


def draw_dots(canvas: ndarray, centres: ndarray, metres_per_pixel: float) -> None:
    """Draw black dots with soft edges onto a picture, (h, w) of uint8, in place."""
    radius = DOT_RADIUS / metres_per_pixel
    reach = int(np.ceil(radius + 1.0))
    rows, columns = np.ogrid[: canvas.shape[0], : canvas.shape[1]]
    for x, y in (centres / metres_per_pixel - 0.5).tolist():
        near = [slice(max(round(v) - reach, 0), round(v) + reach + 1) for v in (y, x)]
        distance = np.hypot(columns[:, near[1]] - x, rows[near[0]] - y)
        ink = np.clip(radius + 0.5 - distance, 0.0, 1.0)
        canvas[tuple(near)] = np.rint(canvas[tuple(near)] * (1.0 - ink))


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
        return np.kron(framed, np.full((pixels, pixels), WHITE, dtype=np.uint8))


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
    centres = scatter_dots(WALL_SIZE, marker.face_size(), np.random.default_rng(seed))
    canvas = _wall(WHITE)
    draw_dots(canvas, centres, WALL_SIZE / WALL_PIXELS)
    return _with_marker(canvas, marker)


def nested_face(marker: Print, around: Print) -> Face:
    """Return a white back wall with a marker in its middle, as one white cell of a larger one.

    The white cell of the larger marker that is nearest to its middle is taken; ties go to the
    upper, then to the left one. Raises LabError if the marker does not fit into a cell, or the
    larger one on the wall.
    """
    canvas = _wall(WHITE)
    pixels = _pixels(around)
    cells = around.cells()
    white = np.argwhere(cells)
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


# Of a model's boxes by name: size and centre in m.
Boxes = Mapping[str, Tuple[Vector, Vector]]


def write_panel(face: Face, height: float, folder: Path, about: str) -> None:
    """Write a model of a plate on a post, its middle at a height above the floor in m.

    Its frame is the dock's: the origin on the floor below the marker's face, x into the face. A
    docked robot looks along x. Raises LabError if the plate would reach into the floor, or the
    folder cannot be written to.
    """
    below = height - 0.5 * face.size
    if below < 0.0:
        raise LabError(f"a plate of {face.size:g} m at a height of {height:g} m is in the floor")
    middle = 0.5 * PLATE_THICKNESS
    boxes = {"plate": ((PLATE_THICKNESS, face.size, face.size), (middle, 0.0, height))}
    if below > 0.0:
        boxes["post"] = (PLATE_THICKNESS, POST_WIDTH, below), (middle, 0.0, 0.5 * below)
    _write_model(face, boxes, folder, about)


def write_dock(face: Face, folder: Path, about: str) -> None:
    """Write a model of the docking station, whose back wall shows a picture.

    Three boxes as a U, open towards -x; frame and errors as of `write_panel`.
    """
    size, half = WALL_SIZE, 0.5 * WALL_SIZE
    side = (DOCK_DEPTH + WALL_THICKNESS, WALL_THICKNESS, size)
    x = 0.5 * (WALL_THICKNESS - DOCK_DEPTH)
    y = half + 0.5 * WALL_THICKNESS
    boxes = {
        "back_wall": ((WALL_THICKNESS, size, size), (0.5 * WALL_THICKNESS, 0.0, half)),
        "left_wall": (side, (x, y, half)),
        "right_wall": (side, (x, -y, half)),
    }
    _write_model(face, boxes, folder, about)


def _write_model(face: Face, boxes: Boxes, folder: Path, about: str) -> None:
    """Write a model in Gazebo's layout, named like its folder; the first box shows the picture."""
    name, (shown, *_) = folder.absolute().name, boxes
    shapes = ""
    for part, (size, centre) in boxes.items():
        box = visual = _BOX.format(place=_numbers(centre), size=_numbers(size))
        if part == shown:
            write_plate(face, size[0], folder / "meshes", part)
            # No <material>: Gazebo would paint it over the texture. The mesh begins at the front.
            place = _numbers((0.0, *centre[1:]))
            visual = _MESH.format(place=place, model=name, name=part)
        else:
            visual += _GREY.format(f"{WALL_GREY / 255.0:.3f}")
        shapes += _SHAPES.format(name=part, box=box, visual=visual)
    write_text(folder / "model.sdf", _SDF.format(name=name, shapes=shapes))
    write_text(folder / "model.config", _CONFIG.format(name=name, about=escape(about)))


def write_plate(face: Face, thickness: float, folder: Path, name: str) -> tuple[Path, ...]:
    """Write <name>.obj, <name>.mtl and <name>.png of a box that shows a picture on its front.

    The origin is the middle of the front, which looks along -x with z up; the box reaches
    `thickness` metres to +x. The other sides have the colour of the picture's corner. The box
    is whole, so that nothing has to stand close behind the picture: in a depth buffer of 16
    bits things some millimetres apart fight for the pixels. Returns the three files; raises
    FileError if the folder cannot be written to.
    """
    make_folder(folder)
    obj, mtl, png = (folder / f"{name}.{kind}" for kind in ("obj", "mtl", "png"))
    write_text(obj, _obj(face, thickness, name))
    write_text(mtl, _MTL.format(name=name))
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
    for side in range(len(_SIDES)):
        one, two, three, four = (
            f"{4 * side + k}/{5 if side else k}/{1 + side}" for k in range(1, 5)
        )
        lines += [f"f {one} {two} {three}", f"f {one} {three} {four}"]
    return "\n".join(lines) + "\n"


def _numbers(values: Vector) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def make(values: argparse.Namespace) -> str:
    """Make what the command line asks for, and return a sentence that describes it.

    Raises:
        LabError: it cannot be made.
    """
    folder = values.out
    if not NAME.fullmatch(folder.absolute().name):
        raise LabError(f"'{folder.name}' is no name of a model: letters, digits, _ - and .")
    marker = Print(values.dictionary, values.id, values.size, values.quiet)
    made = f"Marker {marker.identifier} of {marker.dictionary}, {marker.size:g} m"
    if values.on != "dock":
        if values.dots or values.around is not None:
            raise LabError("--dots and --around are for the back wall: add --on dock")
        if values.on == "panel":
            write_panel(plate_face(marker), values.height, folder, f"{made}, on a panel.")
        else:
            write_plate(plate_face(marker), PLATE_THICKNESS, folder, folder.absolute().name)
        return made
    if values.dots and values.around is not None:
        raise LabError("a back wall has either --dots or a marker --around, not both")
    face = wall_face(marker)
    if values.dots:
        face = dots_face(marker, values.seed)
        made += f", among dots (seed {values.seed})"
    elif values.around is not None:
        identifier = values.id if values.around_id is None else values.around_id
        around = Print(values.dictionary, identifier, values.around, values.quiet)
        face = nested_face(marker, around)
        made += f", as a white cell of marker {identifier}, {values.around:g} m"
    made += ", on a docking station's back wall"
    write_dock(face, folder, f"{made}.")
    return made


def parser() -> ArgumentParser:
    """Return the parser of the command line."""
    form = argparse.RawDescriptionHelpFormatter
    made = ArgumentParser(prog="make_marker.py", description=__doc__, formatter_class=form)
    made.add_argument("out", type=Path, help="folder that is written to; its name is the model's")

    def option(name: str, default: Any, about: str, **more: Any) -> None:
        if default is not None:
            about += " [%(default)s]"
        made.add_argument(name, default=default, help=about.strip(), **more)

    names = ", ".join(simple_name(name).lower() for name in DICTIONARY_NAMES)
    option("--dictionary", Print.dictionary, f"of OpenCV: {names}")
    option("--id", Print.identifier, "", type=int)
    option("--size", Print.size, "edge of the black square, m", type=float)
    option("--quiet", Print.quiet, "white cells around it", type=int)
    option(
        "--on",
        "plate",
        "plate: image and mesh only; panel: a model that stands on a post; dock: the model "
        "of a docking station with the marker on its back wall",
        choices=("plate", "panel", "dock"),
    )
    option("--height", 0.5, "of a panel's middle, m", type=float)
    made.add_argument("--dots", action="store_true", help="strew the back wall with dots")
    option("--seed", 1, "of the dots", type=int)
    option("--around", None, "size of a larger marker that has this one as a cell, m", type=float)
    option("--around-id", None, "its number [that of the marker]", type=int)
    return made


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line, and exit: 0 done, 2 bad input, 130 interrupted."""
    words = sys.argv[1:] if arguments is None else arguments
    # roslaunch adds its own: __name:=… and __log:=…
    words = [word for word in words if not re.match(r"__\w+:=", word)]
    try:
        made = make(parser().parse_args(words))
    except LabError as error:
        print(f"make_marker: {error}", file=sys.stderr, flush=True)
        sys.exit(STATUS_BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(STATUS_INTERRUPTED)
    print(f"make_marker: {made}", flush=True)
    sys.exit(0)
