"""The bridge as gazebo_ros's executables gzserver and gazebo start it.

:ROS Parameters:
    - /gazebo/pub_clock_frequency (number, 100): messages on /clock per simulated second
:Everything else: see `bullet_lab.ros.bridge`. The robot comes by the spawn services.
"""

from __future__ import annotations

import sys

import rospy

from bullet_lab.ros.bridge import BridgeParameters, serve
from bullet_lab.ros.exported_paths import add_exported_paths
from bullet_lab.ros.gazebo_server_arguments import (
    ServerArguments,
    find_world,
    parse_server_arguments,
)
from bullet_lab.ros.parameters import ParameterError, read_parameters

CLOCK_RATE = "/gazebo/pub_clock_frequency"


def bridge_parameters(told: ServerArguments) -> BridgeParameters:
    """Return the bridge's parameters; raises LabError."""
    for name in told.plugins:
        rospy.logwarn("server plugin %s is not simulated and skipped", name)
    given = {
        "world": find_world(told.world),
        "robot_description": "",
        "paused": told.paused,
        "seed": told.seed,
        "clock_rate": rospy.get_param(CLOCK_RATE, 100.0),
    }
    try:
        return read_parameters(BridgeParameters, lambda name, other: given.get(name[1:], other))
    except ParameterError as error:
        raise ParameterError(str(error).replace("~clock_rate", CLOCK_RATE)) from error


def main() -> None:
    """Run the node."""

    def read() -> BridgeParameters:
        add_exported_paths()
        return bridge_parameters(parse_server_arguments(rospy.myargv(sys.argv)[1:]))

    serve("gazebo", read)
