"""Conversions of images, camera geometry and detections to messages and back."""

from __future__ import annotations

import math
import re

import cv2
import numpy as np
from geometry_msgs.msg import (
    Point,
    Point32,
    PoseWithCovariance,
    Quaternion,
    TransformStamped,
    Vector3,
)
from geometry_msgs.msg import Pose as PoseMessage
from numpy import ndarray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from bullet_lab.core.pinhole import PinholeCamera, PinholeError
from bullet_lab.errors import LabError
from bullet_lab.msg import ImagePoints, MarkerBundle, MarkerDetection
from bullet_lab.vision.images import LEAST_EDGE
from bullet_lab.vision.marker_bundles import ObservedBundle
from bullet_lab.vision.marker_detector import DetectedMarker
from bullet_lab.vision.pose_fit import MarkerPose

# px
_LARGEST_EDGE = 16384
# Encodings with colours, as sensor_msgs/image_encodings.h has them: OpenCV's name and channels.
_COLOURS = {
    "mono8": ("GRAY", 1),
    "mono16": ("GRAY", 1),
    **{
        f"{name}{bits}": (name.upper(), len(name))
        for name in ("bgr", "rgb", "bgra", "rgba")
        for bits in (8, 16)
    },
    # OpenCV names a Bayer pattern by the second row.
    **{
        f"bayer_{name}{bits}": (f"Bayer{code}", 1)
        for name, code in (("rggb", "BG"), ("bggr", "RG"), ("gbrg", "GR"), ("grbg", "GB"))
        for bits in (8, 16)
    },
    "yuv422": ("YUV_UYVY", 2),
    "yuv422_yuy2": ("YUV_YUY2", 2),
}
_PLAIN = re.compile(r"(8U|8S|16U|16S|32S|32F|64F)(?:C([1-9][0-9]?))?")
_KINDS = {"U": "u", "S": "i", "F": "f"}
_NO_DISTORTION = (0.0,) * 5
# As a share of the focal length.
_ALLOWED_SKEW = 1e-6


class ImageError(LabError):
    """An image message has an invalid size or encoding."""


def pixels_of(message: Image, encoding: str) -> ndarray:
    """Return the image of a message as (h, w) for mono8 or (h, w, 3) for bgr8, uint8.

    Colours are converted as by cv_bridge. An encoding that is the message's own is left as it is.

    Raises:
        ImageError: its sizes are inconsistent, or its encoding cannot be converted.
    """
    pixels = _stored_pixels(message)
    if message.encoding == encoding:
        return pixels
    colours, wanted = _COLOURS.get(message.encoding), _COLOURS[encoding][0]
    if colours is None:
        raise ImageError(f"an image of encoding '{message.encoding}' has no colours to convert")
    if colours[0] != wanted:
        name = f"{colours[0]}2{wanted}"
        if name.startswith("YUV_"):
            name = f"YUV2{wanted}{colours[0][3:]}"
        pixels = cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{name}"))
    if pixels.dtype == np.uint16:
        pixels = cv2.convertScaleAbs(pixels, alpha=255.0 / 65535.0)
    return pixels


def _stored_pixels(message: Image) -> ndarray:
    """Return the pixels as the message has them, (h, w) or (h, w, channels), native byte order."""
    kind, channels = _layout(message.encoding)
    _check_sizes(message, channels * kind.itemsize)
    if message.is_bigendian:
        kind = kind.newbyteorder(">")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : message.width * channels * kind.itemsize].copy().view(kind)
    shape = (message.height, message.width, channels)[: 3 if channels > 1 else 2]
    return pixels.astype(kind.newbyteorder("="), copy=False).reshape(shape)


def _layout(encoding: str) -> tuple[np.dtype, int]:
    """Return the type of a channel and the number of channels; raises ImageError."""
    if encoding in _COLOURS:
        return np.dtype(np.uint16 if encoding.endswith("16") else np.uint8), _COLOURS[encoding][1]
    match = _PLAIN.fullmatch(encoding)
    if match is None:
        raise ImageError(f"the encoding '{encoding}' is not known")
    bits, kind = int(match[1][:-1]), _KINDS[match[1][-1]]
    return np.dtype(f"{kind}{bits // 8}"), int(match[2] or 1)


def image_message(header: Header, pixels: ndarray, encoding: str) -> Image:
    """Return an image (h, w) or (h, w, channels) uint8 as a message with a given header."""
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels)
    return Image(header, height, width, encoding, 0, data.strides[0], data.tobytes())


def _check_sizes(message: Image, bytes_per_pixel: int) -> None:
    width, height = message.width, message.height
    if not (LEAST_EDGE <= width <= _LARGEST_EDGE and LEAST_EDGE <= height <= _LARGEST_EDGE):
        allowed = f"{LEAST_EDGE} to {_LARGEST_EDGE} px are allowed"
        raise ImageError(f"an image of {width} x {height} px; {allowed}")
    if message.step < width * bytes_per_pixel:
        raise ImageError(f"rows of {message.step} bytes for {width} px of {message.encoding}")
    if len(message.data) != message.step * height:
        raise ImageError(f"{len(message.data)} bytes for {height} rows of {message.step}")


