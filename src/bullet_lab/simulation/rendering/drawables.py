"""Make Panda3D's triangles, colours and textures of the links of a model."""

from __future__ import annotations

import itertools
import weakref
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.graphics import panda3d
from bullet_lab.simulation.rendering.lights import BITS, PICTURE
from bullet_lab.simulation.rendering.surfaces import Surface, surfaces_of
from bullet_lab.simulation.world.description import Plane, Texture, Visual
from bullet_lab.simulation.world.meshes import file_version, read_bytes
from bullet_lab.simulation.world.xml import ReportOnce

# The longest side of a texture in pixels; larger pictures are shrunk.
LARGEST_SIDE = 8192


class TextureError(LabError):
    """A file is not a readable picture."""


class LoadedTexture:
    """A texture of Panda3D, which is released together with this object."""

    def __init__(self, texture: Any):
        self.texture = texture
        # Without this, the driver keeps it as long as the context exists.
        weakref.finalize(self, texture.release_all)


class Textures:
    """The pictures on surfaces; each is read once, and kept while a surface has it."""

    def __init__(self) -> None:
        self._known: Any = weakref.WeakValueDictionary()

    def of(self, texture: Texture) -> LoadedTexture:
        """Return a loaded texture; raise LabError for a file that is not a picture."""
        kind = (texture.blends, texture.repeats, texture.sharp)
        key = (texture.path, kind, file_version(texture))
        found = self._known.get(key)
        if found is None:
            found = self._known[key] = LoadedTexture(_panda_texture(texture))
        return found


def read_pixels(texture: Texture) -> np.ndarray:
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


def _panda_texture(texture: Texture) -> Any:
    core, pixels = panda3d(), read_pixels(texture)
    height, width = pixels.shape[:2]
    made = core.Texture("image")
    kind = core.Texture.F_rgba if texture.blends else core.Texture.F_rgb
    made.setup_2d_texture(width, height, core.Texture.T_unsigned_byte, kind)
    # In Panda3D, the lowest row is first, and the order is blue, green, red.
    made.set_ram_image(np.ascontiguousarray(pixels[::-1, :, _order(texture)]).tobytes())
    made.minfilter = core.SamplerState.FT_linear_mipmap_linear
    nearest, linear = core.SamplerState.FT_nearest, core.SamplerState.FT_linear
    made.magfilter = nearest if texture.sharp else linear
    if not texture.repeats:
        made.wrap_u = made.wrap_v = core.SamplerState.WM_clamp
    return made


def _order(texture: Texture) -> Tuple[int, ...]:
    return (2, 1, 0, 3) if texture.blends else (2, 1, 0)


# The centre of a textured surface, m in the link's frame, and its mean normal, which has the length
# 1 for a plane and 0 for a closed surface.
Patch = Tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Drawable:
    """The visible parts of a link.

    Attributes:
        nodes: to be attached to the node of a link, with the patch of a textured node.
        boxes: corners of the boxes around shadow casters, (n, 8, 3) in m in the link's frame.
        textures: those of the nodes, to be kept as long as these.
    """

    nodes: List[Tuple[Any, Optional[Patch]]]
    boxes: np.ndarray
    textures: List[LoadedTexture]


class Drawables:
    """Makes the drawables of links in a world's ambient light, RGB.

    Unreadable parts are left out, with one warning each.
    """

    def __init__(self, ambient: Sequence[float]):
        self._ambient = np.array(ambient[:3])
        self._textures = Textures()
        self._report = ReportOnce()

    def of(self, visuals: Sequence[Visual], casts: str, where: str) -> Drawable:
        """Return the drawable of a link.

        `casts` is the kind of its shadow maps, STILL or MOVING; `where` names it in messages.
        """
        # The surfaces of one draw call: of the same kind, with at most one picture.
        calls: Dict[tuple, List[Surface]] = {}
        boxes = [np.zeros((0, 8, 3))]
        for visual in visuals:
            is_plane = isinstance(visual.geometry, Plane)
            for surface in self._surfaces(visual, where):
                blends = surface.texture is not None and surface.texture.blends
                see_through = surface.colour[3] < 1.0 or blends
                throws = visual.casts_shadows and not see_through and not is_plane
                number = len(calls) if surface.texture is not None else -1
                calls.setdefault((number, see_through, is_plane, throws), []).append(surface)
                if throws:
                    boxes.append(_box_around(surface.corners))
        made = Drawable([], np.concatenate(boxes), [])
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

    def _surfaces(self, visual: Visual, where: str) -> List[Surface]:
        """Return the surfaces of a visual, in the link's frame."""
        if visual.colour[3] <= 0.0:
            return []
        try:
            found = surfaces_of(visual.geometry, self._report)
        except LabError as error:
            self._report(f"{where} is not drawn completely: {error}")
            return []
        return [surface.shown(visual, self._ambient, self._report) for surface in found]

    def _loaded(self, surface: Surface) -> Optional[LoadedTexture]:
        if surface.texture is None:
            return None
        try:
            return self._textures.of(surface.texture)
        except LabError as error:
            self._report(f"{error}; drawn without it")
            return None


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


def _box_around(corners: np.ndarray) -> np.ndarray:
    """Return the corners of the box around triangles (n, 3, 3), (1, 8, 3)."""
    ends = np.stack((corners.min(axis=(0, 1)), corners.max(axis=(0, 1))), axis=1)
    return np.array([list(itertools.product(*ends))])
