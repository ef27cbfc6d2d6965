"""Nodes of the page's scene, updated in few messages.

viser sends each property that changes as a message, and none for an equal value. Things that move
together are therefore one node with an array for all of them. Poses are in the scene's one frame,
in m; colours of floats are RGBA or RGB within [0, 1]. Not thread-safe.
"""

from __future__ import annotations

import logging
from functools import partial
from typing import Any, Callable, Hashable, Mapping, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.rendering.drawables import (
    Surface,
    read_pixels,
    surfaces_of,
    visible_surfaces,
)
from bullet_lab.simulation.world.description import Geometry, Texture, Visual
from bullet_lab.simulation.world.shapes import Box, Cylinder, Sphere
from bullet_lab.simulation.world.xml import Report, leaving_out

LOG = logging.getLogger(__name__)
# Segments of one piece of a polyline. A full piece is never sent again.
PIECE = 256
LINE_PIXELS = 2.5
# Solids of a size along their axes, in m.
SOLIDS: dict[str, Callable[[Vector], Geometry]] = {
    "box": Box,
    "cylinder": lambda size: Cylinder(0.5 * size[0], size[2]),
    "sphere": lambda size: Sphere(0.5 * size[0]),
}
UNIT = (1.0, 1.0, 1.0)
NO_LIGHT = np.zeros(3)
# Pixels of a side of a texture: larger ones are scaled down for the page.
MAX_TEXTURE_SIDE = 1024
ROUGHNESS = 0.9
# Exponent from a colour as a screen shows it to glTF's colour factor, which is linear in light.
GAMMA = 2.2

# A colour within [0, 255], as viser expects it.
RGB = Tuple[int, int, int]


def rgb(colour: Sequence[float]) -> RGB:
    """Return a colour's red, green and blue.

    >>> rgb((1.0, 0.5, 0.0, 1.0))
    (255, 128, 0)
    """
    red, green, blue = (round(255.0 * min(1.0, max(0.0, part))) for part in colour[:3])
    return red, green, blue


def wxyz(pose: Pose) -> tuple[float, float, float, float]:
    """Return the orientation of a pose as viser expects it."""
    x, y, z, w = pose.quaternion
    return w, x, y, z


class Nodes:
    """Nodes of the scene, by their names; each exists only while it has something to show."""

    def __init__(self, scene: Any):
        self._scene = scene
        # With their looks.
        self._nodes: dict[str, tuple[Any, Mapping[str, Any]]] = {}

    def put(
        self, name: str, make: Callable[..., Any], look: Mapping[str, Any], **varying: Any
    ) -> None:
        """Show a node with properties that vary; none if the first of them is empty.

        It is made anew if its look has changed.
        """
        node, before = self._nodes.get(name, (None, None))
        if not len(next(iter(varying.values()))):
            self.drop(name)
        elif before == look:
            for key, value in varying.items():
                setattr(node, key, value)
        else:
            # It replaces the node before it, which has the same name.
            self._nodes[name] = make(name, **varying, **look), look

    def put_points(self, name: str, look: Mapping[str, Any], **varying: ndarray) -> None:
        """Show points (n, 3) in m."""
        look = {"precision": "float32", **look}
        self.put(name, self._scene.add_point_cloud, look, **varying)

    def put_segments(self, name: str, ends: ndarray, colour: RGB) -> None:
        """Show segments (n, 2, 3) in m."""
        look = {"colors": colour, "thickness": LINE_PIXELS, "thickness_units": "screen"}
        self.put(name, self._scene.add_line_segments, look, points=ends)

    def put_line(self, name: str, points: ndarray, colour: RGB) -> None:
        """Show a line through points (n, 3) in m; when it grows, only its end is sent."""
        ends = segments(points)
        starts = range(0, len(ends), PIECE)
        for number, start in enumerate(starts):
            self.put_segments(f"{name}/{number}", ends[start : start + PIECE], colour)
        self._drop_line(name, len(starts))

    def put_label(self, name: str, text: str, position: Vector) -> None:
        """Show a text above a place."""
        look = {"anchor": "bottom-center"}
        self.put(name, self._scene.add_label, look, text=text, position=position)

    def drop(self, name: str) -> None:
        """Remove a node or a line, if there is one of this name."""
        if name in self._nodes:
            self._nodes.pop(name)[0].remove()
        self._drop_line(name)

    def clear(self) -> None:
        """Remove all nodes."""
        while self._nodes:
            self.drop(next(iter(self._nodes)))

    def _drop_line(self, name: str, number: int = 0) -> None:
        """Remove the pieces of a line from a number on."""
        while f"{name}/{number}" in self._nodes:
            self._nodes.pop(f"{name}/{number}")[0].remove()
            number += 1


