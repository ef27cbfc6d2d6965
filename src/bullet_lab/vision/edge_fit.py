"""Sub-pixel corners: lines fitted to where the grey levels rise along each side."""

from __future__ import annotations

from typing import Optional

import numpy as np

from bullet_lab.vision.quads import intersections
from bullet_lab.vision.sampling import Lens, sample

# How far from the line to look for the edge and how close to sample, px; first roughly, then
# centred on what was found.
_LOOKS = ((2.5, 0.5), (2.0, 0.25), (2.0, 0.25))
# Places at which a side is crossed.
_FEWEST_PLACES, _MOST_PLACES = 12, 48
_LEAST_REACH = 1.25
# The border is black one cell deep, and white outside as deep.
_BORDER_PART = 0.9
# Sides are looked at without so much of them at either end.
_TRIM = 0.08
# An edge that is seen at fewer of its places is none.
_LEAST_SEEN = 0.5
# Grey levels by which an edge has to rise.
_LEAST_RISE = 4.0


def refine_corners(
    image: np.ndarray, quad: np.ndarray, cells: int, lens: Optional[Lens] = None
) -> Optional[np.ndarray]:
    """Return the corners of a dark quadrilateral where the lines along its sides meet.

    Each side is crossed at many places; where the grey level rises, on average, the edge is.
    The second and third look are centred on the line found before, and so are not biased by
    what lies on either side of it.

    Args:
        image: (h, w) grey levels.
        quad: (4, 2) corners in px, clockwise, to about two pixels.
        cells: number of cells of the marker along an edge, with its border.
        lens: straightens edges; None for a camera without distortion.

    Returns:
        (4, 2) corners u, v in ideal px; None if there are no four edges.
    """
    lens = lens or Lens()
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
    places = np.linspace(_TRIM, 1.0 - _TRIM, count)
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
    weights = np.where(seen, weights, 0.0)
    heights = np.where(seen, heights, 0.0)
    level, slope = _robust_lines(places, heights, weights)
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
