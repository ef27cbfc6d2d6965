"""Make triangles of shapes, with normals and texture coordinates.

Texture coordinates are those of Gazebo: upright and not mirrored on boxes, upside down around
cylinders.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.simulation.world.description import (
    WHITE,
    Appearance,
    Box,
    Colour,
    Cylinder,
    Geometry,
    Material,
    Mesh,
    Plane,
    Sphere,
    Texture,
    Visual,
)
from bullet_lab.simulation.world.mesh_parts import Part, Report, mesh_parts

LOG = logging.getLogger(__name__)
CYLINDER_SIDES = 48
# The number of lines of a ball, from pole to pole and around.
SPHERE_LINES = (18, 16)
# The directions right and up of a picture on a side of a box, by the side's axis and its sign.
BOX_SIDES = {
    (0, 1): ((0, 1, 0), (0, 0, 1)),
    (0, -1): ((0, -1, 0), (0, 0, 1)),
    (1, 1): ((-1, 0, 0), (0, 0, 1)),
    (1, -1): ((1, 0, 0), (0, 0, 1)),
    (2, 1): ((0, -1, 0), (1, 0, 0)),
    (2, -1): ((0, -1, 0), (-1, 0, 0)),
}


@dataclass(frozen=True)
class Surface:
    """Triangles in metres: corner arrays of shape (n, 3, …), three corners each.

    Attributes:
        corners: (n, 3, 3) positions.
        normals: (n, 3, 3) unit normals at the corners.
        picture: (n, 3, 2) coordinates in a picture, from its lower left; None without any.
        look: colour and material in the file of a mesh; None without any.
        colour: of scattered light.
        glow: RGB of the light that it emits.
        texture: its picture, or None.
    """

    corners: np.ndarray
    normals: np.ndarray
    picture: Optional[np.ndarray] = None
    look: Optional[Appearance] = None
    colour: Colour = WHITE
    glow: Sequence[float] = (0.0, 0.0, 0.0)
    texture: Optional[Texture] = None

    def shown(self, visual: Visual, ambient: np.ndarray, report: Report) -> Surface:
        """Return the surface with the look of a visual, in the link's frame.

        `ambient` is the world's light, RGB; `report` gets a line if the texture is left out.
        """
        turn = visual.pose.rotation_matrix()
        corners = self.corners @ turn.T + np.asarray(visual.pose.position)
        colour, material = visual.colour, visual.material
        if self.look is not None and not material.covers:
            (*rgb, alpha), material = self.look
            colour = (*rgb, alpha * colour[3])
        texture, picture = material.texture, self.picture
        if texture is not None and picture is None:
            report(f"{texture.path}: the mesh has no texture coordinates; drawn without it")
            texture = None
        return replace(
            self,
            corners=corners,
            normals=self.normals @ turn.T,
            picture=None if texture is None else texture.coordinates(picture),
            colour=colour if material.lit else (0.0, 0.0, 0.0, colour[3]),
            glow=_glow(colour, material, ambient),
            texture=texture,
        )

    def floats(self) -> np.ndarray:
        """Return position, normal, colour, texture coordinates and glow of corners, (3 n, 15)."""
        shape = self.corners.shape[:2]
        colour, glow = (np.broadcast_to(c, (*shape, len(c))) for c in (self.colour, self.glow))
        picture = np.zeros((*shape, 2)) if self.picture is None else self.picture
        parts = (self.corners, self.normals, colour, picture, glow)
        return np.concatenate(parts, axis=2, dtype=np.float32).reshape(-1, 15)


def _glow(colour: Colour, material: Material, ambient: np.ndarray) -> Tuple[float, ...]:
    """Return the light of a surface that does not depend on lamps.

    That is what it emits, and what its ambient colour adds to its diffuse one in ambient light.
    """
    if not material.lit:
        return colour[:3]
    glow = np.array(material.emissive[:3])
    if material.ambient is not None:
        glow += ambient * (np.array(material.ambient[:3]) - colour[:3])
    return tuple(glow.tolist())


def surfaces_of(geometry: Geometry, report: Report = LOG.warning) -> List[Surface]:
    """Return the surfaces of a shape; raise LabError for an unusable mesh.

    `report` gets a line for each missing file.
    """
    return SURFACES[type(geometry)](geometry, report)


def _box(box: Box, _report: Report) -> List[Surface]:
    from trimesh import creation

    surface = flat(creation.box(box.size).triangles)
    axes = np.argmax(np.abs(surface.normals[:, 0]), axis=1)
    signs = np.sign(np.take_along_axis(surface.normals[:, 0], axes[:, None], axis=1))[:, 0]
    sides = np.array([BOX_SIDES[(a, int(s))] for a, s in zip(axes.tolist(), signs.tolist())])
    picture = 0.5 + np.einsum("nki,nji->nkj", surface.corners / box.size, sides)
    return [replace(surface, picture=picture)]


def _cylinder(cylinder: Cylinder, _report: Report) -> List[Surface]:
    from trimesh import creation

    made = creation.cylinder(cylinder.radius, cylinder.length, CYLINDER_SIDES)
    surface = flat(made.triangles)
    round_ = np.where(
        np.abs(surface.normals[..., 2:]) > 0.5, surface.normals, surface.corners * (1, 1, 0)
    )
    x, y, z = np.moveaxis(surface.corners, -1, 0)
    # As in Gazebo, the middle of each end shows the upper left corner of the picture.
    middle = np.hypot(x, y) < 0.5 * cylinder.radius
    turns = _turns(np.where(middle, np.nan, np.arctan2(x, y)))
    picture = np.stack((turns, 0.5 - z / cylinder.length), axis=2)
    picture[middle] = (0.0, 1.0)
    return [replace(surface, normals=_unit(round_), picture=picture)]


def _sphere(sphere: Sphere, _report: Report) -> List[Surface]:
    from trimesh import creation

    made = creation.uv_sphere(radius=sphere.radius, count=SPHERE_LINES).triangles
    # Gazebo's has its poles on y.
    corners = made[..., (1, 2, 0)]
    x, y, z = np.moveaxis(corners / sphere.radius, -1, 0)
    at_pole = np.hypot(x, z) < 1e-6
    turns = _turns(np.where(at_pole, np.nan, np.arctan2(x, z)))
    height = 1.0 - np.arccos(np.clip(y, -1.0, 1.0)) / np.pi
    return [Surface(corners, _unit(corners), np.stack((turns, height), axis=2))]


def _turns(angles: np.ndarray) -> np.ndarray:
    """Return angles (rad) of corners (n, 3) as shares of a turn, without a jump in a triangle.

    Corners at poles have no angle (NaN); they get the mean of the others.
    """
    turns = angles / (2.0 * np.pi) % 1.0
    turns = np.where(np.nanmax(turns, axis=1, keepdims=True) - turns > 0.5, turns + 1.0, turns)
    between = np.nanmean(turns, axis=1, keepdims=True)
    return np.where(np.isnan(turns), between, turns)


def _plane(plane: Plane, _report: Report) -> List[Surface]:
    z = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
    y = np.cross(z, (1.0, 0.0, 0.0) if abs(z[0]) < 0.9 else (0.0, 1.0, 0.0))
    y /= np.linalg.norm(y)
    square = np.array(((-1, -1), (1, -1), (1, 1), (-1, -1), (1, 1), (-1, 1)))
    corners = square * 0.5 * np.array(plane.size) @ (np.cross(y, z), y)
    picture = (0.5 + 0.5 * square).reshape(2, 3, 2)
    return [replace(flat(corners.reshape(2, 3, 3)), picture=picture)]


def _mesh(mesh: Mesh, report: Report) -> List[Surface]:
    return [_part(part) for part in mesh_parts(mesh, report)]


def _part(part: Part) -> Surface:
    normals, picture, order = flat(part.corners).normals, part.picture, slice(None)
    if part.normals is not None:
        # A missing normal is replaced by that of the triangle.
        lengths = np.linalg.norm(part.normals, axis=-1, keepdims=True)
        given = _unit(np.where(lengths > 1e-9, part.normals, normals))
        outward = np.median(np.sum(normals * given, axis=-1))
        # Mirrored, or with the corners in the other order: the given normals point outwards.
        order = slice(None, None, -1 if outward < 0.0 else 1)
        normals = given[:, order]
    picture = None if picture is None else picture[:, order]
    return Surface(part.corners[:, order], normals, picture, part.look)


# The function that makes the surfaces of each shape.
SURFACES: Dict[type, Callable[[Any, Report], List[Surface]]] = {
    Box: _box,
    Cylinder: _cylinder,
    Sphere: _sphere,
    Plane: _plane,
    Mesh: _mesh,
}


def flat(corners: np.ndarray) -> Surface:
    """Return triangles whose corners have the normal of the triangle."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Surface(corners, np.repeat(_unit(normals)[:, None], 3, axis=1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors with length 1; zero vectors become (0, 0, 1)."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(lengths > 0.0, vectors / np.where(lengths > 0.0, lengths, 1.0), (0.0, 0.0, 1.0))
