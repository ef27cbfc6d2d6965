"""Copies of a picture for several distances, for a renderer that takes the nearest texel.

From afar, TinyRenderer picks single texels out of a fine picture: it aliases, and an edge is
seen up to half a pixel beside its place. So each picture is smoothed in advance to what a pixel
covers, and the copy that fits the distance is shown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from io import BytesIO
from typing import Optional, Tuple

import cv2
import numpy as np

from bullet_lab.simulation.rendering.surfaces import Surface

# Texels across a pixel: an edge is off by half a texel at most.
TEXELS_PER_PIXEL = 4
# Standard deviation of the smoothing, in pixels.
SMOOTHING = 0.5
# From one copy to the next, a pixel covers so much more.
STEP = math.sqrt(2.0)
# Texels are cut up until they are this small, in m, or too many.
FINEST = 2e-4
MOST_TEXELS = 7_000_000
LEAST_SIDE = 8


@dataclass(frozen=True)
class Level:
    """A picture smoothed for pixels that cover `footprint` metres of the surface."""

    footprint: float
    image: bytes


def levels_of(surface: Surface) -> Tuple[Level, ...]:
    """Return copies of a surface's picture, for the closest look first."""
    from PIL import Image

    with Image.open(BytesIO(surface.texture)) as image:
        picture = np.array(image.convert("RGB"))
    texel = _metres_per_texel(surface, picture.shape[1], picture.shape[0])
    if texel is None:
        # All triangles show a single point of it.
        return (Level(1.0, surface.texture),)
    finer = 1
    while texel / finer > FINEST and picture.size // 3 * (2 * finer) ** 2 <= MOST_TEXELS:
        finer *= 2
    picture = cv2.resize(picture, None, fx=finer, fy=finer, interpolation=cv2.INTER_NEAREST)
    finest = TEXELS_PER_PIXEL * texel / finer
    levels = []
    footprint, halved = 1.0, 1.0
    while min(picture.shape[:2]) * halved / footprint >= LEAST_SIDE:
        if footprint >= 4.0 * halved:
            # Smoothing a coarser picture a little does the same as a fine one a lot.
            halves = tuple(max(1, side // 2) for side in picture.shape[1::-1])
            picture = cv2.resize(picture, halves, interpolation=cv2.INTER_AREA)
            halved *= 2.0
        levels.append(Level(footprint * finest, _shrunk(picture, footprint / halved)))
        footprint *= STEP
    return tuple(levels) or (Level(finest, surface.texture),)


def fitting(levels: Tuple[Level, ...], footprint: float) -> int:
    """Return which copy to show where a pixel covers so many metres."""
    steps = math.log(max(1e-12, footprint) / levels[0].footprint) / math.log(STEP)
    return min(len(levels) - 1, max(0, round(steps)))


def _metres_per_texel(surface: Surface, width: int, height: int) -> Optional[float]:
    """Return the side of a texel, from the areas of all triangles; None if it has none."""
    a, b, c = (surface.corners[:, k] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    (u1, v1), (u2, v2) = ((surface.picture[:, k] - surface.picture[:, 0]).T for k in (1, 2))
    texels = np.abs(u1 * v2 - u2 * v1).sum() * width * height
    return math.sqrt(area / texels) if texels > 0.0 and area > 0.0 else None


def _shrunk(picture: np.ndarray, shrink: float) -> bytes:
    # The picture repeats beyond its edges.
    sigma = SMOOTHING * TEXELS_PER_PIXEL * shrink
    margin = min(*picture.shape[:2], math.ceil(3.0 * sigma))
    padded = cv2.copyMakeBorder(picture, *[margin] * 4, cv2.BORDER_WRAP)
    smooth = cv2.GaussianBlur(padded, (0, 0), sigma)[margin:-margin, margin:-margin]
    size = tuple(max(1, round(side / shrink)) for side in picture.shape[1::-1])
    ok, data = cv2.imencode(
        ".png",
        cv2.cvtColor(cv2.resize(smooth, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2BGR),
        [cv2.IMWRITE_PNG_COMPRESSION, 1],
    )
    if not ok:
        raise ValueError("a picture cannot be written")
    return data.tobytes()
