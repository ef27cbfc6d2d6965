"""Nodes that process images: their base class, and those of figure 7 but for aruco.

They show the image (view_camera), its edges (canny_edges), corners (harris_corners) and good
features (good_features, by Shi and Tomasi). A node subscribes to the image and its camera_info only
while one of its results has a subscriber. It processes each image once, in order.

A new detector is a subclass of `ImageNode` with its parameters, and an executable in scripts/.

:ROS Parameters: see `ImageParameters` and those of the node
:ROS Subscribers, while a result has a subscriber: ~image and its camera_info
:ROS Publishers:
    - canny_edges: ~edges (sensor_msgs/Image), mono8: 255 on an edge, as in figure 7a
    - harris_corners, good_features: ~points (bullet_lab/ImagePoints), the strongest first
    - ~image_annotated (sensor_msgs/Image): the image with the results drawn into it: edges in blue,
      corners as squares as in figure 7d, good features as discs as in 7c
    - ~camera_info (sensor_msgs/CameraInfo): of each annotated image
    - /diagnostics (diagnostic_msgs/DiagnosticArray), once a second of wall time
"""

from __future__ import annotations

import functools
import math
import posixpath
import statistics
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from typing import Any, Callable, Mapping, NamedTuple

import cv2
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy import ndarray
from sensor_msgs.msg import CameraInfo, Image

from bullet_lab.core.parameters import integer, number, odd, text
from bullet_lab.errors import LabError
from bullet_lab.msg import ImagePoints
from bullet_lab.ros.messages.images import image_message, pixels_of, points_message
from bullet_lab.ros.node.lock_step import Publisher, join_when, publisher, subscriber
from bullet_lab.ros.node.node import Refusals, node
from bullet_lab.vision import features
from bullet_lab.vision.drawing import draw_area, draw_points, draw_text

# Larger than an image, so that old images do not collect in the socket.
_BUFFER_BYTES = 2**24
# Wall seconds that the first image waits for its camera_info.
_INFO_PATIENCE = 1.0
# Wall seconds without an image until the diagnostics warn.
_SILENCE = 1.5
# Wall seconds between two checks for subscribers that have come, gone or died.
_CHECK_SECONDS = 0.05
# Wall seconds between two messages on /diagnostics, and over which rates are counted.
_PERIOD = 1.0
_WINDOW = 2.0
# More than a node can have in that time.
_MOST_RESULTS = 10_000

Diagnostics = Mapping[str, Any]
"""Figures of an image by their names on /diagnostics."""


@dataclass(frozen=True)
class ImageParameters:
    """Private parameters of all nodes that process images."""

    image: str = text("/mycamera/image_raw", "topic of the images")
    camera_info: str = text("", "topic of their camera_info; empty: beside the image")

    @property
    def info_topic(self) -> str:
        """The topic of camera_info."""
        return self.camera_info or posixpath.join(posixpath.dirname(self.image), "camera_info")


class CameraImage:
    """An image, which is decoded on demand; `info` is the newest camera_info."""

    def __init__(self, message: Image, info: CameraInfo | None):
        self.header = message.header
        self.info = info
        self.width = message.width
        self.height = message.height
        self._message = message

    @functools.cached_property
    def grey(self) -> ndarray:
        """The image in grey levels, (height, width) uint8; raises ImageError."""
        return pixels_of(self._message, "mono8")

    def colour(self) -> ndarray:
        """Return a copy to draw into, (height, width, 3) uint8 BGR; raises ImageError."""
        return pixels_of(self._message, "bgr8").copy()


class Health(NamedTuple):
    """A level of DiagnosticStatus, and a message."""

    level: int
    message: str


class Traffic:
    """Rate and latency of a node's results over the last two seconds of wall time."""

    def __init__(self):
        # When each result was there, and how long it took.
        self._done: deque[tuple[float, float]] = deque(maxlen=_MOST_RESULTS)
        self._total = 0

    def note(self, seconds: float) -> None:
        """Count a result, `seconds` after its input had arrived."""
        self._total += 1
        self._done.append((time.monotonic(), seconds))

    def figures(self) -> dict[str, str]:
        """Return the number of results, their rate and latency as text."""
        latencies = [seconds for _, seconds in self._recent()]
        figures = {"frames": str(self._total), "frame rate (Hz)": f"{len(latencies) / _WINDOW:.1f}"}
        if latencies:
            figures["latency median (ms)"] = f"{1e3 * statistics.median(latencies):.1f}"
            figures["latency max (ms)"] = f"{1e3 * max(latencies):.1f}"
        return figures

    @property
    def silence(self) -> float:
        """Wall seconds since the last result, at most two."""
        recent = self._recent()
        return time.monotonic() - recent[-1][0] if recent else _WINDOW

    def _recent(self) -> list[tuple[float, float]]:
        start = time.monotonic() - _WINDOW
        return [one for one in tuple(self._done) if one[0] >= start]


