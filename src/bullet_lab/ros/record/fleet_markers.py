"""The paths of several robots for RViz, in one display whatever their number."""

from __future__ import annotations

import threading
from typing import Dict, List, Tuple

import rospy
from geometry_msgs.msg import Point, Vector3
from nav_msgs.msg import Odometry
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.record.odometry_recorder import NOISY, PERFECT

TOPIC = "fleet_paths"
PERIOD_SECONDS = 0.5
LINE_WIDTH = 0.02
# As in all figures: the perfect path is orange, the noisy one blue.
COLOURS = {PERFECT: ColorRGBA(0.90, 0.62, 0.0, 1.0), NOISY: ColorRGBA(0.0, 0.45, 0.70, 1.0)}
# m above the floor.
HEIGHTS = {PERFECT: 0.01, NOISY: 0.015}
LABEL_HEIGHT = 0.4
LABEL_SIZE = 0.25

_Key = Tuple[str, str]


class FleetMarkers:
    """Publishes paths twice a second at most, and only if somebody looks."""

    def __init__(self):
        self._lock = threading.Lock()
        self._markers: Dict[_Key, Marker] = {}
        self._lengths: Dict[_Key, int] = {}
        self._publisher = Publisher(TOPIC, MarkerArray, queue_size=1, latch=True)
        threading.Thread(target=self._run, daemon=True).start()

    def append(self, robot: str, topic: str, msg: Odometry) -> None:
        """Add where a message of PERFECT or NOISY says that a robot is."""
        place = msg.pose.pose.position
        with self._lock:
            marker = self._markers.get((robot, topic))
            if marker is None:
                marker = self._markers[robot, topic] = _line(robot, topic, msg)
            marker.points.append(Point(place.x, place.y, 0.0))

    def forget(self, robot: str) -> None:
        """Begin the paths of a robot anew."""
        with self._lock:
            for topic in COLOURS:
                if (robot, topic) in self._markers:
                    self._markers[robot, topic].points.clear()

    def _run(self) -> None:
        while not rospy.is_shutdown():
            rospy.rostime.wallsleep(PERIOD_SECONDS)
            if self._publisher.has_connections():
                self._publish()

    def _publish(self) -> None:
        with self._lock:
            lengths = {key: len(marker.points) for key, marker in self._markers.items()}
            if lengths == self._lengths:
                return
            self._lengths = lengths
            drawn = [_copy(marker) for marker in self._markers.values() if marker.points]
            labels = [_label(m) for m in drawn if m.ns.endswith(f"/{PERFECT}")]
        self._publisher.publish(MarkerArray(drawn + labels))


def _line(robot: str, topic: str, msg: Odometry) -> Marker:
    marker = Marker(ns=f"{robot}/{topic}", type=Marker.LINE_STRIP, color=COLOURS[topic])
    # Without a stamp, RViz takes the newest transform.
    marker.header.frame_id = msg.header.frame_id
    marker.pose.position.z = HEIGHTS[topic]
    marker.pose.orientation.w = 1.0
    marker.scale.x = LINE_WIDTH
    return marker


def _copy(marker: Marker) -> Marker:
    """Return a marker with points of its own, which stay as they are while it is sent."""
    return Marker(
        header=marker.header,
        ns=marker.ns,
        type=marker.type,
        pose=marker.pose,
        scale=marker.scale,
        color=marker.color,
        points=list(marker.points),
    )


def _label(marker: Marker) -> Marker:
    """Return the name of a robot, to be shown where its path has come to."""
    label = Marker(header=marker.header, ns=f"{marker.ns}/label", type=Marker.TEXT_VIEW_FACING)
    label.text = marker.ns.rsplit("/", 1)[0]
    label.pose.orientation.w = 1.0
    last: List[Point] = marker.points[-1:]
    label.pose.position = Point(last[0].x, last[0].y, LABEL_HEIGHT)
    label.scale = Vector3(0.0, 0.0, LABEL_SIZE)
    label.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
    return label
