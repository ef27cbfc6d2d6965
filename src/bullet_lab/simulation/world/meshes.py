"""Read mesh files as triangles, and cut them into pieces that PyBullet accepts.

COLLADA files are read with pycollada. trimesh would ignore their unit and their mistakes, and takes
0.3 s to import; only worlds with .stl and .obj files need it.
"""

from __future__ import annotations

import contextlib
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
# Meshes that are kept in memory, since many models may share one.
CACHED_MESHES = 16
# PyBullet accepts so many corners in one call.
MOST_CORNERS = 131_072
# The directions in which corners of a large convex hull are searched.
DIRECTIONS = 4096
# Faces of an .obj that have negative indices, or at least four corners with textures or normals.
ODD_FACE = re.compile(rb"^\s*f(\s[^#\n]*-|([ \t]+\d*/\S*){4})", re.MULTILINE)
UNUSABLE_NUMBER = re.compile(r"nan|inf", re.IGNORECASE)
COLLADA = "{http://www.collada.org/2005/11/COLLADASchema}"


class MeshError(LabError):
    """A mesh file holds no usable triangles."""


class MeshFile(Protocol):
    """A mesh: its file, three factors for its coordinates, and the part of it that is used.

    Without the name of a `submesh`, all of it is used. A `centred` part has its middle at the
    origin.
    """

    path: Path
    scale: Vector
    submesh: str
    centred: bool


