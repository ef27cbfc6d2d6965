"""Make triangles, colours and textures of the links of a model, and give them to Panda3D.

Texture coordinates are those of Gazebo: upright and not mirrored on boxes, upside down around
cylinders.
"""

from __future__ import annotations

import itertools
import logging
import weakref
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any, Callable, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering import panda3d
from bullet_lab.simulation.rendering.lights import BITS, PICTURE
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
from bullet_lab.simulation.world.mesh_parts import mesh_parts
from bullet_lab.simulation.world.meshes import file_version, flat_normals, read_bytes, unit
from bullet_lab.simulation.world.xml import Report, ReportOnce

LOG = logging.getLogger(__name__)
# The longest side of a texture in pixels; larger pictures are shrunk.
LARGEST_SIDE = 8192
CYLINDER_SIDES = 48
# The number of lines of a ball, from pole to pole and around.
SPHERE_LINES = (18, 16)


class TextureError(LabError):
    """A file is not a readable picture."""


def read_pixels(texture: Texture) -> ndarray:
    """Return a picture of limited size, (height, width, 3) uint8, or RGBA if it blends."""
    import PIL.Image

    data = read_bytes(texture.path)
    try:
        with PIL.Image.open(BytesIO(data)) as image:
            plain = image.convert("RGBA" if texture.blends else "RGB")
        plain.thumbnail((LARGEST_SIDE, LARGEST_SIDE))
        return np.array(plain)
    except Exception as error:
        raise TextureError(f"{texture.path}: not a readable image: {error}") from error


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
        shine: of its wide highlights.
        texture: its picture, or None.
    """

    corners: ndarray
    normals: ndarray
    picture: ndarray | None = None
    look: Appearance | None = None
    colour: Colour = WHITE
    glow: Sequence[float] = (0.0, 0.0, 0.0)
    shine: float = 0.0
    texture: Texture | None = None

    def shown(self, visual: Visual, ambient: ndarray, report: Report) -> Surface:
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
            shine=material.shine if material.lit else 0.0,
            texture=texture,
        )

    def floats(self) -> ndarray:
        """Return the columns of `_vertex_format` for all corners, (3 n, 16)."""
        shape, plain = self.corners.shape[:2], (self.colour, self.glow, (self.shine,))
        colour, glow, shine = (np.broadcast_to(c, (*shape, len(c))) for c in plain)
        picture = np.zeros((*shape, 2)) if self.picture is None else self.picture
        parts = (self.corners, self.normals, colour, picture, glow, shine)
        return np.concatenate(parts, axis=2, dtype=np.float32).reshape(-1, 16)


def _glow(colour: Colour, material: Material, ambient: ndarray) -> tuple[float, ...]:
    """Return the light of a surface that does not depend on lamps.

    That is what it emits, and what its ambient colour adds to its diffuse one in ambient light.
    """
    if not material.lit:
        return colour[:3]
    glow = np.array(material.emissive[:3])
    if material.ambient is not None:
        glow += ambient * (np.array(material.ambient[:3]) - colour[:3])
    return tuple(glow.tolist())


def surfaces_of(geometry: Geometry, report: Report = LOG.warning) -> list[Surface]:
    """Return the surfaces of a shape; raise LabError for an unusable mesh.

    `report` gets a line for each missing file.
    """
    if isinstance(geometry, Mesh):
        parts = mesh_parts(geometry, report)
        return [Surface(p.corners, p.normals, p.picture, p.material) for p in parts]
    return [SURFACES[type(geometry)](geometry)]


def visible_surfaces(visual: Visual, ambient: ndarray, report: Report) -> list[Surface]:
    """Return the surfaces of a visual with its look, see `Surface.shown` and `surfaces_of`."""
    if visual.colour[3] <= 0.0:
        return []
    found = surfaces_of(visual.geometry, report)
    return [surface.shown(visual, ambient, report) for surface in found]


def _box(box: Box) -> Surface:
    from trimesh import creation

    surface = flat(creation.box(box.size).triangles)
    normals = surface.normals[:, 0].round()
    # A picture is upright on the sides; on the upper one, up is along x, on the lower one, back.
    up = np.where(normals[:, 2:], normals[:, 2:] * (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    axes = np.stack((np.cross(up, normals), up), axis=1)
    picture = 0.5 + np.einsum("nki,nji->nkj", surface.corners / box.size, axes)
    return replace(surface, picture=picture)


def _cylinder(cylinder: Cylinder) -> Surface:
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
    return replace(surface, normals=unit(round_), picture=picture)


def _sphere(sphere: Sphere) -> Surface:
    from trimesh import creation

    made = creation.uv_sphere(radius=sphere.radius, count=SPHERE_LINES).triangles
    # Gazebo's has its poles on y.
    corners = made[..., (1, 2, 0)]
    x, y, z = np.moveaxis(corners / sphere.radius, -1, 0)
    at_pole = np.hypot(x, z) < 1e-6
    turns = _turns(np.where(at_pole, np.nan, np.arctan2(x, z)))
    height = 1.0 - np.arccos(np.clip(y, -1.0, 1.0)) / np.pi
    return Surface(corners, unit(corners), np.stack((turns, height), axis=2))


def _turns(angles: ndarray) -> ndarray:
    """Return angles (rad) of corners (n, 3) as shares of a turn, without a jump in a triangle.

    Corners at poles have no angle (NaN); they get the mean of the others.
    """
    turns = angles / (2.0 * np.pi) % 1.0
    turns = np.where(np.nanmax(turns, axis=1, keepdims=True) - turns > 0.5, turns + 1.0, turns)
    between = np.nanmean(turns, axis=1, keepdims=True)
    return np.where(np.isnan(turns), between, turns)


def _plane(plane: Plane) -> Surface:
    z = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
    y = np.cross(z, (1.0, 0.0, 0.0) if abs(z[0]) < 0.9 else (0.0, 1.0, 0.0))
    y /= np.linalg.norm(y)
    square = np.array(((-1, -1), (1, -1), (1, 1), (-1, -1), (1, 1), (-1, 1)))
    corners = square * 0.5 * np.array(plane.size) @ (np.cross(y, z), y)
    picture = (0.5 + 0.5 * square).reshape(2, 3, 2)
    return replace(flat(corners.reshape(2, 3, 3)), picture=picture)


# The function that makes the surface of each shape but a mesh.
SURFACES: dict[type, Callable[[Any], Surface]] = {
    Box: _box,
    Cylinder: _cylinder,
    Sphere: _sphere,
    Plane: _plane,
}


def flat(corners: ndarray) -> Surface:
    """Return triangles whose corners have the normal of the triangle."""
    return Surface(corners, flat_normals(corners))


class LoadedTexture:
    """A texture of Panda3D, which is released together with this object."""

    def __init__(self, texture: Any):
        self.texture = texture
        # Without this, the driver keeps it as long as the context exists.
        weakref.finalize(self, texture.release_all)


# The centre of a textured surface, m in the link's frame, and its mean normal, which has the length
# 1 for a plane and 0 for a closed surface.
Patch = Tuple[ndarray, ndarray]


@dataclass(frozen=True, eq=False)
class Drawable:
    """The visible parts of a link.

    Attributes:
        nodes: to be attached to the node of a link, with the patch of a textured node.
        boxes: corners of the boxes around shadow casters, (n, 8, 3) in m in the link's frame.
        textures: those of the nodes, to be kept as long as these.
    """

    nodes: list[tuple[Any, Patch | None]]
    boxes: ndarray
    textures: list[LoadedTexture]


class Drawables:
    """Makes the drawables of links in a world's ambient light, RGB.

    Unreadable parts are left out, with one warning each.
    """

    def __init__(self, ambient: Sequence[float]):
        self._ambient = np.array(ambient[:3])
        # Textures that a surface has, each read once.
        self._textures: Any = weakref.WeakValueDictionary()
        self._report = ReportOnce()

    def of(self, visuals: Sequence[Visual], casts: str, where: str) -> Drawable:
        """Return the drawable of a link.

        `casts` is the kind of its shadow maps, STILL or MOVING; `where` names it in messages.
        """
        # The surfaces of one draw call: of the same kind, with at most one picture.
        calls: dict[tuple, list[Surface]] = {}
        boxes = []
        for visual in visuals:
            is_plane = isinstance(visual.geometry, Plane)
            for surface in self._surfaces(visual, where):
                blends = surface.texture is not None and surface.texture.blends
                see_through = surface.colour[3] < 1.0 or blends
                throws = visual.casts_shadows and not see_through and not is_plane
                number = len(calls) if surface.texture is not None else -1
                calls.setdefault((number, see_through, is_plane, throws), []).append(surface)
                if throws:
                    points = surface.corners.reshape(-1, 3)
                    ends = zip(points.min(axis=0), points.max(axis=0))
                    boxes.append(list(itertools.product(*ends)))
        made = Drawable([], np.array(boxes).reshape(-1, 8, 3), [])
        for (_, see_through, is_plane, throws), surfaces in calls.items():
            path, patch = panda3d().NodePath(_node(surfaces)), None
            loaded = self._loaded(surfaces[0])
            if loaded is not None:
                path.set_texture(loaded.texture)
                patch = _patch(surfaces[0])
                made.textures.append(loaded)
            if see_through:
                path.set_transparency(panda3d().TransparencyAttrib.M_alpha)
                path.set_bin("transparent", 0)
            else:
                # Floors last, since most of a floor is hidden. Otherwise in the order of addition,
                # so that equal worlds give equal pictures ("fixed" comes after "transparent").
                path.set_bin("background", int(is_plane))
            path.hide(panda3d().BitMask32.all_on())
            for kind in (PICTURE, casts) if throws else (PICTURE,):
                path.show(panda3d().BitMask32.bit(BITS[kind]))
            made.nodes.append((path.node(), patch))
        return made

    def _surfaces(self, visual: Visual, where: str) -> list[Surface]:
        """Return the surfaces of a visual, in the link's frame."""
        try:
            return visible_surfaces(visual, self._ambient, self._report)
        except LabError as error:
            self._report(f"{where} is not drawn completely: {error}")
            return []

    def _loaded(self, surface: Surface) -> LoadedTexture | None:
        texture = surface.texture
        if texture is None:
            return None
        try:
            kind = (texture.blends, texture.repeats, texture.sharp)
            key = (texture.path, kind, file_version(texture))
            loaded = self._textures.get(key)
            if loaded is None:
                loaded = self._textures[key] = LoadedTexture(_panda_texture(texture))
            return loaded
        except LabError as error:
            self._report(f"{error}; drawn without it")
            return None


