"""Models with a marker, in Gazebo's layout: model.config, model.sdf and meshes.

The frame of each model is the dock's: the origin on the floor below the marker's face, x into
the face. A docked robot looks along x.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Sequence, Tuple
from xml.sax.saxutils import escape

import numpy as np
from PIL import Image

from bullet_lab.core.files import make_folder, replace_file
from bullet_lab.markers.faces import WALL_GREY, WALL_SIZE, Face, MarkerError

DOCK_DEPTH = 2.0
WALL_THICKNESS = 0.2
PLATE_THICKNESS = 0.02
POST_WIDTH = 0.04

Vector = Tuple[float, float, float]

# Corners of the front as one sees it, from the lower left one against the clock: depth as 0 or
# 1, y (to the left) and z as -1 or 1. Then the other sides, normal and corners.
_CORNERS = ((0, 1, -1), (0, -1, -1), (0, -1, 1), (0, 1, 1))
_SIDES = (
    ((1, 0, 0), ((1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1))),
    ((0, 1, 0), ((1, 1, -1), (0, 1, -1), (0, 1, 1), (1, 1, 1))),
    ((0, -1, 0), ((0, -1, -1), (1, -1, -1), (1, -1, 1), (0, -1, 1))),
    ((0, 0, 1), ((0, 1, 1), (0, -1, 1), (1, -1, 1), (1, 1, 1))),
    ((0, 0, -1), ((1, 1, -1), (1, -1, -1), (0, -1, -1), (0, 1, -1))),
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


@dataclass(frozen=True)
class _Piece:
    """A box of a model. With a `mesh_origin`, the mesh of its name is drawn there instead."""

    name: str
    size: Vector
    centre: Vector
    mesh_origin: Vector | None = None


def write_panel(face: Face, height: float, folder: Path, about: str) -> None:
    """Write a model of a plate on a post; its name is that of the folder, made if need be.

    The middle of the plate is at `height` above the floor, m.

    Raises:
        MarkerError: the plate would reach into the floor.
        FileError: the folder cannot be written to.
    """
    below = height - 0.5 * face.size
    if below < 0.0:
        raise MarkerError(f"a plate of {face.size:g} m at a height of {height:g} m is in the floor")
    middle = 0.5 * PLATE_THICKNESS
    plate = (PLATE_THICKNESS, face.size, face.size)
    parts = [_Piece("plate", plate, (middle, 0.0, height), (0.0, 0.0, height))]
    if below > 0.0:
        post = (PLATE_THICKNESS, POST_WIDTH, below)
        parts.append(_Piece("post", post, (middle, 0.0, 0.5 * below)))
    write_plate(face, PLATE_THICKNESS, folder / "meshes", "plate")
    _write_model(folder, parts, about)


def write_dock(face: Face, folder: Path, about: str) -> None:
    """Write a model of the docking station, whose back wall shows a picture.

    Three boxes as a U, open towards -x; arguments and errors as of `write_panel`.
    """
    size, half = WALL_SIZE, 0.5 * WALL_SIZE
    back = (WALL_THICKNESS, size, size)
    side = (DOCK_DEPTH + WALL_THICKNESS, WALL_THICKNESS, size)
    x = 0.5 * (WALL_THICKNESS - DOCK_DEPTH)
    y = half + 0.5 * WALL_THICKNESS
    parts = (
        _Piece("back_wall", back, (0.5 * WALL_THICKNESS, 0.0, half), (0.0, 0.0, half)),
        _Piece("left_wall", side, (x, y, half)),
        _Piece("right_wall", side, (x, -y, half)),
    )
    write_plate(face, WALL_THICKNESS, folder / "meshes", "back_wall")
    _write_model(folder, parts, about)


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
    scale, sides = np.array([thickness, 0.5 * face.size, 0.5 * face.size]), [c for _, c in _SIDES]
    for corners in (_CORNERS, *sides):
        lines += [f"v {_numbers(scale * corner)}" for corner in corners]
    # The picture's corners, and the middle of its corner pixel for all other sides.
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines.append(f"vt {0.5 / len(face.image):.9g} {0.5 / len(face.image):.9g}")
    lines.append("vn -1 0 0")
    lines += ["vn {} {} {}".format(*normal) for normal, _ in _SIDES]
    lines += _quad(1, (1, 2, 3, 4), 1)
    for index in range(len(_SIDES)):
        lines += _quad(5 + 4 * index, (5, 5, 5, 5), 2 + index)
    return "\n".join(lines) + "\n"


def _quad(first: int, texture: tuple[int, int, int, int], normal: int) -> list[str]:
    corners = [f"{first + k}/{texture[k]}/{normal}" for k in range(4)]
    return [f"f {corners[0]} {corners[b]} {corners[c]}" for b, c in ((1, 2), (2, 3))]


def _write_model(folder: Path, parts: Sequence[_Piece], about: str) -> None:
    make_folder(folder)
    name = folder.absolute().name
    sdf = _SDF.format(name=name, shapes="".join(_shapes(part, name) for part in parts))
    config = _CONFIG.format(name=name, about=escape(about))
    replace_file(folder / "model.sdf", lambda path: path.write_text(sdf))
    replace_file(folder / "model.config", lambda path: path.write_text(config))


def _shapes(part: _Piece, model: str) -> str:
    """Return a part's collision and visual."""
    box = _BOX.format(place=_numbers(part.centre), size=_numbers(part.size))
    if part.mesh_origin is None:
        visual = box + _GREY.format(f"{WALL_GREY / 255.0:.3f}")
    else:
        # No <material>: Gazebo would paint it over the texture.
        place = _numbers(part.mesh_origin)
        visual = _MESH.format(place=place, model=model, name=part.name)
    return _SHAPES.format(name=part.name, box=box, visual=visual)


def _numbers(values: Vector) -> str:
    return " ".join(f"{value:.9g}" for value in values)
