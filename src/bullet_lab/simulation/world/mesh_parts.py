"""Read what is visible of mesh files: triangles with normals, colours and pictures.

Pictures and the .mtl of an .obj are searched where Gazebo searches them. Missing ones are reported;
the mesh is drawn without them.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any, Iterable
from urllib.parse import unquote

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import (
    WHITE,
    Appearance,
    Colour,
    Material,
    Mesh,
    Texture,
)
from bullet_lab.simulation.world.meshes import (
    MeshError,
    MeshPart,
    flat_normals,
    read_bytes,
    read_parts,
    readable,
    unit,
)
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder, is_below
from bullet_lab.simulation.world.shapes import load_triangles, middle_of
from bullet_lab.simulation.world.xml import Report, finite

LOG = logging.getLogger(__name__)
# The word by which a file with own materials is recognised.
OWN_LOOKS = {".obj": b"usemtl", ".dae": b"instance_material"}


def mesh_parts(mesh: Mesh, report: Report = LOG.warning) -> list[MeshPart]:
    """Return the parts of a scaled mesh, with unit normals, and with looks as their materials.

    `report` gets a line for each missing file. Raises as `load_triangles`.
    """
    # Checks the mesh.
    load_triangles(mesh)
    materials = _Materials(mesh.path, report)
    with readable(mesh.path):
        raw = list(read_parts(mesh.path, mesh.submesh, materials))
        middle, scale = middle_of([part.corners for part in raw], mesh), np.asarray(mesh.scale)
        looks = [materials.look(part.material) for part in raw]
    return [
        _outward(part._replace(vertices=(part.vertices - middle) * scale, material=look), scale)
        for part, look in zip(raw, looks)
    ]


def _outward(part: MeshPart, scale: np.ndarray) -> MeshPart:
    """Return a part that was scaled with all its normals, and its triangles turned outwards."""
    part = _turned_over(part) if np.signbit(np.prod(scale)) else part
    flat = flat_normals(part.corners)
    if part.normals is None:
        return part._replace(normals=flat)
    given = part.normals / scale
    # A missing normal is replaced by that of the triangle.
    lengths = np.linalg.norm(given, axis=-1, keepdims=True)
    given = unit(np.where(lengths > 1e-9, given, flat))
    part = part._replace(normals=given)
    # Mirrored, or with the corners in the other order: the given normals point outwards.
    return _turned_over(part) if np.median(np.sum(flat * given, axis=-1)) < 0.0 else part


def _turned_over(part: MeshPart) -> MeshPart:
    vertices, *arrays, look = part
    return MeshPart(vertices, *(a if a is None else a[:, ::-1] for a in arrays), look)


def has_own_looks(mesh: Mesh) -> bool:
    """Return whether a mesh file has its own materials; False if it is unreadable."""
    word = OWN_LOOKS.get(mesh.path.suffix.lower())
    try:
        return word is not None and word in read_bytes(mesh.path)
    except MeshError:
        return False


def _effect_look(effect: Any, path: Path, report: Report) -> Appearance:
    """Return the look of a COLLADA material."""
    texture, opacity = None, 1.0
    sampler = getattr(effect.diffuse, "sampler", None)
    if sampler is not None:
        texture = _texture(sampler.surface.image.path, path, report)
    if isinstance(effect.transparent, tuple) and effect.transparency is not None:
        share = effect.transparent[3] if len(effect.transparent) > 3 else 1.0
        opacity = share * float(effect.transparency)
        if str(getattr(effect, "opaque_mode", "")).endswith("RGB_ZERO"):
            opacity = 1.0 - np.mean(effect.transparent[:3]) * float(effect.transparency)
    return _look((effect.diffuse, effect.ambient, effect.emission), opacity, texture)


def _look(colours: Iterable[Any], opacity: float, texture: Texture | None) -> Appearance:
    """Return the look of a diffuse, an ambient and an emissive colour."""
    diffuse, ambient, emissive = map(_rgb, colours)
    # An invisible material is a mistake of the exporter.
    opacity = opacity if 0.0 < opacity <= 1.0 else 1.0
    rest = Material(ambient, emissive or Material.emissive, texture)
    return (*(diffuse or WHITE)[:3], opacity), rest


def _rgb(value: Any) -> Colour | None:
    """Return a colour within [0, 1]; None for a missing one or a picture."""
    if not isinstance(value, tuple) or len(value) < 3:
        return None
    return (*np.clip(value[:3], 0.0, 1.0).tolist(), 1.0)


class _Materials:
    """The materials of a mesh file.

    It also gives trimesh the .mtl files that an .obj names, but only the names of the materials in
    them, which is enough to separate the parts of a mesh.
    """

    def __init__(self, path: Path, report: Report):
        self._path, self._report = path, report
        self._looks: dict[str, Appearance] = {}

    def __getitem__(self, name: str) -> str:
        """Return a material file; many meshes name one that does not exist."""
        file = self._path.parent / name
        if not os.path.exists(file):
            raise FileNotFoundError(name)
        try:
            file = _find(name, self._path)
            text = read_bytes(file).decode("utf-8", errors="replace")
        except LabError as error:
            self._report(f"{error}; drawn without it")
            raise FileNotFoundError(name) from error
        for material, statements in _statements(text).items():
            self._looks[material] = _wavefront_look(statements, file, self._report)
        return "".join(f"newmtl {material}\n" for material in self._looks)

    def look(self, material: Any) -> Appearance | None:
        """Return the look of a material of a part; None without any."""
        if material is None or isinstance(material, str):
            # trimesh replaces an unknown material by one without a name.
            return self._looks.get(material)
        return _effect_look(material, self._path, self._report)


def _statements(text: str) -> dict[str, dict[str, str]]:
    """Return the lines of each material in a .mtl by their first words."""
    found: dict[str, dict[str, str]] = {}
    statements: dict[str, str] = {}
    for line in text.splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "newmtl":
            statements = found.setdefault(rest.strip(), {})
        else:
            statements[word] = rest.strip()
    return found


def _wavefront_look(statements: dict[str, str], path: Path, report: Report) -> Appearance:
    """Return the look of a material in a .mtl file."""

    def numbers(key: str, count: int) -> tuple[float, ...]:
        """Return the numbers of a statement; empty unless there are as many."""
        found = finite(statements.get(key, "").split())
        return found if len(found) == count else ()

    (opacity,) = numbers("d", 1) or [1.0 - share for share in numbers("Tr", 1)] or [1.0]
    name, texture = statements.get("map_Kd", ""), None
    if name:
        # Options such as "-s 1 1 1" may stand before the name.
        texture = _texture(name.split()[-1] if name.startswith("-") else name, path, report)
    return _look((numbers(key, 3) for key in ("Kd", "Ka", "Ke")), opacity, texture)


def _texture(name: str, user: Path, report: Report) -> Texture | None:
    try:
        return Texture(_find(name, user))
    except ResourceError as error:
        report(f"{error}; drawn without it")
        return None


def _find(name: str, user: Path) -> Path:
    """Return a file that another one names, within its Gazebo model or ROS package.

    It is at the path from the other file, or in the model's textures.
    """
    folder, name = user.parent, unquote(name.replace("\\", "/"))
    marks = ("model.config", "package.xml")
    # A model in a package may use the files of the package.
    holders = [f for f in user.parents if any((f / mark).is_file() for mark in marks)] or [folder]
    root = holders[0]
    outer = next((f for f in holders if (f / "package.xml").is_file()), root)
    bare = name.rpartition("/")[2]
    places = (folder, folder.parent / "materials" / "textures", root / "materials" / "textures")
    try:
        if "://" in name or name.startswith("/"):
            return ResourceFinder(root).find(name)
        return ResourceFinder(outer).find(os.path.relpath(folder / name, outer))
    except (ResourceError, ValueError) as error:
        for path in (place / bare for place in places):
            if os.path.isfile(path) and is_below(path, outer):
                return path
        raise ResourceError(f"{user}: {error}") from error