def _panda_texture(texture: Texture) -> Any:
    core, pixels = panda3d(), read_pixels(texture)
    height, width = pixels.shape[:2]
    made = core.Texture("image")
    kind = core.Texture.F_rgba if texture.blends else core.Texture.F_rgb
    made.setup_2d_texture(width, height, core.Texture.T_unsigned_byte, kind)
    # In Panda3D, the lowest row is first, and the order is blue, green, red.
    order = (2, 1, 0, 3) if texture.blends else (2, 1, 0)
    made.set_ram_image(np.ascontiguousarray(pixels[::-1, :, order]).tobytes())
    made.minfilter = core.SamplerState.FT_linear_mipmap_linear
    nearest, linear = core.SamplerState.FT_nearest, core.SamplerState.FT_linear
    made.magfilter = nearest if texture.sharp else linear
    if not texture.repeats:
        made.wrap_u = made.wrap_v = core.SamplerState.WM_clamp
    return made


def _node(surfaces: Sequence[Surface]) -> Any:
    core = panda3d()
    corners = np.concatenate([surface.floats() for surface in surfaces])
    vertices = core.GeomVertexData("shape", _vertex_format(), core.Geom.UH_static)
    vertices.unclean_set_num_rows(len(corners))
    memoryview(vertices.modify_array(0)).cast("B")[:] = corners.tobytes()
    triangles = core.GeomTriangles(core.Geom.UH_static)
    triangles.add_next_vertices(len(corners))
    geom, node = core.Geom(vertices), core.GeomNode("shape")
    geom.add_primitive(triangles)
    node.add_geom(geom)
    return node


def _vertex_format() -> Any:
    """Return the columns of `Surface.floats` for Panda3D."""
    core, kinds, columns = panda3d(), panda3d().Geom, panda3d().GeomVertexArrayFormat()
    for name, count, content in (
        ("vertex", 3, kinds.C_point),
        ("normal", 3, kinds.C_normal),
        ("color", 4, kinds.C_color),
        ("texcoord", 2, kinds.C_texcoord),
        ("glow", 3, kinds.C_other),
        ("shine", 1, kinds.C_other),
    ):
        columns.add_column(name, count, kinds.NT_float32, content)
    return core.GeomVertexFormat.register_format(core.GeomVertexFormat(columns))


def _patch(surface: Surface) -> Patch:
    # Without triangles that show a single point of the picture.
    chosen = np.ptp(surface.picture, axis=1).max(axis=1) > 0.0
    corners = surface.corners[chosen] if chosen.any() else surface.corners
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.linalg.norm(areas, axis=1).sum()
    centre = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    return centre, areas.sum(axis=0) / (total or 1.0)
