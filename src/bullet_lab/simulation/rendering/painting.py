"""Writing the lit copy of a link as files that PyBullet's renderers draw as they are.

Each corner's brightness is written into its picture coordinates: they point into a grey ramp
that is drawn instead of light. Shapes with pictures of their own are cut up by brightness, and
each part gets it in its colour. The renderers' own light has to be constant for that:
TinyRenderer's is by its coefficients; EGL's, 0.5 + 0.5 i with i in [0, 1] by the angle between
normal and light, is 0.5 for normals straight away from the light, which also have no highlight
and no shadow. So that is what all normals are set to, and colours are doubled.
"""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Iterable, List, Tuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from bullet_lab.simulation.description import Colour, Visual
from bullet_lab.simulation.pose import Pose, Vector
from bullet_lab.simulation.rendering.choice import EGL, TINY
from bullet_lab.simulation.rendering.engine import RenderEngine
from bullet_lab.simulation.rendering.lighting import Lighting
from bullet_lab.simulation.rendering.prefilter import Level, levels_of
from bullet_lab.simulation.rendering.surfaces import Surface, surfaces_of

RAMP = 256
# EGL's brightness at normals away from its light, and halfway for those that are kept.
EGL_FLAT, EGL_MEAN = 0.5, 0.75
# Steps of brightness that parts with a picture are told apart by.
SHADES = 128
# Triangles under lamps are cut until an edge is no longer than this, in m, or so many times.
FINEST_EDGE = 0.25
MOST_CUTS = 5

STANDING, TURNING, TUMBLING = "standing", "turning", "tumbling"

_Part = Tuple[Surface, Colour]


@dataclass(frozen=True)
class Painted:
    """A part of a link as URDF files, one for each fineness of its picture.

    Attributes:
        files: for the closest look first; one only where there is no picture, or the renderer
            smooths pictures by itself.
        levels: finenesses of the files; empty if there is one only.
        box: least and greatest corner of the part in the link's frame, (2, 3).
    """

    files: Tuple[Path, ...]
    levels: Tuple[Level, ...]
    box: np.ndarray


def paint_link(
    engine: RenderEngine, visuals: Iterable[Visual], pose: Pose, lighting: Lighting, motion: str
) -> List[Painted]:
    """Write a link's shapes as files.

    Args:
        engine: whose folder the files go to, and whose formula of light counts.
        visuals: the shapes, in the link's frame.
        pose: of the link in the world now.
        lighting: of the world.
        motion: "standing" things are lit where they are; "turning" ones may have any heading,
            "tumbling" ones, such as wheels, any attitude.

    Raises:
        LabError: a mesh or a texture is not usable.
    """
    plain: List[_Part] = []
    pictures: List[_Part] = []
    for visual in visuals:
        for surface in surfaces_of(visual.geometry):
            placed = surface.moved(visual.pose)
            for part, colour in _light(placed, visual.colour, pose, lighting, motion):
                apart = part.texture is not None and engine.renderer == TINY
                (pictures if apart else plain).append((part, colour))
    painter = _Painter(engine, pose.inverse().rotate((0.0, 0.0, -1.0)), motion)
    painted = [Painted((painter.write(plain),), (), _box(plain))] if plain else []
    for part, colour in pictures:
        levels = levels_of(part)
        copies = [[(replace(part, texture=level.image), colour)] for level in levels]
        painted.append(Painted(tuple(map(painter.write, copies)), levels, _box(copies[0])))
    return painted


def _box(parts: List[_Part]) -> np.ndarray:
    corners = np.concatenate([part.corners.reshape(-1, 3) for part, _ in parts])
    return np.stack((corners.min(axis=0), corners.max(axis=0)))


def _light(
    surface: Surface, colour: Colour, pose: Pose, lighting: Lighting, motion: str
) -> List[_Part]:
    """Return the parts of a surface, each with its colour and coordinates in its texture."""
    if lighting.local and motion == STANDING:
        surface = _cut_up(surface)
    world = surface.moved(pose)
    if motion == STANDING:
        shades = lighting.shade(world.corners, world.normals)
    elif motion == TURNING:
        shades = lighting.mean_shade(world.corners, world.normals)
    else:
        every_way = np.broadcast_to(_ALL_WAYS, (1, *_ALL_WAYS.shape))
        points = np.broadcast_to(np.asarray(pose.position), every_way.shape)
        mean = float(lighting.shade(points, every_way).mean())
        shades = np.full(world.corners.shape[:2], mean)
    shades = shades / lighting.peak
    if surface.texture is None:
        # The ramp goes up and down again: coarse copies of it wrap around without a seam.
        along = (np.clip(shades, 0.0, 1.0) * (RAMP - 1) + 0.5) / (2 * RAMP)
        picture = np.stack((along, np.full_like(along, 0.5)), axis=-1)
        return [(Surface(surface.corners, surface.normals, picture), colour)]
    steps = np.round(shades.mean(axis=1) * SHADES).astype(int)
    return [_part_of(surface, steps == step, colour, step / SHADES) for step in np.unique(steps)]


