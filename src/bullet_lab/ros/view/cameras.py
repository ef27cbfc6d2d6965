"""Displays of images, and of clouds of points from depth cameras and turning lasers."""

from __future__ import annotations

import math
import time
from typing import Any, Callable

import cv2
import numpy as np
from sensor_msgs.msg import Image, PointCloud2, PointField

from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.view.displays import Display, placed
from bullet_lab.ros.view.frames import DisplayContext
from bullet_lab.ros.view.scene import PointsNode
from bullet_lab.ros.view.subscription import MessageError, Subscription, reader_of

# Encodings of depth images, with m per unit; far points are drawn darker.
DEPTHS = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 0.001)}
MAX_DEPTH = 10.0
MAX_WIDTH = 640
FIELD_TYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
# Larger clouds are thinned out, for the network and for the browser.
MAX_POINTS = 8000
POINT_SIZE = 0.015
GREY = 128


class CameraDisplay:
    """Shows the images of one topic at a limited rate.

    Args:
        show: takes an image (h, w, 3) uint8 RGB.
        rate: images per second at most.
    """

    def __init__(self, show: Callable[[np.ndarray], None], rate: float):
        self._show = show
        self._period = 1.0 / rate
        self._topic = ""
        self._subscription: Subscription | None = None
        self._last = -math.inf

    def follow(self, topic: str) -> None:
        """Show the images of a topic; none if it is empty."""
        if topic == self._topic:
            return
        self.close()
        self._topic = topic
        if topic:
            self._subscription = Subscription(topic, reader_of(Image, visible), large=True)

    def tick(self) -> None:
        """Show the newest image."""
        if self._subscription is None or time.monotonic() - self._last < self._period:
            return
        pixels = self._subscription.newest()
        if pixels is not None:
            self._last = time.monotonic()
            self._show(pixels)

    def close(self) -> None:
        """Unsubscribe."""
        if self._subscription is not None:
            self._subscription.close()
        self._subscription = None
        self._topic = ""


def visible(message: Image) -> np.ndarray:
    """Return an image as (h, w, 3) uint8 RGB, scaled down if wide; raises ImageError."""
    if message.encoding in DEPTHS:
        pixels = cv2.cvtColor(_grey_of_depths(message), cv2.COLOR_GRAY2RGB)
    else:
        pixels = cv2.cvtColor(pixels_of(message, "bgr8"), cv2.COLOR_BGR2RGB)
    height, width = pixels.shape[:2]
    if width > MAX_WIDTH:
        size = (MAX_WIDTH, max(1, height * MAX_WIDTH // width))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return pixels


def _grey_of_depths(message: Image) -> np.ndarray:
    kind, metres = DEPTHS[message.encoding]
    rows = pixels_of(message, message.encoding).astype(kind) * metres
    rows = np.nan_to_num(rows, nan=MAX_DEPTH, posinf=MAX_DEPTH)
    return (255.0 * (1.0 - np.clip(rows / MAX_DEPTH, 0.0, 1.0))).astype(np.uint8)


class PointsDisplay(Display):
    """The points of a cloud, in their colours if it has any."""

    def __init__(self, context: DisplayContext, topic: str):
        super().__init__(context, topic, reader_of(PointCloud2), large=True)
        self._cloud = PointsNode(self._make)
        self._parts = [self._cloud]

    def show(self, message: PointCloud2) -> None:  # noqa: D102 - inherited
        points, colours = points_of(message)
        points = placed(self.context.pose_of(message.header.frame_id), points)
        self._cloud.set(points, colors=colours)

    def _make(self, points: np.ndarray, colors: np.ndarray) -> Any:
        return self.context.scene.add_point_cloud(
            self.node, points, colors, point_size=POINT_SIZE, precision="float32"
        )


def points_of(message: PointCloud2, most: int = MAX_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 3) in m and colours (n, 3) uint8 of at most so many points of a cloud.

    Points that are not finite are left out. Raises MessageError if the cloud is invalid.
    """
    fields = {field.name: field for field in message.fields}
    if not fields.keys() >= set("xyz"):
        raise MessageError("the cloud has no x, y and z; these fields are needed")
    order = ">" if message.is_bigendian else "<"
    try:
        layout = {
            "names": list(fields),
            "formats": [order + FIELD_TYPES[field.datatype] for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": message.point_step,
        }
        shape, strides = (message.height, message.width), (message.row_step, message.point_step)
        rows = np.ndarray(shape, layout, message.data, strides=strides).reshape(-1)
    except (KeyError, TypeError, ValueError) as error:
        raise MessageError(f"the cloud does not match its declared layout: {error}") from error
    positions = np.column_stack([rows[name] for name in "xyz"]).astype(np.float64)
    chosen = np.flatnonzero(np.isfinite(positions).all(axis=1))
    chosen = chosen[:: max(1, -(-len(chosen) // most))]
    colours = np.full((len(chosen), 3), GREY, np.uint8)
    packed = next((rows[name] for name in ("rgb", "rgba") if name in fields), None)
    if packed is not None and packed.dtype.itemsize == 4:
        # Four bytes from blue upwards, whether the field is declared as a float or an integer.
        words = np.ascontiguousarray(packed[chosen]).view(np.uint32)
        colours = np.stack([words >> shift & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)
    return positions[chosen], colours
