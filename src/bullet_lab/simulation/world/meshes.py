"""Mesh files as triangles and as what PyBullet takes.

COLLADA is read with pycollada itself: trimesh would pass over its unit and over what is broken in
it, and costs 0.3 s to import, which only worlds with .stl and .obj files pay.
"""

from __future__ import annotations

import functools
import logging
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Collection, Iterator, List, Optional, Protocol, Sequence, Tuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from bullet_lab.core.pose import Vector
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.xml import file_bytes, number, parse_text, read_text

LOG = logging.getLogger(__name__)

KNOWN_SUFFIXES = (".dae", ".stl", ".obj")
MAXIMUM_BYTES = 200_000_000
# Meshes that are kept as they were read, since many models may share one.
CACHED_MESHES = 16
# PyBullet takes so many corners in one call.
MOST_CORNERS = 131_072
# That corners of a larger convex hull are looked for in.
DIRECTIONS = 4096
# Faces of an .obj with indices that count back, or with four corners that are more than places.
ODD_FACE = re.compile(rb"^\s*f(\s[^#\n]*-|([ \t]+\d*/\S*){4})", re.MULTILINE)
UNUSABLE_NUMBER = re.compile(r"nan|inf", re.IGNORECASE)
COLLADA = "{http://www.collada.org/2005/11/COLLADASchema}"


class MeshError(LabError):
    """A mesh file holds no usable triangles."""


class MeshFile(Protocol):
    """What names a mesh: its file, three factors for the coordinates in it, and which part of it.

    With a name, that is the part of this name, with its middle at the origin if it is centred.
    """

    path: Path
    scale: Vector
    submesh: str
    centred: bool


@dataclass(frozen=True)
class Triangles:
    """A triangle mesh: `vertices` (n, 3) in metres, `faces` (m, 3) indices into them."""

    vertices: np.ndarray
    faces: np.ndarray


def load_triangles(mesh: MeshFile) -> Triangles:
    """Read a mesh with all transforms of its file and the description's scale applied.

    The transforms matter: the `<matrix>` of a COLLADA node is where Blender writes the size.
    So does the length of its `<unit>`; as in Gazebo, its `<up_axis>` does not.

    Raises:
        MeshError: unknown kind of file, too large, malformed, empty, or with coordinates that
            are not finite.
        XmlError: a COLLADA file that is missing, not well-formed or has a document type.
    """
    return _load(mesh, file_version(mesh))


def file_version(mesh: MeshFile) -> Tuple[int, int]:
    """Return what changes when the file of a mesh does: its time (ns) and its size (bytes)."""
    try:
        found = mesh.path.stat()
    except OSError:
        return (0, 0)
    return (found.st_mtime_ns, found.st_size)


@functools.lru_cache(maxsize=CACHED_MESHES)
def _load(mesh: MeshFile, _version: Tuple[int, int]) -> Triangles:
    suffix = mesh.path.suffix.lower()
    if suffix not in KNOWN_SUFFIXES:
        raise MeshError(f"{mesh.path}: a mesh is one of {', '.join(KNOWN_SUFFIXES)}")
    vertices, faces = _read(mesh, suffix)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(f"{mesh.path}: a corner has three coordinates")
    vertices = (vertices - middle_of([vertices], mesh)) * np.asarray(mesh.scale)
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise MeshError(f"{mesh.path}: no triangles with finite corners")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"{mesh.path}: a triangle names a corner that is not there")
    for array in (vertices, faces):
        # Others get the same arrays.
        array.setflags(write=False)
    return Triangles(vertices, faces)


def middle_of(parts: Sequence[np.ndarray], mesh: MeshFile) -> np.ndarray:
    """Return what of the places (…, 3) in a mesh is to be at its origin, unscaled."""
    if not (mesh.submesh and mesh.centred and any(map(len, parts))):
        return np.zeros(3)
    places = np.concatenate([part.reshape(-1, 3) for part in parts])
    return 0.5 * (places.min(axis=0) + places.max(axis=0))


def mesh_bounds(mesh: MeshFile) -> np.ndarray:
    """Return the least and the greatest corner of a mesh, shape (2, 3); raises as it is read."""
    return _bounds(mesh, file_version(mesh))


@functools.lru_cache(maxsize=64)
def _bounds(mesh: MeshFile, _version: Tuple[int, int]) -> np.ndarray:
    vertices = load_triangles(mesh).vertices
    bounds = np.array((vertices.min(axis=0), vertices.max(axis=0)))
    bounds.setflags(write=False)
    return bounds


