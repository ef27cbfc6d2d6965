"""Recorded paths for RViz: published twice a second at most, and only if somebody looks."""

from __future__ import annotations

import copy
import threading
from typing import Callable, Dict, Iterable, List, Mapping, Tuple

import rospy
from geometry_msgs.msg import Point, PoseStamped, Vector3
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
    """A latched nav_msgs/Path for each topic of odometry.

    Args:
        topics: names of the paths, by those of the odometry.
    """

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
LINE_WIDTH = 0.02
LABEL_HEIGHT = 0.4
LABEL_SIZE = 0.25


class FleetMarkers:
    """The paths of several robots, in one display whatever their number: fleet_paths."""

    def __init__(self):
        self._lock = threading.Lock()
        self._markers: Dict[str, Marker] = {}
        self._lengths: Dict[str, int] = {}
        self._publisher = Publisher("fleet_paths", MarkerArray, queue_size=1, latch=True)
        _often(self._publish)

    def append(self, topic: str, message: Odometry) -> None:
        """Add where a message on <robot>/odom or <robot>/noisy_odom says that a robot is."""
        place = message.pose.pose.position
        with self._lock:
            marker = self._markers.get(topic)
            if marker is None:
                marker = self._markers[topic] = _line(topic, message)
            marker.points.append(Point(place.x, place.y, 0.0))

    def forget(self, namespace: str) -> None:
        """Begin the paths of a robot anew."""
        with self._lock:
            for topic, marker in self._markers.items():
                if _split(topic)[0] == namespace:
                    marker.points.clear()

    def _publish(self) -> None:
        if not self._publisher.has_connections():
            return
        with self._lock:
            lengths = {topic: len(marker.points) for topic, marker in self._markers.items()}
            if lengths == self._lengths:
                return
            self._lengths = lengths
            drawn = [_copy(marker) for marker in self._markers.values() if marker.points]
            labels = _labels(drawn)
        self._publisher.publish(MarkerArray(drawn + labels))


def _split(topic: str) -> Tuple[str, str]:
    """Return the robot and which of its odometries it is."""
    robot, _, which = topic.rpartition("/")
    return robot, which


def _line(topic: str, message: Odometry) -> Marker:
    _, which = _split(topic)
    marker = Marker(ns=topic, type=Marker.LINE_STRIP, color=COLOURS[which])
    # Without a stamp, RViz takes the newest transform.
    marker.header.frame_id = message.header.frame_id
    marker.pose.position.z = HEIGHTS[which]
    marker.pose.orientation.w = 1.0
    marker.scale.x = LINE_WIDTH
    return marker


def _copy(marker: Marker) -> Marker:
    """Return a marker with points of its own, which stay as they are while it is sent."""
    copied = copy.copy(marker)
    copied.points = list(marker.points)
    return copied


def _labels(markers: Iterable[Marker]) -> List[Marker]:
    """Return the names of the robots, to be shown where their perfect paths have come to."""
    labels = []
    for marker in markers:
        robot, which = _split(marker.ns)
        if which == "odom":
            label = Marker(
                header=marker.header, ns=f"{marker.ns}/label", type=Marker.TEXT_VIEW_FACING
            )
            label.text = robot
            label.pose.orientation.w = 1.0
            last = marker.points[-1]
            label.pose.position = Point(last.x, last.y, LABEL_HEIGHT)
            label.scale = Vector3(0.0, 0.0, LABEL_SIZE)
            label.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
            labels.append(label)
    return labels
