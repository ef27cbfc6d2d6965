"""From sensor_msgs/CameraInfo to the geometry of an image."""

from __future__ import annotations

import math

from sensor_msgs.msg import CameraInfo

from bullet_lab.core.pinhole import PinholeCamera, PinholeError
from bullet_lab.errors import LabError

_NO_DISTORTION = (0.0,) * 5
_ALLOWED_SKEW = 1e-6


class CameraGeometryError(LabError):
    """A camera_info message that says nothing of use about the image."""


def camera_of(info: CameraInfo, width: int, height: int, rectified: bool = False) -> PinholeCamera:
    """Return the geometry of an image.

    Args:
        info: belongs to the image.
        width: of the image that has come, px.
        height: of it, px.
        rectified: the image is a rectified one: P holds, and there is no distortion.

    Raises:
        CameraGeometryError: nothing there (a zero K), not finite, of another size, binned, or
            with a lens that the pinhole camera has no numbers for.
    """
    numbers = info.P if rectified else info.K
    name = "P" if rectified else "K"
    if not all(map(math.isfinite, (*numbers, *info.D))):
        raise CameraGeometryError(f"camera_info has numbers in {name} or D that are not finite")
    if not any(numbers):
        raise CameraGeometryError(f"camera_info has a zero {name}: the camera is not calibrated")
    row = 4 if rectified else 3
    fx, skew, cx, fy, cy = numbers[0], numbers[1], numbers[2], numbers[row + 1], numbers[row + 2]
    if abs(skew) > _ALLOWED_SKEW * abs(fx) or numbers[row] or numbers[2 * row + 2] != 1.0:
        raise CameraGeometryError(f"camera_info has a {name} that is no pinhole camera's")
    left, top = _region(info, width, height)
    distortion = _NO_DISTORTION if rectified else _distortion(info)
    try:
        return PinholeCamera(width, height, fx, fy, cx - left, cy - top, distortion)
    except PinholeError as error:
        raise CameraGeometryError(f"camera_info: {error}") from error


def _region(info: CameraInfo, width: int, height: int):
    """Return where the image begins in what K is about, px."""
    if info.binning_x > 1 or info.binning_y > 1:
        binning = f"{info.binning_x} x {info.binning_y}"
        raise CameraGeometryError(f"camera_info has {binning} binning, which is not supported")
    region = info.roi
    size = (info.width, info.height)
    if region.width or region.height:
        size = (region.width or info.width, region.height or info.height)
    if size != (width, height):
        described = f"{size[0]} x {size[1]}"
        raise CameraGeometryError(f"camera_info is about {described} px, not {width} x {height}")
    return region.x_offset, region.y_offset


def _distortion(info: CameraInfo):
    values = tuple(info.D)
    if not any(values):
        return _NO_DISTORTION
    if info.distortion_model != "plumb_bob" or len(values) not in (4, 5):
        kind = f"'{info.distortion_model}' with {len(values)} numbers"
        raise CameraGeometryError(f"camera_info has the lens {kind}, only plumb_bob is known")
    return (*values, 0.0)[:5]
