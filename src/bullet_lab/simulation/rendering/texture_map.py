"""One map from places in the world to places in pictures, for EGL's fast way of drawing.

EGL spends half of a frame on a shadow map that nobody looks at, unless it projects pictures onto
the world: then it takes the place in a shape's picture not from the shape but from a matrix, the
same for all. That is enough where all pictures lie on parallel planes and stand still, as on a
dock: the matrix is that of the largest picture, and the others are redrawn to fit it.
"""

from __future__ import annotations

from io import BytesIO
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.simulation.rendering.surfaces import Surface

# Greatest misfit of a picture's coordinates, of its size.
TOLERANCE = 1e-5
LARGEST_SIDE = 4096
# Larger ones take long to load: they are not made finer than the original.
COMMON_SIDE = 2048
# Pixels of a redrawn picture per pixel of the original, along each side.
FINEST = 4.0


class TextureMap:
    """Maps points p of the world to (u, v): `matrix` (2, 4) times (x, y, z, 1)."""

    def __init__(self, matrix: np.ndarray):
        self.matrix = matrix

    @property
    def columns(self) -> Tuple[float, ...]:
        """The map as an OpenGL matrix, by columns."""
        full = np.zeros((4, 4))
        full[:2] = self.matrix
        full[3, 3] = 1.0
        return tuple(full.T.ravel())

    def image(self, surface: Surface) -> Optional[bytes]:
        """Return the picture of a surface, given in the world, as the map wants it.

        None where there is none: the surface lies across the map, or is too large for it.
        """
        here = _apply(self.matrix, surface.corners.reshape(-1, 3))
        fit = _fit(here, surface.picture.reshape(-1, 2))
        if fit is None:
            return None
        if np.abs(fit - np.eye(2, 3)).max() < TOLERANCE:
            return surface.texture
        low, high = here.min(axis=0), here.max(axis=0)
        if (high - low).max() > 1.0:
            return None
        return _redrawn(surface.texture, fit, 0.5 * (low + high) - 0.5)


def common_map(surfaces: Sequence[Surface]) -> Optional[TextureMap]:
    """Return a map that fits all these surfaces with pictures, given in the world, or None."""
    if not surfaces:
        return TextureMap(np.zeros((2, 4)))
    largest = max(surfaces, key=lambda s: np.ptp(s.corners.reshape(-1, 3), axis=0).max())
    matrix = _fit(largest.corners.reshape(-1, 3), largest.picture.reshape(-1, 2))
    if matrix is None:
        return None
    found = TextureMap(matrix)
    images: List[Optional[bytes]] = [found.image(surface) for surface in surfaces]
    return None if any(image is None for image in images) else found


def _apply(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:, :-1].T + matrix[:, -1]


def _fit(points: np.ndarray, places: np.ndarray) -> Optional[np.ndarray]:
    """Return the affine map (2, d + 1) from points to places in a picture, or None."""
    middle = points.mean(axis=0)
    # The least one: nothing along a plane's normal.
    slopes, *_ = np.linalg.lstsq(points - middle, places - places.mean(axis=0), rcond=1e-9)
    matrix = np.column_stack((slopes.T, places.mean(axis=0) - middle @ slopes))
    misfit = np.abs(_apply(matrix, points) - places).max()
    return matrix if misfit <= TOLERANCE * max(1.0, np.ptp(places)) else None


def _redrawn(texture: bytes, fit: np.ndarray, first: np.ndarray) -> Optional[bytes]:
    """Return a picture over one period of the map, from `first` on, by `fit` from the texture."""
    from PIL import Image

    with Image.open(BytesIO(texture)) as image:
        picture = np.array(image.convert("RGB"))
    height, width = picture.shape[:2]
    # More pixels than the texture has there, in rows of a length that EGL reads.
    sides = np.hypot(fit[0, :2] * width, fit[1, :2] * height)
    if not 1e-3 < sides.min() <= sides.max() <= LARGEST_SIDE:
        return None
    finer = max(1.0, min(FINEST, COMMON_SIDE / sides.max()))
    sides = np.ceil(finer * sides / 4).astype(int) * 4
    across = (np.arange(sides[0]) + 0.5) / sides[0]
    down = 1.0 - (np.arange(sides[1]) + 0.5) / sides[1]
    # The picture repeats: this is the repetition that begins at `first`.
    across, down = (axis + np.ceil(start - axis) for axis, start in zip((across, down), first))
    grid = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    u, v = np.mod(_apply(fit, grid), 1.0).T
    columns, rows = (
        places.astype(np.float32).reshape(sides[1], sides[0])
        for places in (u * width - 0.5, (1.0 - v) * height - 0.5)
    )
    redrawn = cv2.remap(
        picture[:, :, ::-1], columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    ok, data = cv2.imencode(".png", redrawn, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return data.tobytes() if ok else None
