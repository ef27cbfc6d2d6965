"""The node that places a beacon where RViz's "Publish Point" says.

:ROS Parameters: see `PlaceBeaconParameters`.
:ROS Subscribers:
    - /clicked_point (geometry_msgs/PointStamped): where, in any frame; its height is passed over
    - /bullet_lab/world (visualization_msgs/MarkerArray): what stands there already
:ROS Publishers: ~placed (std_msgs/String), latched: name of the last beacon
:ROS Service clients: /gazebo/spawn_sdf_model, get_world_properties, get_model_state
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Collection

import rospy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from bullet_lab.core import parameters
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import InputError, pose_message
from bullet_lab.ros.node.node import Refusals, private_parameters, run_node, wait_until
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.node.transforms import FrameFinder
from bullet_lab.ros.nodes.populate import SERVICE, description_of

CLICKED = "/clicked_point"


class OccupiedError(LabError):
    """Something stands there already."""


@dataclass(frozen=True)
class PlaceBeaconParameters:
    """Private parameters of place_beacon."""

    model: str = parameters.text(
        "model://beacon", "what to place: model://…, or an SDF or URDF file, a path or package://"
    )
    prefix: str = parameters.text("beacon", "first part of the names: beacon_0, beacon_1 …")
    world_frame: str = parameters.text("world", "frame of the world")
    clearance: float = parameters.number(
        0.3, "m from the point to what stands there: a beacon's radius, and some more", above=0.0
    )
    robot_radius: float = parameters.number(0.3, "m that a robot takes up", above=0.0)


def free_name(prefix: str, taken: Collection[str]) -> str:
    """Return the first of prefix_0, prefix_1 … that is not taken."""
    number = 0
    while f"{prefix}_{number}" in taken:
        number += 1
    return f"{prefix}_{number}"


class PlaceBeacon:
    """Places beacons, one for each click."""

    def __init__(self, parameters: PlaceBeaconParameters):
        self._parameters = parameters
        self._text = description_of(parameters.model)
        self._refusals = Refusals()
        self._frames = FrameFinder()
        self._standing = StandingModels()
        self._placed = Publisher("~placed", String, queue_size=10, latch=True)
        # Everything that stands there comes first, then what changes.
        self._world = rospy.Subscriber(WORLD, MarkerArray, self._standing.take)
        wait_until(self._standing.is_known, f"somebody to publish {WORLD}")
        self._clicks = rospy.Subscriber(CLICKED, PointStamped, self._receive, queue_size=10)

    def _receive(self, message: PointStamped) -> None:
        try:
            x, y, _ = self._place_of(message)
            name = self._spawn(x, y)
        except LabError as error:
            self._refusals.refuse(CLICKED, str(error))
            return
        rospy.loginfo("%s placed at (%.2f, %.2f) m", name, x, y)
        self._placed.publish(String(name))

    def _place_of(self, message: PointStamped) -> Vector:
        point = (message.point.x, message.point.y, message.point.z)
        if not all(map(math.isfinite, point)):
            raise InputError("a point that is not finite")
        frames = (message.header.frame_id, self._parameters.world_frame)
        return self._frames.bring(Pose(point), *frames).position

    def _spawn(self, x: float, y: float) -> str:
        names = call("/gazebo/get_world_properties", srv.GetWorldProperties).model_names
        self._check_free(x, y, names)
        name = free_name(self._parameters.prefix, names)
        pose = pose_message(Pose((x, y, 0.0)))
        call(SERVICE, srv.SpawnModel, name, self._text, "", pose, "")
        return name

    def _check_free(self, x: float, y: float, names: Collection[str]) -> None:
        nearest, distance = self._standing.nearest(x, y)
        if distance < self._parameters.clearance:
            raise OccupiedError(f"({x:.2f}, {y:.2f}) m is too near to {nearest}")
        room = self._parameters.clearance + self._parameters.robot_radius
        # The robot is no part of what the bridge draws: RViz does, of its description.
        for name in set(names) - set(self._standing.names()):
            place = call("/gazebo/get_model_state", srv.GetModelState, name, "").pose.position
            if math.hypot(place.x - x, place.y - y) < room:
                raise OccupiedError(f"({x:.2f}, {y:.2f}) m is too near to {name}")


def main() -> None:
    """Run the node."""

    def body() -> None:
        PlaceBeacon(private_parameters(PlaceBeaconParameters))
        rospy.spin()

    run_node("place_beacon", body)
