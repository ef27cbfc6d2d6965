"""The bridge as gazebo_ros's executables gzserver and gazebo start it.

`<export><gazebo_ros gazebo_model_path="${prefix}/models"/></export>` in a package that depends on
gazebo_ros adds a folder to GAZEBO_MODEL_PATH; gazebo_media_path is one of GAZEBO_RESOURCE_PATH.

:ROS Parameters:
    - /gazebo/pub_clock_frequency (number, 100): messages on /clock per simulated second
:Everything else: see `bullet_lab.ros.nodes.bridge`. The robot comes by the spawn services.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterable, List, Optional, Sequence, Tuple
from xml.etree.ElementTree import Element

import rospkg
import rospy

from bullet_lab.core.parameters import (
    ArgumentParser,
    ArgumentsError,
    ParameterError,
    read_parameters,
)
from bullet_lab.errors import LabError
from bullet_lab.ros.nodes.bridge import BridgeParameters, serve
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.simulation.world.xml import parse_text, read_text

CLOCK_RATE = "/gazebo/pub_clock_frequency"
# They give Gazebo its ROS interface, which the bridge has.
ROS_PLUGINS = "libgazebo_ros_"

# Options without a meaning here that are followed by a value.
IDLE_VALUES = (
    ("-e", "--physics"),
    ("-g", "--gui-plugin"),
    ("-o", "--profile"),
    ("--record_encoding",),
    ("--record_path",),
    ("--record_period",),
    ("--record_filter",),
    ("--gui-client-plugin",),
)
IDLE_FLAGS = (
    ("-r", "--record"),
    ("--record_resources",),
    ("-q", "--quiet"),
    ("--verbose",),
    ("--minimal_comms",),
    ("--lockstep",),
)
# What others do with these would be missed.
REFUSED = (("-p", "--play"), ("--iters",), ("--initial_sim_time",))

# What packages export, and the variables that it goes into.
VARIABLES = {
    "gazebo_model_path": "GAZEBO_MODEL_PATH",
    "gazebo_media_path": "GAZEBO_RESOURCE_PATH",
}
EXPORTER = "gazebo_ros"


@dataclass(frozen=True)
class ServerArguments:
    """The command line of gzserver.

    Attributes:
        world: name of the world file, as given.
        paused: whether to start paused.
        seed: of all that is random.
        plugins: server plugins that are not simulated, by the names of their files.
    """

    world: str = "worlds/empty.world"
    paused: bool = False
    seed: int = 0
    plugins: Tuple[str, ...] = ()


def parse_server_arguments(words: Sequence[str]) -> ServerArguments:
    """Read gzserver's arguments, less those of ROS.

    Options that have no meaning here (recording, the choice of a physics engine, …) are passed
    over.

    Raises:
        ArgumentsError: an option that is unknown, or one whose effect would be missed.
    """
    parser = ArgumentParser(prog="gzserver", add_help=False, allow_abbrev=False)
    parser.add_argument("world", nargs="?", default=ServerArguments.world)
    parser.add_argument("-u", "--pause", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-s", "--server-plugin", action="append", default=[])
    for names in IDLE_FLAGS:
        parser.add_argument(*names, action="store_true")
    for names in IDLE_VALUES:
        parser.add_argument(*names, action="append")
    for names in REFUSED:
        parser.add_argument(*names, dest=names[-1].lstrip("-"))
    # Launch files leave empty words where an argument of theirs is empty.
    found = parser.parse_args([word for word in words if word])
    for names in REFUSED:
        if getattr(found, names[-1].lstrip("-")) is not None:
            raise ArgumentsError(f"{names[-1]} is not simulated")
    if found.seed < 0:
        raise ArgumentsError(f"--seed {found.seed} is negative")
    plugins = (Path(name).name for name in found.server_plugin)
    strange = tuple(name for name in plugins if not name.startswith(ROS_PLUGINS))
    return ServerArguments(found.world, found.pause, found.seed, strange)


def bridge_parameters(arguments: ServerArguments) -> BridgeParameters:
    """Return the bridge's parameters; raises LabError."""
    for name in arguments.plugins:
        rospy.logwarn("server plugin %s is not simulated and skipped", name)
    given = {
        "world": find_world(arguments.world),
        "robot_description": "",
        "paused": arguments.paused,
        "seed": arguments.seed,
        "clock_rate": rospy.get_param(CLOCK_RATE, 100.0),
    }
    try:
        return read_parameters(BridgeParameters, lambda name, other: given.get(name[1:], other))
    except ParameterError as error:
        raise ParameterError(str(error).replace("~clock_rate", CLOCK_RATE)) from error


def find_world(name: str, folder: Optional[Path] = None) -> str:
    """Return what names a world file for the bridge.

    As in Gazebo, a relative name is looked up in the working folder, then in the folders of
    GAZEBO_RESOURCE_PATH; the last of them is this package's, which has worlds/empty.world.

    Args:
        name: a path, or a URI, which is returned as it is.
        folder: the working folder.

    Raises:
        ArgumentsError: there is no such file.
    """
    if "://" in name or Path(name).is_absolute():
        return name
    listed = _folders_in("GAZEBO_RESOURCE_PATH")
    folders = [folder or Path.cwd(), *map(Path, listed), package_share()]
    for place in folders:
        if (place / name).is_file():
            return str((place / name).absolute())
    looked = ", ".join(map(str, folders))
    raise ArgumentsError(f"world '{name}' is in none of {looked} (GAZEBO_RESOURCE_PATH)")


def add_exported_paths() -> None:
    """Add what all packages export to the environment of this process."""
    packages = rospkg.RosPack()
    folders = (Path(packages.get_path(name)) for name in sorted(packages.list()))
    for variable, paths in exported_paths(folders).items():
        known = _folders_in(variable)
        new = [path for path in paths if path not in known]
        if new:
            os.environ[variable] = os.pathsep.join([*known, *new])


def exported_paths(folders: Iterable[Path]) -> Dict[str, List[str]]:
    """Return the folders that packages export, by the names of environment variables.

    Args:
        folders: of the packages; a package.xml that makes no sense is passed over.
    """
    found: Dict[str, List[str]] = {variable: [] for variable in VARIABLES.values()}
    for folder in folders:
        for element in _exports(folder / "package.xml"):
            for attribute, variable in VARIABLES.items():
                value = element.get(attribute, "").replace("${prefix}", str(folder))
                found[variable].extend(part for part in value.split(os.pathsep) if part)
    return found


def _folders_in(variable: str) -> List[str]:
    return [path for path in os.environ.get(variable, "").split(os.pathsep) if path]


def _exports(manifest: Path) -> List[Element]:
    try:
        text = read_text(manifest)
        # There may be hundreds of packages, and few of them know Gazebo.
        if EXPORTER not in text:
            return []
        return parse_text(text, str(manifest)).findall(f"export/{EXPORTER}")
    except LabError:
        return []


def main() -> None:
    """Run the node."""

    def read() -> BridgeParameters:
        add_exported_paths()
        return bridge_parameters(parse_server_arguments(rospy.myargv(sys.argv)[1:]))

    serve("gazebo", read)
