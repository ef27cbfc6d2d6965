"""Finding dark convex quadrilaterals, the outlines of what may be markers."""

from __future__ import annotations

import math
from typing import List, Optional, Sequence

import cv2
import numpy as np

# Part of its outline's length by which a quadrilateral may differ from a contour.
_OUTLINE_TOLERANCE = 0.035
# Corners nearer than this part of the outline's length are one.
_MIN_EDGE = 0.05
# A side's line is fitted to its contour without so much at either end.
_TRIM = 0.15
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
    quads: List[np.ndarray] = []
    for contour in long:
        quad = _quad_of(contour, min_side)
        if quad is not None:
            quads.append(quad)
        if len(quads) == most:
            break
    return quads


def same_quads(first: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which of (n, 4, 2) quadrilaterals are the same as (4, 2), to a fraction of a cell."""
    # A marker's white surroundings on a bright ground are a dark square one cell larger.
    tolerance = 1.0 + 0.04 * mean_side(first)
    # (4, n, 4, 2): in each of the four orders.
    turned = first[_TURNS][:, None]
    return (np.abs(others - turned).max(axis=(2, 3)) < tolerance).any(axis=0)


def mean_side(quad: np.ndarray) -> float:
    """Return the mean length of the sides of (4, 2) corners."""
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
        trim = int(_TRIM * steps)
        part = np.arange(start + trim, start + steps - trim + 1) % count
        along_x, along_y, x, y = cv2.fitLine(contour[part], cv2.DIST_L2, 0, 0.01, 0.01).ravel()
        normal = np.array([along_y, -along_x])
        edge = corners[(side + 1) % 4] - corners[side]
        if edge[0] * along_x + edge[1] * along_y < 0.0:
            normal = -normal
        # The contour runs through the centres of the outermost dark pixels.
        points[side], normals[side] = (x, y) + 0.5 * normal, normal
    return intersections(points, normals)


def intersections(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (4, 2) corners: the k-th is where line k - 1 meets line k.

    Args:
        points: (4, 2), one on each line.
        normals: (4, 2), that of each line.
    """
    offsets = (points * normals).sum(axis=1)
    before, offsets_before = np.roll(normals, 1, axis=0), np.roll(offsets, 1)
    determinant = before[:, 0] * normals[:, 1] - before[:, 1] * normals[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (offsets_before * normals[:, 1] - before[:, 1] * offsets) / determinant
        v = (before[:, 0] * offsets - offsets_before * normals[:, 0]) / determinant
    return np.column_stack((u, v))
