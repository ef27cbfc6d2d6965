"""From pictures and their geometry to ROS messages."""

from __future__ import annotations

from sensor_msgs.msg import CameraInfo, Image

from bullet_lab.ros.stamps import set_time
from bullet_lab.simulation.samples import CameraInfoSample, ImageSample


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
