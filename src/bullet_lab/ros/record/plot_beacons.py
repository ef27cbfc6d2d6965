"""Records and plots the distances that track_robot measures, over the true ones.

:ROS Parameters: see `PlotBeaconsParameters`.
:ROS Subscribers:
    - odom (nav_msgs/Odometry)
    - beacon_0/range … (sensor_msgs/Range)
    - /bullet_lab/world (visualization_msgs/MarkerArray): where the beacons really stand

Leaves distances.csv, written row by row, distances.png and summary.json.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Tuple

import rospy
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.parameters import name_list, text
from bullet_lab.reports.beacons import BeaconsReport
from bullet_lab.ros.node.node import NodeError, private_parameters, run_node
from bullet_lab.ros.record.recorder import Recorder, TimedParameters

WORLD_TIMEOUT_SECONDS = 60.0
BEACONS = ("beacon_0", "beacon_1", "beacon_2")


@dataclass(frozen=True)
class PlotBeaconsParameters(TimedParameters):
    """Private parameters of plot_beacons."""

    out: str = text("results/beacons", "folder for the files")
    beacons: Tuple[str, ...] = name_list("models of the world that are beacons")


def true_beacons(names: Tuple[str, ...]) -> Dict[str, Tuple[float, float]]:
    """Return where models of the world stand (m, m), from the bridge's markers.

    Raises:
        NodeError: no markers come, or a name is not among them.
    """
    try:
        world = rospy.wait_for_message("/bullet_lab/world", MarkerArray, WORLD_TIMEOUT_SECONDS)
    except rospy.ROSException as error:
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown") from error
        raise NodeError("nobody publishes /bullet_lab/world: is the bridge running?") from error
    places = {m.ns: (m.pose.position.x, m.pose.position.y) for m in reversed(world.markers)}
    missing = [name for name in names if name not in places]
    if missing:
        raise NodeError(f"the world has no model '{missing[0]}', only {', '.join(sorted(places))}")
    return {name: places[name] for name in names}


def main() -> None:
    """Run the node."""

    def body() -> None:
        parameters = private_parameters(PlotBeaconsParameters)
        report = BeaconsReport(Path(parameters.out), true_beacons(parameters.beacons or BEACONS))
        Recorder(report, parameters, "odom and the distances").run()

    run_node("plot_beacons", body)
