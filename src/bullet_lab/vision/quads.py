"""Dark convex quadrilaterals, which may be markers: in an image, to sub-pixels, in a marker."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import islice
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.vision.algebra import homography, intersections
from bullet_lab.vision.images import Lens, sample

# Part of its outline's length by which a quadrilateral may differ from a contour.
_OUTLINE_TOLERANCE = 0.035
# Corners nearer than this part of the outline's length are one.
_MIN_EDGE = 0.05
# A side's line is fitted to its contour without so much at either end.
_FIT_TRIM = 0.15
# The four orders of corners.
_TURNS = np.array([[(corner - turn) % 4 for corner in range(4)] for turn in range(4)])


def find_quads(
    grey: np.ndarray,
    windows: Sequence[int],
    contrast: float,
    min_side: float,
    levels: Sequence[float] = (),
    most: int = 1000,
) -> np.ndarray:
    """Return the outlines of dark quadrilaterals, to about a pixel.

    Args:
        grey: (h, w) uint8.
        windows: sizes of the neighbourhoods in px (odd) whose mean a dark pixel is below.
        contrast: by how many grey levels it is.
        min_side: least mean length of the sides, px.
        levels: grey levels up to which a pixel is dark as well, whatever its neighbourhood.
        most: so many are returned for each window and level, those with the longest outline.

    Returns:
        (n, 4, 2) corners u, v in px, clockwise as one looks at the image. The same
        quadrilateral may be there several times, once for each window.
    """
    found: List[np.ndarray] = []
    constant = max(1, math.ceil(contrast))
    for window in windows:
        # What OpenCV's adaptiveThreshold does, in half its time.
        mean = cv2.blur(grey, (window, window), borderType=cv2.BORDER_REPLICATE)
        darker = cv2.subtract(mean, grey)
        _, dark = cv2.threshold(darker, constant - 1, 255, cv2.THRESH_BINARY)
        found += _outlines(dark, min_side, most)
    for level in levels:
        _, dark = cv2.threshold(grey, level, 255, cv2.THRESH_BINARY_INV)
        found += _outlines(dark, min_side, most)
    return np.array(found).reshape(-1, 4, 2)


def _outlines(dark: np.ndarray, min_side: float, most: int) -> List[np.ndarray]:
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # A diagonal step counts as one pixel.
    long = [contour for contour in contours if len(contour) >= 2.8 * min_side]
    long.sort(key=len, reverse=True)
    quads = (_quad_of(contour, min_side) for contour in long)
    return list(islice((quad for quad in quads if quad is not None), most))


def same_quads(first: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which of (n, 4, 2) quadrilaterals are the same as (4, 2), to a fraction of a cell."""
    # A marker's white surroundings on a bright ground are a dark square one cell larger.
    tolerance = 1.0 + 0.04 * mean_side(first)
    # (4, n, 4, 2): in each of the four orders.
    turned = first[_TURNS][:, None]
    return (np.abs(others - turned).max(axis=(2, 3)) < tolerance).any(axis=0)


def mean_side(quad: np.ndarray) -> float:
    """Return the mean length of the sides of (4, 2) corners, px.

    >>> mean_side(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]]))
    2.0
    """
    sides = np.roll(quad, -1, axis=0) - quad
    return float(np.hypot(sides[:, 0], sides[:, 1]).mean())


def _quad_of(contour: np.ndarray, min_side: float) -> Optional[np.ndarray]:
    """Return the (4, 2) corners of a contour, or None if it is not a dark quadrilateral."""
    length = cv2.arcLength(contour, True)
    if length < 4.0 * min_side:
        return None
    outline = cv2.approxPolyDP(contour, max(1.0, _OUTLINE_TOLERANCE * length), True)
    if len(outline) != 4 or not cv2.isContourConvex(outline):
        return None
    # OpenCV runs around what is dark in one sense, around the holes in it in the other.
    if cv2.contourArea(outline, oriented=True) > 0.0:
        return None
    corners = outline[::-1, 0].astype(float)
    edges = np.roll(corners, -1, axis=0) - corners
    if np.hypot(edges[:, 0], edges[:, 1]).min() < _MIN_EDGE * length:
        return None
    fitted = _fit_sides(contour[::-1, 0], corners)
    return fitted if np.isfinite(fitted).all() else None


