"""Confidence ellipses of planar positions."""

from __future__ import annotations

import math

import numpy as np

LEVEL = 0.95
"""Probability that a Gaussian position lies within the ellipse."""

SQUARE_RADIUS = -2.0 * math.log(1.0 - LEVEL)
"""Of the ellipse in units of the standard deviation: chi-square with two degrees of freedom."""


def ellipse_points(covariance, count: int = 73) -> np.ndarray:
    """Return points of the 95 % ellipse around the origin, the first and the last the same.

    Args:
        covariance: 2x2 or larger (m²), of which the first two rows and columns are looked at.
        count: how many points.

    Returns:
        (count, 2) array of x and y in m.

    >>> ellipse_points(np.diag([0.04, 0.01]), 5).round(3).max(axis=0)
    array([0.49 , 0.245])
    """
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float)[:2, :2])
    radii = np.sqrt(SQUARE_RADIUS * np.maximum(values, 0.0))
    angles = np.linspace(0.0, math.tau, count)
    return (radii * np.column_stack((np.cos(angles), np.sin(angles)))) @ vectors.T
