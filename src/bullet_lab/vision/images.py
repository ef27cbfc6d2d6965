"""Images as the detectors want them, and the error of the vision library."""

from __future__ import annotations

import cv2
import numpy as np

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


def grey(pixels: np.ndarray, encoding: str = "") -> np.ndarray:
    """Return an image as (h, w) uint8 grey levels.

    Args:
        pixels: (h, w) or (h, w, 3) or (h, w, 4) uint8.
        encoding: mono8, bgr8, rgb8, bgra8 or rgba8; empty: mono8, bgr8 or bgra8 by the shape.

    Raises:
        VisionError: it is not such an image, or smaller than 16 px.
    """
    pixels = np.asarray(pixels)
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or min(pixels.shape[:2]) < LEAST_EDGE:
        raise VisionError(f"no image: an array of shape {pixels.shape} and type {pixels.dtype}")
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return np.ascontiguousarray(pixels.reshape(pixels.shape[:2]))
    known = {3: ("bgr8", "rgb8"), 4: ("bgra8", "rgba8")}.get(pixels.shape[2], ())
    encoding = encoding or next(iter(known), "")
    if encoding not in known:
        raise VisionError(f"an image of {pixels.shape[2]} channels is not {encoding or 'known'}")
    return cv2.cvtColor(pixels, _TO_GREY[encoding])
