"""Images as messages and as arrays."""

from __future__ import annotations

from typing import Tuple

import cv2
import cv_bridge
import numpy as np
from geometry_msgs.msg import Point32
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from bullet_lab.errors import LabError
from bullet_lab.msg import ImagePoints
from bullet_lab.vision.images import LEAST_EDGE

_LARGEST_EDGE = 16384
_BRIDGE = cv_bridge.CvBridge()


class ImageError(LabError):
    """An image message that holds no image to use."""


def pixels_of(message: Image, encoding: str) -> np.ndarray:
    """Return the image of a message as (h, w) for mono8 or (h, w, 3) for bgr8, uint8.

    Raises:
        ImageError: its sizes do not fit together, or its encoding is no image to look at.
    """
    _check_sizes(message)
    try:
        return _BRIDGE.imgmsg_to_cv2(message, encoding)
    except (cv_bridge.CvBridgeError, cv2.error, KeyError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImageError(f"an image of encoding '{message.encoding}': {reason}") from error


def image_message(header: Header, pixels: np.ndarray, encoding: str) -> Image:
    """Return an image (h, w) or (h, w, channels) uint8 as a message with a given header."""
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels)
    return Image(header, height, width, encoding, 0, data.strides[0], data.tobytes())


def _check_sizes(message: Image) -> None:
    width, height = message.width, message.height
    if not (LEAST_EDGE <= width <= _LARGEST_EDGE and LEAST_EDGE <= height <= _LARGEST_EDGE):
        raise ImageError(f"an image of {width} x {height} px")
    try:
        kind, channels = _BRIDGE.encoding_to_dtype_with_channels(message.encoding)
        row = width * channels * np.dtype(kind).itemsize
    except (cv_bridge.CvBridgeError, KeyError, TypeError, ValueError) as error:
        raise ImageError(f"the encoding '{message.encoding}' is not known") from error
    if message.step < row:
        raise ImageError(f"rows of {message.step} bytes for {width} px of {message.encoding}")
    if len(message.data) != message.step * height:
        raise ImageError(f"{len(message.data)} bytes for {height} rows of {message.step}")


def points_message(header: Header, shape: Tuple[int, int], points: np.ndarray) -> ImagePoints:
    """Return (n, 3) points u, v, strength of an image of a shape (h, w) as a message."""
    height, width = shape
    return ImagePoints(header, width, height, [Point32(u, v, s) for u, v, s in points])
