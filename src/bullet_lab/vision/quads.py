"""Quadrilaterals to sub-pixels, and those within the cells of a marker."""

from __future__ import annotations

from functools import lru_cache
from typing import Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import homography, intersections
from bullet_lab.vision.images import Lens, sample
from bullet_lab.vision.outlines import outlines_within

# How far from the line to look for the edge and how close to sample, px; first roughly, then
# centred on what was found.
_LOOKS = ((2.5, 0.5), (1.5, 0.25))
# Places at which a side is crossed.
_CROSSINGS = 16
_LEAST_REACH = 1.25
# The border is black one cell deep, and white outside as deep.
_BORDER_PART = 0.9
# Sides are looked at without so much of them at either end.
_CROSS_TRIM = 0.08
_PLACED = np.linspace(_CROSS_TRIM, 1.0 - _CROSS_TRIM, _CROSSINGS)
# An edge that is seen at fewer of its places is none.
_LEAST_SEEN = 0.5
# Grey levels by which an edge has to rise.
_LEAST_RISE = 4.0


def refine_corners(image: np.ndarray, quads: np.ndarray, cells: int, lens: Lens) -> np.ndarray:
    """Return the corners of dark quadrilaterals where the lines along their sides meet.

    Each side is crossed at many places; where the grey level rises, on average, the edge is.
    The second look is centred on the line found before, and so is not biased by what lies on
    either side of it.

    Args:
        image: (h, w) grey levels.
        quads: (n, 4, 2) corners in px, clockwise, to about two pixels.
        cells: number of cells of the marker along an edge, with its border.
        lens: straightens edges.

    Returns:
        (n, 4, 2) corners u, v in ideal px; NaN where there are no four edges.
    """
    corners = lens.ideal(quads)
    for reach, step in _LOOKS:
        corners = _refine_once(image, corners, cells, lens, reach, step)
    return corners


