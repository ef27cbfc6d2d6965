"""Images and their geometry: as messages, as arrays, as samples of the simulation."""

from __future__ import annotations

from typing import Tuple

import cv2
import cv_bridge
import numpy as np
from geometry_msgs.msg import Point32
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header

from bullet_lab.errors import LabError
from bullet_lab.msg import ImagePoints
from bullet_lab.ros.messages.stamps import set_time
from bullet_lab.simulation.plugins.samples import CameraInfoSample, ImageSample, PointsSample
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


class ImageConverter:
    """ImageSample to sensor_msgs/Image."""

    message_kind = Image

    def __init__(self):
        self._message = Image()

    def convert(self, sample: ImageSample) -> Image:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        message.encoding = sample.encoding
        message.height, message.width = sample.pixels.shape[:2]
        message.step = sample.pixels.nbytes // message.height
        message.data = sample.pixels.tobytes()
        return message


class CameraInfoConverter:
    """CameraInfoSample to sensor_msgs/CameraInfo."""

    message_kind = CameraInfo

    def __init__(self):
        self._message = CameraInfo(distortion_model="plumb_bob")
        self._message.R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]

    def convert(self, sample: CameraInfoSample) -> CameraInfo:
        """Return the message, which the next call overwrites."""
        message, camera = self._message, sample.camera
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        message.width, message.height = camera.width, camera.height
        message.D = list(camera.distortion)
        message.K = camera.matrix.ravel().tolist()
        shift = 0.0 - camera.fx * sample.baseline
        message.P = [camera.fx, 0.0, camera.cx, shift, 0.0, camera.fy, camera.cy, 0.0]
        message.P += [0.0, 0.0, 1.0, 0.0]
        return message


# As PCL's PointXYZRGB lies in memory, and Gazebo's messages.
POINT = np.dtype(
    {
        "names": ["x", "y", "z", "rgb"],
        "formats": ["<f4", "<f4", "<f4", "<u4"],
        "offsets": [0, 4, 8, 16],
        "itemsize": 32,
    }
)


class PointsConverter:
    """PointsSample to sensor_msgs/PointCloud2, a row of points for each row of pixels.

    The colour is 0x00rrggbb, declared as a float, as PCL has it.
    """

    message_kind = PointCloud2

    def __init__(self):
        self._message = PointCloud2(is_bigendian=False, point_step=POINT.itemsize)
        self._message.fields = [
            PointField(name, POINT.fields[name][1], PointField.FLOAT32, 1) for name in POINT.names
        ]
        self._points = np.zeros((0, 0), POINT)

    def convert(self, sample: PointsSample) -> PointCloud2:
        """Return the message, which the next call overwrites."""
        message = self._message
        set_time(message.header.stamp, sample.step)
        message.header.frame_id = sample.frame
        message.height, message.width = sample.points.shape[:2]
        message.row_step = message.width * message.point_step
        message.is_dense = bool(np.isfinite(sample.points[..., 2]).all())
        message.data = self._packed(sample).tobytes()
        return message

    def _packed(self, sample: PointsSample) -> np.ndarray:
        points, colours = self._points, sample.colours.astype(np.uint32)
        if points.shape != sample.points.shape[:2]:
            points = self._points = np.zeros(sample.points.shape[:2], POINT)
        for axis, name in enumerate("xyz"):
            points[name] = sample.points[..., axis]
        points["rgb"] = colours[..., 0] << 16 | colours[..., 1] << 8 | colours[..., 2]
        return points
