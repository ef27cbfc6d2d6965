"""Spawns models in a pattern, deletes them, and spawns a beacon at each point clicked in RViz.

:ROS Parameters: see `PopulateParameters`, `DepopulateParameters` and `PlaceBeaconParameters`.
:ROS Service clients: /gazebo/spawn_sdf_model (gazebo_msgs/SpawnModel); depopulate:
    /gazebo/get_world_properties, /gazebo/delete_model; place_beacon: /gazebo/get_world_properties,
    /gazebo/get_model_state
:ROS Subscribers of place_beacon:
    - /clicked_point (geometry_msgs/PointStamped): in any frame; the height is ignored
    - /bullet_lab/world (visualization_msgs/MarkerArray): the models of the world
:ROS Publishers of place_beacon: ~placed (std_msgs/String), latched: name of the last beacon
"""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass
from typing import Any, Collection
from xml.sax.saxutils import escape

import rospy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from bullet_lab.core import se2
from bullet_lab.core.parameters import (
    ParameterError,
    checked,
    choice,
    integer,
    number,
    number_list,
    text,
)
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import quaternion_from_yaw
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, call, numbered
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import InputError, pose_message, vector_of
from bullet_lab.ros.node.node import NodeError, Refusals, node, spin, wait_until
from bullet_lab.ros.node.odometry import FrameFinder
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.xml import read_text

SERVICE = "/gazebo/spawn_sdf_model"
CLICKED = "/clicked_point"
# Frame of the world.
FRAME = "world"
# m
ROBOT_RADIUS = 0.3
# The three beacons of the report.
BEACONS: tuple[se2.PlanarPose, ...] = ((1.0, 1.0, 0.0), (5.0, 1.0, 0.0), (-5.0, 1.0, 0.0))


def accept_poses(value: Any) -> tuple[se2.PlanarPose, ...]:
    """Return the poses of a list of [x, y] or [x, y, yaw]; raises ValueError or TypeError."""
    poses = []
    for entry in value:
        if len(entry) not in (2, 3) or any(isinstance(part, (bool, str)) for part in entry):
            raise ValueError(entry)
        x, y, yaw = (float(part) for part in (*entry, 0.0)[:3])
        if not all(map(math.isfinite, (x, y, yaw))):
            raise ValueError(entry)
        poses.append((x, y, yaw))
    return tuple(poses)


@dataclass(frozen=True)
class DepopulateParameters:
    """Private parameters of depopulate."""

    prefix: str = text("beacon", "first part of the models' names: beacon_0, beacon_1 …")


@dataclass(frozen=True)
class PopulateParameters(DepopulateParameters):
    """Private parameters of populate."""

    model: str = text(
        "model://beacon", "what to place: model://…, or an SDF or URDF file, a path or package://"
    )
    pattern: str = choice(
        "poses", "how they are arranged", ("poses", "line", "grid", "circle")
    )
    poses: tuple[se2.PlanarPose, ...] = checked(
        BEACONS,
        "their poses, for the pattern poses",
        "a list of [x, y] or [x, y, yaw] with finite numbers in m and rad",
        accept_poses,
    )
    count: int = integer(3, "how many, for the other patterns", 1, 100_000)
    spacing: float = number(1.0, "m between neighbours in a line or grid", above=0.0)
    radius: float = number(3.0, "of the circle, in m", above=0.0)
    origin: tuple[float, ...] = number_list(
        (0.0, 0.0, 0.0), "displacement of the pattern: x y z in m"
    )
    name: str = text("", "name of the model, if it is only one")
    namespace: str = text(
        "", "robotNamespace of plugins that have none; the node's own namespace if empty"
    )


@dataclass(frozen=True)
class PlaceBeaconParameters:
    """Private parameters of place_beacon."""

    model: str = text(
        "model://beacon", "what to place: model://…, or an SDF or URDF file, a path or package://"
    )
    prefix: str = text("beacon", "first part of the names: beacon_0, beacon_1 …")
    clearance: float = number(
        0.3, "m from the point to other models: a beacon's radius and a margin", above=0.0
    )


