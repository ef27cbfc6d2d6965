"""A picture as the front of a box: a Wavefront mesh, its material and its texture."""

from __future__ import annotations

from pathlib import Path
from typing import List, Tuple

import numpy as np
from PIL import Image

from bullet_lab.markers.faces import Face
from bullet_lab.recording.files import make_folder, replace_file

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