def hull_corners(mesh: MeshFile) -> np.ndarray:
    """Return corners (n, 3) that have the same convex hull as a mesh, as many as Bullet takes.

    Bullet itself drops those within the hull. Of a mesh with too many, those stay that are
    farthest in one of many directions, which is the same to a thousandth of its size. Raises as
    `load_triangles`.
    """
    corners = np.unique(load_triangles(mesh).vertices, axis=0)
    if len(corners) <= MOST_CORNERS:
        return corners
    spans = np.ptp(corners, axis=0)
    round_ = (corners / np.where(spans > 0.0, spans, 1.0)).T
    blocks = np.array_split(_directions(), DIRECTIONS // 32)
    return corners[np.unique([np.argmax(block @ round_, axis=1) for block in blocks])]


def triangle_corners(mesh: MeshFile) -> List[np.ndarray]:
    """Return a mesh in pieces that Bullet takes: corners (n, 3), three for each triangle."""
    triangles = load_triangles(mesh)
    corners = triangles.vertices[triangles.faces.ravel()]
    piece = MOST_CORNERS // 3 * 3
    return [corners[start : start + piece] for start in range(0, len(corners), piece)]


def _directions() -> np.ndarray:
    """Return unit vectors that are spread evenly, shape (DIRECTIONS, 3): Fibonacci's sphere."""
    number = np.arange(DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * number / DIRECTIONS, number * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - height * height)
    return np.column_stack((level * np.cos(turn), level * np.sin(turn), height))


def _read(mesh: MeshFile, suffix: str) -> Tuple[np.ndarray, np.ndarray]:
    path = mesh.path
    try:
        if suffix == ".dae":
            return _read_collada(mesh)
        scene = read_scene(mesh)
        merged = scene.to_geometry() if hasattr(scene, "to_geometry") else scene.dump(True)
        return np.asarray(merged.vertices, dtype=float), np.asarray(merged.faces, dtype=int)
    except LabError:
        raise
    except Exception as error:
        # What the libraries raise on a malformed file can be anything.
        raise MeshError(f"{path}: not a readable mesh: {error}") from error


def read_scene(mesh: MeshFile, resolver: Any = None) -> Any:
    """Return what trimesh reads of an .obj or .stl file, or of a part of an .obj file.

    A `resolver` gives it the other files that the file names; without one, it gets none.

    Raises:
        MeshError: the file is missing, too large or malformed.
    """
    # Costs 100 ms and 30 MB: only worlds with such meshes pay for it.
    import trimesh

    path = mesh.path
    data, kind = read_bytes(path), path.suffix.lower()[1:]
    try:
        data = _plain_faces(_as_utf8(data)) if kind == "obj" else _whole_stl(path, data)
        if mesh.submesh:
            data = _part_of(data, mesh) if kind == "obj" else _whole(data, mesh)
        # From memory: given a file, trimesh would look beside it for the materials and textures
        # that a mesh names. Not processed: that would drop corners that are not finite.
        how = {"file_type": kind, "force": "scene", "process": False, "resolver": resolver}
        return trimesh.load(BytesIO(data), **how)
    except LabError:
        raise
    except Exception as error:
        raise MeshError(f"{path}: not a readable mesh: {error}") from error


def _as_utf8(data: bytes) -> bytes:
    """Return a text with signs of other encodings replaced: names and comments may have some.

    trimesh would guess the encoding, with a library that may be there or not.
    """
    return data.decode("utf-8", "replace").encode()


def _whole_stl(path: Path, data: bytes) -> bytes:
    """Return an STL file that is as long as it says, or a text.

    Raises:
        MeshError: it is neither.
    """
    if len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        return data
    if b"\0" in data:
        raise MeshError(f"{path}: neither a whole binary mesh nor text")
    return _as_utf8(data)


def _plain_faces(data: bytes) -> bytes:
    """Return an .obj with triangles only that name corners by their numbers from the start.

    trimesh counts back from the end of the file, and before 5 it passes over what corners of
    other faces say of textures.
    """
    if not ODD_FACE.search(data):
        return data
    counts = {b"v": 0, b"vt": 0, b"vn": 0}
    lines = data.splitlines()
    for row, line in enumerate(lines):
        word, *corners = line.split(b"#")[0].split() or [b""]
        if word in counts:
            counts[word] += 1
        elif word == b"f":
            parts = (zip(corner.split(b"/"), counts.values()) for corner in corners)
            first, *others = (b"/".join(_index(*pair) for pair in part) for part in parts)
            fan = zip(others, others[1:])
            lines[row] = b"\n".join(b" ".join((b"f", first, *pair)) for pair in fan)
    return b"\n".join(lines)


def _part_of(data: bytes, mesh: MeshFile) -> bytes:
    """Return an .obj with the faces alone that are in its objects or groups of a name.

    As in Gazebo, a group is known by the first of its names, and by no object's around it.
    """
    kept, name, found = [], "", False
    for line in data.splitlines():
        word, _, rest = line.strip().partition(b" ")
        if word in (b"o", b"g"):
            said = rest.decode(errors="replace").strip()
            name = said if word == b"o" else said.partition(" ")[0]
        if word != b"f" or name == mesh.submesh:
            kept.append(line)
            found = found or word == b"f"
    return b"\n".join(kept) if found else _whole(data, mesh)


def _whole(data: bytes, mesh: MeshFile) -> bytes:
    LOG.warning("%s: no submesh '%s'; all of it is taken", mesh.path, mesh.submesh)
    return data


def _index(index: bytes, count: int) -> bytes:
    if not index.startswith(b"-"):
        return index
    if count + int(index) < 0:
        raise ValueError(f"index {int(index)} of {count}")
    return b"%d" % (count + int(index) + 1)


def _read_collada(mesh: MeshFile) -> Tuple[np.ndarray, np.ndarray]:
    metres, sets = collada_triangles(mesh)
    parts = [(np.asarray(s.vertex, float), np.asarray(s.vertex_index, int)) for s in sets]
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
    firsts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    faces = [indices + first for (_, indices), first in zip(parts, firsts)]
    return metres * np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def collada_triangles(mesh: MeshFile) -> Tuple[float, List[Any]]:
    """Return the length of a COLLADA mesh's unit, m, and its bound triangle sets, by pycollada.

    Raises:
        XmlError: the file is missing, not well-formed or has a document type.
        Exception: anything, where what it says makes no sense.
    """
    import collada
    from collada.triangleset import BoundTriangleSet

    path = mesh.path
    root = parse_text(read_text(path), str(path))
    unit = root.find(f"{COLLADA}asset/{COLLADA}unit")
    metres = 1.0 if unit is None else number(unit.get("meter", "1"), f"{path}: <unit>")
    for array in root.iter(f"{COLLADA}float_array"):
        if UNUSABLE_NUMBER.search(array.text or ""):
            # pycollada would make zeros of them.
            raise ValueError("a number is not finite")
    for image in root.iter(f"{COLLADA}image"):
        if not "".join(image.itertext()).strip():
            # pycollada would refuse the mesh for a picture without a name.
            image[:] = []
            SubElement(image, f"{COLLADA}init_from").text = image.get("id", "picture")
    # Written anew, so that pycollada's own parser sees what was checked and nothing else: no
    # entities, no encodings. Images are not looked for; they may be missing.
    optional = [collada.common.DaeBrokenRefError, collada.common.DaeUnsupportedError]
    document = collada.Collada(BytesIO(tostring(root)), ignore=optional)
    if _without_lost_materials(root, {f"#{material.id}" for material in document.materials}):
        document = collada.Collada(BytesIO(tostring(root)), ignore=optional)
    if document.scene is None:
        raise ValueError("there is no scene")
    geometries = list(document.scene.objects("geometry"))
    if mesh.submesh:
        named = [g for name, g in _in_nodes(document.scene.nodes) if name == mesh.submesh]
        if not named:
            LOG.warning("%s: no submesh '%s'; all of it is taken", path, mesh.submesh)
        geometries = named or geometries
    primitives = (p for g in geometries for p in g.primitives())
    cut = (p.triangleset() if hasattr(p, "triangleset") else p for p in primitives)
    # Points and lines are left out.
    return metres, [p for p in cut if isinstance(p, BoundTriangleSet) and len(p)]


def _in_nodes(
    nodes: Sequence[Any], outer: Optional[np.ndarray] = None, name: str = ""
) -> Iterator[Tuple[str, Any]]:
    """Yield the bound geometries in nodes, with the names of the nodes that they are in."""
    from collada.scene import Node

    outer = np.eye(4) if outer is None else outer
    for node in nodes:
        if isinstance(node, Node):
            inner = getattr(node, "node", node).xmlnode.get("name", name)
            yield from _in_nodes(node.children, outer @ node.matrix, inner)
        else:
            yield from ((name, bound) for bound in node.objects("geometry", outer))


def _without_lost_materials(root: Element, known: Collection[str]) -> bool:
    """Take out what names materials that are not there; return whether there was any.

    pycollada would leave out the geometry with them.
    """
    lost = False
    for holder in root.iter(f"{COLLADA}technique_common"):
        for element in holder.findall(f"{COLLADA}instance_material"):
            if element.get("target") not in known:
                holder.remove(element)
                lost = True
    return lost


def read_bytes(path: Path) -> bytes:
    """Return what is in a file; raises MeshError if it is missing or too large."""
    return file_bytes(path, MAXIMUM_BYTES, MeshError)
