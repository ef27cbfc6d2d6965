"""Algebra of small symmetric matrices and of quadrilaterals.

numpy's BLAS may wake threads for a 6 × 6 system, which takes a thousand times as long as the sum
itself when the cores are busy. OpenCV does not, so its solvers are used here.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

NEXT = [1, 2, 3, 0]
"""Index of the corner, or of the side, after each of a quadrilateral's four."""

PREVIOUS = [3, 0, 1, 2]
"""Index of the one before each."""

UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def solve_symmetric(matrix: ndarray, right: ndarray) -> ndarray:
    """Return x (n,) of matrix · x = right for a positive definite (n, n) matrix; NaN if not.

    >>> solve_symmetric(np.diag([2.0, 4.0]), np.array([2.0, 2.0]))
    array([1. , 0.5])
    """
    solved, x = cv2.solve(matrix, right, flags=cv2.DECOMP_CHOLESKY)
    return x.ravel() if solved else np.full(len(right), np.nan)


def invert_symmetric(matrix: ndarray) -> ndarray:
    """Return the inverse of a positive definite (n, n) matrix; NaN if it is not."""
    solved, inverse = cv2.invert(matrix, flags=cv2.DECOMP_CHOLESKY)
    return 0.5 * (inverse + inverse.T) if solved else np.full(matrix.shape, np.nan)


def largest_singular_value(matrix: ndarray) -> float:
    """Return the largest singular value of a (2, 2) matrix.

    >>> largest_singular_value(np.diag([-3.0, 2.0]))
    3.0
    """
    (a, b), (c, d) = matrix
    square, determinant = float(a * a + b * b + c * c + d * d), float(a * d - b * c)
    rest = max(0.0, square * square - 4.0 * determinant * determinant)
    return float(np.sqrt(0.5 * (square + np.sqrt(rest))))


def mean_side(quad: ndarray) -> float:
    """Return the mean length of the sides of (4, 2) corners.

    >>> mean_side(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]]))
    2.0
    """
    sides = quad[NEXT] - quad
    return float(np.hypot(sides[:, 0], sides[:, 1]).mean())


def homography(corners: ndarray) -> ndarray:
    """Return the (..., 3, 3) map from the unit square, clockwise from (0, 0), to (..., 4, 2).

    >>> corners = np.array([[2.0, 1.0], [4.0, 1.0], [4.0, 3.0], [2.0, 3.0]])
    >>> homography(corners) @ [0.5, 0.5, 1.0]
    array([3., 2., 1.])
    """
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = np.moveaxis(corners, (-2, -1), (0, 1))
    sum_x, sum_y = x0 - x1 + x2 - x3, y0 - y1 + y2 - y3
    dx1, dx2, dy1, dy2 = x1 - x2, x3 - x2, y1 - y2, y3 - y2
    determinant = dx1 * dy2 - dx2 * dy1
    g = (sum_x * dy2 - dx2 * sum_y) / determinant
    h = (dx1 * sum_y - sum_x * dy1) / determinant
    numbers = (x1 - x0 + g * x1, x3 - x0 + h * x3, x0, y1 - y0 + g * y1, y3 - y0 + h * y3, y0)
    rows = np.array((*numbers, g, h, np.ones_like(g)))
    return np.ascontiguousarray(rows.T).reshape(*np.shape(g), 3, 3)


def mapped(places: ndarray, to_image: ndarray) -> ndarray:
    """Return the points (n, 2) to which a homography (3, 3) maps (n, 2) places."""
    there = places @ to_image[:, :2].T + to_image[:, 2]
    return there[:, :2] / there[:, 2:]


def unmapped(points: ndarray, to_image: ndarray) -> tuple[ndarray, ndarray]:
    """Return the places (2, n) that a homography maps to points (2, n), and derivatives (2, 2, n).

    >>> corners = np.array([[2.0, 1.0], [4.0, 1.0], [4.0, 3.0], [2.0, 3.0]])
    >>> unmapped(np.array([[3.0], [2.0]]), homography(corners))[0].ravel().tolist()
    [0.5, 0.5]
    """
    back = cv2.invert(to_image)[1]
    one = 1.0 / (back[2, 0] * points[0] + back[2, 1] * points[1] + back[2, 2])
    places = (back[:2, :1] * points[0] + back[:2, 1:2] * points[1] + back[:2, 2:]) * one
    return places, (back[:2, :2, None] - places[:, None] * back[2, :2, None]) * one


def intersections(points: ndarray, normals: ndarray) -> ndarray:
    """Return (..., 4, 2) corners: the k-th is where line k - 1 meets line k.

    Args:
        points: (..., 4, 2), one on each line.
        normals: (..., 4, 2), one of each line.

    >>> points = np.array([[1.0, 1.0], [3.0, 1.0], [1.0, 2.0], [1.0, 1.0]])
    >>> intersections(points, np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])).tolist()
    [[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]]
    """
    offsets = (points * normals).sum(axis=-1)
    before, offsets_before = normals[..., PREVIOUS, :], offsets[..., PREVIOUS]
    determinant = before[..., 0] * normals[..., 1] - before[..., 1] * normals[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (offsets_before * normals[..., 1] - before[..., 1] * offsets) / determinant
        v = (before[..., 0] * offsets - offsets_before * normals[..., 0]) / determinant
    return np.stack((u, v), axis=-1)
