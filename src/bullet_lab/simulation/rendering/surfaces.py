"""Shapes as triangles with normals and, where they have an image on them, its coordinates.

Meshes with images are Wavefront .obj with the .mtl and the images that it names.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Iterator, List, Optional, Sequence

import numpy as np

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import Box, Geometry, Mesh, Model, Plane, Sphere
from bullet_lab.simulation.world.meshes import load_triangles, read_bytes, read_scene
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder

CYLINDER_SIDES = 48
# Of a ball, from pole to pole and around.
SPHERE_LINES = (18, 16)
# Of an image's sides, in pixels: what the graphics side takes; larger images are made smaller.
LARGEST_SIDE = 8192


class TextureError(LabError):
    """An image that a mesh names is not there or is none."""


@dataclass(frozen=True)
class Surface:
    """Triangles in metres: corner arrays of shape (n, 3, …), three corners each.

    Attributes:
        corners: (n, 3, 3) positions.
        normals: (n, 3, 3) unit normals at the corners.
        picture: (n, 3, 2) coordinates in the image, from its lower left; None without one.
        image: on the surface, (height, width, 3) uint8, RGB; None without one.
        colour: that all of it, and of the image, is multiplied by.
    """

    corners: np.ndarray
    normals: np.ndarray
    picture: Optional[np.ndarray] = None
    image: Optional[np.ndarray] = None
    colour: Sequence[float] = (1.0, 1.0, 1.0, 1.0)

    def placed(self, pose: Pose, colour: Sequence[float]) -> Surface:
        """Return the same in a colour, seen from the frame that `pose` is given in."""
        turn = pose.rotation_matrix()
        corners = self.corners @ turn.T + np.asarray(pose.position)
        return replace(self, corners=corners, normals=self.normals @ turn.T, colour=colour)

    def floats(self) -> np.ndarray:
        """Return place, normal, colour and place in the image of all corners, (3 n, 12) float32."""
        colour = np.broadcast_to(self.colour, (*self.corners.shape[:2], 4))
        picture = np.zeros(colour.shape) if self.picture is None else self.picture
        parts = (self.corners, self.normals, colour, picture[..., :2])
        return np.concatenate(parts, axis=2, dtype=np.float32).reshape(-1, 12)


def surfaces_of(geometry: Geometry) -> List[Surface]:
    """Return what is seen of a shape; raises LabError for an unusable mesh or texture."""
    from trimesh import creation

    if isinstance(geometry, Mesh):
        return _mesh(geometry)
    if isinstance(geometry, Plane):
        return [_flat(_plane(geometry))]
    if isinstance(geometry, Box):
        return [_flat(creation.box(geometry.size).triangles)]
    if isinstance(geometry, Sphere):
        corners = creation.uv_sphere(radius=geometry.radius, count=SPHERE_LINES).triangles
        return [Surface(corners, _unit(corners))]
    flat = _flat(creation.cylinder(geometry.radius, geometry.length, CYLINDER_SIDES).triangles)
    round_ = np.where(np.abs(flat.normals[..., 2:]) > 0.5, flat.normals, flat.corners * (1, 1, 0))
    return [replace(flat, normals=_unit(round_))]


def check_textures(model: Model) -> None:
    """Refuse a model whose meshes name images that are not there, or lie where they must not."""
    for link in model.links:
        for visual in link.visuals:
            if isinstance(visual.geometry, Mesh):
                _scene_with_images(visual.geometry)


def _plane(plane: Plane) -> np.ndarray:
    z = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    square = np.array(((-1, -1), (1, -1), (1, 1), (-1, -1), (1, 1), (-1, 1)))
    return (square * 0.5 * np.array(plane.size) @ (x, np.cross(z, x))).reshape(2, 3, 3)


def _mesh(mesh: Mesh) -> List[Surface]:
    triangles, order = load_triangles(mesh), -1 if np.prod(mesh.scale) < 0.0 else 1
    scene = _scene_with_images(mesh)
    if scene is None:
        return [_flat(triangles.vertices[triangles.faces[:, ::order]])]
    found = []
    for part in scene.geometry.values():
        faces = part.faces[:, ::order]
        surface = _flat((part.vertices * mesh.scale)[faces])
        material = getattr(part.visual, "material", None)
        # Where a material is not known, trimesh makes one up, without a name.
        if material is not None and material.name is not None and material.image is not None:
            if part.visual.uv is None:
                raise TextureError(f"{mesh.path}: a face with a picture has no picture coordinates")
            picture = part.visual.uv[faces][..., :2]
            surface = replace(surface, picture=picture, image=_pixels(material.image, mesh.path))
        found.append(surface)
    return found


def _scene_with_images(mesh: Mesh) -> Any:
    """Return what trimesh reads of a mesh that names images; None if it names none."""
    if mesh.path.suffix.lower() != ".obj":
        return None
    files = _Files(mesh.path)
    scene = read_scene(mesh.path, files)
    if files.refusal is not None:
        raise files.refusal
    return scene if files.has_images else None


class _Files:
    """What trimesh may read beside a mesh: its material file, and the images that this names."""

    def __init__(self, mesh: Path):
        self._user = mesh
        # trimesh passes over what is raised here.
        self.refusal: Optional[LabError] = None
        self.has_images = False

    def __getitem__(self, name: str) -> str:
        """Return a material file; many meshes name one that nobody has."""
        if not (self._user.parent / name).exists():
            raise FileNotFoundError(name)
        with self._remembering():
            self._user = _find(name, self._user)
            return read_bytes(self._user).decode("utf-8", errors="replace")

    def get(self, name: str) -> bytes:
        """Return an image; options such as "-s 1 1 1" may stand before its name."""
        import PIL.Image

        with self._remembering():
            path = _find(name.split()[-1] if name.startswith("-") else name, self._user)
            data = read_bytes(path)
            try:
                PIL.Image.open(BytesIO(data))
            except Exception as error:
                raise TextureError(f"{path}: not a readable image") from error
            self.has_images = True
            return data

    @contextlib.contextmanager
    def _remembering(self) -> Iterator[None]:
        try:
            yield
        except LabError as error:
            self.refusal = self.refusal or error
            raise


def _find(name: str, user: Path) -> Path:
    """Return a file that another one names: in its folder, or that of its Gazebo model."""
    folder = user.parent
    try:
        if "://" in name or Path(name).is_absolute():
            return ResourceFinder(folder).find(name)
        root = folder.parent if (folder.parent / "model.config").is_file() else folder
        return ResourceFinder(root).find(os.path.relpath(folder / name, root))
    except (ResourceError, ValueError) as error:
        raise TextureError(f"{user}: '{name}': {error}") from error


def _pixels(image: Any, user: Path) -> np.ndarray:
    """Return an image without its transparency, and not too large."""
    try:
        plain = image.convert("RGB")
        plain.thumbnail((LARGEST_SIDE, LARGEST_SIDE))
        return np.array(plain)
    except Exception as error:
        raise TextureError(f"{user}: not a readable image: {error}") from error


def _flat(corners: np.ndarray) -> Surface:
    """Return triangles with the normal of each at its three corners."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Surface(corners, np.repeat(_unit(normals)[:, None], 3, axis=1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors with length 1; up for those without any."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(lengths > 0.0, vectors / np.where(lengths > 0.0, lengths, 1.0), (0.0, 0.0, 1.0))