class ImageNode(ABC):
    """The base class of nodes that process images.

    Args:
        parameters: of the node.
        always: whether to process images even without a subscriber to a result.

    Attributes:
        task: of the node, for the diagnostics.
        outputs: its private topics and their types; the node works while one has a subscriber.
        parameters: as given.
        health: of the node while images come.
    """

    task = ""
    outputs: Mapping[str, type] = {}

    def __init__(self, parameters: Any, always: bool = False):
        # One thread is enough and leaves the other cores to the simulation.
        cv2.setNumThreads(1)
        self.parameters = parameters
        self._lock = threading.Condition()
        self._info: CameraInfo | None = None
        self._last_stamp: rospy.Time | None = None
        # To camera_info and to the images, while there is demand.
        self._subscribers: list[rospy.Subscriber] = []
        self._always = always
        self._traffic = Traffic()
        self._refusals = Refusals()
        self._trouble = ""
        self._figures: Diagnostics = {}
        self.health = Health(DiagnosticStatus.OK, "images come")
        topics = {"image_annotated": Image, "camera_info": CameraInfo, **self.outputs}
        self._publishers = {
            # Old images are of no use.
            topic: publisher(f"~{topic}", kind, 1 if kind in (Image, CameraInfo) else 10)
            for topic, kind in topics.items()
        }
        self._diagnostics = Publisher("/diagnostics", DiagnosticArray, queue_size=10)

    # For subclasses

    @abstractmethod
    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the results and return figures for the diagnostics; raises LabError."""

    def process_unusable(self, image: CameraImage) -> None:
        """Publish an empty result for an image that cannot be used."""

    def reset(self) -> None:
        """Forget earlier images, as time was set back or some are missing."""

    def has_listeners(self, topic: str) -> bool:
        """Return whether an output has a subscriber."""
        return self._publishers[topic].has_connections()

    def publish(self, topic: str, message: Any) -> None:
        """Publish on an output."""
        self._publishers[topic].publish(message)

    def annotate(self, image: CameraImage, draw: Callable[[ndarray], None]) -> None:
        """Publish the image if it has a subscriber; `draw` gets (height, width, 3) uint8 BGR."""
        if self.has_listeners("image_annotated"):
            canvas = image.colour()
            draw(canvas)
            self.publish("image_annotated", image_message(image.header, canvas, "bgr8"))

    def refuse(self, topic: str, reason: str) -> None:
        """Count a message that cannot be used, and log the reason at most once a second."""
        self._trouble = reason
        self._refusals.refuse(topic, reason)

    # Images

    def run(self) -> None:
        """Process images while a result has a subscriber, until ROS shuts down."""
        what = f"a subscriber to a result and a publisher of {self.parameters.image}"
        join_when(self._is_connected, what)
        reported = -math.inf
        while not rospy.is_shutdown():
            self._follow_demand()
            if time.monotonic() - reported >= _PERIOD:
                reported = time.monotonic()
                self._report()
            time.sleep(_CHECK_SECONDS)

    def _is_connected(self) -> bool:
        self._follow_demand()
        counts = [one.get_num_connections() for one in self._subscribers]
        return bool(counts) and all(counts)

    def _follow_demand(self) -> None:
        """Subscribe when the first subscriber to a result comes, and unsubscribe after the last."""
        for one in self._publishers.values():
            # rospy itself checks only when it writes whether a subscriber is alive.
            if one.has_connections():
                one.impl.check()
        wanted = self._always or any(one.has_connections() for one in self._publishers.values())
        if wanted != bool(self._subscribers):
            (self._start if wanted else self._stop)()

    def _start(self) -> None:
        with self._lock:
            self._info = self._last_stamp = None
            self.reset()
            info = subscriber(self.parameters.info_topic, CameraInfo, self._receive_info)
            images = subscriber(
                self.parameters.image, Image, self._receive_image, 1, buffer_bytes=_BUFFER_BYTES
            )
            self._subscribers = [info, images]

    def _stop(self) -> None:
        for one in self._subscribers:
            one.unregister()
        self._subscribers = []

    def _receive_info(self, message: CameraInfo) -> None:
        with self._lock:
            self._info = message
            self._lock.notify_all()

    def _receive_image(self, message: Image) -> None:
        start = time.monotonic()
        stamp, last = message.header.stamp, self._last_stamp
        self._last_stamp = stamp
        if last is not None and not stamp.is_zero():
            if stamp == last:
                reason = f"duplicate image with stamp {stamp.to_sec():.3f} s"
                self.refuse(self.parameters.image, reason)
                return
            if stamp < last:
                rospy.loginfo("%s: time was set back: resetting", self.parameters.image)
                self.reset()
        with self._lock:
            if last is None:
                self._lock.wait_for(lambda: self._info is not None, _INFO_PATIENCE)
            image = CameraImage(message, self._info)
        try:
            self._figures = self.process(image)
            self._trouble = ""
        except LabError as error:
            self.refuse(self.parameters.image, str(error))
            self.process_unusable(image)
        if image.info is not None and self.has_listeners("camera_info"):
            image.info.header = message.header
            self.publish("camera_info", image.info)
        self._traffic.note(time.monotonic() - start)

    def _report(self) -> None:
        """Publish the health of the node.

        diagnostic_updater measures its period and its rates in ROS time, which passes a hundred
        times as fast at full speed, and not at all while the simulation is paused.
        """
        figures = {**self._traffic.figures(), **self._figures, "refused": self._refusals.total}
        values = [KeyValue(key, str(value)) for key, value in figures.items()]
        level, line = self._verdict()
        name = f"{rospy.get_name().lstrip('/')}: {self.task}"
        message = DiagnosticArray(status=[DiagnosticStatus(level, name, line, "", values)])
        message.header.stamp = rospy.Time.now()
        self._diagnostics.publish(message)

    def _verdict(self) -> Health:
        if not self._subscribers:
            return Health(DiagnosticStatus.OK, "idle: no subscriber")
        if self._traffic.silence > _SILENCE:
            reason = "no messages" if self._subscribers[1].get_num_connections() else "no publisher"
            topic = self.parameters.image
            return Health(DiagnosticStatus.WARN, f"no image on {topic}: {reason}")
        if self._trouble:
            return Health(DiagnosticStatus.ERROR, self._trouble)
        return self.health


class ViewCamera(ImageNode):
    """Publishes images with their time and size written into them."""

    task = "camera view"

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the image."""
        size = f"{image.width} x {image.height}"
        stamp = image.header.stamp.to_sec()
        self.annotate(image, lambda canvas: draw_text(canvas, f"{size}  {stamp:.2f} s", (8, 16)))
        return {"size": size, "mean grey level": f"{image.grey.mean():.0f}"}


