"""Records what a robot's sensors measure, and plots it.

:ROS Parameters: see `PlotSensorsParameters`.
:ROS Subscribers:
    - odom (nav_msgs/Odometry)
    - scan (sensor_msgs/LaserScan), sonar (sensor_msgs/Range), imu (sensor_msgs/Imu)
    - bumper (gazebo_msgs/ContactsState)

Leaves odom.csv, scan.csv, range.csv, imu.csv and bumper.csv, written row by row, sensors.png and
summary.json.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

from bullet_lab.core.parameters import integer, text
from bullet_lab.reports.sensors import SensorsReport
from bullet_lab.ros.node.node import private_parameters, run_node
from bullet_lab.ros.nodes.drive_squares import DriveSquaresParameters
from bullet_lab.ros.record.recorder import Recorder, TimedParameters, about


@dataclass(frozen=True)
class PlotSensorsParameters(TimedParameters):
    """Private parameters of plot_sensors."""

    about: Mapping[str, Any] = about(DriveSquaresParameters)
    out: str = text("results/sensors", "folder for the files")
    rays: int = integer(360, "of the laser scanner", minimum=1, maximum=100_000)


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(PlotSensorsParameters)
        Recorder(
            SensorsReport(Path(parameters.out), parameters.rays), parameters, "the sensors"
        ).run()

    run_node("plot_sensors", body)
