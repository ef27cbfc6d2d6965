"""What the nodes that look at images share: when they work, what they take, how they fare.

A node subscribes to the image (and, where it wants it, to camera_info) only while somebody
listens to one of its results. Each image that comes is answered once, in order.

:ROS Publishers, beside the node's own:
    - ~image_annotated (sensor_msgs/Image): what was found, drawn into the image
    - ~camera_info (sensor_msgs/CameraInfo): that of the image, for each annotated one
    - /diagnostics (diagnostic_msgs/DiagnosticArray), once a second of wall time
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, Mapping, Optional

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from bullet_lab.errors import LabError
from bullet_lab.ros.messages.images import image_message, pixels_of
from bullet_lab.ros.node import parameters
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


class FrameError(LabError):
    """An image that cannot be answered."""


@dataclass(frozen=True)
class ImageParameters:
    """Private parameters of all nodes that look at images."""

    image: str = parameters.text("/mycamera/image_raw", "topic of the images")
    camera_info: str = parameters.text("", "topic of their camera_info; empty: beside the image")

    @property
    def info_topic(self) -> str:
        """Where camera_info comes from."""
        return self.camera_info or f"{self.image.rpartition('/')[0]}/camera_info".replace("//", "/")


class Frame:
    """An image that has come, decoded when it is asked for."""

    def __init__(self, message: Image, info: Optional[CameraInfo]):
        self.header = message.header
        self.info = info
        self.width, self.height = message.width, message.height
        self._message = message
        self._grey: Optional[np.ndarray] = None

    @property
    def grey(self) -> np.ndarray:
        """The image in grey levels; raises ImageError."""
        if self._grey is None:
            self._grey = pixels_of(self._message, "mono8")
        return self._grey

    def colour(self) -> np.ndarray:
        """Return a copy of the image, bgr8, to draw into; raises ImageError."""
        return pixels_of(self._message, "bgr8").copy()


class ImageNode:
    """The base of the nodes that look at images.

    Args:
        wanted: parameters.
        task: what the node does, for the diagnostics.
        always: whether to work even if nobody listens.
    """

    def __init__(self, wanted: ImageParameters, task: str, always: bool = False):
        # One thread is enough, and leaves the other cores to the simulation.
        cv2.setNumThreads(1)
        self._wanted = wanted
        self._lock = threading.Condition()
        self._info: Optional[CameraInfo] = None
        self._waits_for_info = True
        self._last_stamp: Optional[rospy.Time] = None
        self._image_subscriber: Optional[rospy.Subscriber] = None
        self._info_subscriber: Optional[rospy.Subscriber] = None
        self._demand = Demand(self._start, self._stop, always)
        self._traffic = Traffic()
        self._refusals = Refusals()
        self._trouble = ""
        self._figures: Mapping[str, Any] = {}
        self._annotated = self.output("image_annotated", Image, queue_size=1)
        self._copied_info = self.output("camera_info", CameraInfo, queue_size=1)
        self._diagnostics = Diagnostics(task, self._health)

    # For the nodes

    def output(self, topic: str, kind: type, queue_size: int = 10) -> Publisher:
        """Return a publisher on a private topic, to which to listen is to ask for work."""
        return self._demand.publisher(f"~{topic}", kind, queue_size)

    def look(self, frame: Frame) -> Mapping[str, Any]:
        """Answer an image and return figures for the diagnostics; raises LabError."""
        raise NotImplementedError

    def look_away(self, frame: Frame) -> None:
        """Answer an image that cannot be used, where an answer is due."""

    def forget(self) -> None:
        """Forget all that was before, as time was set back or the work was interrupted."""

    def state(self) -> Health:
        """Return how the node fares while images come."""
        return Health(DiagnosticStatus.OK, "images come")

    def annotate(self, frame: Frame, draw: Callable[[np.ndarray], None]) -> None:
        """Publish the image with something drawn into it, if somebody listens.

        Args:
            frame: the image.
            draw: draws into a (h, w, 3) BGR array.
        """
        if self._annotated.has_connections():
            canvas = frame.colour()
            draw(canvas)
            self._annotated.publish(image_message(frame.header, canvas, "bgr8"))

    def refuse(self, topic: str, reason: str) -> None:
        """Count something that cannot be used and say why, once a second at most."""
        self._trouble = reason
        self._refusals.refuse(topic, reason)

    # The work

    def start(self) -> None:
        """Begin to work when somebody listens."""
        self._diagnostics.start()
        self._demand.watch()
        join_when(self._is_connected, f"a listener, and somebody to publish {self._wanted.image}")

    def _is_connected(self) -> bool:
        with self._lock:
            subscribers = (self._image_subscriber, self._info_subscriber)
        return all(s is not None and s.get_num_connections() > 0 for s in subscribers)

    def _start(self) -> None:
        with self._lock:
            self._info, self._waits_for_info, self._last_stamp = None, True, None
            self.forget()
            self._info_subscriber = subscriber(
                self._wanted.info_topic, CameraInfo, self._receive_info
            )
            self._image_subscriber = subscriber(
                self._wanted.image,
                Image,
                self._receive_image,
                queue_size=1,
                buffer_bytes=_BUFFER_BYTES,
            )

    def _stop(self) -> None:
        with self._lock:
            subscribers = (self._image_subscriber, self._info_subscriber)
            self._image_subscriber = self._info_subscriber = None
        for one in subscribers:
            if one is not None:
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
        except FrameError as error:
            self.refuse(self._wanted.image, str(error))
            return
        frame = Frame(message, self._info_now())
        try:
            self._figures = self.look(frame)
            self._trouble = ""
        except LabError as error:
            self.refuse(self._wanted.image, str(error))
            self.look_away(frame)
        if frame.info is not None and self._copied_info.has_connections():
            frame.info.header = message.header
            self._copied_info.publish(frame.info)
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
                raise FrameError(f"a second image of {stamp.to_sec():.3f} s")
            if stamp < last:
                rospy.loginfo("%s: time was set back: starting anew", self._wanted.image)
                self.forget()
        self._last_stamp = stamp

    def _health(self) -> Health:
        figures: Dict[str, str] = self._traffic.figures()
        figures.update({key: str(value) for key, value in dict(self._figures).items()})
        figures["refused"] = str(self._refusals.total)
        level, message = self._verdict()
        return Health(level, message, figures)

    def _verdict(self):
        if not self._demand.is_there:
            return DiagnosticStatus.OK, "idle: nobody listens"
        if self._traffic.silence > _SILENCE:
            with self._lock:
                subscriber = self._image_subscriber
            known = subscriber is not None and subscriber.get_num_connections() > 0
            reason = "nothing comes" if known else "nobody publishes it"
            return DiagnosticStatus.WARN, f"no image on {self._wanted.image}: {reason}"
        if self._trouble:
            return DiagnosticStatus.ERROR, self._trouble
        state = self.state()
        return state.level, state.message


def run_image_node(name: str, kind: type, node: Callable[[Any], ImageNode]) -> None:
    """Run a node that looks at images.

    Args:
        name: of the node.
        kind: the dataclass of its parameters.
        node: makes it from them.
    """

    def body() -> None:
        node(private_parameters(kind)).start()
        rospy.spin()

    run_node(name, body)