@dataclass(frozen=True)
class CannyParameters(ImageParameters):
    """Private parameters of canny_edges."""

    low: float = number(100.0, "least gradient of an edge pixel", minimum=0.0)
    high: float = number(200.0, "least gradient of a strong edge pixel", minimum=0.0)
    aperture: int = odd(3, "size of the Sobel operator, px", 3, 7)


class CannyEdges(ImageNode):
    """Publishes the edges of each image."""

    task = "edge detection"
    outputs = {"edges": Image}

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the edges."""
        given = self.parameters
        edges = cv2.Canny(image.grey, given.low, given.high, apertureSize=given.aperture)
        self.publish("edges", image_message(image.header, edges, "mono8"))
        self.annotate(image, lambda canvas: draw_area(canvas, edges > 0))
        return {"edge pixels": cv2.countNonZero(edges)}


@dataclass(frozen=True)
class HarrisParameters(ImageParameters):
    """Private parameters of harris_corners."""

    block_size: int = integer(2, "size of the neighbourhood, px", 1, 31)
    aperture: int = odd(3, "size of the Sobel operator, px", 1, 31)
    k: float = number(0.04, "Harris' free parameter", above=0.0, maximum=0.25)
    threshold: float = number(
        0.01, "least response, as a share of the largest", above=0.0, maximum=1.0
    )


class HarrisCorners(ImageNode):
    """Publishes the corners of each image."""

    task = "corner detection"
    outputs = {"points": ImagePoints}

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the corners."""
        given = self.parameters
        area, points = features.harris_corners(
            image.grey, given.block_size, given.aperture, given.k, given.threshold
        )
        self.publish("points", points_message(image.header, image.grey.shape, points))
        self.annotate(image, lambda canvas: draw_area(canvas, area))
        return {"corners": len(points)}


@dataclass(frozen=True)
class GoodFeaturesParameters(ImageParameters):
    """Private parameters of good_features."""

    max_corners: int = integer(25, "greatest number of features", 1, 100000)
    quality: float = number(
        0.01, "least strength, as a share of the strongest", above=0.0, maximum=1.0
    )
    min_distance: float = number(10.0, "px between two features", minimum=0.0)


class GoodFeatures(ImageNode):
    """Publishes the good features of each image."""

    task = "feature detection"
    outputs = {"points": ImagePoints}

    def process(self, image: CameraImage) -> Diagnostics:
        """Publish the features."""
        given = self.parameters
        points = features.good_features(
            image.grey, given.max_corners, given.quality, given.min_distance
        )
        self.publish("points", points_message(image.header, image.grey.shape, points))
        self.annotate(image, lambda canvas: draw_points(canvas, points))
        return {"features": len(points)}


@node
def view_camera(parameters: ImageParameters) -> None:
    """Run until ROS shuts down."""
    ViewCamera(parameters).run()


@node
def canny_edges(parameters: CannyParameters) -> None:
    """Run until ROS shuts down."""
    CannyEdges(parameters).run()


@node
def harris_corners(parameters: HarrisParameters) -> None:
    """Run until ROS shuts down."""
    HarrisCorners(parameters).run()


@node
def good_features(parameters: GoodFeaturesParameters) -> None:
    """Run until ROS shuts down."""
    GoodFeatures(parameters).run()
