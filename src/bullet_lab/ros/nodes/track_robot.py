"""Publishes the distance of the robot from each beacon.

:ROS Parameters: see `TrackRobotParameters`.
:ROS Subscribers:
    - odom (nav_msgs/Odometry)
    - /bullet_lab/world (visualization_msgs/MarkerArray), if ~watch: the beacons of the world
:ROS Publishers:
    - beacon_0 … (std_msgs/String), the name of each beacon: the line of the report
    - beacon_0/range … (sensor_msgs/Range): the same distance, with the stamp of the odometry
    - beacon_markers (visualization_msgs/MarkerArray): the distances for RViz
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any, Union

import rosgraph.names
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.parameters import boolean, checked, text
from bullet_lab.core.se2 import hypot
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, numbered
from bullet_lab.ros.messages.poses import marker
from bullet_lab.ros.node.lock_step import Publisher, join_when, publisher, subscriber
from bullet_lab.ros.node.node import node, spin
from bullet_lab.ros.node.odometry import FrameGuard

Number = Union[int, float]
DEFAULT_BEACONS = (("beacon_0", 1, 1), ("beacon_1", 5, 1), ("beacon_2", -5, 1))
QUEUE_SIZE = 10
# m; the labels are above the beacons of meshes/beacon.dae.
LABEL_HEIGHT = 2.3
LABEL_SIZE = 0.25
LABEL_COLOUR = ColorRGBA(1.0, 0.55, 0.1, 1.0)
RAY_COLOUR = ColorRGBA(0.84, 0.37, 0.0, 1.0)


@dataclass(frozen=True)
class Beacon:
    """A beacon in the frame of the odometry; x and y are in m, and may be whole numbers."""

    name: str
    x: Number
    y: Number


def accept_beacons(value: Any) -> tuple[Beacon, ...]:
    """Return the beacons of a list of [name, x, y]; raises ValueError or TypeError."""
    beacons = tuple(Beacon(str(name), x, y) for name, x, y in value)
    for beacon in beacons:
        if not rosgraph.names.is_legal_name(beacon.name) or not beacon.name:
            raise ValueError(beacon.name)
        if any(isinstance(v, (bool, str)) or not math.isfinite(v) for v in (beacon.x, beacon.y)):
            raise ValueError(beacon.name)
    if len({beacon.name for beacon in beacons}) != len(beacons):
        raise ValueError("duplicate beacon name")
    return beacons


@dataclass(frozen=True)
class TrackRobotParameters:
    """Private parameters of track_robot."""

    beacons: tuple[Beacon, ...] = checked(
        accept_beacons(DEFAULT_BEACONS),
        "names and places of the beacons",
        "a list of [name, x, y] with names that topics can have and finite x and y in metres",
        accept_beacons,
    )
    watch: bool = boolean(
        False, "add the beacons that are spawned in the world, and remove those that are deleted"
    )
    prefix: str = text("beacon", "first part of the names of those beacons: beacon_0 …")


class _BeaconTopics:
    """The two publishers of one beacon."""

    def __init__(self, beacon: Beacon):
        self.beacon = beacon
        self._line = publisher(beacon.name, String, QUEUE_SIZE)
        self._range = publisher(f"{beacon.name}/range", Range, QUEUE_SIZE)

    def publish(self, header: Header, dist: float) -> None:
        """Publish a distance in m, as the line of the report and with a header."""
        name, x, y = self.beacon.name, self.beacon.x, self.beacon.y
        self._line.publish(String(f"source: {name}, position: x:{x} y:{y}, distance: {dist}"))
        self._range.publish(Range(header, Range.INFRARED, 0.0, 0.0, math.inf, dist))

    def close(self) -> None:
        """Unregister the publishers."""
        self._line.unregister()
        self._range.unregister()


class TrackRobot:
    """Computes the distances for each message of odometry."""

    def __init__(self, parameters: TrackRobotParameters):
        self._parameters = parameters
        self._lock = threading.Lock()
        self._topics = {beacon.name: _BeaconTopics(beacon) for beacon in parameters.beacons}
        self._markers = Publisher("beacon_markers", MarkerArray, queue_size=1)
        self._frames = FrameGuard()
        self._standing = StandingModels()
        if parameters.watch:
            self._world = rospy.Subscriber(WORLD, MarkerArray, self._watch)
        self.sub = subscriber("odom", Odometry, self.callback)

    def callback(self, msg: Odometry) -> None:
        """Publish the distances from the pose of a message; raises LabError if it has none."""
        with self._lock:
            x, y, _ = self._frames.check(msg)
            distances = []
            for topics in self._topics.values():
                dist = hypot(x - topics.beacon.x, y - topics.beacon.y)
                topics.publish(Header(0, msg.header.stamp, msg.child_frame_id), dist)
                distances.append((topics.beacon, dist))
            if self._markers.get_num_connections() > 0:
                self._markers.publish(self._draw(msg, distances))

    def _watch(self, message: MarkerArray) -> None:
        """Add, move and remove the beacons of the world; those of ~beacons stay."""
        self._standing.take(message)
        wanted = {beacon.name: beacon for beacon in self._parameters.beacons}
        for name in numbered(self._standing.names(), self._parameters.prefix):
            x, y, _ = self._standing.origin(name)
            wanted.setdefault(name, Beacon(name, x, y))
        with self._lock:
            for name, beacon in wanted.items():
                if name not in self._topics:
                    rospy.loginfo("new beacon %s at (%.2f, %.2f) m", name, beacon.x, beacon.y)
                    self._topics[name] = _BeaconTopics(beacon)
                self._topics[name].beacon = beacon
            gone = set(self._topics) - set(wanted)
            for name in gone:
                rospy.loginfo("beacon %s was deleted", name)
                self._topics.pop(name).close()
            if gone:
                # Delete the old labels; the next message draws the others.
                self._markers.publish(MarkerArray([Marker(action=Marker.DELETEALL)]))

    def _draw(self, msg: Odometry, distances: list[tuple[Beacon, float]]) -> MarkerArray:
        """Return a label above each beacon, and a line to it from the robot."""
        header = Header(0, msg.header.stamp, msg.header.frame_id)
        robot = msg.pose.pose.position
        markers = []
        for number, (beacon, dist) in enumerate(distances):
            size, place = (0.0, 0.0, LABEL_SIZE), (beacon.x, beacon.y, LABEL_HEIGHT)
            label = marker(header, "label", Marker.TEXT_VIEW_FACING, LABEL_COLOUR, size, place)
            label.text = f"{beacon.name}: {dist:.2f} m"
            ends = ((robot.x, robot.y, 0.1), (beacon.x, beacon.y, 0.1))
            ray = marker(header, "ray", Marker.LINE_LIST, RAY_COLOUR, (0.03, 0.0, 0.0), points=ends)
            label.id = ray.id = number
            markers += [label, ray]
        return MarkerArray(markers)


@node
def track_robot(parameters: TrackRobotParameters) -> None:
    """Run until ROS shuts down."""
    tracker = TrackRobot(parameters)
    join_when(lambda: tracker.sub.get_num_connections() > 0, "a publisher of odom")
    spin()
