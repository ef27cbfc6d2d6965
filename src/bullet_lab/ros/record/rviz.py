"""Recorded paths for RViz, published at most twice a second and only for subscribers."""

from __future__ import annotations

import threading
from collections import defaultdict
from typing import Callable, Mapping

import rospy
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.ros.node.publishers import Publisher

PERIOD_SECONDS = 0.5


def _repeat(publish: Callable[[], None]) -> None:
    """Call a function every `PERIOD_SECONDS`, in a thread, until ROS shuts down."""

    def run() -> None:
        while not rospy.is_shutdown():
            rospy.rostime.wallsleep(PERIOD_SECONDS)
            publish()

    threading.Thread(target=run, daemon=True).start()


class PathTopics:
    """A latched nav_msgs/Path for each topic of odometry; `topics` has the names of both."""

    def __init__(self, topics: Mapping[str, str]):
        self._paths = {topic: Path() for topic in topics}
        self._publishers = {
            topic: Publisher(path, Path, queue_size=1, latch=True) for topic, path in topics.items()
        }
        self._published = dict.fromkeys(topics, 0)
        _repeat(self._publish)

    def append(self, topic: str, message: Odometry) -> None:
        """Add the pose of a message to its path."""
        path = self._paths.get(topic)
        if path is not None:
            path.header = message.header
            path.poses.append(PoseStamped(message.header, message.pose.pose))

    def forget(self, namespace: str) -> None:
        """Start new paths, as time was set back."""
        for path in self._paths.values():
            path.poses = []

    def _publish(self) -> None:
        for topic, path in self._paths.items():
            poses = list(path.poses)
            publisher = self._publishers[topic]
            if len(poses) != self._published[topic] and publisher.has_connections():
                self._published[topic] = len(poses)
                publisher.publish(Path(path.header, poses))


# As in all figures: the perfect path is orange, the noisy one blue.
COLOURS = {"odom": ColorRGBA(0.90, 0.62, 0.0, 1.0), "noisy_odom": ColorRGBA(0.0, 0.45, 0.70, 1.0)}
# m above the floor.
HEIGHTS = {"odom": 0.01, "noisy_odom": 0.015}
# Sizes in m.
LINE_WIDTH = 0.02
LABEL_HEIGHT = 0.4
LABEL_SIZE = 0.25
WHITE = ColorRGBA(1.0, 1.0, 1.0, 1.0)


class FleetMarkers:
    """The paths of any number of robots on one topic, fleet_paths."""

    def __init__(self):
        self._lock = threading.Lock()
        # By <robot>/odom and <robot>/noisy_odom.
        self._frames: dict[str, str] = {}
        self._points: dict[str, list[Point]] = defaultdict(list)
        self._lengths: dict[str, int] = {}
        self._publisher = Publisher("fleet_paths", MarkerArray, queue_size=1, latch=True)
        _repeat(self._publish)

    def append(self, topic: str, message: Odometry) -> None:
        """Add the position of a message on <robot>/odom or <robot>/noisy_odom."""
        place = message.pose.pose.position
        with self._lock:
            self._frames.setdefault(topic, message.header.frame_id)
            self._points[topic].append(Point(place.x, place.y, 0.0))

    def forget(self, namespace: str) -> None:
        """Start new paths of a robot, as time was set back."""
        with self._lock:
            for which in COLOURS:
                self._points[f"{namespace}/{which}"].clear()

    def _publish(self) -> None:
        if not self._publisher.has_connections():
            return
        with self._lock:
            lengths = {topic: len(points) for topic, points in self._points.items()}
            if lengths == self._lengths:
                return
            self._lengths = lengths
            paths = {topic: list(points) for topic, points in self._points.items() if points}
        markers = [self._line(topic, points) for topic, points in paths.items()]
        for topic, points in paths.items():
            if topic.endswith("/odom"):
                markers.append(self._label(topic, points[-1]))
        self._publisher.publish(MarkerArray(markers))

    def _marker(self, topic: str, name: str, kind: int, color: ColorRGBA) -> Marker:
        marker = Marker(ns=name, type=kind, color=color)
        # Without a stamp, RViz uses the newest transform.
        marker.header.frame_id = self._frames[topic]
        marker.pose.orientation.w = 1.0
        return marker

    def _line(self, topic: str, points: list[Point]) -> Marker:
        which = topic.rpartition("/")[2]
        marker = self._marker(topic, topic, Marker.LINE_STRIP, COLOURS[which])
        marker.pose.position.z = HEIGHTS[which]
        marker.scale.x = LINE_WIDTH
        marker.points = points
        return marker

    def _label(self, topic: str, last: Point) -> Marker:
        """Return a label with the name of a robot, at the end of its perfect path."""
        marker = self._marker(topic, f"{topic}/label", Marker.TEXT_VIEW_FACING, WHITE)
        marker.text, _, _ = topic.rpartition("/")
        marker.scale.z = LABEL_SIZE
        marker.pose.position = Point(last.x, last.y, LABEL_HEIGHT)
        return marker
