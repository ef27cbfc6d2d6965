"""Shapes as triangles with normals, and with coordinates of the picture that may be on them.

Where a picture lies on boxes, cylinders, balls and planes is as in Gazebo, upright on the sides of
boxes and not mirrored, upside down around cylinders.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.simulation.world.description import (
    WHITE,
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
from bullet_lab.simulation.world.mesh_parts import Look, Part, Report, mesh_parts

LOG = logging.getLogger(__name__)
CYLINDER_SIDES = 48
# Of a ball, from pole to pole and around.
SPHERE_LINES = (18, 16)
# Of a picture on a side of a box: what is to the right and up, by the side's axis and direction.
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
        look: colour and material that it has of its own; None without.
        colour: that light is scattered in.
        glow: RGB that it gives off.
        texture: on it, None without one.
    """

    corners: np.ndarray
    normals: np.ndarray
    picture: Optional[np.ndarray] = None
    look: Optional[Look] = None
    colour: Colour = WHITE
    glow: Sequence[float] = (0.0, 0.0, 0.0)
    texture: Optional[Texture] = None

    def shown(self, visual: Visual, ambient: np.ndarray, report: Report) -> Surface:
        """Return the same as a visual of a link shows it, in the link's frame.

        `ambient` is the world's light, RGB; `report` is told what cannot be shown.
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
        """Return place, normal, colour, place in the picture and glow of corners, (3 n, 15)."""
        shape = self.corners.shape[:2]
        colour, glow = (np.broadcast_to(c, (*shape, len(c))) for c in (self.colour, self.glow))
        picture = np.zeros((*shape, 2)) if self.picture is None else self.picture
        parts = (self.corners, self.normals, colour, picture, glow)
        return np.concatenate(parts, axis=2, dtype=np.float32).reshape(-1, 15)


def _glow(colour: Colour, material: Material, ambient: np.ndarray) -> Tuple[float, ...]:
    """Return what a surface gives off, with what is more than its colour in ambient light."""
    if not material.lit:
        return colour[:3]
    glow = np.array(material.emissive[:3])
    if material.ambient is not None:
        glow += ambient * (np.array(material.ambient[:3]) - colour[:3])
    return tuple(glow.tolist())


def surfaces_of(geometry: Geometry, report: Report = LOG.warning) -> List[Surface]:
    """Return what is seen of a shape; raises LabError for an unusable mesh.

    `report` is told what is missing of it.
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
    # The middle of each end shows the picture's upper left corner, in Gazebo as well.
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
    """Return how far around corners (n, 3) are, at angles (rad), without a jump in a triangle.

    Corners without an angle, at poles, are in the middle between the others.
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
    surface = flat(part.corners)
    if part.normals is not None:
        # Where there is none, the triangle's own.
        lengths = np.linalg.norm(part.normals, axis=-1, keepdims=True)
        normals = _unit(np.where(lengths > 1e-9, part.normals, surface.normals))
        outward = np.median(np.sum(surface.normals * normals, axis=-1))
        surface = replace(surface, normals=normals)
        if outward < 0.0:
            # Mirrored, or wound the other way around: the normals know where outside is.
            corners, normals = part.corners[:, ::-1], normals[:, ::-1]
            picture = None if part.picture is None else part.picture[:, ::-1]
            return Surface(corners, normals, picture, part.look)
    return replace(surface, picture=part.picture, look=part.look)


# What makes surfaces of each shape.
SURFACES: Dict[type, Callable[[Any, Report], List[Surface]]] = {
    Box: _box,
    Cylinder: _cylinder,
    Sphere: _sphere,
    Plane: _plane,
    Mesh: _mesh,
}


def flat(corners: np.ndarray) -> Surface:
    """Return triangles with the normal of each at its three corners."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Surface(corners, np.repeat(_unit(normals)[:, None], 3, axis=1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors with length 1; up for those without any."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(lengths > 0.0, vectors / np.where(lengths > 0.0, lengths, 1.0), (0.0, 0.0, 1.0))
