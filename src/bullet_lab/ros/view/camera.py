"""The image of a camera, with what was found in it, on the page."""

from __future__ import annotations

import math
import time
from typing import Any, Callable, Optional

import cv2
import numpy as np
from sensor_msgs.msg import Image

from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.view.feeds import Feed, reader_of

# Distances, which grow darker with the distance; 16UC1 has them in mm.
DEPTHS = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 0.001)}
DEEPEST = 10.0
WIDEST = 640


class CameraDisplay:
    """The images of one topic, as many a second as there is use for.

    Args:
        show: takes an image (h, w, 3) uint8 RGB.
        rate: images per second at most.
    """

    def __init__(self, show: Callable[[np.ndarray], None], rate: float):
        self._show, self._period = show, 1.0 / rate
        self._topic = ""
        self._feed: Optional[Feed] = None
        self._last = -math.inf

    def follow(self, topic: str) -> None:
        """Show the images of a topic; none, where it is empty."""
        if topic == self._topic:
            return
        self.close()
        self._topic = topic
        self._feed = Feed(topic, lambda data: seen(READ(data)), large=True) if topic else None

    def tick(self) -> None:
        """Show what has come."""
        if self._feed is None or time.monotonic() - self._last < self._period:
            return
        pixels = self._feed.newest()
        if pixels is not None:
            self._last = time.monotonic()
            self._show(pixels)

    def close(self) -> None:
        """Listen no longer."""
        if self._feed is not None:
            self._feed.close()
        self._feed, self._topic = None, ""


READ = reader_of(Image)


def seen(message: Any) -> np.ndarray:
    """Return what is to be seen of an image, (h, w, 3) uint8 RGB; raises ImageError."""
    if message.encoding in DEPTHS:
        grey = _grey_of_depths(message)
        pixels = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
    else:
        pixels = cv2.cvtColor(pixels_of(message, "bgr8"), cv2.COLOR_BGR2RGB)
    height, width = pixels.shape[:2]
    if width > WIDEST:
        size = (WIDEST, max(1, height * WIDEST // width))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return pixels


def _grey_of_depths(message: Any) -> np.ndarray:
    kind, metres = DEPTHS[message.encoding]
    rows = pixels_of(message, message.encoding).astype(kind) * metres
    rows = np.nan_to_num(rows, nan=DEEPEST, posinf=DEEPEST)
    return (255.0 * (1.0 - np.clip(rows / DEEPEST, 0.0, 1.0))).astype(np.uint8)
