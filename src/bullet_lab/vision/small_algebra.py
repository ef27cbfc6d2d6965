"""Linear algebra of a few rows.

numpy's goes to a BLAS that may wake threads for a 6 × 6 system, which on busy cores takes a
thousand times as long as the sum itself; OpenCV's does not.
"""

from __future__ import annotations

import cv2
import numpy as np


def solve_symmetric(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return x (n,) of matrix · x = right for a positive definite (n, n) matrix; NaN if not."""
    solved, x = cv2.solve(matrix, right, flags=cv2.DECOMP_CHOLESKY)
    return x.ravel() if solved else np.full(len(right), np.nan)


def invert_symmetric(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite (n, n) matrix; NaN if it is not."""
    solved, inverse = cv2.invert(matrix, flags=cv2.DECOMP_CHOLESKY)
    return 0.5 * (inverse + inverse.T) if solved else np.full(matrix.shape, np.nan)


def least_squares(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return x (n,) of the least |matrix · x - right|, by the normal equations."""
    return solve_symmetric(matrix.T @ matrix, matrix.T @ right)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """Return the rotation nearest a (3, 3) matrix that is nearly one."""
    _, left, right = cv2.SVDecomp(matrix)
    return left @ right


def largest_singular_value(matrix: np.ndarray) -> float:
    """Return it for a (2, 2) matrix."""
    (a, b), (c, d) = matrix
    square, determinant = float(a * a + b * b + c * c + d * d), float(a * d - b * c)
    rest = max(0.0, square * square - 4.0 * determinant * determinant)
    return float(np.sqrt(0.5 * (square + np.sqrt(rest))))