@dataclass(frozen=True)
class Triangles:
    """A triangle mesh: `vertices` (n, 3) in metres, `faces` (m, 3) indices of vertices."""

    vertices: np.ndarray
    faces: np.ndarray


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raise MeshError for any error of a library that reads a malformed mesh file."""
    try:
        yield
    except LabError:
        raise
    except Exception as error:
        raise MeshError(f"{path}: not a readable mesh: {error}") from error


def load_triangles(mesh: MeshFile) -> Triangles:
    """Read a mesh, with the transforms of its file and the scale of the description applied.

    The transforms matter: Blender writes the size into the `<matrix>` of a COLLADA node. So does
    the `<unit>` of a COLLADA file. As in Gazebo, its `<up_axis>` does not.

    Raises:
        MeshError: unknown kind of file, too large, malformed, empty, or with coordinates that
            are not finite.
        XmlError: a COLLADA file that is missing, not well-formed or has a document type.
    """
    return _load(mesh, file_version(mesh))


def file_version(mesh: MeshFile) -> Tuple[int, int]:
    """Return the time (ns) and the size (bytes) of a file, which differ when it has changed."""
    try:
        found = mesh.path.stat()
    except OSError:
        return (0, 0)
    return (found.st_mtime_ns, found.st_size)


@functools.lru_cache(maxsize=CACHED_MESHES)
def _load(mesh: MeshFile, _version: Tuple[int, int]) -> Triangles:
    path = mesh.path
    if path.suffix.lower() not in KNOWN_SUFFIXES:
        raise MeshError(f"{path}: unknown kind of mesh; use {', '.join(KNOWN_SUFFIXES)}")
    with readable(path):
        vertices, faces = _read(mesh)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(f"{path}: a corner needs three coordinates")
    vertices = (vertices - middle_of([vertices], mesh)) * np.asarray(mesh.scale)
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise MeshError(f"{path}: no triangles with finite corners")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"{path}: a triangle has an unknown corner")
    # Callers share these arrays.
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return Triangles(vertices, faces)


def _read(mesh: MeshFile) -> Tuple[np.ndarray, np.ndarray]:
    """Return the unscaled vertices of a mesh and the indices of its triangles."""
    if mesh.path.suffix.lower() != ".dae":
        scene = read_scene(mesh)
        merged = scene.to_geometry() if hasattr(scene, "to_geometry") else scene.dump(True)
        return np.asarray(merged.vertices, dtype=float), np.asarray(merged.faces, dtype=int)
    metres, sets = collada_triangles(mesh)
    vertices = [np.zeros((0, 3)), *(np.asarray(s.vertex, float) for s in sets)]
    faces, count = [np.zeros((0, 3), dtype=int)], 0
    for part in sets:
        faces.append(np.asarray(part.vertex_index, int) + count)
        count += len(part.vertex)
    return metres * np.concatenate(vertices), np.concatenate(faces)


def middle_of(parts: Sequence[np.ndarray], mesh: MeshFile) -> np.ndarray:
    """Return the point, among the points (…, 3) of an unscaled mesh, that becomes its origin."""
    if not (mesh.submesh and mesh.centred and any(map(len, parts))):
        return np.zeros(3)
    points = np.concatenate([part.reshape(-1, 3) for part in parts])
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def mesh_bounds(mesh: MeshFile) -> np.ndarray:
    """Return the least and the greatest corner, shape (2, 3); raise as `load_triangles`."""
    return _bounds(mesh, file_version(mesh))


@functools.lru_cache(maxsize=64)
def _bounds(mesh: MeshFile, _version: Tuple[int, int]) -> np.ndarray:
    vertices = load_triangles(mesh).vertices
    bounds = np.array((vertices.min(axis=0), vertices.max(axis=0)))
    bounds.setflags(write=False)
    return bounds


def hull_corners(mesh: MeshFile) -> np.ndarray:
    """Return at most MOST_CORNERS corners (n, 3) with the same convex hull as a mesh.

    Bullet itself drops corners inside the hull. Of a larger mesh, the farthest corner in each of
    many directions is kept: the hull is the same to a thousandth of its size. Raises as
    `load_triangles`.
    """
    corners = np.unique(load_triangles(mesh).vertices, axis=0)
    if len(corners) <= MOST_CORNERS:
        return corners
    spans = np.ptp(corners, axis=0)
    normalised = (corners / np.where(spans > 0.0, spans, 1.0)).T
    blocks = np.array_split(_directions(), DIRECTIONS // 32)
    return corners[np.unique([np.argmax(block @ normalised, axis=1) for block in blocks])]


def triangle_corners(mesh: MeshFile) -> List[np.ndarray]:
    """Return a mesh in pieces for PyBullet: corners (n, 3), three for each triangle."""
    triangles = load_triangles(mesh)
    corners = triangles.vertices[triangles.faces.ravel()]
    piece = MOST_CORNERS // 3 * 3
    return [corners[start : start + piece] for start in range(0, len(corners), piece)]


def _directions() -> np.ndarray:
    """Return evenly spread unit vectors, shape (DIRECTIONS, 3): a Fibonacci sphere."""
    number = np.arange(DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * number / DIRECTIONS, number * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - height * height)
    return np.column_stack((level * np.cos(turn), level * np.sin(turn), height))


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; raise MeshError if it is missing or too large."""
    return file_bytes(path, MAXIMUM_BYTES, MeshError)


def read_scene(mesh: MeshFile, resolver: Any = None) -> Any:
    """Return trimesh's scene of an .obj or .stl file, or of a part of an .obj file.

    A `resolver` gives it the other files that the file names; without one, it gets none.

    Raises:
        MeshError: the file is missing, too large or not a whole STL file.
        Exception: any other, for a malformed file.
    """
    # Takes 100 ms and 30 MB: only worlds with such meshes import it.
    import trimesh

    path = mesh.path
    data, kind = read_bytes(path), path.suffix.lower()[1:]
    if kind == "stl" and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        # A whole binary file.
        pass
    elif kind == "stl" and b"\0" in data:
        raise MeshError(f"{path}: neither a whole binary mesh nor text")
    else:
        # Names and comments may be in any encoding; trimesh would guess which.
        data = data.decode("utf-8", "replace").encode()
    if kind == "obj":
        data = _plain_faces(data)
    if mesh.submesh:
        part = _submesh(data, mesh.submesh) if kind == "obj" else b""
        if not part:
            warn_of_submesh(mesh)
        data = part or data
    # From memory: given a file name, trimesh would read the materials and textures beside it. Not
    # processed: that would drop corners that are not finite.
    options = {"file_type": kind, "force": "scene", "process": False, "resolver": resolver}
    return trimesh.load(BytesIO(data), **options)


