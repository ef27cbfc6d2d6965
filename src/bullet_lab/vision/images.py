"""Images for the detectors: conversion to grey levels, and pictures taken through a lens."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.errors import LabError


class VisionError(LabError):
    """An image, a camera or a setting that cannot be used."""


LEAST_EDGE = 16
_TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
}


def grey(pixels: ndarray, encoding: str = "") -> ndarray:
    """Return an image as (h, w) uint8 grey levels.

    Args:
        pixels: (h, w) or (h, w, 3) or (h, w, 4) uint8.
        encoding: mono8, bgr8, rgb8, bgra8 or rgba8; empty: mono8, bgr8 or bgra8 by the shape.

    Raises:
        VisionError: it is not such an image, or smaller than 16 px.

    >>> grey(np.full((16, 20, 3), (0, 0, 255), dtype=np.uint8), "bgr8")[0, 0]
    76
    """
    pixels = np.asarray(pixels)
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or min(pixels.shape[:2]) < LEAST_EDGE:
        raise VisionError(
            f"no image: an array of shape {pixels.shape} and type {pixels.dtype}; it must be "
            f"uint8, (h, w), (h, w, 3) or (h, w, 4), and {LEAST_EDGE} px or more each way"
        )
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return np.ascontiguousarray(pixels.reshape(pixels.shape[:2]))
    known = {3: ("bgr8", "rgb8"), 4: ("bgra8", "rgba8")}.get(pixels.shape[2], ())
    encoding = encoding or next(iter(known), "")
    if encoding not in known:
        raise VisionError(
            f"encoding '{encoding}' does not fit an image of {pixels.shape[2]} channels; "
            "rgb8 and bgr8 have 3, rgba8 and bgra8 have 4"
        )
    return cv2.cvtColor(pixels, _TO_GREY[encoding])


def sample(image: ndarray, points: ndarray) -> ndarray:
    """Return the bilinear values of a (h, w) image at points (..., 2) of u, v in px.

    Points outside get the value at the border; at NaN it is 0. (OpenCV's `remap` rounds
    positions to 1/32 px.)

    >>> sample(np.array([[0.0, 10.0], [20.0, 30.0]]), np.array([[0.5, 0.5], [0.0, 0.25]]))
    array([15.,  5.])
    """
    height, width = image.shape
    u = np.fmin(np.fmax(points[..., 0], 0.0), width - 1.001)
    v = np.fmin(np.fmax(points[..., 1], 0.0), height - 1.001)
    column, row = u.astype(np.intp), v.astype(np.intp)
    right, down = u - column, v - row
    index = row * width + column
    flat = image.ravel()
    upper = flat[index] + right * (flat[index + 1].astype(float) - flat[index])
    index += width
    lower = flat[index] + right * (flat[index + 1].astype(float) - flat[index])
    return upper + down * (lower - upper)


class Picture:
    """Grey levels of an image, addressed by ideal pixels.

    Ideal pixels are those that a camera without distortion would see: straight edges are straight
    only there.

    Args:
        levels: (h, w) grey levels.
        camera: the camera; None, or one without distortion: ideal pixels are those of the image.
    """

    def __init__(self, levels: ndarray, camera: PinholeCamera | None = None):
        self.levels = levels
        self._camera = camera if camera is not None and any(camera.distortion) else None

    def at(self, points: ndarray) -> ndarray:
        """Return the bilinear grey levels at ideal pixels (..., 2)."""
        return sample(self.levels, self.seen(points))

    def ideal(self, points: ndarray) -> ndarray:
        """Return the ideal pixels (..., 2) of pixels of the image."""
        if self._camera is None:
            return points
        flat = np.asarray(points, dtype=float).reshape(-1, 1, 2)
        matrix = self._camera.matrix
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-6)
        distortion = np.array(self._camera.distortion)
        undistorted = cv2.undistortPointsIter(flat, matrix, distortion, None, matrix, criteria)
        return undistorted.reshape(np.shape(points))

    def seen(self, points: ndarray) -> ndarray:
        """Return the pixels (..., 2) of the image at ideal ones."""
        camera = self._camera
        if camera is None:
            return points
        flat = np.asarray(points, dtype=float).reshape(-1, 2)
        rays = (flat - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return camera.project(np.column_stack((rays, np.ones(len(rays))))).reshape(points.shape)

    def derivatives(self, points: ndarray) -> ndarray:
        """Return the derivatives (2 n, 2 n) of `seen` at (n, 2) ideal pixels."""
        count = len(points)
        moves = np.eye(2 * count)
        if self._camera is None:
            return moves
        step = 0.5
        for index in range(count):
            shifts = points[index] + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
            seen = self.seen(shifts)
            own = slice(2 * index, 2 * index + 2)
            moves[own, own] = np.stack((seen[0] - seen[1], seen[2] - seen[3]), axis=1)
        return moves
