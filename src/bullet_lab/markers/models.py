"""Models with a marker in Gazebo's layout: model.config, model.sdf and meshes.

The frame of each model is the dock's: the origin on the floor below the marker's face, x into
the face. A robot that is docked looks along x.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Tuple
from xml.etree.ElementTree import Element, SubElement, tostring

from bullet_lab.core.files import make_folder, replace_file
from bullet_lab.markers.faces import WALL_GREY, WALL_SIZE, Face, write_plate
from bullet_lab.markers.images import MarkerError

DOCK_DEPTH = 2.0
WALL_THICKNESS = 0.2
PLATE_THICKNESS = 0.02
POST_WIDTH = 0.04
HEADER = '<?xml version="1.0"?>\n'

Vector = Tuple[float, float, float]


@dataclass(frozen=True)
class _Part:
    """A box of a model; a `mesh` is drawn instead of it, with its origin at `mesh_origin`."""

    name: str
    size: Vector
    centre: Vector
    mesh: str = ""
    mesh_origin: Vector = (0.0, 0.0, 0.0)


def write_panel(face: Face, height: float, folder: Path, about: str) -> None:
    """Write a model of a plate on a post; its name is that of the folder.

    Args:
        face: what the plate shows.
        height: of the middle of the plate above the floor, m.
        folder: of the model; made if need be.
        about: a sentence for model.config.

    Raises:
        MarkerError: the plate would reach into the floor.
        FileError: the folder cannot be written to.
    """
    below = height - 0.5 * face.size
    if below < 0.0:
        raise MarkerError(f"a plate of {face.size:g} m at a height of {height:g} m is in the floor")
    middle = 0.5 * PLATE_THICKNESS
    plate = (PLATE_THICKNESS, face.size, face.size)
    mesh = _uri(folder, "plate")
    parts = [_Part("plate", plate, (middle, 0.0, height), mesh, (0.0, 0.0, height))]
    if below > 0.0:
        post = (PLATE_THICKNESS, POST_WIDTH, below)
        parts.append(_Part("post", post, (middle, 0.0, 0.5 * below)))
    write_plate(face, PLATE_THICKNESS, folder / "meshes", "plate")
    _write_model(folder, tuple(parts), about)


def write_dock(face: Face, folder: Path, about: str) -> None:
    """Write a model of the docking station, whose back wall shows a picture.

    Three boxes as a U, open towards -x; arguments and errors as of `write_panel`.
    """
    size, half = WALL_SIZE, 0.5 * WALL_SIZE
    back = (WALL_THICKNESS, size, size)
    side = (DOCK_DEPTH + WALL_THICKNESS, WALL_THICKNESS, size)
    x = 0.5 * (WALL_THICKNESS - DOCK_DEPTH)
    y = half + 0.5 * WALL_THICKNESS
    mesh = _uri(folder, "back_wall")
    parts = (
        _Part("back_wall", back, (0.5 * WALL_THICKNESS, 0.0, half), mesh, (0.0, 0.0, half)),
        _Part("left_wall", side, (x, y, half)),
        _Part("right_wall", side, (x, -y, half)),
    )
    write_plate(face, WALL_THICKNESS, folder / "meshes", "back_wall")
    _write_model(folder, parts, about)


def _uri(folder: Path, mesh: str) -> str:
    return f"model://{_name(folder)}/meshes/{mesh}.obj"


def _name(folder: Path) -> str:
    return folder.absolute().name


def _write_model(folder: Path, parts: Tuple[_Part, ...], about: str) -> None:
    make_folder(folder)
    root = Element("sdf", version="1.6")
    model = SubElement(root, "model", name=_name(folder))
    SubElement(model, "static").text = "true"
    link = SubElement(model, "link", name="link")
    for part in parts:
        _add_part(link, part)
    config = Element("model")
    SubElement(config, "name").text = _name(folder)
    SubElement(config, "version").text = "1.0"
    SubElement(config, "sdf", version="1.6").text = "model.sdf"
    SubElement(config, "description").text = about
    for name, element in (("model.sdf", root), ("model.config", config)):
        _indent(element)
        text = HEADER + tostring(element, encoding="unicode")
        replace_file(folder / name, lambda path, text=text: path.write_text(text))


def _add_part(link: Element, part: _Part) -> None:
    collision = SubElement(link, "collision", name=part.name)
    _add_box(collision, part)
    visual = SubElement(link, "visual", name=part.name)
    if not part.mesh:
        _add_box(visual, part)
        _add_material(visual)
        return
    # No <material>: Gazebo would paint it over the texture.
    _add_pose(visual, part.mesh_origin)
    mesh = SubElement(SubElement(visual, "geometry"), "mesh")
    SubElement(mesh, "uri").text = part.mesh


def _add_box(element: Element, part: _Part) -> None:
    _add_pose(element, part.centre)
    box = SubElement(SubElement(element, "geometry"), "box")
    SubElement(box, "size").text = _numbers(part.size)


def _add_pose(element: Element, position: Vector) -> None:
    SubElement(element, "pose").text = f"{_numbers(position)} 0 0 0"


def _add_material(visual: Element) -> None:
    material = SubElement(visual, "material")
    grey = f"{WALL_GREY / 255.0:.3f}"
    for name in ("ambient", "diffuse"):
        SubElement(material, name).text = f"{grey} {grey} {grey} 1"


def _numbers(values: Vector) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _indent(element: Element, level: int = 0) -> None:
    """Put each element on its own line; ElementTree learnt it in Python 3.9 only."""
    children = list(element)
    if children:
        element.text = "\n" + "  " * (level + 1)
    for child in children:
        _indent(child, level + 1)
        child.tail = "\n" + "  " * (level + 1)
    if children:
        children[-1].tail = "\n" + "  " * level
    if level == 0:
        element.tail = "\n"
