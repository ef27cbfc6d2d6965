"""Quadrilaterals: corners to sub-pixels, and the search for markers in the cells of a marker."""

from __future__ import annotations

from functools import lru_cache
from typing import Sequence

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.vision.candidates import FIRST_TRIM, outlined_quads, outlines_of, sound_quads
from bullet_lab.vision.images import (
    NEXT,
    PREVIOUS,
    UNIT_SQUARE,
    Picture,
    homography,
    intersections,
    lengths_of,
    mapped,
    right_of,
)

# Reach to either side of a line within which its edge is looked for, and sampling step, px: first
# coarsely, then centred on the line found.
_ROUNDS = ((2.5, 0.5), (1.5, 0.25))
_LEAST_REACH = 1.25
# Most reach, as a share of a cell: the border is black one cell deep, and white outside as deep.
_BORDER_PART = 0.9
# Shortest side that is refined, px.
_LEAST_SIDE = 3.0
# Places at which a side is crossed, and share of the side at either end that is left out.
_CROSSINGS = 16
_TRIM = 0.08
_PLACES = np.linspace(_TRIM, 1.0 - _TRIM, _CROSSINGS)
# Least share of the places at which an edge must be seen.
_LEAST_SEEN = 0.5
# Grey levels by which an edge must rise, and the same as a share of the mean rise.
_LEAST_RISE = 4.0
_LEAST_OF_MEAN = 0.25
# An edge is no outlier within so many mean distances from the line, and px more.
_OUTLYING = 3.0
_LEAST_OUTLYING = 0.02


def refine_corners(picture: Picture, quads: ndarray, cells: int) -> ndarray:
    """Return the corners of dark quadrilaterals where the lines along their sides meet.

    Each side is crossed at many places; the edge is where the grey level rises, on average. The
    second round is centred on the line found in the first, so that what lies on either side of the
    line does not bias it.

    Args:
        picture: the image.
        quads: (n, 4, 2) corners in px of the image, clockwise, to about two pixels.
        cells: number of cells of the marker along an edge, with its border.

    Returns:
        (n, 4, 2) corners u, v in ideal px; NaN where there are no four edges.
    """
    corners = picture.ideal(quads)
    for reach, step in _ROUNDS:
        corners = _refine_once(picture, corners, cells, reach, step)
    return corners


def _refine_once(
    picture: Picture, corners: ndarray, cells: int, reach: float, step: float
) -> ndarray:
    refined = np.full(corners.shape, np.nan)
    edges = corners[:, NEXT] - corners
    lengths = lengths_of(edges)
    usable = np.isfinite(lengths).all(axis=1) & (lengths.min(axis=1) >= _LEAST_SIDE)
    corners, edges, lengths = corners[usable], edges[usable], lengths[usable]
    outward = right_of(edges) / lengths[..., None]
    cell = 0.5 * (lengths[:, PREVIOUS] + lengths[:, NEXT]) / cells
    reaches = np.minimum(reach, np.maximum(_LEAST_REACH, _BORDER_PART * cell))
    steps = int(np.ceil(reach / step))
    offsets = np.arange(-steps, steps + 1) / steps * reaches[..., None]
    base = corners[:, :, None] + edges[:, :, None] * _PLACES[:, None]
    points = base[:, :, :, None] + outward[:, :, None, None] * offsets[:, :, None, :, None]
    heights, weights = _edge_heights(picture.at(points), offsets)
    level, slope = _robust_lines(heights, weights)
    # Two points of each line: beside the old corners.
    first = corners + outward * level[..., None]
    second = corners + edges + outward * (level + slope)[..., None]
    met = intersections(first, right_of(second - first))
    seen = (weights > 0.0).sum(axis=-1)
    met[seen.min(axis=1) < _LEAST_SEEN * _CROSSINGS] = np.nan
    refined[usable] = met
    return refined


