"""What links look like, as binary glTF: triangles with their colours and pictures in one piece."""

from __future__ import annotations

import logging
from typing import Any, Callable, Sequence

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.drawables import read_pixels
from bullet_lab.simulation.rendering.surfaces import Surface, surfaces_of
from bullet_lab.simulation.world.description import Texture, Visual

LOG = logging.getLogger(__name__)
NO_LIGHT = np.zeros(3)
# Of a picture's sides, in pixels: what goes to the page.
LARGEST_SIDE = 1024
ROUGHNESS = 0.9
# Colours are as a screen shows them; glTF multiplies light, in proportion to which they are this.
GAMMA = 2.2


def glb_of(visuals: Sequence[Visual], report: Callable[[str], None] = LOG.warning) -> bytes:
    """Return what is seen of a link, in its frame, as binary glTF; empty where nothing is.

    What cannot be read is left out, and `report` is told, a line each.
    """
    import trimesh

    meshes = [_mesh(s, report) for visual in visuals for s in _surfaces(visual, report)]
    if not meshes:
        return b""
    return trimesh.Scene(meshes).export(file_type="glb", include_normals=True)


def _surfaces(visual: Visual, report: Callable[[str], None]) -> Sequence[Surface]:
    if visual.colour[3] <= 0.0:
        return []
    try:
        found = surfaces_of(visual.geometry, report)
    except LabError as error:
        report(str(error))
        return []
    return [surface.shown(visual, NO_LIGHT, report) for surface in found]


def _mesh(surface: Surface, report: Callable[[str], None]) -> Any:
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    picture = None if surface.texture is None else _picture(surface.texture, report)
    (*rgb, alpha), count = surface.colour, surface.corners.size // 3
    see_through = alpha < 1.0 or (surface.texture is not None and surface.texture.blends)
    material = PBRMaterial(
        baseColorFactor=[*(min(1.0, part) ** GAMMA for part in rgb), alpha],
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


def _picture(texture: Texture, report: Callable[[str], None]) -> Any:
    import PIL.Image

    try:
        image = PIL.Image.fromarray(read_pixels(texture))
    except LabError as error:
        report(str(error))
        return None
    image.thumbnail((LARGEST_SIDE, LARGEST_SIDE))
    return image