def warn_of_submesh(mesh: MeshFile) -> None:
    """Log that a file has no such submesh."""
    LOG.warning("%s: no submesh '%s'; the whole mesh is used", mesh.path, mesh.submesh)


def _plain_faces(data: bytes) -> bytes:
    """Return an .obj that has triangles only, with positive indices.

    trimesh counts negative indices from the end of the file. Before version 5, it ignores the
    textures of faces with more corners.
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


def _index(index: bytes, count: int) -> bytes:
    if not index.startswith(b"-"):
        return index
    if count + int(index) < 0:
        raise ValueError(f"index {int(index)} of {count}")
    return b"%d" % (count + int(index) + 1)


def _submesh(data: bytes, submesh: str) -> bytes:
    """Return an .obj with only the faces in objects or groups of a name; empty without any.

    As in Gazebo, the first of its names is that of a group.
    """
    kept, name, found = [], "", False
    for line in data.splitlines():
        word, _, rest = line.strip().partition(b" ")
        if word in (b"o", b"g"):
            name = rest.decode(errors="replace").strip()
            name = name if word == b"o" else name.partition(" ")[0]
        if word != b"f" or name == submesh:
            kept.append(line)
            found = found or word == b"f"
    return b"\n".join(kept) if found else b""


def collada_triangles(mesh: MeshFile) -> Tuple[float, List[Any]]:
    """Return the unit of a COLLADA mesh in m, and pycollada's bound triangle sets.

    Raises:
        XmlError: the file is missing, not well-formed or has a document type.
        Exception: any other, for a malformed file.
    """
    import collada
    from collada.triangleset import BoundTriangleSet

    path = mesh.path
    root = parse_text(read_text(path), str(path))
    unit = root.find(f"{COLLADA}asset/{COLLADA}unit")
    metres = 1.0 if unit is None else number(unit.get("meter", "1"), f"{path}: <unit>")
    for array in root.iter(f"{COLLADA}float_array"):
        if UNUSABLE_NUMBER.search(array.text or ""):
            # pycollada would replace them by zeros.
            raise ValueError("a number is not finite")
    for image in root.iter(f"{COLLADA}image"):
        if not "".join(image.itertext()).strip():
            # pycollada would refuse the mesh because of a picture without a name.
            image[:] = []
            SubElement(image, f"{COLLADA}init_from").text = image.get("id", "picture")
    # Written again, so that pycollada's own parser gets what was checked: no entities and no other
    # encodings. Missing images and materials are no errors.
    optional = [collada.common.DaeBrokenRefError, collada.common.DaeUnsupportedError]
    document = collada.Collada(BytesIO(tostring(root)), ignore=optional)
    if _drop_unknown_materials(root, {f"#{material.id}" for material in document.materials}):
        document = collada.Collada(BytesIO(tostring(root)), ignore=optional)
    if document.scene is None:
        raise ValueError("there is no scene")
    geometries = list(document.scene.objects("geometry"))
    if mesh.submesh:
        named = [g for name, g in _in_nodes(document.scene.nodes) if name == mesh.submesh]
        if not named:
            warn_of_submesh(mesh)
        geometries = named or geometries
    primitives = (p for g in geometries for p in g.primitives())
    cut = (p.triangleset() if hasattr(p, "triangleset") else p for p in primitives)
    # Without points and lines.
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


def _drop_unknown_materials(root: Element, known: Collection[str]) -> bool:
    """Remove references to unknown materials; return whether there were any.

    pycollada would leave out the geometry with such a reference.
    """
    dropped = False
    for holder in root.iter(f"{COLLADA}technique_common"):
        for element in holder.findall(f"{COLLADA}instance_material"):
            if element.get("target") not in known:
                holder.remove(element)
                dropped = True
    return dropped
