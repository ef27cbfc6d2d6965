"""The node that puts several robots into the running world and drives all of them in squares.

Robot k is the model robot<k> with the namespace robot<k> and, if none is set there, the
tf_prefix robot<k>; k counts from 1.

:ROS Parameters: see `FleetParameters`.
:ROS Publishers:
    - robot<k>/cmd_vel (geometry_msgs/Twist)
    - fleet/finished (std_msgs/Time), latched: when all squares were finished
:ROS Subscribers: robot<k>/odom (nav_msgs/Odometry), in closed loop only
:ROS Service clients: /gazebo/spawn_urdf_model (gazebo_msgs/SpawnModel)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion

from bullet_lab.core import patterns
from bullet_lab.drive.square import MODES, OPEN_LOOP, Square
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import TF_PREFIX, private_parameters, run_node
from bullet_lab.ros.nodes.drive_squares import DriveSquares
from bullet_lab.ros.nodes.populate import description_of

SERVICE = "/gazebo/spawn_urdf_model"
MOST_ROBOTS = 100


@dataclass(frozen=True)
class FleetParameters:
    """Private parameters of fleet."""

    robots: int = parameters.integer(8, "how many there are", 1, MOST_ROBOTS)
    robot: str = parameters.text(
        "package://bullet_lab/urdf/block_robot.urdf", "URDF of each: a path or package://"
    )
    spacing: float = parameters.number(2.5, "m from one start to the next, in a grid", above=0.0)
    mode: str = parameters.choice(OPEN_LOOP, "what ends a side", MODES)
    sides: int = parameters.integer(4, "number of sides", minimum=1)
    side: float = parameters.number(2.0, "length of a side in m", above=0.0)


def robot_names(count: int) -> List[str]:
    """Return the names of so many robots, which are their namespaces as well; from robot1 on."""
    return [f"robot{number}" for number in range(1, count + 1)]


def spawn(parameters: FleetParameters) -> None:
    """Put the robots into the world; raises LabError."""
    text = description_of(parameters.robot)
    places = patterns.grid(parameters.robots, parameters.spacing)
    for name, (x, y, _) in zip(robot_names(parameters.robots), places):
        space = rospy.resolve_name(name)
        if not rospy.has_param(f"{space}/{TF_PREFIX}"):
            rospy.set_param(f"{space}/{TF_PREFIX}", name)
        pose = Pose(Point(x, y, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
        call(SERVICE, srv.SpawnModel, name, text, space, pose, "")


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(FleetParameters)
        spawn(parameters)
        square = Square(parameters.sides, parameters.side)
        topics = [(f"{name}/cmd_vel", f"{name}/odom") for name in robot_names(parameters.robots)]
        DriveSquares(square, parameters.mode, topics).drive()

    run_node("fleet", body)
