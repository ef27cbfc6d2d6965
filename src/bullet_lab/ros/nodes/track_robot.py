"""The node that says how far the robot is from each beacon.

:ROS Parameters: see `TrackRobotParameters`.
:ROS Subscribers:
    - odom (nav_msgs/Odometry)
    - /bullet_lab/world (visualization_msgs/MarkerArray), if ~watch: beacons that come and go
:ROS Publishers, for each beacon, named as the beacon:
    - beacon_0 (std_msgs/String): the report's line
    - beacon_0/range (sensor_msgs/Range): the same distance as a number, stamped as the odometry
    - beacon_markers (visualization_msgs/MarkerArray): the distances for RViz
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any, List, Tuple, Union

import rosgraph.names
import rospy
from geometry_msgs.msg import Point, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core import parameters
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, numbered
from bullet_lab.ros.node.lock_step import join_when
from bullet_lab.ros.node.node import Refusals, private_parameters, run_node
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, planar_pose
from bullet_lab.ros.node.publishers import Publisher, publisher, subscriber

Number = Union[int, float]
DEFAULT_BEACONS = (("beacon_0", 1, 1), ("beacon_1", 5, 1), ("beacon_2", -5, 1))
QUEUE_SIZE = 10
# Height of the beacons of meshes/beacon.dae, in m; the labels float above it.
LABEL_HEIGHT, LABEL_SIZE = 2.3, 0.25


@dataclass(frozen=True)
class Beacon:
    """A beacon in the frame of the odometry; x and y in m, as whole numbers where given so."""

    name: str
    x: Number
    y: Number


def accept_beacons(value: Any) -> Tuple[Beacon, ...]:
    """Turn a list of [name, x, y] into beacons; raises ValueError or TypeError."""
    beacons = tuple(Beacon(str(name), x, y) for name, x, y in value)
    for beacon in beacons:
        if not rosgraph.names.is_legal_name(beacon.name) or not beacon.name:
            raise ValueError(beacon.name)
        if any(isinstance(v, (bool, str)) or not math.isfinite(v) for v in (beacon.x, beacon.y)):
            raise ValueError(beacon.name)
    if len({beacon.name for beacon in beacons}) != len(beacons):
        raise ValueError("a name twice")
    return beacons


@dataclass(frozen=True)
class TrackRobotParameters:
    """Private parameters of track_robot."""

    beacons: Tuple[Beacon, ...] = parameters.checked(
        accept_beacons(DEFAULT_BEACONS),
        "where the beacons stand",
        "a list of [name, x, y] with names that topics can have and finite x and y in metres",
        accept_beacons,
    )
    watch: bool = parameters.boolean(
        False, "take up beacons that are placed in the world, and drop those taken away"
    )
    prefix: str = parameters.text("beacon", "first part of those beacons' names: beacon_0 …")


def report_line(beacon: Beacon, dist: float) -> str:
    """Return what the report publishes for a beacon, to the letter."""
    return f"source: {beacon.name}, position: x:{beacon.x} y:{beacon.y}, distance: {dist}"


class _BeaconTopics:
    """The two publishers of one beacon."""

    def __init__(self, beacon: Beacon):
        self.beacon = beacon
        self._line = publisher(beacon.name, String, QUEUE_SIZE)
        self._range = publisher(f"{beacon.name}/range", Range, QUEUE_SIZE)

    def publish(self, header: Header, dist: float) -> None:
        """Publish a distance in m, measured at a stamp in the frame of a header."""
        self._line.publish(String(report_line(self.beacon, dist)))
        message = Range(header=header, radiation_type=Range.INFRARED)
        message.min_range, message.max_range, message.range = 0.0, math.inf, dist
        self._range.publish(message)

    def close(self) -> None:
        """Publish nothing more."""
        self._line.unregister()
        self._range.unregister()


class TrackRobot:
    """Measures the distances whenever the robot says where it is."""

    def __init__(self, parameters: TrackRobotParameters):
        self._parameters = parameters
        self._lock = threading.Lock()
        self._beacons = tuple(_BeaconTopics(one) for one in parameters.beacons)
        self._markers = Publisher("beacon_markers", MarkerArray, queue_size=1)
        self._frames = FrameGuard()
        self._refusals = Refusals()
        self._standing = StandingModels()
        if parameters.watch:
            self._world = rospy.Subscriber(WORLD, MarkerArray, self._watch)
        self.sub = subscriber("odom", Odometry, self.callback)

    def callback(self, msg: Odometry) -> None:
        """Publish the distances from where the message says the robot is."""
        try:
            x, y, _ = planar_pose(msg)
            self._frames.check(msg)
        except OdometryError as error:
            self._refusals.refuse("odom", str(error))
            return
        with self._lock:
            self._measure(msg, x, y)

    def _measure(self, msg: Odometry, x: float, y: float) -> None:
        distances = [math.hypot(x - t.beacon.x, y - t.beacon.y) for t in self._beacons]
        for topics, dist in zip(self._beacons, distances):
            topics.publish(Header(0, msg.header.stamp, msg.child_frame_id), dist)
        if self._markers.get_num_connections() > 0:
            self._markers.publish(self._draw(msg, distances))

    def _watch(self, message: MarkerArray) -> None:
        self._standing.take(message)
        with self._lock:
            self._follow_the_world()

    def _follow_the_world(self) -> None:
        """Keep to the beacons that stand in the world, each where it stands now."""
        names = set(numbered(self._standing.names(), self._parameters.prefix))
        kept, gone = [], []
        for topics in self._beacons:
            listed = topics.beacon in self._parameters.beacons
            (kept if listed or topics.beacon.name in names else gone).append(topics)
        for topics in kept:
            names.discard(topics.beacon.name)
            place = self._standing.origin(topics.beacon.name)
            if place is not None and topics.beacon not in self._parameters.beacons:
                topics.beacon = Beacon(topics.beacon.name, *place[:2])
        for name in sorted(names):
            x, y, _ = self._standing.origin(name)
            kept.append(_BeaconTopics(Beacon(name, x, y)))
            rospy.loginfo("%s stands at (%.2f, %.2f) m", name, x, y)
        self._beacons = tuple(kept)
        for topics in gone:
            rospy.loginfo("%s is gone", topics.beacon.name)
            topics.close()
        if gone:
            # Fewer labels than before: those that stay are drawn anew.
            self._markers.publish(MarkerArray([Marker(action=Marker.DELETEALL)]))

    def _draw(self, msg: Odometry, distances: List[float]) -> MarkerArray:
        markers = []
        for number, (topics, dist) in enumerate(zip(self._beacons, distances)):
            beacon = topics.beacon
            header = Header(0, msg.header.stamp, msg.header.frame_id)
            label = Marker(header=header, ns="label", id=number, type=Marker.TEXT_VIEW_FACING)
            label.pose.position = Point(beacon.x, beacon.y, LABEL_HEIGHT)
            label.pose.orientation.w = 1.0
            label.scale.z = LABEL_SIZE
            label.color = ColorRGBA(1.0, 0.55, 0.1, 1.0)
            label.text = f"{beacon.name}: {dist:.2f} m"
            ray = Marker(header=header, ns="ray", id=number, type=Marker.LINE_LIST)
            ray.pose.orientation.w = 1.0
            robot = msg.pose.pose.position
            ray.points = [Point(robot.x, robot.y, 0.1), Point(beacon.x, beacon.y, 0.1)]
            ray.scale = Vector3(0.03, 0.0, 0.0)
            ray.color = ColorRGBA(0.84, 0.37, 0.0, 1.0)
            markers += [label, ray]
        return MarkerArray(markers)


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(TrackRobotParameters)
        tracker = TrackRobot(parameters)
        join_when(lambda: tracker.sub.get_num_connections() > 0, "somebody to publish odom")
        rospy.spin()

    run_node("track_robot", body)