def segments(points: ndarray) -> ndarray:
    """Return the segments (n - 1, 2, 3) between successive points (n, 3)."""
    return np.stack((points[:-1], points[1:]), axis=1)


class Copies:
    """Copies of one thing, each with a key, in one node of the scene.

    `make` makes the node from named arrays with a row for each copy.
    """

    def __init__(self, make: Callable[..., Any]):
        self._make = make
        # Properties of each copy.
        self._rows: dict[Hashable, dict[str, Any]] = {}
        self._changed = False
        self._node: Any = None
        # Number of copies in the node.
        self._count = 0

    def put(self, key: Hashable, pose: Pose, **others: Any) -> None:
        """Place a copy; `others` are properties besides position and orientation."""
        row = {"batched_positions": pose.position, "batched_wxyzs": wxyz(pose), **others}
        if self._rows.get(key) != row:
            self._rows[key] = row
            self._changed = True

    def drop(self, key: Hashable) -> None:
        """Remove a copy, if there is one with this key."""
        if self._rows.pop(key, None) is not None:
            self._changed = True

    def clear(self) -> None:
        """Remove all copies."""
        self._changed = True
        self._rows.clear()

    def flush(self) -> None:
        """Send what has changed."""
        if not self._changed:
            return
        self._changed = False
        rows = list(self._rows.values())
        arrays = {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}
        if self._node is not None and len(rows) == self._count:
            for name, array in arrays.items():
                setattr(self._node, name, array)
        elif rows:
            # It replaces the node before it, which has the same name.
            self._node = self._make(**arrays)
        elif self._node is not None:
            self._node.remove()
            self._node = None
        self._count = len(rows)


class CopyGroups:
    """Copies of several things, with a node each; a key is in one group at most.

    Args:
        scene: viser's.
        name: of the node above those of the groups.
    """

    def __init__(self, scene: Any, name: str):
        self._scene, self._name = scene, name
        self._groups: dict[Any, Copies] = {}

    def group(self, thing: Any) -> Copies:
        """Return the copies of a thing."""
        if thing not in self._groups:
            self._groups[thing] = Copies(self.maker(thing))
        return self._groups[thing]

    def maker(self, thing: Any) -> Callable[..., Any]:
        """Return a function that makes the node of a thing's copies from arrays."""
        raise NotImplementedError

    def put(self, thing: Any, key: Hashable, pose: Pose, **others: Any) -> None:
        """Place a copy of a thing, and remove those of others with this key."""
        for other, copies in self._groups.items():
            if other != thing:
                copies.drop(key)
        self.group(thing).put(key, pose, **others)

    def drop(self, key: Hashable) -> None:
        """Remove a copy, if there is one with this key."""
        for copies in self._groups.values():
            copies.drop(key)

    def clear(self) -> None:
        """Remove all copies."""
        for copies in self._groups.values():
            copies.clear()

    def flush(self) -> None:
        """Send what has changed."""
        for copies in self._groups.values():
            copies.flush()


