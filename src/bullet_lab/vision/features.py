"""Corners, with the defaults of the course code."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray


def good_features(
    grey: ndarray, count: int = 25, quality: float = 0.01, distance: float = 10.0
) -> ndarray:
    """Return the good features to track (Shi and Tomasi), the best first.

    Args:
        grey: (h, w) uint8.
        count: at most so many.
        quality: least strength, as part of the strongest.
        distance: between two of them, at least, px.

    Returns:
        (n, 3): u, v in px and strength, the smaller eigenvalue of the gradients' covariance.
    """
    corners = cv2.goodFeaturesToTrack(grey, count, quality, distance)
    if corners is None:
        return np.empty((0, 3))
    places = corners[:, 0].astype(float)
    strength = cv2.cornerMinEigenVal(grey, 3)
    column, row = np.rint(places).astype(int).T
    return np.column_stack((places, strength[row, column]))


def harris_corners(
    grey: ndarray,
    block: int = 2,
    aperture: int = 3,
    k: float = 0.04,
    threshold: float = 0.01,
) -> tuple[ndarray, ndarray]:
    """Return Harris corners as an area and as points.

    Args:
        grey: (h, w) uint8.
        block: size of the neighbourhood, px.
        aperture: size of the Sobel operator, px.
        k: Harris' free parameter.
        threshold: least response, as part of the largest.

    Returns:
        (h, w) bool, true where there is a corner, a pixel wider each way; and (n, 3): u, v in
        px of where the response is largest in each patch, and the response there.
    """
    response = cv2.cornerHarris(grey, block, aperture, k)
    largest = float(response.max())
    if largest <= 0.0:
        return np.zeros(grey.shape, dtype=bool), np.empty((0, 3))
    peaks = cv2.dilate(response, np.ones((3, 3)))
    area = peaks > threshold * largest
    row, column = np.nonzero(area & (response == peaks))
    order = np.argsort(-response[row, column], kind="stable")
    row, column = row[order], column[order]
    return area, np.column_stack((column, row, response[row, column])).astype(float)
