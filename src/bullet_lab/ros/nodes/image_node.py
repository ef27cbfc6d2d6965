"""The base of the nodes that process images: when they work, what they take, how they fare.

A node subscribes to the image and its camera_info only while somebody listens to one of its
results. Each image that comes is processed once, in order.

A new detector is a subclass of `ImageNode` with its parameters, and the 7 lines in scripts/ that
run it; `bullet_lab.ros.nodes.harris_corners` is one to begin with.

:ROS Publishers, beside the node's own:
    - ~image_annotated (sensor_msgs/Image): what was found, drawn into the image
    - ~camera_info (sensor_msgs/CameraInfo): that of the image, for each annotated one
    - /diagnostics (diagnostic_msgs/DiagnosticArray), once a second of wall time
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from bullet_lab.core import parameters
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.images import image_message, pixels_of
from bullet_lab.ros.node.diagnostics import Diagnostics, Health, Traffic
from bullet_lab.ros.node.lock_step import join_when
from bullet_lab.ros.node.node import Refusals, private_parameters, run_node
from bullet_lab.ros.node.publishers import Demand, Publisher, subscriber

# Larger than an image, so that old ones do not pile up in the socket.
_BUFFER_BYTES = 2**24
# Wall seconds that the first image waits for its camera_info.
_INFO_PATIENCE = 1.0
# Wall seconds without an image after which that is a warning.
_SILENCE = 1.5


class RepeatedImageError(LabError):
    """An image whose stamp came before."""


@dataclass(frozen=True)
class ImageParameters:
    """Private parameters of all nodes that process images."""

    image: str = parameters.text("/mycamera/image_raw", "topic of the images")
    camera_info: str = parameters.text("", "topic of their camera_info; empty: beside the image")

    @property
    def info_topic(self) -> str:
        """Where camera_info comes from."""
        return self.camera_info or f"{self.image.rpartition('/')[0]}/camera_info".replace("//", "/")


class CameraImage:
    """An image that has come, decoded when it is asked for; `info` is the newest camera_info."""

    def __init__(self, message: Image, info: Optional[CameraInfo]):
        self.header = message.header
        self.info = info
        self.width, self.height = message.width, message.height
        self._message = message
        self._grey: Optional[np.ndarray] = None

    @property
    def grey(self) -> np.ndarray:
        """The image in grey levels, (height, width) uint8; raises ImageError."""
        if self._grey is None:
            self._grey = pixels_of(self._message, "mono8")
        return self._grey

    def colour(self) -> np.ndarray:
        """Return a copy to draw into, (height, width, 3) uint8 BGR; raises ImageError."""
        return pixels_of(self._message, "bgr8").copy()


class ImageNode(ABC):
    """The base of the nodes that process images.

    Args:
        parameters: those of the node.
        always: whether to work even if nobody listens.

    Attributes:
        task: what the node does, for the diagnostics.
        outputs: its private topics and their types; to listen to one is to ask for work.
        parameters: as given.
    """

    task = ""
    outputs: Mapping[str, type] = {}

    def __init__(self, parameters: Any, always: bool = False):
        # One thread is enough, and leaves the other cores to the simulation.
        cv2.setNumThreads(1)
        self.parameters = parameters
        self._lock = threading.Condition()
        self._info: Optional[CameraInfo] = None
        self._waits_for_info = True
        self._last_stamp: Optional[rospy.Time] = None
        # To camera_info and to images, while there is work.
        self._subscribers: List[rospy.Subscriber] = []
        self._demand = Demand(self._start, self._stop, always)
        self._traffic = Traffic()
        self._refusals = Refusals()
        self._trouble = ""
        self._figures: Mapping[str, Any] = {}
        topics = {"image_annotated": Image, "camera_info": CameraInfo, **self.outputs}
        self._publishers: Dict[str, Publisher] = {
            # An old image is of no use; of anything else, 10 may wait.
            topic: self._demand.publisher(
                f"~{topic}", kind, 1 if kind in (Image, CameraInfo) else 10
            )
            for topic, kind in topics.items()
        }
        self._diagnostics = Diagnostics(self.task, self._diagnose)

    # For the nodes

    @abstractmethod
    def process(self, image: CameraImage) -> Mapping[str, Any]:
        """Publish what is found and return figures for the diagnostics; raises LabError."""

    def process_unusable(self, image: CameraImage) -> None:
        """Publish an answer to an image that cannot be used, where an answer is due."""

    def reset(self) -> None:
        """Forget all that was before, as time was set back or the work was interrupted."""

    def health(self) -> Health:
        """Return how the node fares while images come."""
        return Health(DiagnosticStatus.OK, "images come")

    def has_listeners(self, topic: str) -> bool:
        """Return whether somebody listens to an output."""
        return self._publishers[topic].has_connections()

    def publish(self, topic: str, message: Any) -> None:
        """Publish on an output."""
        self._publishers[topic].publish(message)

    def annotate(self, image: CameraImage, draw: Callable[[np.ndarray], None]) -> None:
        """Publish the image, if somebody listens; `draw` gets (height, width, 3) uint8 BGR."""
        if self.has_listeners("image_annotated"):
            canvas = image.colour()
            draw(canvas)
            self.publish("image_annotated", image_message(image.header, canvas, "bgr8"))

    def refuse(self, topic: str, reason: str) -> None:
        """Count something that cannot be used and say why, once a second at most."""
        self._trouble = reason
        self._refusals.refuse(topic, reason)

    # The work

    def start(self) -> None:
        """Begin to work when somebody listens."""
        self._diagnostics.start()
        self._demand.watch()
        join_when(
            self._is_connected, f"a listener, and somebody to publish {self.parameters.image}"
        )

    def _is_connected(self) -> bool:
        with self._lock:
            counts = [one.get_num_connections() for one in self._subscribers]
        return bool(counts) and all(counts)

    def _start(self) -> None:
        with self._lock:
            self._info, self._waits_for_info, self._last_stamp = None, True, None
            self.reset()
            info = subscriber(self.parameters.info_topic, CameraInfo, self._receive_info)
            images = subscriber(
                self.parameters.image, Image, self._receive_image, 1, buffer_bytes=_BUFFER_BYTES
            )
            self._subscribers = [info, images]

    def _stop(self) -> None:
        with self._lock:
            subscribers, self._subscribers = self._subscribers, []
        for one in subscribers:
            one.unregister()

    def _receive_info(self, message: CameraInfo) -> None:
        with self._lock:
            self._info = message
            self._waits_for_info = True
            self._lock.notify_all()

    def _receive_image(self, message: Image) -> None:
        start = time.monotonic()
        try:
            self._check_time(message)
        except RepeatedImageError as error:
            self.refuse(self.parameters.image, str(error))
            return
        image = CameraImage(message, self._info_now())
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

    def _info_now(self) -> Optional[CameraInfo]:
        """Return the newest camera_info; the first image waits for it a little."""
        with self._lock:
            if self._info is None and self._waits_for_info:
                self._lock.wait_for(lambda: self._info is not None, _INFO_PATIENCE)
                self._waits_for_info = self._info is not None
            return self._info

    def _check_time(self, message: Image) -> None:
        stamp, last = message.header.stamp, self._last_stamp
        if last is not None and not stamp.is_zero():
            if stamp == last:
                raise RepeatedImageError(f"a second image of {stamp.to_sec():.3f} s")
            if stamp < last:
                rospy.loginfo("%s: time was set back: starting anew", self.parameters.image)
                self.reset()
        self._last_stamp = stamp

    def _diagnose(self) -> Health:
        figures: Dict[str, str] = self._traffic.figures()
        figures.update({key: str(value) for key, value in dict(self._figures).items()})
        figures["refused"] = str(self._refusals.total)
        health = self._verdict()
        return Health(health.level, health.message, figures)

    def _verdict(self) -> Health:
        if not self._demand.is_there:
            return Health(DiagnosticStatus.OK, "idle: nobody listens")
        if self._traffic.silence > _SILENCE:
            with self._lock:
                known = any(one.get_num_connections() for one in self._subscribers[1:])
            reason = "nothing comes" if known else "nobody publishes it"
            topic = self.parameters.image
            return Health(DiagnosticStatus.WARN, f"no image on {topic}: {reason}")
        if self._trouble:
            return Health(DiagnosticStatus.ERROR, self._trouble)
        return self.health()


def run_image_node(name: str, kind: type, node: Callable[[Any], ImageNode]) -> None:
    """Run a node that processes images, made by `node` of parameters of a kind."""

    def body() -> None:
        node(private_parameters(kind)).start()
        rospy.spin()

    run_node(name, body)
