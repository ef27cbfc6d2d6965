"""Reading images between their pixels, and lenses out of the way."""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera


def sample(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the bilinear values of a (h, w) image at points (..., 2) of u, v in px.

    Points outside get the value at the border. (OpenCV's `remap` rounds positions to 1/32 px.)
    """
    height, width = image.shape
    u = np.clip(points[..., 0], 0.0, width - 1.001)
    v = np.clip(points[..., 1], 0.0, height - 1.001)
    column, row = u.astype(np.intp), v.astype(np.intp)
    right, down = u - column, v - row
    index = row * width + column
    flat = image.ravel()
    upper = flat[index] + right * (flat[index + 1].astype(float) - flat[index])
    index += width
    lower = flat[index] + right * (flat[index + 1].astype(float) - flat[index])
    return upper + down * (lower - upper)


class Lens:
    """Maps pixels to where a camera without distortion would see them, and back.

    Straight edges are straight in ideal pixels only.

    Args:
        camera: the camera; None, or one without distortion, leaves pixels as they are.
    """

    def __init__(self, camera: Optional[PinholeCamera] = None):
        self._camera = camera if camera is not None and any(camera.distortion) else None

    def ideal(self, points: np.ndarray) -> np.ndarray:
        """Return ideal pixels (..., 2) of those of the image."""
        if self._camera is None:
            return points
        flat = np.asarray(points, dtype=float).reshape(-1, 1, 2)
        matrix = self._camera.matrix
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-6)
        distortion = np.array(self._camera.distortion)
        undistorted = cv2.undistortPointsIter(flat, matrix, distortion, None, matrix, criteria)
        return undistorted.reshape(np.shape(points))

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Return pixels (..., 2) of the image of ideal ones."""
        if self._camera is None:
            return points
        flat = np.asarray(points, dtype=float).reshape(-1, 2)
        camera = self._camera
        rays = (flat - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return camera.project(np.column_stack((rays, np.ones(len(rays))))).reshape(points.shape)