def _fit_sides(contour: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return corners where lines through the contour's sides meet."""
    count = len(contour)
    places = [int(np.flatnonzero((contour == corner).all(axis=1))[0]) for corner in corners]
    points, normals = np.empty((4, 2)), np.empty((4, 2))
    for side in range(4):
        start, end = places[side], places[(side + 1) % 4]
        steps = (end - start) % count
        trim = int(_FIT_TRIM * steps)
        part = np.arange(start + trim, start + steps - trim + 1) % count
        along_x, along_y, x, y = cv2.fitLine(contour[part], cv2.DIST_L2, 0, 0.01, 0.01).ravel()
        normal = np.array([along_y, -along_x])
        edge = corners[(side + 1) % 4] - corners[side]
        if edge[0] * along_x + edge[1] * along_y < 0.0:
            normal = -normal
        # The contour runs through the centres of the outermost dark pixels.
        points[side], normals[side] = (x, y) + 0.5 * normal, normal
    return intersections(points, normals)


# How far from the line to look for the edge and how close to sample, px; first roughly, then
# centred on what was found.
_LOOKS = ((2.5, 0.5), (2.0, 0.25), (2.0, 0.25))
# Places at which a side is crossed.
_FEWEST_PLACES, _MOST_PLACES = 12, 48
_LEAST_REACH = 1.25
# The border is black one cell deep, and white outside as deep.
_BORDER_PART = 0.9
# Sides are looked at without so much of them at either end.
_CROSS_TRIM = 0.08
# An edge that is seen at fewer of its places is none.
_LEAST_SEEN = 0.5
# Grey levels by which an edge has to rise.
_LEAST_RISE = 4.0


def refine_corners(
    image: np.ndarray, quad: np.ndarray, cells: int, lens: Lens
) -> Optional[np.ndarray]:
    """Return the corners of a dark quadrilateral where the lines along its sides meet.

    Each side is crossed at many places; where the grey level rises, on average, the edge is.
    The second and third look are centred on the line found before, and so are not biased by
    what lies on either side of it.

    Args:
        image: (h, w) grey levels.
        quad: (4, 2) corners in px, clockwise, to about two pixels.
        cells: number of cells of the marker along an edge, with its border.
        lens: straightens edges.

    Returns:
        (4, 2) corners u, v in ideal px; None if there are no four edges.
    """
    corners = lens.ideal(quad)
    for reach, step in _LOOKS:
        corners = _refine_once(image, corners, cells, lens, reach, step)
        if corners is None:
            return None
    return corners


def _refine_once(
    image: np.ndarray, corners: np.ndarray, cells: int, lens: Lens, reach: float, step: float
) -> Optional[np.ndarray]:
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    if not np.isfinite(lengths).all() or lengths.min() < 3.0:
        return None
    along = edges / lengths[:, None]
    outward = np.column_stack((along[:, 1], -along[:, 0]))
    across = 0.5 * (np.roll(lengths, 1) + np.roll(lengths, -1)) / cells
    reaches = np.minimum(reach, np.maximum(_LEAST_REACH, _BORDER_PART * across))
    count = int(np.clip(lengths.max(), _FEWEST_PLACES, _MOST_PLACES))
    places = np.linspace(_CROSS_TRIM, 1.0 - _CROSS_TRIM, count)
    steps = int(np.ceil(reach / step))
    offsets = np.linspace(-1, 1, 2 * steps + 1) * reaches[:, None]
    base = corners[:, None] + edges[:, None] * places[None, :, None]
    points = base[:, :, None] + outward[:, None, None] * offsets[:, None, :, None]
    values = sample(image, lens.seen(points))
    rises = np.clip(np.diff(values, axis=2), 0.0, None)
    weights = rises.sum(axis=2)
    middles = 0.5 * (offsets[:, None, 1:] + offsets[:, None, :-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        heights = (rises * middles).sum(axis=2) / weights
    seen = weights > np.maximum(_LEAST_RISE, 0.25 * weights.mean(axis=1, keepdims=True))
    if seen.mean(axis=1).min() < _LEAST_SEEN:
        return None
    level, slope = _robust_lines(places, np.where(seen, heights, 0.0), np.where(seen, weights, 0.0))
    # The lines at the old corners, and the new ones where they meet.
    first = corners + outward * level[:, None]
    second = corners + edges + outward * (level + slope)[:, None]
    direction = second - first
    return intersections(first, np.column_stack((direction[:, 1], -direction[:, 0])))


def _robust_lines(places: np.ndarray, heights: np.ndarray, weights: np.ndarray):
    """Fit height = level + slope · place to each row, without outliers."""
    for _ in range(2):
        total = weights.sum(axis=1)
        mean_place = (weights * places).sum(axis=1) / total
        mean_height = (weights * heights).sum(axis=1) / total
        centred = places - mean_place[:, None]
        spread = (weights * centred**2).sum(axis=1)
        slope = (weights * centred * (heights - mean_height[:, None])).sum(axis=1) / spread
        level = mean_height - slope * mean_place
        residuals = np.abs(heights - level[:, None] - slope[:, None] * places)
        typical = (weights * residuals).sum(axis=1) / total
        weights = np.where(residuals <= 3.0 * typical[:, None] + 0.02, weights, 0.0)
    return level, slope


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
_UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def quads_in_cells(
    image: np.ndarray,
    corners: np.ndarray,
    pattern: np.ndarray,
    lens: Lens,
    min_side: float,
) -> np.ndarray:
    """Return the outlines of what is dark and has four corners in the white cells of a marker.

    A smaller marker may be in one. Where it is small or the light is poor, thresholds made for
    the whole image miss it. Those of a single cell are told by the marker around it: its black
    and its white are known.

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
    levels = sample(image, lens.seen(_mapped(_cell_samples(cells), to_image)))
    levels = levels.reshape(cells, cells, -1)
    black = float(np.median(levels[pattern == 0]))
    white = float(np.quantile(levels[pattern == 1], 0.75))
    if white - black < 1.0:
        return np.empty((0, 4, 2))
    low = (white - np.quantile(levels, _DARK_PART, axis=2)) / (white - black)
    low[pattern == 0] = 0.0
    rows, columns = np.nonzero(low > _DARKER)
    fullest = np.argsort(-low[rows, columns], kind="stable")[:_MOST_CELLS]
    found = [np.empty((0, 4, 2))]
    for row, column in zip(rows[fullest], columns[fullest]):
        outline = lens.seen(_mapped((_UNIT_SQUARE + (column, row)) / cells, to_image))
        found.append(_quads_within(image, outline, (black, white), min_side))
    return np.concatenate(found)


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