def points_message(header: Header, shape: tuple[int, int], points: ndarray) -> ImagePoints:
    """Return (n, 3) points u, v, strength of an image of a shape (h, w) as a message."""
    height, width = shape
    return ImagePoints(header, width, height, [Point32(u, v, s) for u, v, s in points])


class CameraGeometryError(LabError):
    """A camera_info message does not describe the image, or has unsupported values."""


def camera_of(info: CameraInfo, width: int, height: int, rectified: bool = False) -> PinholeCamera:
    """Return the camera geometry of an image of a size in px.

    A `rectified` image has the geometry P and no distortion.

    Raises:
        CameraGeometryError: not calibrated (a zero K), not finite, another size, binning, or an
            unsupported distortion model.
    """
    numbers = info.P if rectified else info.K
    name = "P" if rectified else "K"
    if not all(map(math.isfinite, (*numbers, *info.D))):
        raise CameraGeometryError(f"camera_info has numbers in {name} or D that are not finite")
    if not any(numbers):
        raise CameraGeometryError(f"camera_info has a zero {name}: the camera is not calibrated")
    rows = np.reshape(numbers, (3, -1))[:, :3].tolist()
    (fx, skew, cx), (lower, fy, cy), (_, _, scale) = rows
    if abs(skew) > _ALLOWED_SKEW * abs(fx) or lower or scale != 1.0:
        raise CameraGeometryError(f"camera_info has a {name} that is no pinhole camera's matrix")
    left, top = _region(info, width, height)
    distortion = _NO_DISTORTION if rectified else _distortion(info)
    try:
        return PinholeCamera(width, height, fx, fy, cx - left, cy - top, distortion)
    except PinholeError as error:
        raise CameraGeometryError(f"camera_info: {error}") from error


def _region(info: CameraInfo, width: int, height: int) -> tuple[int, int]:
    """Return the offset (px) of the image in the full image that K describes."""
    if info.binning_x > 1 or info.binning_y > 1:
        binning = f"{info.binning_x} x {info.binning_y}"
        raise CameraGeometryError(f"camera_info has {binning} binning, which is not supported")
    region = info.roi
    size = (region.width or info.width, region.height or info.height)
    if size != (width, height):
        described = f"{size[0]} x {size[1]}"
        raise CameraGeometryError(f"camera_info is about {described} px, not {width} x {height}")
    return region.x_offset, region.y_offset


def _distortion(info: CameraInfo) -> tuple[float, ...]:
    values = tuple(info.D)
    if not any(values):
        return _NO_DISTORTION
    if info.distortion_model != "plumb_bob" or len(values) not in (4, 5):
        kind = f"'{info.distortion_model}' with {len(values)} numbers"
        raise CameraGeometryError(f"camera_info has the lens {kind}, only plumb_bob is known")
    return (*values, 0.0)[:5]


def marker_pose_message(pose: MarkerPose) -> PoseMessage:
    """Return a marker's pose in the optical frame as a message."""
    return PoseMessage(Point(*map(float, pose.translation)), Quaternion(*pose.quaternion))


def covariance_message(pose: MarkerPose) -> PoseWithCovariance:
    """Return a marker's pose with its covariance as a message."""
    return PoseWithCovariance(marker_pose_message(pose), pose.covariance.ravel().tolist())


def detection_message(
    marker: DetectedMarker, pose: MarkerPose | None, dictionary: str
) -> MarkerDetection:
    """Return a marker, with the chosen one of its two poses if there is a camera_info."""
    message = MarkerDetection(id=marker.id, dictionary=dictionary, bit_errors=marker.bit_errors)
    message.corners = np.asarray(marker.corners, dtype=float).ravel().tolist()
    message.deviations = marker.deviations.ravel().tolist()
    if pose is None:
        message.pose.pose.orientation.w = message.alternative_pose.orientation.w = 1.0
        return message
    estimate = marker.pose
    other = estimate.alternative if pose is estimate.best else estimate.best
    message.size = marker.size
    message.pose = covariance_message(pose)
    message.reprojection_error = pose.error
    message.alternative_pose = marker_pose_message(other)
    message.alternative_reprojection_error = other.error
    message.ambiguous = estimate.ambiguous
    return message


def bundle_message(bundle: ObservedBundle, pose: MarkerPose) -> MarkerBundle:
    """Return a bundle as a message, with the chosen one of its two poses."""
    return MarkerBundle(
        name=bundle.id,
        ids=bundle.seen,
        pose=covariance_message(pose),
        reprojection_error=pose.error,
        ambiguous=bundle.pose.ambiguous,
    )


def marker_transform(header: Header, frame: str, pose: MarkerPose) -> TransformStamped:
    """Return a marker's pose as the transform of a frame."""
    message = TransformStamped(header=header, child_frame_id=frame)
    message.transform.translation = Vector3(*map(float, pose.translation))
    message.transform.rotation = Quaternion(*pose.quaternion)
    return message
