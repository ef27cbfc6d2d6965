"""Mesh files, made ready for PyBullet and measured."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.description import Mesh
from bullet_lab.simulation.xml_input import parse_text, read_text

KNOWN_SUFFIXES = (".dae", ".stl", ".obj")


class MeshError(LabError):
    """A mesh file holds no usable triangles."""


@dataclass(frozen=True)
class Triangles:
    """A triangle mesh: `vertices` (n, 3) in metres, `faces` (m, 3) indices into them."""

    vertices: np.ndarray
    faces: np.ndarray


def load_triangles(mesh: Mesh) -> Triangles:
    """Read a mesh with all transforms of its file and the description's scale applied.

    The transforms matter: the `<matrix>` of a COLLADA node is where Blender writes the size.

    Raises:
        MeshError: unknown kind of file, malformed, empty, or with coordinates that are not
            finite.
        XmlError: a COLLADA file that is missing, not well-formed or has a document type.
    """
    suffix = mesh.path.suffix.lower()
    if suffix not in KNOWN_SUFFIXES:
        raise MeshError(f"{mesh.path}: a mesh is one of {', '.join(KNOWN_SUFFIXES)}")
    if suffix == ".dae":
        # trimesh's own parser would follow entities: the checked parser has the first look.
        parse_text(read_text(mesh.path), str(mesh.path))
    triangles = _read(mesh.path, suffix)
    scaled = Triangles(triangles.vertices * np.asarray(mesh.scale), triangles.faces)
    if len(scaled.faces) == 0 or not np.isfinite(scaled.vertices).all():
        raise MeshError(f"{mesh.path}: no triangles with finite corners")
    return scaled


def write_obj(triangles: Triangles, folder: Path) -> Path:
    """Write a mesh as a Wavefront .obj into a folder and return the file.

    The name follows from the content, so equal meshes share one file.
    """
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangles.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles.faces.tolist()]
    text = "\n".join(lines) + "\n"
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.obj"
    if not path.exists():
        path.write_text(text)
    return path


def _read(path: Path, suffix: str) -> Triangles:
    # Costs 100 ms and 30 MB: only worlds with meshes pay for it.
    import trimesh

    try:
        # No resolver: a mesh's materials and textures name files that are none of its business.
        with path.open("rb") as file:
            scene = trimesh.load(file, file_type=suffix[1:], force="scene", resolver=None)
        merged = scene.to_geometry() if hasattr(scene, "to_geometry") else scene.dump(True)
        vertices = np.asarray(merged.vertices, dtype=float)
        faces = np.asarray(merged.faces, dtype=int)
    except OSError as error:
        raise MeshError(f"{path}: {error.strerror}") from error
    except Exception as error:
        # Whatever trimesh and pycollada raise on a malformed file, and that is anything.
        raise MeshError(f"{path}: not a readable mesh: {error}".splitlines()[0]) from error
    return Triangles(vertices, faces)
