"""What stands on the command line of gzserver, and where it finds worlds. No rospy."""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path
from typing import List, NoReturn, Optional, Sequence, Tuple

from bullet_lab.errors import LabError
from bullet_lab.simulation.resources import package_share

DEFAULT_WORLD = "worlds/empty.world"
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
# They give Gazebo its ROS interface, which the bridge has.
ROS_PLUGINS = "libgazebo_ros_"


class ServerArgumentsError(LabError):
    """A command line that cannot be followed."""


@dataclass(frozen=True)
class ServerArguments:
    """What gzserver is told.

    Attributes:
        world: name of the world file, as given.
        paused: whether to start paused.
        seed: of all that is random.
        plugins: server plugins that are not simulated, by the names of their files.
    """

    world: str = DEFAULT_WORLD
    paused: bool = False
    seed: int = 0
    plugins: Tuple[str, ...] = ()


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ServerArgumentsError(message)


def parse_server_arguments(words: Sequence[str]) -> ServerArguments:
    """Read gzserver's arguments, less those of ROS.

    Options that have no meaning here (recording, the choice of a physics engine, …) are passed
    over.

    Raises:
        ServerArgumentsError: an option that is unknown, or one whose effect would be missed.
    """
    parser = _Parser(prog="gzserver", add_help=False, allow_abbrev=False)
    parser.add_argument("world", nargs="?", default=DEFAULT_WORLD)
    parser.add_argument("-u", "--pause", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-s", "--server-plugin", action="append", default=[])
    for names in IDLE_FLAGS:
        parser.add_argument(*names, action="store_true")
    for names in IDLE_VALUES:
        parser.add_argument(*names, action="append")
    for names in REFUSED:
        parser.add_argument(*names, dest=names[-1].lstrip("-"))
    found = parser.parse_args([word for word in words if word])
    for names in REFUSED:
        if getattr(found, names[-1].lstrip("-")) is not None:
            raise ServerArgumentsError(f"{names[-1]} is not simulated")
    if found.seed < 0:
        raise ServerArgumentsError(f"--seed {found.seed} is negative")
    strange = (Path(name).name for name in found.server_plugin)
    plugins = tuple(name for name in strange if not name.startswith(ROS_PLUGINS))
    return ServerArguments(found.world, found.pause, found.seed, plugins)


def find_world(name: str, folder: Optional[Path] = None) -> str:
    """Return what names a world file for the bridge.

    As in Gazebo, a relative name is looked up in the working folder, then in the folders of
    GAZEBO_RESOURCE_PATH; the last of them is this package's, which has worlds/empty.world.

    Args:
        name: a path, or a URI, which is returned as it is.
        folder: the working folder.

    Raises:
        ServerArgumentsError: there is no such file.
    """
    if "://" in name or Path(name).is_absolute():
        return name
    folders = [folder or Path.cwd(), *resource_folders()]
    for place in folders:
        if (place / name).is_file():
            return str((place / name).absolute())
    looked = ", ".join(map(str, folders))
    raise ServerArgumentsError(f"world '{name}' is in none of {looked} (GAZEBO_RESOURCE_PATH)")


def resource_folders() -> List[Path]:
    """Return the folders of GAZEBO_RESOURCE_PATH and this package's."""
    listed = os.environ.get("GAZEBO_RESOURCE_PATH", "").split(os.pathsep)
    return [Path(folder) for folder in listed if folder] + [package_share()]
