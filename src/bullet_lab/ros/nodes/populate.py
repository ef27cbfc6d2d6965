"""Spawns models in a pattern, and deletes them.

:ROS Parameters: see `PopulateParameters` and, for depopulate, `DepopulateParameters`.
:ROS Service clients: /gazebo/spawn_sdf_model (gazebo_msgs/SpawnModel); depopulate:
    /gazebo/get_world_properties, /gazebo/delete_model
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any, List, Tuple
from xml.sax.saxutils import escape

import rospy

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
from bullet_lab.ros.gazebo.client import call, numbered
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.node import NodeError, node
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.xml import read_text

SERVICE = "/gazebo/spawn_sdf_model"
# The three beacons of the report.
BEACONS: Tuple[se2.PlanarPose, ...] = ((1.0, 1.0, 0.0), (5.0, 1.0, 0.0), (-5.0, 1.0, 0.0))


def accept_poses(value: Any) -> Tuple[se2.PlanarPose, ...]:
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
    poses: Tuple[se2.PlanarPose, ...] = checked(
        BEACONS,
        "their poses, for the pattern poses",
        "a list of [x, y] or [x, y, yaw] with finite numbers in m and rad",
        accept_poses,
    )
    count: int = integer(3, "how many, for the other patterns", 1, 100_000)
    spacing: float = number(1.0, "m between neighbours in a line or grid", above=0.0)
    radius: float = number(3.0, "of the circle, in m", above=0.0)
    origin: Tuple[float, ...] = number_list(
        (0.0, 0.0, 0.0), "displacement of the pattern: x y z in m"
    )
    name: str = text("", "name of the model, if it is only one")
    namespace: str = text(
        "", "robotNamespace of plugins that have none; the node's own namespace if empty"
    )


def places_of(parameters: PopulateParameters) -> List[se2.PlanarPose]:
    """Return the poses of the models, without the displacement ~origin."""
    if parameters.pattern == "line":
        return se2.line(parameters.count, parameters.spacing)
    if parameters.pattern == "grid":
        return se2.grid(parameters.count, parameters.spacing)
    if parameters.pattern == "circle":
        return se2.circle(parameters.count, parameters.radius)
    return list(parameters.poses)


def names_of(parameters: PopulateParameters) -> List[str]:
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
