"""Writing lit parts of a link as files that PyBullet loads."""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import List, Tuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.choice import TINY
from bullet_lab.simulation.rendering.engine import RenderEngine
from bullet_lab.simulation.rendering.prefilter import Level, levels_of
from bullet_lab.simulation.rendering.shading import RAMP, Part
from bullet_lab.simulation.rendering.surfaces import Surface


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


def paint(engine: RenderEngine, parts: List[Part], pose: Pose) -> List[Painted]:
    """Write lit parts of a link, whose pose in the world is given, as files."""
    apart = [p for p in parts if p.surface.texture is not None and engine.renderer == TINY]
    plain = [p for p in parts if not any(p is other for other in apart)]
    painter = _Painter(engine, pose)
    painted = [Painted((painter.write(plain),), (), _box(plain))] if plain else []
    for part in apart:
        levels = levels_of(part.surface)
        copies = [
            [replace(part, surface=replace(part.surface, texture=level.image))] for level in levels
        ]
        painted.append(Painted(tuple(map(painter.write, copies)), levels, _box([part])))
    return painted


def _box(parts: List[Part]) -> np.ndarray:
    corners = np.concatenate([part.surface.corners.reshape(-1, 3) for part in parts])
    return np.stack((corners.min(axis=0), corners.max(axis=0)))


class _Painter:
    """Writes parts of one link at a pose in the world."""

    def __init__(self, engine: RenderEngine, pose: Pose):
        self._engine = engine
        # EGL's light comes from above.
        local = pose.inverse()
        self._light = np.array(local.rotate((0.0, 0.0, 1.0)))
        self._level = np.array(local.rotate((1.0, 0.0, 0.0)))

    def write(self, parts: List[Part]) -> Path:
        """Return a URDF file with all parts."""
        robot = Element("robot", name="drawn")
        link = SubElement(robot, "link", name="link")
        _add_no_inertia(link)
        for part in parts:
            self._add(link, part)
        text = tostring(robot, encoding="unicode").encode()
        return self._engine.write(f"{_digest(text)}.urdf", text)

    def _add(self, link: Element, part: Part) -> None:
        visual = SubElement(link, "visual")
        mesh = self._mesh(part)
        SubElement(SubElement(visual, "geometry"), "mesh", filename=str(mesh))
        text = " ".join(f"{value:.6g}" for value in part.colour)
        SubElement(SubElement(visual, "material", name=text), "color", rgba=text)

    def _mesh(self, part: Part) -> Path:
        surface, normals = part.surface, part.surface.normals
        if part.cosines is not None:
            up = part.cosines[..., None]
            normals = up * self._light + np.sqrt(1.0 - up * up) * self._level
        head = b""
        if surface.picture is not None:
            image = _ramp() if surface.texture is None else surface.texture
            picture = self._engine.write(f"{_digest(image)}.png", image)
            material = f"newmtl m\nKd 1 1 1\nmap_Kd {picture.name}\n".encode()
            library = self._engine.write(f"{_digest(material)}.mtl", material)
            head = f"mtllib {library.name}\nusemtl m\n".encode()
        obj = head + _obj(surface, normals)
        return self._engine.write(f"{_digest(obj)}.obj", obj)


def _obj(surface: Surface, normals: np.ndarray) -> bytes:
    picture = surface.picture
    if picture is None:
        picture = np.zeros((*surface.corners.shape[:2], 2))
    points, point_index = _distinct(surface.corners)
    places, place_index = _distinct(picture)
    turns, turn_index = _distinct(np.ascontiguousarray(normals))
    lines = ["v {:.7g} {:.7g} {:.7g}".format(*row) for row in points.tolist()]
    lines += ["vt {:.7g} {:.7g}".format(*row) for row in places.tolist()]
    lines += ["vn {:.7g} {:.7g} {:.7g}".format(*row) for row in turns.tolist()]
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
