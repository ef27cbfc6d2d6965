"""The node that takes away what populate has put into the running world.

:ROS Parameters: see `DepopulateParameters`.
:ROS Service clients: /gazebo/get_world_properties, /gazebo/delete_model
"""

from __future__ import annotations

from dataclasses import dataclass

import rospy

from bullet_lab.ros.gazebo.client import call, numbered
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import private_parameters, run_node


@dataclass(frozen=True)
class DepopulateParameters:
    """Private parameters of depopulate."""

    prefix: str = parameters.text("beacon", "first part of the models' names: beacon_0, beacon_1 …")


def depopulate(parameters: DepopulateParameters) -> int:
    """Take the models away and return how many there were; raises LabError."""
    world = call("/gazebo/get_world_properties", srv.GetWorldProperties)
    names = numbered(world.model_names, parameters.prefix)
    for name in names:
        call("/gazebo/delete_model", srv.DeleteModel, name)
    return len(names)


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(DepopulateParameters)
        rospy.loginfo("%d models taken away", depopulate(parameters))

    run_node("depopulate", body)