def _part_of(surface: Surface, chosen: np.ndarray, colour: Colour, shade: float) -> _Part:
    part = Surface(
        surface.corners[chosen], surface.normals[chosen], surface.picture[chosen], surface.texture
    )
    return part, tuple(shade * value for value in colour[:3]) + (colour[3],)


def _cut_up(surface: Surface) -> Surface:
    """Cut triangles into four until their edges are short, for light that changes over them."""
    arrays = [surface.corners, surface.normals, surface.picture]
    for _ in range(MOST_CUTS):
        sides = np.linalg.norm(arrays[0] - np.roll(arrays[0], 1, axis=1), axis=-1)
        if sides.max() <= FINEST_EDGE:
            break
        arrays = [None if array is None else _quarter(array) for array in arrays]
    return Surface(*arrays, surface.texture)


def _quarter(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


class _Painter:
    """Writes parts of one link; `down` is the world's in the link's frame."""

    def __init__(self, engine: RenderEngine, down: Vector, motion: str):
        self._engine = engine
        self._down = np.array(down)
        self._flat = motion != TUMBLING

    def write(self, parts: List[_Part]) -> Path:
        """Return a URDF file with all parts."""
        robot = Element("robot", name="drawn")
        link = SubElement(robot, "link", name="link")
        _add_no_inertia(link)
        for part, colour in parts:
            self._add(link, part, colour)
        text = tostring(robot, encoding="unicode").encode()
        return self._engine.write(f"{_digest(text)}.urdf", text)

    def _add(self, link: Element, part: Surface, colour: Colour) -> None:
        if self._engine.renderer == EGL:
            gain = 1.0 / (EGL_FLAT if self._flat else EGL_MEAN)
            colour = tuple(gain * value for value in colour[:3]) + (colour[3],)
        visual = SubElement(link, "visual")
        mesh = self._mesh(part)
        SubElement(SubElement(visual, "geometry"), "mesh", filename=str(mesh))
        text = " ".join(f"{value:.6g}" for value in colour)
        SubElement(SubElement(visual, "material", name=text), "color", rgba=text)

    def _mesh(self, part: Surface) -> Path:
        normals = part.normals
        if self._flat:
            normals = np.broadcast_to(self._down, normals.shape)
        write = self._engine.write
        image = _ramp() if part.texture is None else part.texture
        picture = write(f"{_digest(image)}.png", image)
        material = f"newmtl m\nKd 1 1 1\nmap_Kd {picture.name}\n".encode()
        library = write(f"{_digest(material)}.mtl", material)
        obj = _obj(part, normals, library.name)
        return write(f"{_digest(obj)}.obj", obj)


def _obj(part: Surface, normals: np.ndarray, library: str) -> bytes:
    points, point_index = _distinct(part.corners)
    places, place_index = _distinct(part.picture)
    turns, turn_index = _distinct(np.ascontiguousarray(normals))
    lines = [f"mtllib {library}"]
    lines += ["v {:.7g} {:.7g} {:.7g}".format(*row) for row in points.tolist()]
    lines += ["vt {:.7g} {:.7g}".format(*row) for row in places.tolist()]
    lines += ["vn {:.7g} {:.7g} {:.7g}".format(*row) for row in turns.tolist()]
    lines.append("usemtl m")
    corners = np.stack((point_index, place_index, turn_index), axis=-1) + 1
    for face in corners.tolist():
        lines.append("f " + " ".join("{}/{}/{}".format(*corner) for corner in face))
    return ("\n".join(lines) + "\n").encode()


def _distinct(corners: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the distinct rows and (n, 3) indices into them."""
    rows, index = np.unique(corners.reshape(-1, corners.shape[-1]), axis=0, return_inverse=True)
    return rows, index.reshape(-1, 3)


@functools.lru_cache(maxsize=None)
def _ramp() -> bytes:
    from PIL import Image

    up = np.arange(RAMP, dtype=np.uint8)
    out = BytesIO()
    row = np.concatenate((up, up[::-1]))
    Image.fromarray(np.repeat(row[None, :, None], 3, axis=2).repeat(4, axis=0)).save(out, "PNG")
    return out.getvalue()


def _add_no_inertia(link: Element) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "mass", value="0")
    moments = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
    SubElement(inertial, "inertia", moments)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _directions() -> np.ndarray:
    """Return directions spread evenly over all ways (a spiral from pole to pole)."""
    count = 64
    heights = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angles = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.sqrt(1.0 - heights**2)
    return np.column_stack((flat * np.cos(angles), flat * np.sin(angles), heights))


_ALL_WAYS = _directions()
