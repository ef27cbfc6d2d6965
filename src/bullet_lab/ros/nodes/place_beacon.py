"""Spawns a beacon at each point that is clicked with RViz's "Publish Point".

:ROS Parameters: see `PlaceBeaconParameters`.
:ROS Subscribers:
    - /clicked_point (geometry_msgs/PointStamped): in any frame; the height is ignored
    - /bullet_lab/world (visualization_msgs/MarkerArray): the models of the world
:ROS Publishers: ~placed (std_msgs/String), latched: name of the last beacon
:ROS Service clients: /gazebo/spawn_sdf_model, get_world_properties, get_model_state
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Collection

import rospy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.parameters import number, text
from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import InputError, pose_message
from bullet_lab.ros.node.node import Refusals, node, wait_until
from bullet_lab.ros.node.odometry import FrameFinder
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.nodes.populate import SERVICE, description_of

CLICKED = "/clicked_point"


class OccupiedError(LabError):
    """The place is too near to a model."""


@dataclass(frozen=True)
class PlaceBeaconParameters:
    """Private parameters of place_beacon."""

    model: str = text(
        "model://beacon", "what to place: model://…, or an SDF or URDF file, a path or package://"
    )
    prefix: str = text("beacon", "first part of the names: beacon_0, beacon_1 …")
    world_frame: str = text("world", "frame of the world")
    clearance: float = number(
        0.3, "m from the point to other models: a beacon's radius and a margin", above=0.0
    )
    robot_radius: float = number(0.3, "m, radius of a robot", above=0.0)


def free_name(prefix: str, taken: Collection[str]) -> str:
    """Return the first of prefix_0, prefix_1 … that is not taken."""
    names = (f"{prefix}_{number}" for number in itertools.count())
    return next(name for name in names if name not in taken)


class PlaceBeacon:
    """Spawns a beacon for each click."""

    def __init__(self, parameters: PlaceBeaconParameters):
        self._parameters = parameters
        self._text = description_of(parameters.model)
        self._refusals = Refusals()
        self._frames = FrameFinder()
        self._standing = StandingModels()
        self._placed = Publisher("~placed", String, queue_size=10, latch=True)
        # The first message has all models, later ones have changes.
        self._world = rospy.Subscriber(WORLD, MarkerArray, self._standing.take)
        wait_until(self._standing.is_known, f"a publisher of {WORLD}")
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
        # The markers leave out the robot, which RViz draws from its description.
        for name in set(names) - set(self._standing.names()):
            place = call("/gazebo/get_model_state", srv.GetModelState, name, "").pose.position
            if math.hypot(place.x - x, place.y - y) < room:
                raise OccupiedError(f"({x:.2f}, {y:.2f}) m is too near to {name}")


@node
def place_beacon(parameters: PlaceBeaconParameters) -> None:
    """Run until ROS shuts down."""
    PlaceBeacon(parameters)
    rospy.spin()
