"""The distractor of the report's figure 8: a sheet strewn with dots."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from bullet_lab.markers.images import MarkerError

# Measured in figure 8, whose sheet, 309 pixels wide, is taken to be 1 m wide: 1187 dots on
# 309 x 259 pixels, 5.5 pixels of ink each, one in twenty nearer than 3.9 pixels to the next.
DOTS_PER_SQUARE_METRE = 1420.0
DOT_RADIUS = 0.0043
CLOSEST = 0.0126
TRIES_PER_DOT = 100

Rectangle = Tuple[float, float, float, float]


def scatter_dots(
    width: float, height: float, keep_out: Rectangle, rng: np.random.Generator
) -> np.ndarray:
    """Return the centres of dots on a sheet, as dense as those of figure 8.

    Args:
        width: of the sheet, m.
        height: of the sheet, m.
        keep_out: left, top, right and bottom of the part that no dot may touch, m.
        rng: source of the places.

    Returns:
        (n, 2) array in metres from the upper left corner, to the right and downwards. All dots
        are whole.

    Raises:
        MarkerError: so many dots do not fit.
    """
    left, top, right, bottom = keep_out
    free_area = width * height - (right - left) * (bottom - top)
    wanted = int(round(DOTS_PER_SQUARE_METRE * free_area))
    margin = np.array([DOT_RADIUS, DOT_RADIUS])
    kept = np.empty((wanted, 2))
    count = 0
    for _ in range(TRIES_PER_DOT * wanted):
        if count == wanted:
            return kept
        dot = rng.uniform(margin, np.array([width, height]) - margin)
        outside = np.maximum(np.array([left, top]) - dot, dot - np.array([right, bottom]))
        clear = np.linalg.norm(np.maximum(outside, 0.0)) > DOT_RADIUS and outside.max() > 0.0
        near = np.linalg.norm(kept[:count] - dot, axis=1) < CLOSEST
        if clear and not near.any():
            kept[count] = dot
            count += 1
    raise MarkerError(f"no room for {wanted} dots on {width:g} x {height:g} m")


def draw_dots(canvas: np.ndarray, centres: np.ndarray, metres_per_pixel: float) -> None:
    """Draw black dots with soft edges onto a picture, (h, w) of uint8, in place."""
    radius = DOT_RADIUS / metres_per_pixel
    reach = int(np.ceil(radius + 1.0))
    for x, y in np.asarray(centres) / metres_per_pixel - 0.5:
        rows = _within(y, reach, canvas.shape[0])
        columns = _within(x, reach, canvas.shape[1])
        distance = np.hypot(*np.meshgrid(columns - x, rows - y))
        ink = np.clip(radius + 0.5 - distance, 0.0, 1.0)
        patch = canvas[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        patch[...] = np.rint(patch * (1.0 - ink))


def _within(centre: float, reach: int, size: int) -> np.ndarray:
    """Return the pixels about a centre that are in a picture."""
    middle = int(round(centre))
    return np.arange(max(middle - reach, 0), min(middle + reach + 1, size))
