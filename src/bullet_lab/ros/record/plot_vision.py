"""Saves the results of the five detectors for one image, side by side as in figure 7.

:ROS Parameters: see `PlotVisionParameters`.
:ROS Subscribers:
    - view_camera/image_annotated, canny_edges/edges, good_features/image_annotated,
      harris_corners/image_annotated, aruco/image_annotated (sensor_msgs/Image)
    - good_features/points, harris_corners/points (bullet_lab/ImagePoints)
    - aruco/detections (bullet_lab/MarkerDetectionArray)

Writes a picture of each detector, marker.png if one is found, side_by_side.png and summary.json.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Mapping

import rospy
from message_filters import SimpleFilter, TimeSynchronizer

from bullet_lab.core.parameters import number, text
from bullet_lab.reports import save_all
from bullet_lab.reports.vision import VisionReport
from bullet_lab.ros.node.lock_step import join_when
from bullet_lab.ros.node.node import NodeError, node
from bullet_lab.ros.node.publishers import subscriber
from bullet_lab.ros.record.recorder import POLL_SECONDS, RecordParameters, reader_of

# Wall seconds to wait for results of one image, once each detector has sent a result.
_PATIENCE = 5.0
# Number of images that the fastest detector may be ahead of the slowest.
_QUEUE = 100


@dataclass(frozen=True)
class PlotVisionParameters(RecordParameters):
    """Private parameters of plot_vision."""

    out: str = text("results/vision", "folder for the files")
    settle: float = number(1.0, "simulated seconds before the image", minimum=0.0)
    timeout: float = number(90.0, "wall seconds to wait for all results", above=0.0)


class SameImage:
    """Collects the results of all detectors for one image.

    Args:
        topics: of the results, with the types of their messages.
        settle: simulated seconds; earlier images are ignored.
    """

    def __init__(self, topics: Mapping[str, str], settle: float):
        self._settle = settle
        self._lock = threading.Lock()
        self._newest: dict[str, Any] = {}
        self._found: dict[str, Any] | None = None
        self._filters = {topic: SimpleFilter() for topic in topics}
        self._synchronizer = TimeSynchronizer(list(self._filters.values()), _QUEUE)
        self._synchronizer.registerCallback(self._take)
        # After the synchronizer, which needs their messages.
        self._subscribers = [
            subscriber(topic, reader_of(kind)[0], partial(self._receive, topic))
            for topic, kind in topics.items()
        ]

    def is_connected(self) -> bool:
        """Return whether every topic has a publisher."""
        return all(subscriber.get_num_connections() > 0 for subscriber in self._subscribers)

    def wait(self, timeout: float) -> Mapping[str, Any]:
        """Return a message of each topic, all for one image if such messages come.

        Raises NodeError if a topic has no message after `timeout` wall seconds.
        """
        deadline, whole_since = time.monotonic() + timeout, None
        while not rospy.is_shutdown():
            now = time.monotonic()
            with self._lock:
                missing = [topic for topic in self._filters if topic not in self._newest]
                if self._found is not None:
                    return self._found
                whole_since = None if missing else whole_since or now
                if whole_since is not None and now - whole_since > _PATIENCE:
                    rospy.logwarn("no image has results of all detectors; using the newest ones")
                    return dict(self._newest)
            if now > deadline:
                what = ", ".join(missing) or "results of one image"
                raise NodeError(f"nothing on {what} within {timeout:g} s")
            time.sleep(POLL_SECONDS)
        raise rospy.ROSInterruptException("shutdown")

    def close(self) -> None:
        """Unsubscribe."""
        for one in self._subscribers:
            one.unregister()

    def _receive(self, topic: str, message: Any) -> None:
        if message.header.stamp.to_sec() >= self._settle:
            with self._lock:
                self._newest[topic] = message
            self._filters[topic].signalMessage(message)

    def _take(self, *messages: Any) -> None:
        with self._lock:
            if self._found is None:
                self._found = dict(zip(self._filters, messages))


@node
def plot_vision(parameters: PlotVisionParameters) -> None:
    """Wait for the results for one image and save them."""
    report = VisionReport(Path(parameters.out))
    report.about = parameters.about
    answers = SameImage(report.topics, parameters.settle)
    join_when(answers.is_connected, "the detectors")
    messages = answers.wait(parameters.timeout)
    answers.close()
    for topic, kind in report.topics.items():
        report.take(topic, reader_of(kind)[1](messages[topic]))
    summary = save_all(report, True)
    for name, line in report.found.items():
        rospy.loginfo("%s: %s", name, line)
    rospy.loginfo("%s", report.line(summary))