def _edge_heights(levels: ndarray, offsets: ndarray) -> tuple[ndarray, ndarray]:
    """Return the mean offset of the rises at each crossing, and its weight; 0 without an edge.

    Grey levels are (n, 4, places, offsets), offsets (n, 4, offsets) px.
    """
    rises = np.maximum(levels[..., 1:] - levels[..., :-1], 0.0)
    weights = rises.sum(axis=-1)
    middles = 0.5 * (offsets[..., 1:] + offsets[..., :-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        heights = (rises * middles[:, :, None]).sum(axis=-1) / weights
    mean = weights.mean(axis=-1, keepdims=True)
    seen = weights > np.maximum(_LEAST_RISE, _LEAST_OF_MEAN * mean)
    return np.where(seen, heights, 0.0), np.where(seen, weights, 0.0)


def _robust_lines(heights: ndarray, weights: ndarray) -> tuple[ndarray, ndarray]:
    """Fit height = level + slope · place along the last axis, the second time without outliers.

    Without an edge both are NaN.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(2):
            total = weights.sum(axis=-1)
            mean_place = (weights * _PLACES).sum(axis=-1) / total
            mean_height = (weights * heights).sum(axis=-1) / total
            centred = _PLACES - mean_place[..., None]
            spread = (weights * centred**2).sum(axis=-1)
            product = weights * centred * (heights - mean_height[..., None])
            slope = product.sum(axis=-1) / spread
            level = mean_height - slope * mean_place
            residuals = np.abs(heights - level[..., None] - slope[..., None] * _PLACES)
            typical = (weights * residuals).sum(axis=-1, keepdims=True) / total[..., None]
            own = residuals <= _OUTLYING * typical + _LEAST_OUTLYING
            weights = np.where(own, weights, 0.0)
    return level, slope


# Samples of a cell along each edge, and the part of the edge that they cover.
_SAMPLES = 7
_COVERED = 0.8
# A cell is not empty if this share of its samples is darker than white by this part of the
# contrast.
_DARK_SHARE = 0.2
_DARKER = 0.25
# Shares of the black and of the white samples that are darker than the levels of black and white.
_BLACK_SHARE = 0.5
_WHITE_SHARE = 0.75
# At most so many cells are searched, the darkest first.
_MOST_CELLS = 3
# A cell is enlarged to about so many px, at most by this factor.
_ENLARGED = 160.0
_LARGEST_SCALE = 6
# Thresholds, as parts of the contrast, and the grey levels of black and of the contrast then.
_THRESHOLDS = (0.4, 0.55, 0.7, 0.82)
_BLACK_LEVEL = 25.0
_CONTRAST = 200.0
# Standard deviation of the smoothing before, px.
_SMOOTHING = 0.8
_NONE = np.empty((0, 4, 2))


def quads_in_cells(
    picture: Picture,
    corners: ndarray,
    pattern: ndarray,
    min_side: float,
    known: Sequence[ndarray] = (),
) -> ndarray:
    """Return the dark quadrilaterals in the white cells of a marker, where a smaller one may be.

    Where it is small or the light is poor, thresholds of the whole image miss it. The marker around
    a cell shows how bright black and white are there.

    Args:
        picture: the image.
        corners: (4, 2) of the marker, ideal px, clockwise from its top left.
        pattern: (n, n) its cells with the border, 1 for white.
        min_side: px, least mean length of the sides that are looked for.
        known: (4, 2) corners of other markers, ideal px; a cell with one in it is left out.

    Returns:
        (m, 4, 2) corners u, v in px of the image, clockwise.
    """
    cells = len(pattern)
    if lengths_of(corners[NEXT] - corners).min() < cells * min_side:
        return _NONE
    to_image = homography(corners)
    levels = picture.at(mapped(_cell_samples(cells), to_image)).reshape(cells * cells, -1)
    is_white = (pattern > 0).ravel()
    black = _quantile(levels[~is_white], _BLACK_SHARE)
    white = _quantile(levels[is_white], _WHITE_SHARE)
    contrast = white - black
    if contrast < 1.0:
        return _NONE
    dark = int(_DARK_SHARE * levels.shape[1])
    darkness = (white - np.partition(levels, dark, axis=1)[:, dark]) / contrast
    darkness[~is_white] = 0.0
    for other in known:
        column, row = (cells * mapped(other.mean(axis=0)[None], cv2.invert(to_image)[1]))[0]
        if 0.0 <= column < cells and 0.0 <= row < cells:
            darkness[cells * int(row) + int(column)] = 0.0
    darkest = np.argsort(-darkness, kind="stable")[:_MOST_CELLS]
    found = [_NONE]
    for index in darkest[darkness[darkest] > _DARKER].tolist():
        row, column = divmod(index, cells)
        outline = picture.seen(mapped((UNIT_SQUARE + (column, row)) / cells, to_image))
        found.append(_quads_within(picture.levels, outline, black, contrast, min_side))
    return np.concatenate(found)


def _quantile(levels: ndarray, part: float) -> float:
    index = int(part * levels.size)
    return float(np.partition(levels, index, axis=None)[index])


def _quads_within(
    image: ndarray, outline: ndarray, black: float, contrast: float, min_side: float
) -> ndarray:
    """Return the dark quadrilaterals within an outline (4, 2)."""
    height, width = image.shape
    left, top = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, (width, height))
    if min(right - left, bottom - top) < min_side:
        return _NONE
    cell = image[top:bottom, left:right].astype(np.float32)
    scale = int(np.clip(_ENLARGED / max(cell.shape), 1, _LARGEST_SCALE))
    cell = cv2.GaussianBlur(cell, (0, 0), _SMOOTHING)
    cell = cv2.resize(cell, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    # Beyond the cell all is white, so that black neighbours do not join what is in it.
    inside = np.zeros(cell.shape, dtype=np.uint8)
    polygon = scale * (outline - (left, top) + 0.5) - 0.5
    cv2.fillConvexPoly(inside, np.rint(polygon).astype(np.int32), 255)
    spread = np.clip((cell - black) * (_CONTRAST / contrast) + _BLACK_LEVEL, 0.0, 255.0)
    grey = np.where(inside > 0, np.rint(spread), 255.0).astype(np.uint8)
    found = []
    for threshold in _THRESHOLDS:
        limit = _BLACK_LEVEL + _CONTRAST * threshold
        _, dark = cv2.threshold(grey, limit, 255, cv2.THRESH_BINARY_INV)
        contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        # OpenCV orients the contours of dark pieces and those of holes in them oppositely.
        outer = [one for one in contours if cv2.contourArea(one, oriented=True) < 0.0]
        outlines = outlines_of(outer, scale * min_side)
        found.append(sound_quads(outlined_quads(outlines, FIRST_TRIM)))
    return (np.concatenate(found) + 0.5) / scale - 0.5 + (left, top)


@lru_cache(maxsize=None)
def _cell_samples(cells: int) -> ndarray:
    """Return (n, 2) points of the unit square, cell by cell, row by row."""
    within = 0.5 + _COVERED * (np.arange(_SAMPLES) / (_SAMPLES - 1.0) - 0.5)
    each = np.arange(cells)
    row, column, down, right = np.meshgrid(each, each, within, within, indexing="ij")
    return np.column_stack(((column + right).ravel(), (row + down).ravel())) / cells
