"""What is to be seen of a link as Panda3D draws it: triangles, colours and textures.

Links that look the same share one drawable for as long as any of them is there.
"""

from __future__ import annotations

import logging
import weakref
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.pose import Vector
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.graphics import Graphics
from bullet_lab.simulation.rendering.lights import BITS, PICTURE
from bullet_lab.simulation.rendering.surfaces import Surface, surfaces_of
from bullet_lab.simulation.rendering.textures import Image
from bullet_lab.simulation.world.description import Link, Mesh, Plane, Visual
from bullet_lab.simulation.world.meshes import file_version

LOG = logging.getLogger(__name__)

# A texture on a plane is drawn by the better and slower way where the cosine of its normal with the
# direction of view is less: where a pixel's footprint is 1.3 times as long as wide. (Below that,
# sharper textures only let the smallest markers flicker.)
SLANT = 0.77
# Triangles lie in a plane where their mean normal has this length, of 1.
FLAT = 0.98
# Corners of one drawing call above which it takes too long to see which are the same.
MOST_SHARED = 100_000
# Floats of a corner: place, normal, colour, place in the texture.
CORNER = (("vertex", 3), ("normal", 3), ("color", 4), ("texcoord", 2))


@dataclass(frozen=True)
class _Look:
    """What triangles of one drawing call have in common."""

    image: Optional[Image]
    see_through: bool
    casts_shadows: bool
    is_plane: bool


# A shape, and triangles of it in the link's frame.
Part = Tuple[Visual, Surface]


class _Texture:
    """A texture on the graphics side; Panda3D's own objects take no weak references."""

    def __init__(self, graphics: Graphics, image: Image):
        core = graphics.core
        kind = core.Texture
        height, width = image.pixels.shape[:2]
        self.texture = kind("image")
        self.texture.setup_2d_texture(width, height, kind.T_unsigned_byte, kind.F_rgb)
        # Panda3D has the lowest row first, and blue before green before red.
        self.texture.set_ram_image(np.ascontiguousarray(image.pixels[::-1, :, ::-1]).tobytes())
        self.texture.set_minfilter(core.SamplerState.FT_linear_mipmap_linear)
        self.texture.set_magfilter(core.SamplerState.FT_linear)
        # Without this, the driver keeps it for as long as the context lives.
        weakref.finalize(self, self.texture.release_all)


@dataclass(frozen=True)
class Patch:
    """Where textured triangles are, in the link's frame.

    Attributes:
        centre: of all, m.
        radius: of a ball around them, m.
        normal: unit normal of all, if they lie about in a plane.
    """

    centre: Vector
    radius: float
    normal: Optional[Vector]

    def is_slanted(self, eye: Vector) -> bool:
        """Whether it is seen at such a slant from a place in the link's frame, m.

        What is no plane is so from far away: close by it would take long to draw.
        """
        way = np.subtract(self.centre, eye)
        distance = float(np.linalg.norm(way))
        if self.normal is None:
            return distance > 2.0 * self.radius
        return abs(float(way @ self.normal)) < SLANT * distance


@dataclass(frozen=True, eq=False)
class Drawable:
    """What is to be seen of a link.

    Attributes:
        nodes: to be hung below the node of a link, with where they are if they are textured.
        boxes: (n, 8, 3) corners of the boxes around what throws shadows, m in the link's frame.
        bounds: (8, 3) corners of the box around all, m in the link's frame.
        textures: that the nodes use.
    """

    nodes: Tuple[Tuple[Any, Optional[Patch]], ...]
    boxes: np.ndarray
    bounds: np.ndarray
    textures: Tuple[_Texture, ...]


