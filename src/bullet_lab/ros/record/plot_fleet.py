"""Records and plots the perfect and the noisy odometry of several robots.

:ROS Parameters: see `PlotFleetParameters`.
:ROS Subscribers, for each robot: <robot>/odom, <robot>/noisy_odom (nav_msgs/Odometry)
:ROS Publishers: fleet_paths (visualization_msgs/MarkerArray), latched

Leaves odom.tum, noisy_odom.tum and paths.csv in a folder for each robot, written row by row,
and fleet.png and summary.json, which are renewed while it runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

from bullet_lab.core.parameters import integer, text
from bullet_lab.core.seeds import derived_seed
from bullet_lab.reports.fleet import FleetReport
from bullet_lab.ros.node.node import private_parameters, run_node
from bullet_lab.ros.nodes.drive_squares import MOST_ROBOTS, robot_names
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.recorder import Recorder, TimedParameters, about
from bullet_lab.ros.record.rviz import FleetMarkers


@dataclass(frozen=True)
class PlotFleetParameters(TimedParameters):
    """Private parameters of plot_fleet."""

    about: Mapping[str, Any] = about(NoisyOdomParameters)
    out: str = text("results/fleet", "folder for the files")
    robots: int = integer(8, "how many there are: robot1 and so on", 1, MOST_ROBOTS)
    seed: int = integer(0, "of noisy_odom, which derives one for each robot", minimum=0)


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(PlotFleetParameters)
        names = robot_names(parameters.robots)
        seeds = {name: derived_seed(parameters.seed, index) for index, name in enumerate(names)}
        report = FleetReport(Path(parameters.out), seeds)
        Recorder(report, parameters, "the robots' odometry", FleetMarkers()).run()

    run_node("plot_fleet", body)
