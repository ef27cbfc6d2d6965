"""Sends a robot to a goal, records how it goes, and leaves what came of it.

:ROS Parameters: see `PlotGoalParameters`.
:ROS Publishers: move_base_simple/goal (geometry_msgs/PoseStamped): the first goal
:ROS Subscribers:
    - odom (nav_msgs/Odometry): the true pose, as the simulation sends it
    - drive_to_goal/current_goal, status, finished: what is driven to, whoever wants it
    - /bullet_lab/world (visualization_msgs/MarkerArray): the beacons

Leaves truth.tum, written row by row, path.png and summary.json.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, List, Mapping, Tuple

import rospy
from geometry_msgs.msg import PoseStamped
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.parameters import boolean, number, number_list, text
from bullet_lab.reports.goal import Beacon, GoalReport
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, numbered
from bullet_lab.ros.messages.poses import stamped_pose
from bullet_lab.ros.node.node import private_parameters, run_node
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.nodes.drive_to_goal import DriveToGoalParameters
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.recorder import Errand, Recorder, RecordParameters, about


@dataclass(frozen=True)
class PlotGoalParameters(RecordParameters):
    """Private parameters of plot_goal."""

    about: Mapping[str, Any] = about(DriveToGoalParameters, NoisyOdomParameters)
    out: str = text("results/goal", "folder for the files")
    goal: Tuple[float, ...] = number_list((1.0, 1.0, 0.0), "where to: x y in m, yaw in rad")
    frame: str = text("world", "frame of the goal")
    tolerance: float = number(0.05, "m, for the picture", above=0.0)
    stay: bool = boolean(False, "wait for more goals, such as RViz's, until Ctrl-C")


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(PlotGoalParameters)
        standing = StandingModels()

        def beacons() -> List[Beacon]:
            names = numbered(standing.names(), "beacon")
            return [(name, *standing.origin(name)[:2]) for name in names]

        report = GoalReport(Path(parameters.out), parameters.tolerance, parameters.stay, beacons)
        rospy.Subscriber(WORLD, MarkerArray, standing.take)
        first = Publisher("move_base_simple/goal", PoseStamped, queue_size=10)

        def send() -> None:
            first.publish(stamped_pose(rospy.Time.now(), parameters.frame, parameters.goal))

        errand = Errand("drive_to_goal", first.has_connections, send, report.is_answered)
        Recorder(report, parameters, "the bridge and drive_to_goal", errand=errand).run()

    run_node("plot_goal", body)
