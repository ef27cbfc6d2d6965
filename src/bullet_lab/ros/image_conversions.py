"""From pictures and their geometry to ROS messages."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField

from bullet_lab.ros.stamps import set_time
from bullet_lab.simulation.samples import CameraInfoSample, ImageSample, PointsSample


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
