"""Nodes of the page's scene, updated in few messages.

viser sends each property that changes as a message, and none for an equal value. Things that move
together are therefore one node with an array for all of them. Poses are in the scene's one frame,
in m; colours are RGBA or RGB within [0, 1]. Not thread-safe.
"""

from __future__ import annotations

import logging
from typing import Any, Callable, Hashable, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.rendering.drawables import (
    Surface,
    read_pixels,
    surfaces_of,
    visible_surfaces,
)
from bullet_lab.simulation.world.description import Texture, Visual
from bullet_lab.simulation.world.shapes import Box, Cylinder, Sphere
from bullet_lab.simulation.world.xml import Report, leaving_out

LOG = logging.getLogger(__name__)
# Segments of one piece of a polyline. A full piece is never sent again.
PIECE = 256
LINE_PIXELS = 2.5
# Shapes of 1 m along each axis.
UNITS = {
    "box": Box((1.0, 1.0, 1.0)),
    "cylinder": Cylinder(0.5, 1.0),
    "sphere": Sphere(0.5),
}
NO_LIGHT = np.zeros(3)
# Pixels of a side of a texture: larger ones are scaled down for the page.
MAX_TEXTURE_SIDE = 1024
ROUGHNESS = 0.9
# Exponent from a colour as a screen shows it to glTF's colour factor, which is linear in light.
GAMMA = 2.2

Row = Tuple[Any, ...]


def rgb(colour: Sequence[float]) -> tuple[int, int, int]:
    """Return red, green and blue within [0, 255], as viser expects a colour.

    >>> rgb((1.0, 0.5, 0.0, 1.0))
    (255, 128, 0)
    """
    red, green, blue = (round(255.0 * min(1.0, max(0.0, part))) for part in colour[:3])
    return red, green, blue


def wxyz(pose: Pose) -> tuple[float, float, float, float]:
    """Return the orientation of a pose as viser expects it."""
    x, y, z, w = pose.quaternion
    return w, x, y, z


class Copies:
    """Copies of one thing, each with a key, in one node of the scene.

    Args:
        make: makes the node from named arrays with a row for each copy.
        names: of the arrays.
    """

    def __init__(self, make: Callable[[dict[str, ndarray]], Any], names: Sequence[str]):
        self._make = make
        self._names = names
        self._rows: dict[Hashable, Row] = {}
        self._shown: list[Hashable] = []
        self._changed = False
        self._node: Any = None

    def put(self, key: Hashable, pose: Pose, *others: Any) -> None:
        """Place a copy; `others` are the properties after position and orientation."""
        row = (pose.position, wxyz(pose), *others)
        if self._rows.get(key) != row:
            self._rows[key] = row
            self._changed = True

    def drop(self, key: Hashable) -> None:
        """Remove a copy, if there is one with this key."""
        if self._rows.pop(key, None) is not None:
            self._changed = True

    def flush(self) -> None:
        """Send what has changed."""
        if not self._changed:
            return
        self._changed = False
        keys = list(self._rows)
        columns = zip(*self._rows.values())
        arrays = {name: np.array(column) for name, column in zip(self._names, columns)}
        if keys and keys == self._shown and self._node is not None:
            for name, array in arrays.items():
                setattr(self._node, name, array)
        elif keys:
            # It replaces the node before it, which has the same name.
            self._node = self._make(arrays)
        elif self._node is not None:
            self._node.remove()
            self._node = None
        self._shown = keys


class CopyGroups:
    """Copies of several things; a key is in one group at most.

    Args:
        make: makes the copies of a group from its name and its number.
    """

    def __init__(self, make: Callable[[Any, int], Copies]):
        self._make = make
        self._groups: dict[Any, Copies] = {}

    def group(self, name: Any) -> Copies:
        """Return the copies of a group."""
        if name not in self._groups:
            self._groups[name] = self._make(name, len(self._groups))
        return self._groups[name]

    def put(self, name: Any, key: Hashable, pose: Pose, *others: Any) -> None:
        """Place a copy in a group, and remove it from the others."""
        for other, copies in self._groups.items():
            if other != name:
                copies.drop(key)
        self.group(name).put(key, pose, *others)

    def drop(self, key: Hashable) -> None:
        """Remove a copy, if there is one with this key."""
        for copies in self._groups.values():
            copies.drop(key)

    def flush(self) -> None:
        """Send what has changed."""
        for copies in self._groups.values():
            copies.flush()


