"""Meshes with pictures on them: Wavefront .obj with the .mtl and the image that it names."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import Mesh, Model
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder

MAXIMUM_BYTES = 100_000_000
# Of an image's sides, in pixels: what the graphics side takes; larger images are made smaller.
LARGEST_SIDE = 8192


class TextureError(LabError):
    """A picture that a mesh names is not there or is none."""


@dataclass(frozen=True)
class Image:
    """An image: `pixels` (height, width, 3) uint8, RGB; equal to others by their `digest`."""

    digest: str
    pixels: np.ndarray = field(compare=False, repr=False)


# Corners (n, 3, 3) in m, picture coordinates (n, 3, 2) from the lower left, and the image, if any.
Textured = Tuple[np.ndarray, Optional[np.ndarray], Optional[Image]]


def load_textured(mesh: Mesh) -> List[Textured]:
    """Return the parts of a mesh by their pictures; none if it names no picture.

    Raises:
        TextureError: an image or a material file is missing, too large or no image, or lies
            outside the folder of the mesh, its Gazebo model, the packages and model folders.
    """
    if mesh.path.suffix.lower() != ".obj" or not texture_files(mesh.path):
        return []
    return _read(mesh)


def check_textures(model: Model) -> None:
    """Refuse a model whose meshes name images that are not there.

    Raises:
        TextureError: as `texture_files`.
    """
    for link in model.links:
        for visual in link.visuals:
            mesh = visual.geometry
            if isinstance(mesh, Mesh) and mesh.path.suffix.lower() == ".obj":
                texture_files(mesh.path)


def texture_files(path: Path) -> Dict[str, Path]:
    """Return the image that each material of an .obj names, by the material's name.

    A material file that is missing is passed over: many meshes name one that nobody has.

    Raises:
        TextureError: an image is missing, or a file lies where it must not.
    """
    images: Dict[str, Path] = {}
    for library in _values(_text(path), "mtllib"):
        if not (path.parent / library).exists():
            continue
        file = _find(library, path)
        material = ""
        for keyword, rest in _statements(_text(file)):
            if keyword == "newmtl":
                material = rest
            elif keyword == "map_Kd":
                # Options such as "-s 1 1 1" may stand before the name.
                name = rest.split()[-1] if rest.startswith("-") else rest
                images[material] = _find(name, file)
    return images


def _read(mesh: Mesh) -> List[Textured]:
    images = texture_files(mesh.path)
    points: List[List[float]] = []
    places: List[List[float]] = []
    parts: Dict[str, List[List[Tuple[int, int]]]] = {}
    material = ""
    try:
        for keyword, rest in _statements(_text(mesh.path)):
            if keyword == "v":
                points.append([float(word) for word in rest.split()[:3]])
            elif keyword == "vt":
                places.append([float(word) for word in rest.split()[:2]])
            elif keyword == "usemtl":
                material = rest
            elif keyword == "f":
                corners = [_corner(word, len(points), len(places)) for word in rest.split()]
                fan = zip(corners[1:], corners[2:])
                parts.setdefault(material, []).extend([corners[0], b, c] for b, c in fan)
        return [_part(mesh, faces, points, places, images.get(name))
                for name, faces in parts.items()]  # fmt: skip
    except (ValueError, IndexError) as error:
        raise TextureError(f"{mesh.path}: not a readable mesh: {error}") from error


def _part(mesh: Mesh, faces: list, points: list, places: list, image: Optional[Path]) -> Textured:
    indices = np.array(faces)
    corners = np.array(points)[indices[:, :, 0]] * np.asarray(mesh.scale)
    if np.prod(mesh.scale) < 0.0:
        corners, indices = corners[:, ::-1], indices[:, ::-1]
    if not np.isfinite(corners).all():
        raise TextureError(f"{mesh.path}: no triangles with finite corners")
    if image is None:
        return corners, None, None
    if (indices[:, :, 1] < 0).any():
        raise TextureError(f"{mesh.path}: a face with a picture has no picture coordinates")
    return corners, np.array(places)[indices[:, :, 1]], _image(image)


def _corner(word: str, points: int, places: int) -> Tuple[int, int]:
    """Return indices of a corner's point and picture coordinates (-1: none), from 0."""
    parts = word.split("/")
    point = _index(parts[0], points)
    return point, _index(parts[1], places) if len(parts) > 1 and parts[1] else -1


def _index(word: str, count: int) -> int:
    number = int(word)
    index = number - 1 if number > 0 else count + number
    if number == 0 or not 0 <= index < count:
        raise IndexError(f"index {number} of {count}")
    return index


def _image(path: Path) -> Image:
    import PIL.Image

    data = _bytes(path)
    try:
        with PIL.Image.open(BytesIO(data)) as image:
            # Drawn without transparency.
            plain = image.convert("RGB")
            plain.thumbnail((LARGEST_SIDE, LARGEST_SIDE))
            pixels = np.array(plain)
    except (OSError, SyntaxError, ValueError, PIL.Image.DecompressionBombError) as error:
        raise TextureError(f"{path}: not a readable image") from error
    return Image(hashlib.sha256(pixels.tobytes()).hexdigest(), pixels)


def _find(name: str, user: Path) -> Path:
    try:
        if "://" in name or Path(name).is_absolute():
            return ResourceFinder(user.parent).find(name)
        root = _root(user.parent)
        return ResourceFinder(root).find(os.path.relpath(user.parent / name, root))
    except (ResourceError, ValueError) as error:
        raise TextureError(f"{user}: '{name}': {error}") from error


def _root(folder: Path) -> Path:
    """Return the Gazebo model that a folder is part of, such as …/meshes; else the folder."""
    return folder.parent if (folder.parent / "model.config").is_file() else folder


def _values(text: str, keyword: str) -> List[str]:
    return [rest for word, rest in _statements(text) if word == keyword and rest]


def _statements(text: str) -> List[Tuple[str, str]]:
    lines = (line.split("#")[0].strip() for line in text.splitlines())
    return [tuple((line.split(None, 1) + [""])[:2]) for line in lines if line]


def _text(path: Path) -> str:
    return _bytes(path).decode("utf-8", errors="replace")


def _bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAXIMUM_BYTES + 1)
    except OSError as error:
        raise TextureError(f"{path}: {error.strerror}") from error
    if len(data) > MAXIMUM_BYTES:
        raise TextureError(f"{path}: larger than {MAXIMUM_BYTES} bytes")
    return data
