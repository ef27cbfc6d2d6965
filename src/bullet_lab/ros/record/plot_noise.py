"""Records and plots the perfect and the noisy odometry.

:ROS Parameters: see `PlotNoiseParameters`.
:ROS Subscribers: odom, noisy_odom (nav_msgs/Odometry)
:ROS Publishers: odom_path, noisy_odom_path (nav_msgs/Path), latched

Leaves odom.tum, noisy_odom.tum and paths.csv, written row by row, and paths.png and
summary.json, which are renewed while it runs.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import rospy

from bullet_lab.core.parameters import boolean, text
from bullet_lab.reports.squares import SquaresReport
from bullet_lab.ros.node.node import private_parameters, run_node
from bullet_lab.ros.nodes.drive_squares import DriveSquaresParameters
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.recorder import Recorder, TimedParameters, about
from bullet_lab.ros.record.rviz import PathTopics


@dataclass(frozen=True)
class PlotNoiseParameters(TimedParameters):
    """Private parameters of plot_noise."""

    about: Mapping[str, Any] = about(NoisyOdomParameters, DriveSquaresParameters)
    out: str = text("results/squares", "folder for the files")
    show: bool = boolean(False, "open a window at the end, where there is a screen")


def show(path: Path) -> None:
    """Show a picture in a window and wait until it is closed."""
    if not os.environ.get("DISPLAY"):
        rospy.logwarn("~show: there is no screen (DISPLAY is not set); see %s", path.name)
        return
    try:
        from matplotlib import pyplot

        picture = pyplot.imread(str(path))
        pyplot.figure("bullet_lab", figsize=(11.0, 6.6))
        pyplot.axes([0.0, 0.0, 1.0, 1.0]).imshow(picture)
        pyplot.axis("off")
        pyplot.show()
    except ImportError as error:
        rospy.logwarn("~show: matplotlib has no window toolkit here: %s", error)


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(PlotNoiseParameters)
        folder = Path(parameters.out)
        view = PathTopics({"odom": "odom_path", "noisy_odom": "noisy_odom_path"})
        Recorder(SquaresReport(folder), parameters, "odom and noisy_odom", view).run()
        if parameters.show:
            show(folder / "paths.png")

    run_node("plot_noise", body)