class Drawables:
    """Makes drawables, and knows those that are in use.

    Args:
        graphics: that draws them.
    """

    def __init__(self, graphics: Graphics):
        self._graphics = graphics
        self._made: Any = weakref.WeakValueDictionary()
        self._textures: Any = weakref.WeakValueDictionary()
        self._format = _vertex_format(graphics.core)

    def of(self, link: Link, casts: str, where: str) -> Drawable:
        """Return what is to be seen of a link.

        What cannot be read is left out, with a line in the log.

        Args:
            link: the link.
            casts: STILL or MOVING: the shadow maps that it is drawn into.
            where: names the link in messages.
        """
        meshes = [v.geometry for v in link.visuals if isinstance(v.geometry, Mesh)]
        key = (link.visuals, casts, tuple(map(file_version, meshes)))
        found = self._made.get(key)
        if found is None:
            found = self._made[key] = self._make(link.visuals, casts, where)
        return found

    def _make(self, visuals: Sequence[Visual], casts: str, where: str) -> Drawable:
        looks: Dict[_Look, List[Part]] = {}
        boxes, ends = [], [np.zeros((1, 3))]
        for visual, surface in _surfaces(visuals, where):
            look = _look(visual, surface)
            looks.setdefault(look, []).append((visual, surface))
            ends.append(surface.corners.reshape(-1, 3))
            if look.casts_shadows:
                boxes.append(_box_around(ends[-1]))
        textures = {look: self._texture(look.image) for look in looks if look.image is not None}
        nodes = tuple(
            (self._node(look, parts, casts, textures.get(look)), _patch(look, parts))
            for look, parts in looks.items()
        )
        bounds = _box_around(np.concatenate(ends))
        held = tuple(textures.values())
        return Drawable(nodes, np.array(boxes).reshape(-1, 8, 3), bounds, held)

    def _texture(self, image: Image) -> _Texture:
        found = self._textures.get(image.digest)
        if found is None:
            found = self._textures[image.digest] = _Texture(self._graphics, image)
        return found

    def _node(
        self, look: _Look, parts: Sequence[Part], casts: str, texture: Optional[_Texture]
    ) -> Any:
        core = self._graphics.core
        distinct, order = _shared(np.concatenate([_corners(*part) for part in parts]))
        vertices = core.GeomVertexData("shape", self._format, core.Geom.UH_static)
        vertices.unclean_set_num_rows(len(distinct))
        memoryview(vertices.modify_array(0)).cast("B")[:] = distinct.tobytes()
        triangles = core.GeomTriangles(core.Geom.UH_static)
        triangles.set_index_type(core.Geom.NT_uint32)
        indices = triangles.modify_vertices()
        indices.unclean_set_num_rows(len(order))
        memoryview(indices).cast("B")[:] = order.astype(np.uint32).tobytes()
        geom = core.Geom(vertices)
        geom.add_primitive(triangles)
        node = core.GeomNode("shape")
        node.add_geom(geom)
        path = core.NodePath(node)
        if texture is not None:
            path.set_texture(texture.texture)
        if look.see_through:
            path.set_transparency(core.TransparencyAttrib.M_alpha)
            path.set_bin("transparent", 0)
        else:
            # Floors last: most of them is hidden. Else in the order in which things were added,
            # so that equal worlds give equal pictures. ("fixed" would come after "transparent".)
            path.set_bin("background", int(look.is_plane))
        for bit in BITS.values():
            path.hide(core.BitMask32.bit(bit))
        path.show(core.BitMask32.bit(BITS[PICTURE]))
        if look.casts_shadows:
            path.show(core.BitMask32.bit(BITS[casts]))
        return node


def _vertex_format(core: Any) -> Any:
    array = core.GeomVertexArrayFormat()
    contents = {"vertex": core.Geom.C_point, "normal": core.Geom.C_normal,
                "color": core.Geom.C_color, "texcoord": core.Geom.C_texcoord}  # fmt: skip
    for name, count in CORNER:
        array.add_column(core.InternalName.make(name), count, core.Geom.NT_float32, contents[name])
    return core.GeomVertexFormat.register_format(core.GeomVertexFormat(array))


def _surfaces(visuals: Sequence[Visual], where: str) -> List[Part]:
    """Return the surfaces of visuals in the link's frame."""
    found = []
    for visual in visuals:
        if visual.colour[3] <= 0.0:
            continue
        try:
            surfaces = surfaces_of(visual.geometry)
        except LabError as error:
            LOG.warning("%s is not drawn as it should be: %s", where, error)
            continue
        found += [(visual, surface.moved(visual.pose)) for surface in surfaces]
    return found


def _look(visual: Visual, surface: Surface) -> _Look:
    see_through = visual.colour[3] < 1.0
    is_plane = isinstance(visual.geometry, Plane)
    casts = visual.casts_shadows and not see_through and not is_plane
    return _Look(surface.image, see_through, casts, is_plane)


def _patch(look: _Look, parts: Sequence[Part]) -> Optional[Patch]:
    """Return where textured triangles are; those that show a single point of it do not count."""
    if look.image is None:
        return None
    corners = np.concatenate([surface.corners for _, surface in parts])
    pictures = np.concatenate([surface.picture for _, surface in parts])
    chosen = np.ptp(pictures, axis=1).max(axis=1) > 0.0
    corners = corners[chosen] if chosen.any() else corners
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    radius = 0.5 * float(np.linalg.norm(high - low))
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size, total = np.linalg.norm(areas.sum(axis=0)), np.linalg.norm(areas, axis=1).sum()
    normal = tuple((areas.sum(axis=0) / size).tolist()) if size > FLAT * total > 0.0 else None
    return Patch(tuple((0.5 * (low + high)).tolist()), radius, normal)


def _corners(visual: Visual, surface: Surface) -> np.ndarray:
    """Return the floats of all corners, (n, sum of CORNER) float32."""
    count = 3 * len(surface.corners)
    corners = np.zeros((count, sum(width for _, width in CORNER)), np.float32)
    corners[:, 0:3] = surface.corners.reshape(count, 3)
    corners[:, 3:6] = surface.normals.reshape(count, 3)
    corners[:, 6:10] = visual.colour
    if surface.picture is not None:
        corners[:, 10:12] = surface.picture.reshape(count, 2)
    return corners


def _shared(corners: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the distinct ones of corners (n, floats), and for each corner which it is."""
    if len(corners) > MOST_SHARED:
        return corners, np.arange(len(corners))
    rows = np.ascontiguousarray(corners).view(f"V{corners.itemsize * corners.shape[1]}")[:, 0]
    _, first, order = np.unique(rows, return_index=True, return_inverse=True)
    return corners[first], order


def _box_around(corners: np.ndarray) -> np.ndarray:
    """Return the (8, 3) corners of the box around points, (n, 3)."""
    ends = np.array((corners.min(axis=0), corners.max(axis=0)))
    return np.array([(x, y, z) for x in ends[:, 0] for y in ends[:, 1] for z in ends[:, 2]])