def places_of(parameters: PopulateParameters) -> list[se2.PlanarPose]:
    """Return the poses of the models in the frame that ~origin gives."""
    if parameters.pattern == "line":
        return se2.line(parameters.count, parameters.spacing)
    if parameters.pattern == "grid":
        return se2.grid(parameters.count, parameters.spacing)
    if parameters.pattern == "circle":
        return se2.circle(parameters.count, parameters.radius)
    return list(parameters.poses)


def names_of(parameters: PopulateParameters) -> list[str]:
    """Return the names of the models; raises ParameterError if ~name is for several models."""
    count = len(places_of(parameters))
    if not parameters.name:
        return [f"{parameters.prefix}_{index}" for index in range(count)]
    if count != 1:
        raise ParameterError(f"~name is '{parameters.name}': {count} models cannot share one name")
    return [parameters.name]


def description_of(model: str) -> str:
    """Return a model as text for the spawn service; raises LabError.

    For a model:// URI or a folder, the text is an include, which the simulator resolves.
    """
    if model.startswith("model://"):
        return inclusion_of(model)
    path = ResourceFinder.anywhere().find(model)
    return inclusion_of(path.as_uri()) if os.path.isdir(path) else read_text(path)


def inclusion_of(uri: str) -> str:
    """Return SDF that includes a model."""
    return f'<sdf version="1.6"><include><uri>{escape(uri)}</uri></include></sdf>'


@node
def populate(parameters: PopulateParameters) -> None:
    """Spawn the models; raises LabError."""
    names = names_of(parameters)
    text = description_of(parameters.model)
    namespace = parameters.namespace or rospy.get_namespace()
    dx, dy, dz = parameters.origin
    for name, (x, y, yaw) in zip(names, places_of(parameters)):
        pose = pose_message(Pose((x + dx, y + dy, dz), quaternion_from_yaw(yaw)))
        try:
            call(SERVICE, srv.SpawnModel, name, text, namespace, pose, "")
        except NodeError as error:
            raise NodeError(f"cannot place '{name}': {error}") from error
    rospy.loginfo("%d models placed: %s …", len(names), "".join(names[:1]))


@node
def depopulate(parameters: DepopulateParameters) -> None:
    """Delete the models; raises LabError."""
    world = call("/gazebo/get_world_properties", srv.GetWorldProperties)
    names = numbered(world.model_names, parameters.prefix)
    for name in names:
        call("/gazebo/delete_model", srv.DeleteModel, name)
    rospy.loginfo("%d models deleted", len(names))


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
        with self._refusals.on(CLICKED):
            point = vector_of(message.point, "the point")
            x, y, _ = self._frames.bring(Pose(point), message.header.frame_id, FRAME).position
            name = self._spawn(x, y)
            rospy.loginfo("%s placed at (%.2f, %.2f) m", name, x, y)
            self._placed.publish(String(name))

    def _spawn(self, x: float, y: float) -> str:
        names = call("/gazebo/get_world_properties", srv.GetWorldProperties).model_names
        nearest, distance = self._standing.nearest(x, y)
        if distance < self._parameters.clearance:
            raise InputError(f"({x:.2f}, {y:.2f}) m is too near to {nearest}")
        room = self._parameters.clearance + ROBOT_RADIUS
        # The markers leave out the robot, which RViz draws from its description.
        for name in set(names) - set(self._standing.names()):
            place = call("/gazebo/get_model_state", srv.GetModelState, name, "").pose.position
            if math.hypot(place.x - x, place.y - y) < room:
                raise InputError(f"({x:.2f}, {y:.2f}) m is too near to {name}")
        name = free_name(self._parameters.prefix, names)
        call(SERVICE, srv.SpawnModel, name, self._text, "", pose_message(Pose((x, y, 0.0))), "")
        return name


@node
def place_beacon(parameters: PlaceBeaconParameters) -> None:
    """Run until ROS shuts down."""
    PlaceBeacon(parameters)
    spin()