class Solids(CopyGroups):
    """Boxes, cylinders and spheres of any size and colour."""

    def __init__(self, scene: Any, name: str):
        super().__init__(self._copies)
        self._scene = scene
        self._name = name

    def put_solid(self, key: Hashable, kind: str, pose: Pose, size: Vector, colour: Row) -> None:
        """Place a solid, named as in UNITS, whose extents along its axes are `size`, in m."""
        see_through = colour[3] < 1.0
        opacity = (colour[3],) if see_through else ()
        self.put((kind, see_through), key, pose, size, rgb(colour), *opacity)

    def _copies(self, group: tuple[str, bool], _: int) -> Copies:
        kind, see_through = group
        corners = surfaces_of(UNITS[kind])[0].corners.reshape(-1, 3)
        faces = np.arange(len(corners)).reshape(-1, 3)
        name = f"{self._name}/{kind}{'_see_through' if see_through else ''}"

        def make(arrays: dict[str, ndarray]) -> Any:
            arrays["batched_colors"] = arrays["batched_colors"].astype(np.uint8)
            return self._scene.add_batched_meshes_simple(name, corners, faces, lod="off", **arrays)

        names = ["batched_positions", "batched_wxyzs", "batched_scales", "batched_colors"]
        return Copies(make, names + ["batched_opacities"] * see_through)


class VisualCopies(CopyGroups):
    """Copies of what visuals show together; `report` is called as by `glb_of`."""

    def __init__(self, scene: Any, name: str, report: Report):
        super().__init__(self._copies)
        self._scene, self._name, self._report = scene, name, report

    def _copies(self, visuals: tuple[Visual, ...], number: int) -> Copies:
        glb, name = glb_of(visuals, self._report), f"{self._name}/{number}"

        def make(arrays: dict[str, ndarray]) -> Any:
            return self._scene.add_batched_glb(name, glb, lod="off", **arrays) if glb else None

        return Copies(make, ("batched_positions", "batched_wxyzs"))


class Polyline:
    """A line through points; when it grows, only its end is sent."""

    def __init__(self, scene: Any, name: str, colour: Sequence[float]):
        self._scene = scene
        self._name = name
        self._colour = rgb(colour)
        self._nodes: list[Any] = []

    def set(self, points: ndarray) -> None:
        """Draw the line through points, (n, 3) in m."""
        pieces = segments(np.asarray(points, np.float32))
        starts = range(0, len(pieces), PIECE)
        for number, start in enumerate(starts):
            piece = pieces[start : start + PIECE]
            if number < len(self._nodes):
                self._nodes[number].points = piece
            else:
                name = f"{self._name}/{number}"
                self._nodes.append(segments_node(self._scene, name, piece, self._colour))
        for node in self._nodes[len(starts) :]:
            node.remove()
        del self._nodes[len(starts) :]

    def remove(self) -> None:
        """Remove the line."""
        self.set(np.zeros((0, 3)))


def segments(points: ndarray) -> ndarray:
    """Return the segments (n - 1, 2, 3) between successive points (n, 3)."""
    return np.stack((points[:-1], points[1:]), axis=1)


def segments_node(scene: Any, name: str, ends: ndarray, colour: Sequence[int]) -> Any:
    """Make a node of segments (n, 2, 3) in m, of a colour within [0, 255]."""
    return scene.add_line_segments(
        name, ends, colour, thickness=LINE_PIXELS, thickness_units="screen"
    )


class PointsNode:
    """A node with an array of points that exists only while there are points.

    Args:
        make: makes the node from the points and other properties.
    """

    def __init__(self, make: Callable[..., Any]):
        self._make = make
        self._node: Any = None

    def set(self, points: Sequence, **properties: Any) -> None:
        """Show points; their number may change, and none removes the node."""
        points = np.asarray(points, np.float32)
        if not len(points):
            self.remove()
        elif self._node is None:
            self._node = self._make(points, **properties)
        else:
            for name, value in {"points": points, **properties}.items():
                setattr(self._node, name, value)

    def remove(self) -> None:
        """Show nothing."""
        if self._node is not None:
            self._node.remove()
            self._node = None


class Labels:
    """Texts in the scene, by keys."""

    def __init__(self, scene: Any, name: str):
        self._scene = scene
        self._name = name
        self._nodes: dict[Hashable, Any] = {}

    def put(self, key: Hashable, text: str, position: Vector) -> None:
        """Place a text."""
        if key in self._nodes:
            self._nodes[key].text, self._nodes[key].position = text, position
        else:
            name = f"{self._name}/{len(self._nodes)}_{key}"
            made = self._scene.add_label(name, text, position=position, anchor="bottom-center")
            self._nodes[key] = made

    def drop(self, key: Hashable) -> None:
        """Remove a text, if there is one with this key."""
        if key in self._nodes:
            self._nodes.pop(key).remove()

    def keep(self, keys: Sequence[Hashable]) -> None:
        """Remove all texts but these."""
        for key in set(self._nodes) - set(keys):
            self.drop(key)


def floor_point(
    origin: Sequence[float], direction: Sequence[float]
) -> tuple[float, float] | None:
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
