"""The bridge with the command line of gazebo_ros's executables gzserver and gazebo.

:ROS Parameters:
    - /gazebo/pub_clock_frequency (number, 100): messages on /clock per simulated second
:Everything else: see `bullet_lab.ros.nodes.bridge`. Robots are spawned by the services.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import Sequence

import rospy

from bullet_lab.core.parameters import ArgumentParser, ArgumentsError, declarations
from bullet_lab.ros.nodes.bridge import BridgeParameters, serve
from bullet_lab.simulation.world.resources import listed_folders, package_share

EMPTY_WORLD = "worlds/empty.world"
CLOCK_RATE = "/gazebo/pub_clock_frequency"
# Beginning of the file names of Gazebo's ROS interface, which the bridge has.
ROS_PLUGINS = "libgazebo_ros_"

# Options with a value that are ignored, by their short and long names.
IGNORED_VALUES = (
    "-e --physics",
    "-g --gui-plugin",
    "-o --profile",
    "--record_encoding",
    "--record_path",
    "--record_period",
    "--record_filter",
    "--gui-client-plugin",
)
# Options without a value that are ignored.
IGNORED_FLAGS = (
    "-r --record",
    "--record_resources",
    "-q --quiet",
    "--verbose",
    "--minimal_comms",
    "--lockstep",
)
# Options that are refused, as a user would miss their effect.
REFUSED = ("-p --play", "--iters", "--initial_sim_time")


def parse_server_arguments(words: Sequence[str]) -> Namespace:
    """Return the world, paused, seed and unknown plugins of gzserver's command line.

    Options without a meaning here (recording, the choice of a physics engine, …) are ignored.
    Raises ArgumentsError for one that is unknown or refused.
    """
    parser = ArgumentParser(prog="gzserver", add_help=False, allow_abbrev=False)
    parser.add_argument("world", nargs="?", default=EMPTY_WORLD)
    parser.add_argument("-u", "--pause", dest="paused", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-s", "--server-plugin", dest="plugins", action="append", default=[])
    for names in IGNORED_FLAGS:
        parser.add_argument(*names.split(), action="store_true")
    for names in (*IGNORED_VALUES, *REFUSED):
        parser.add_argument(*names.split(), action="append")
    # Launch files have empty words for empty arguments.
    found = parser.parse_args([word for word in words if word])
    for names in REFUSED:
        option = names.split()[-1]
        if getattr(found, option.lstrip("-")) is not None:
            raise ArgumentsError(f"{option} is not simulated")
    names = [Path(name).name for name in found.plugins]
    found.plugins = [name for name in names if not name.startswith(ROS_PLUGINS)]
    return found


def bridge_parameters(arguments: Namespace) -> BridgeParameters:
    """Return the bridge's parameters; raises LabError."""
    for name in arguments.plugins:
        rospy.logwarn("server plugin %s is not simulated and skipped", name)
    known = declarations(BridgeParameters)
    return BridgeParameters(
        world=find_world(arguments.world),
        robot_description="",
        paused=arguments.paused,
        seed=known["seed"].read(arguments.seed, "--seed"),
        clock_rate=known["clock_rate"].read(rospy.get_param(CLOCK_RATE, 100.0), CLOCK_RATE),
    )


def find_world(name: str) -> str:
    """Return the path or URI of a world file.

    As in Gazebo, a relative name is looked up in the working folder, then in the folders of
    GAZEBO_RESOURCE_PATH, then in this package; and without such a file, the world is empty. A
    URI is returned unchanged.
    """
    if "://" in name:
        return name
    folders = [Path.cwd(), *listed_folders("GAZEBO_RESOURCE_PATH"), package_share()]
    for place in folders:
        if (place / name).is_file():
            return str((place / name).absolute())
    searched = ", ".join(map(str, folders))
    line = "no world file '%s' (looked up in %s); the world is empty, as in Gazebo"
    rospy.logwarn(line, name, searched)
    return str(package_share() / EMPTY_WORLD)


def main() -> None:
    """Run the node."""
    words = rospy.myargv(sys.argv)[1:]
    serve("gazebo", lambda: bridge_parameters(parse_server_arguments(words)))
