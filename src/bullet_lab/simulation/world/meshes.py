"""Read mesh files with pycollada and trimesh.

trimesh would ignore the unit and the mistakes of COLLADA files, and takes 0.3 s to import; only
worlds with .stl and .obj files need it.
"""

from __future__ import annotations

import contextlib
import logging
import re
from io import BytesIO
from pathlib import Path
from typing import Any, Collection, Iterator, NamedTuple, Sequence
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from numpy import ndarray

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.xml import file_bytes, numbers, parse_text, read_text

LOG = logging.getLogger(__name__)

MAXIMUM_BYTES = 200_000_000
# Faces of an .obj that have negative indices, or at least four corners with textures or normals.
ODD_FACE = re.compile(rb"^\s*f(\s[^#\n]*-|([ \t]+\d*/\S*){4})", re.MULTILINE)
FACE_WITH_NORMALS = re.compile(rb"^\s*f\s+-?\d+/-?\d*/-?\d", re.MULTILINE)
UNUSABLE_NUMBER = re.compile(r"nan|inf", re.IGNORECASE)
COLLADA = "{http://www.collada.org/2005/11/COLLADASchema}"


class MeshError(LabError):
    """A mesh file holds no usable triangles."""


class MeshPart(NamedTuple):
    """Triangles that look alike.

    Attributes:
        vertices: (n, 3), m.
        faces: (m, 3) indices of vertices.
        normals: (m, 3, 3) at the corners; None without any.
        picture: (m, 3, 2) coordinates in a picture, from its lower left; None without any.
        material: pycollada's effect or the name of trimesh's material; None without any.
    """

    vertices: ndarray
    faces: ndarray
    normals: ndarray | None
    picture: ndarray | None
    material: Any

    @property
    def corners(self) -> ndarray:
        """The corners of the triangles, (m, 3, 3) in m."""
        return self.vertices[self.faces]


def flat_normals(corners: ndarray) -> ndarray:
    """Return the normal of each triangle at its corners; both are of shape (n, 3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.repeat(unit(normals)[:, None], 3, axis=1)


def unit(vectors: ndarray) -> ndarray:
    """Return vectors (…, 3) with length 1; zero vectors become (0, 0, 1)."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(lengths > 0.0, vectors / np.where(lengths > 0.0, lengths, 1.0), (0.0, 0.0, 1.0))


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raise MeshError for any error of a library that reads a malformed mesh file."""
    try:
        yield
    except LabError:
        raise
    except Exception as error:
        raise MeshError(f"{path}: not a readable mesh: {error}") from error


def file_version(file: Any) -> tuple[int, int] | None:
    """Return the time (ns) and the size (bytes) of a file, which differ when it has changed.

    `file` has a `path`: a mesh or a texture. None for one that is missing.
    """
    try:
        found = file.path.stat()
    except OSError:
        return None
    return (found.st_mtime_ns, found.st_size)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; raise MeshError if it is missing or too large."""
    return file_bytes(path, MAXIMUM_BYTES, MeshError)


def read_parts(path: Path, submesh: str, resolver: Any = None) -> Iterator[MeshPart]:
    """Yield the parts of a mesh file, or of one submesh, unscaled but for the file's unit.

    A `resolver` gives trimesh the other files that the file names. Without one, it gets none, and
    the parts of an .obj have no normals.

    Raises:
        LabError: the file is missing, too large, not well-formed or not a whole STL file.
        Exception: any other, for a malformed file.
    """
    if path.suffix.lower() == ".dae":
        yield from _collada_parts(path, submesh)
        return
    smooth = resolver is not None and FACE_WITH_NORMALS.search(read_bytes(path)) is not None
    for part in _scene(path, submesh, resolver).geometry.values():
        faces, visual = np.asarray(part.faces, dtype=int).reshape(-1, 3), part.visual
        uv = getattr(visual, "uv", None)
        yield MeshPart(
            np.asarray(part.vertices, dtype=float),
            faces,
            part.vertex_normals[faces] if smooth else None,
            None if uv is None else uv[faces][..., :2],
            getattr(getattr(visual, "material", None), "name", None),
        )


def _scene(path: Path, submesh: str, resolver: Any) -> Any:
    """Return trimesh's scene of an .obj or .stl file, or of a submesh of an .obj file."""
    # Takes 100 ms and 30 MB: only worlds with such meshes import it.
    import trimesh

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
    if submesh:
        part = _submesh(data, submesh) if kind == "obj" else b""
        data = part or data
        if not part:
            _warn_of_submesh(path, submesh)
    # From memory: given a file name, trimesh would read the materials and textures beside it. Not
    # processed: that would drop corners that are not finite.
    options = {"file_type": kind, "force": "scene", "process": False, "resolver": resolver}
    return trimesh.load(BytesIO(data), **options)


def _warn_of_submesh(path: Path, submesh: str) -> None:
    LOG.warning("%s: no submesh '%s'; the whole mesh is used", path, submesh)


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


def _collada_parts(path: Path, submesh: str) -> Iterator[MeshPart]:
    import collada
    from collada.triangleset import BoundTriangleSet

    root = parse_text(read_text(path), str(path))
    unit = root.find(f"{COLLADA}asset/{COLLADA}unit")
    metre = "1" if unit is None else unit.get("meter", "1")
    (metres,) = numbers(metre, 1, f"{path}: <unit>")
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
    if submesh:
        named = [g for name, g in _in_nodes(document.scene.nodes) if name == submesh]
        if not named:
            _warn_of_submesh(path, submesh)
        geometries = named or geometries
    for primitive in (p for geometry in geometries for p in geometry.primitives()):
        part = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
        # Without points and lines.
        if isinstance(part, BoundTriangleSet) and len(part):
            normals = picture = None
            if part.normal is not None and len(part.normal):
                normals = np.asarray(part.normal, float)[part.normal_index]
            if part.texcoordset:
                # As in Gazebo, the first of several.
                picture = np.asarray(part.texcoordset[0], float)[part.texcoord_indexset[0]]
            vertices, faces = metres * np.asarray(part.vertex, float), part.vertex_index
            effect = getattr(part.material, "effect", None)
            yield MeshPart(vertices, np.asarray(faces, int), normals, picture, effect)


def _in_nodes(
    nodes: Sequence[Any], outer: ndarray | None = None, name: str = ""
) -> Iterator[tuple[str, Any]]:
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
