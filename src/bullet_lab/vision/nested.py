"""Looking into the white cells of a marker that was found: a smaller marker may be in one.

Where it is small or the light is poor, thresholds made for the whole image miss it. Those of a
single cell are told by the marker around it: its black and its white are known.
"""

from __future__ import annotations

from functools import lru_cache
from typing import List, Tuple

import cv2
import numpy as np

from bullet_lab.vision.decoding import homography
from bullet_lab.vision.quads import find_quads
from bullet_lab.vision.sampling import Lens, sample

# Places at which a cell is looked at, along each edge, and the part of the edge that they cover.
_PLACES = 10
_COVERED = 0.8
# A cell is not empty if this part of it is darker than white by this part of the contrast.
_DARK_PART = 0.2
_DARKER = 0.25
# So many cells are searched, those with most in them first.
_MOST_CELLS = 3
# A cell is enlarged to about so many px, at most so many times.
_ENLARGED, _LARGEST_SCALE = 160.0, 6
# Parts of the contrast up to which a pixel is dark.
_LEVELS = (0.4, 0.55, 0.7, 0.82)
_SMOOTHING = 0.8


def quads_in_cells(
    image: np.ndarray,
    corners: np.ndarray,
    pattern: np.ndarray,
    lens: Lens,
    min_side: float,
) -> np.ndarray:
    """Return the outlines of what is dark and has four corners in the white cells of a marker.

    Args:
        image: (h, w) grey levels, float32.
        corners: (4, 2) of the marker, ideal px, clockwise from its top left.
        pattern: (n, n) its cells with the border, 1 for white.
        lens: where ideal pixels are seen.
        min_side: px, least mean length of the sides that are looked for.

    Returns:
        (m, 4, 2) corners u, v in px of the image, clockwise.
    """
    cells = len(pattern)
    sides = np.roll(corners, -1, axis=0) - corners
    if float(np.hypot(sides[:, 0], sides[:, 1]).min()) < cells * min_side:
        return np.empty((0, 4, 2))
    to_image = homography(corners)
    levels = sample(image, lens.seen(_projected(_samples(cells), to_image)))
    levels = levels.reshape(cells, cells, -1)
    black = float(np.median(levels[pattern == 0]))
    white = float(np.quantile(levels[pattern == 1], 0.75))
    if white - black < 1.0:
        return np.empty((0, 4, 2))
    low = (white - np.quantile(levels, _DARK_PART, axis=2)) / (white - black)
    low[pattern == 0] = 0.0
    rows, columns = np.nonzero(low > _DARKER)
    fullest = np.argsort(-low[rows, columns], kind="stable")[:_MOST_CELLS]
    found: List[np.ndarray] = []
    for row, column in zip(rows[fullest], columns[fullest]):
        outline = lens.seen(_projected(_cell_outline(row, column, cells), to_image))
        found.append(_quads_within(image, outline, (black, white), min_side))
    return np.concatenate(found) if found else np.empty((0, 4, 2))


def _quads_within(
    image: np.ndarray, outline: np.ndarray, ends: Tuple[float, float], min_side: float
) -> np.ndarray:
    """Return quadrilaterals within an outline (4, 2), by thresholds between black and white."""
    height, width = image.shape
    left, top = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, (width, height))
    if right - left < min_side or bottom - top < min_side:
        return np.empty((0, 4, 2))
    part = image[top:bottom, left:right]
    scale = int(np.clip(_ENLARGED / max(part.shape), 1, _LARGEST_SCALE))
    size = (scale * part.shape[1], scale * part.shape[0])
    part = cv2.GaussianBlur(part, (0, 0), _SMOOTHING)
    part = cv2.resize(part, size, interpolation=cv2.INTER_CUBIC)
    # What is beyond the cell, its black neighbours, is not to run together with what is in it.
    inside = np.zeros(part.shape, dtype=np.uint8)
    polygon = scale * (outline - (left, top) + 0.5) - 0.5
    cv2.fillConvexPoly(inside, np.rint(polygon).astype(np.int32), 255)
    black, white = ends
    spread = np.clip((part - black) * (200.0 / (white - black)) + 25.0, 0.0, 255.0)
    grey = np.where(inside > 0, np.rint(spread), 255.0).astype(np.uint8)
    levels = [25.0 + 200.0 * level for level in _LEVELS]
    quads = find_quads(grey, (), 1.0, scale * min_side, levels)
    return (quads + 0.5) / scale - 0.5 + (left, top)


def _projected(points: np.ndarray, to_image: np.ndarray) -> np.ndarray:
    """Return where (n, 2) points of the unit square are, in ideal px."""
    there = points @ to_image[:, :2].T + to_image[:, 2]
    return there[:, :2] / there[:, 2:]


@lru_cache(maxsize=None)
def _samples(cells: int) -> np.ndarray:
    """Return (n, 2) points of the unit square, cell by cell, row by row."""
    within = 0.5 + _COVERED * (np.arange(_PLACES) / (_PLACES - 1.0) - 0.5)
    row, column, v, u = np.meshgrid(
        np.arange(cells), np.arange(cells), within, within, indexing="ij"
    )
    return np.column_stack(((column + u).ravel(), (row + v).ravel())) / cells


def _cell_outline(row: int, column: int, cells: int) -> np.ndarray:
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    return (corners + (column, row)) / cells
