"""Recorded paths for RViz: published twice a second at most, and only if somebody looks."""

from __future__ import annotations

import threading
from collections import defaultdict
from typing import Callable, Dict, List, Mapping, Optional

import rospy
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.ros.node.publishers import Publisher

PERIOD_SECONDS = 0.5


def _often(publish: Callable[[], None]) -> None:
    """Call a function from a thread of its own until ROS shuts down."""

    def run() -> None:
        while not rospy.is_shutdown():
            rospy.rostime.wallsleep(PERIOD_SECONDS)
            publish()

    threading.Thread(target=run, daemon=True).start()


class PathTopics:
    """A latched nav_msgs/Path for each topic of odometry, by the names of both."""

    def __init__(self, topics: Mapping[str, str]):
        self._paths = {topic: Path() for topic in topics}
        self._publishers = {
            topic: Publisher(path, Path, queue_size=1, latch=True) for topic, path in topics.items()
        }
        self._published = dict.fromkeys(topics, 0)
        _often(self._publish)

    def append(self, topic: str, message: Odometry) -> None:
        """Add where a message says that the robot is."""
        path = self._paths.get(topic)
        if path is not None:
            path.header = message.header
            path.poses.append(PoseStamped(message.header, message.pose.pose))

    def forget(self, namespace: str) -> None:
        """Start new paths."""
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
LINE_WIDTH, LABEL_HEIGHT, LABEL_SIZE = 0.02, 0.4, 0.25
WHITE = ColorRGBA(1.0, 1.0, 1.0, 1.0)


class FleetMarkers:
    """The paths of several robots, in one display whatever their number: fleet_paths."""

    def __init__(self):
        self._lock = threading.Lock()
        # By <robot>/odom and <robot>/noisy_odom.
        self._frames: Dict[str, str] = {}
        self._points: Dict[str, List[Point]] = defaultdict(list)
        self._lengths: Dict[str, int] = {}
        self._publisher = Publisher("fleet_paths", MarkerArray, queue_size=1, latch=True)
        _often(self._publish)

    def append(self, topic: str, message: Odometry) -> None:
        """Add where a message on <robot>/odom or <robot>/noisy_odom says that a robot is."""
        place = message.pose.pose.position
        with self._lock:
            self._frames.setdefault(topic, message.header.frame_id)
            self._points[topic].append(Point(place.x, place.y, 0.0))

    def forget(self, namespace: str) -> None:
        """Begin the paths of a robot anew."""
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
        lines = [self._line(topic, points) for topic, points in paths.items()]
        labels = [self._label(topic, points[-1]) for topic, points in paths.items()]
        self._publisher.publish(MarkerArray(lines + [label for label in labels if label]))

    def _marker(self, topic: str, name: str, kind: int, color: ColorRGBA) -> Marker:
        marker = Marker(ns=name, type=kind, color=color)
        # Without a stamp, RViz takes the newest transform.
        marker.header.frame_id = self._frames[topic]
        marker.pose.orientation.w = 1.0
        return marker

    def _line(self, topic: str, points: List[Point]) -> Marker:
        which = topic.rpartition("/")[2]
        marker = self._marker(topic, topic, Marker.LINE_STRIP, COLOURS[which])
        marker.pose.position.z, marker.scale.x = HEIGHTS[which], LINE_WIDTH
        marker.points = points
        return marker

    def _label(self, topic: str, last: Point) -> Optional[Marker]:
        """Return the name of a robot, where its perfect path has come to."""
        robot, _, which = topic.rpartition("/")
        if which != "odom":
            return None
        marker = self._marker(topic, f"{topic}/label", Marker.TEXT_VIEW_FACING, WHITE)
        marker.text, marker.scale.z = robot, LABEL_SIZE
        marker.pose.position = Point(last.x, last.y, LABEL_HEIGHT)
        return marker