def _refine_once(
    image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens, reach: float, step: float
) -> np.ndarray:
    refined = np.full(corners.shape, np.nan)
    edges = _following(corners) - corners
    lengths = np.hypot(edges[..., 0], edges[..., 1])
    usable = np.isfinite(lengths).all(axis=1) & (lengths.min(axis=1) >= 3.0)
    corners, edges, lengths = corners[usable], edges[usable], lengths[usable]
    along = edges / lengths[..., None]
    outward = np.stack((along[..., 1], -along[..., 0]), axis=-1)
    across = 0.5 * (lengths[:, _BEFORE] + lengths[:, _AFTER]) / cells
    reaches = np.minimum(reach, np.maximum(_LEAST_REACH, _BORDER_PART * across))
    steps = int(np.ceil(reach / step))
    offsets = np.arange(-steps, steps + 1) / steps * reaches[..., None]
    places = _PLACED
    base = corners[:, :, None] + edges[:, :, None] * places[:, None]
    points = base[:, :, :, None] + outward[:, :, None, None] * offsets[:, :, None, :, None]
    values = sample(image, lens.seen(points))
    rises = np.maximum(values[..., 1:] - values[..., :-1], 0.0)
    weights = rises.sum(axis=-1)
    middles = 0.5 * (offsets[..., 1:] + offsets[..., :-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        heights = (rises * middles[:, :, None]).sum(axis=-1) / weights
        seen = weights > np.maximum(_LEAST_RISE, 0.25 * weights.mean(axis=-1, keepdims=True))
        heights, weights = np.where(seen, heights, 0.0), np.where(seen, weights, 0.0)
        level, slope = _robust_lines(places, heights, weights)
    # The lines at the old corners, and the new ones where they meet.
    first = corners + outward * level[..., None]
    second = corners + edges + outward * (level + slope)[..., None]
    direction = second - first
    normals = np.stack((direction[..., 1], -direction[..., 0]), axis=-1)
    met = intersections(first, normals)
    met[seen.sum(axis=-1).min(axis=1) < _LEAST_SEEN * _CROSSINGS] = np.nan
    refined[usable] = met
    return refined


# The sides before and after each, and the corners after each.
_BEFORE, _AFTER = [3, 0, 1, 2], [1, 2, 3, 0]


def _following(corners: np.ndarray) -> np.ndarray:
    return corners[:, _AFTER]


def _robust_lines(places: np.ndarray, heights: np.ndarray, weights: np.ndarray):
    """Fit height = level + slope · place along the last axis, without outliers."""
    for _ in range(2):
        total = weights.sum(axis=-1)
        mean_place = (weights * places).sum(axis=-1) / total
        mean_height = (weights * heights).sum(axis=-1) / total
        centred = places - mean_place[..., None]
        spread = (weights * centred**2).sum(axis=-1)
        slope = (weights * centred * (heights - mean_height[..., None])).sum(axis=-1) / spread
        level = mean_height - slope * mean_place
        residuals = np.abs(heights - level[..., None] - slope[..., None] * places)
        typical = (weights * residuals).sum(axis=-1) / total
        weights = np.where(residuals <= 3.0 * typical[..., None] + 0.02, weights, 0.0)
    return level, slope


# Places at which a cell is looked at, along each edge, and the part of the edge that they cover.
_PLACES = 7
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
_UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def quads_in_cells(
    image: np.ndarray,
    corners: np.ndarray,
    pattern: np.ndarray,
    lens: Lens,
    min_side: float,
    known: Sequence[np.ndarray] = (),
) -> np.ndarray:
    """Return the outlines of what is dark and has four corners in the white cells of a marker.

    A smaller marker may be in one. Where it is small or the light is poor, thresholds made for
    the whole image miss it. Those of a single cell are told by the marker around it: its black
    and its white are known.

    Args:
        image: (h, w) grey levels.
        corners: (4, 2) of the marker, ideal px, clockwise from its top left.
        pattern: (n, n) its cells with the border, 1 for white.
        lens: where ideal pixels are seen.
        min_side: px, least mean length of the sides that are looked for.
        known: (4, 2) corners of other markers, ideal px; a cell with one in it has no second.

    Returns:
        (m, 4, 2) corners u, v in px of the image, clockwise.
    """
    cells = len(pattern)
    sides = corners[_AFTER] - corners
    if float(np.hypot(sides[:, 0], sides[:, 1]).min()) < cells * min_side:
        return np.empty((0, 4, 2))
    to_image = homography(corners)
    levels = sample(image, lens.seen(_mapped(_cell_samples(cells), to_image)))
    levels = levels.reshape(cells * cells, -1)
    white = (pattern > 0).ravel()
    black_level, white_level = _quantile(levels[~white], 0.5), _quantile(levels[white], 0.75)
    contrast = white_level - black_level
    if contrast < 1.0:
        return np.empty((0, 4, 2))
    dark = int(_DARK_PART * levels.shape[1])
    low = (white_level - np.partition(levels, dark, axis=1)[:, dark]) / contrast
    low[~white] = 0.0
    for other in known:
        column, row = (cells * _mapped(other.mean(axis=0)[None], cv2.invert(to_image)[1]))[0]
        if 0.0 <= column < cells and 0.0 <= row < cells:
            low[cells * int(row) + int(column)] = 0.0
    fullest = np.argsort(-low, kind="stable")[:_MOST_CELLS]
    found = [np.empty((0, 4, 2))]
    for index in fullest[low[fullest] > _DARKER].tolist():
        row, column = divmod(index, cells)
        outline = lens.seen(_mapped((_UNIT_SQUARE + (column, row)) / cells, to_image))
        found.append(_quads_within(image, outline, (black_level, white_level), min_side))
    return np.concatenate(found)


def _quantile(levels: np.ndarray, part: float) -> float:
    index = int(part * levels.size)
    return float(np.partition(levels, index, axis=None)[index])


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
    part = cv2.GaussianBlur(part.astype(np.float32), (0, 0), _SMOOTHING)
    part = cv2.resize(part, size, interpolation=cv2.INTER_CUBIC)
    # What is beyond the cell, its black neighbours, is not to run together with what is in it.
    inside = np.zeros(part.shape, dtype=np.uint8)
    polygon = scale * (outline - (left, top) + 0.5) - 0.5
    cv2.fillConvexPoly(inside, np.rint(polygon).astype(np.int32), 255)
    black, white = ends
    spread = np.clip((part - black) * (200.0 / (white - black)) + 25.0, 0.0, 255.0)
    grey = np.where(inside > 0, np.rint(spread), 255.0).astype(np.uint8)
    limits = (25.0 + 200.0 * level for level in _LEVELS)
    masks = (cv2.threshold(grey, limit, 255, cv2.THRESH_BINARY_INV)[1] for limit in limits)
    found = [outlines_within(dark, scale * min_side) for dark in masks]
    return (np.concatenate(found) + 0.5) / scale - 0.5 + (left, top)


def _mapped(points: np.ndarray, to_image: np.ndarray) -> np.ndarray:
    """Return where (n, 2) points of the unit square are, in ideal px."""
    there = points @ to_image[:, :2].T + to_image[:, 2]
    return there[:, :2] / there[:, 2:]


@lru_cache(maxsize=None)
def _cell_samples(cells: int) -> np.ndarray:
    """Return (n, 2) points of the unit square, cell by cell, row by row."""
    within = 0.5 + _COVERED * (np.arange(_PLACES) / (_PLACES - 1.0) - 0.5)
    row, column, v, u = np.meshgrid(
        np.arange(cells), np.arange(cells), within, within, indexing="ij"
    )
    return np.column_stack(((column + u).ravel(), (row + v).ravel())) / cells
