"""Pictures on surfaces as Panda3D has them: each read once, and kept while something shows it."""

from __future__ import annotations

import weakref
from io import BytesIO
from typing import Any, Tuple

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.graphics import panda3d
from bullet_lab.simulation.world.description import Texture
from bullet_lab.simulation.world.meshes import file_version, read_bytes

# Of a picture's sides, in pixels: what the graphics side takes; larger ones are made smaller.
LARGEST_SIDE = 8192


class TextureError(LabError):
    """A file that is no picture."""


class LoadedTexture:
    """A texture of Panda3D's, given back when nobody has this any more."""

    def __init__(self, texture: Any):
        self.texture = texture
        # Without this, the driver keeps it for as long as the context lives.
        weakref.finalize(self, texture.release_all)


class Textures:
    """The pictures that are shown."""

    def __init__(self) -> None:
        self._known: Any = weakref.WeakValueDictionary()

    def of(self, texture: Texture) -> LoadedTexture:
        """Return what a texture shows; raises LabError for a file that is no picture."""
        kind = (texture.blends, texture.repeats, texture.sharp)
        key = (texture.path, kind, file_version(texture))
        found = self._known.get(key)
        if found is None:
            found = self._known[key] = LoadedTexture(_panda_texture(texture))
        return found


def read_pixels(texture: Texture) -> np.ndarray:
    """Return a picture, not too large: (height, width, 3 or 4) uint8, RGB or RGBA if it blends."""
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
    # Panda3D has the lowest row first, and blue before green before red.
    made.set_ram_image(np.ascontiguousarray(pixels[::-1, :, _order(texture)]).tobytes())
    made.minfilter = core.SamplerState.FT_linear_mipmap_linear
    nearest, linear = core.SamplerState.FT_nearest, core.SamplerState.FT_linear
    made.magfilter = nearest if texture.sharp else linear
    if not texture.repeats:
        made.wrap_u = made.wrap_v = core.SamplerState.WM_clamp
    return made


def _order(texture: Texture) -> Tuple[int, ...]:
    return (2, 1, 0, 3) if texture.blends else (2, 1, 0)