class Solids(CopyGroups):
    """Boxes, cylinders and spheres of any size and colour."""

    def put_solid(
        self, key: Hashable, kind: str, pose: Pose, size: Vector, colour: Sequence[float]
    ) -> None:
        """Place a solid, named as in SOLIDS, whose extents along its axes are `size`, in m."""
        look = {"batched_scales": size, "batched_colors": rgb(colour)}
        if colour[3] < 1.0:
            look["batched_opacities"] = colour[3]
        self.put((kind, colour[3] < 1.0), key, pose, **look)

    def maker(self, thing: tuple[str, bool]) -> Callable[..., Any]:  # noqa: D102 - inherited
        kind, see_through = thing
        corners = surfaces_of(SOLIDS[kind](UNIT))[0].corners.reshape(-1, 3)
        faces = np.arange(len(corners)).reshape(-1, 3)
        name = f"{self._name}/{kind}{'_see_through' if see_through else ''}"
        return partial(self._scene.add_batched_meshes_simple, name, corners, faces, lod="off")


class VisualCopies(CopyGroups):
    """Copies of what visuals show together; `report` is called as by `glb_of`."""

    def __init__(self, scene: Any, name: str, report: Report):
        super().__init__(scene, name)
        self._report = report

    def maker(self, thing: tuple[Visual, ...]) -> Callable[..., Any]:  # noqa: D102 - inherited
        glb = glb_of(thing, self._report)
        if not glb:
            return lambda **_arrays: None
        name = f"{self._name}/{len(self._groups)}"
        return partial(self._scene.add_batched_glb, name, glb, lod="off")


def floor_point(origin: Sequence[float], direction: Sequence[float]) -> tuple[float, float] | None:
    """Return where a ray meets the floor, x and y in m; None if it does not.

    >>> floor_point((0.0, 0.0, 2.0), (1.0, 0.0, -1.0))
    (2.0, 0.0)
    """
    if direction[2] >= 0.0 or origin[2] <= 0.0:
        return None
    share = -origin[2] / direction[2]
    return origin[0] + share * direction[0], origin[1] + share * direction[1]


def glb_of(visuals: Sequence[Visual], report: Report = LOG.warning) -> bytes:
    """Return visuals of one frame as binary glTF; empty if nothing is visible.

    Visuals that cannot be read are left out, each with a call of `report`.
    """
    import trimesh

    meshes = []
    for visual in visuals:
        with leaving_out(report):
            surfaces = visible_surfaces(visual, NO_LIGHT, report)
            meshes += [_mesh(surface, report) for surface in surfaces]
    if not meshes:
        return b""
    return trimesh.Scene(meshes).export(file_type="glb", include_normals=True)


def _mesh(surface: Surface, report: Report) -> Any:
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    picture = None if surface.texture is None else _picture(surface.texture, report)
    *base, alpha = surface.colour
    count = surface.corners.size // 3
    see_through = alpha < 1.0 or (surface.texture is not None and surface.texture.blends)
    material = PBRMaterial(
        baseColorFactor=[*(min(1.0, part) ** GAMMA for part in base), alpha],
        baseColorTexture=picture,
        emissiveFactor=[min(1.0, max(0.0, part)) ** GAMMA for part in surface.glow],
        alphaMode="BLEND" if see_through else "OPAQUE",
        metallicFactor=0.0,
        roughnessFactor=ROUGHNESS,
    )
    uv = np.zeros((count, 2)) if surface.picture is None else surface.picture.reshape(-1, 2)
    return trimesh.Trimesh(
        vertices=surface.corners.reshape(-1, 3),
        faces=np.arange(count).reshape(-1, 3),
        vertex_normals=surface.normals.reshape(-1, 3),
        visual=TextureVisuals(uv=uv, material=material),
        process=False,
    )


def _picture(texture: Texture, report: Report) -> Any:
    import PIL.Image

    with leaving_out(report):
        image = PIL.Image.fromarray(read_pixels(texture))
        image.thumbnail((MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE))
        return image
