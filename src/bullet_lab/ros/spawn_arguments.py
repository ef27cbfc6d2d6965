"""What stands on the command line of spawn_model. No rospy."""

from __future__ import annotations

import argparse
import math
import re
from dataclasses import dataclass
from typing import List, Mapping, NoReturn, Sequence
from xml.sax.saxutils import escape

from bullet_lab.errors import LabError
from bullet_lab.simulation.pose import Pose

GAZEBO = "/gazebo"
NUMBERS = ("-x", "-y", "-z", "-R", "-P", "-Y")
DATABASE = '<sdf version="1.6"><include><uri>model://{}</uri></include></sdf>'
PACKAGE_MESH = re.compile(r"""(<\s*mesh\b[^>]*\bfilename\s*=\s*["'])package://""")


class SpawnArgumentsError(LabError):
    """A command line that cannot be followed."""


@dataclass(frozen=True)
class SpawnArguments:
    """What spawn_model is told.

    Attributes:
        urdf: whether the description is URDF; else it is SDF.
        source: where it comes from: "file", "param", "database" or "stdin".
        source_name: name of the file, parameter or model.
        model: name of the model in the world.
        pose: where it is put, in the reference frame.
        reference_frame: a model or link; empty for the world.
        robot_namespace: robotNamespace of plugins that have none.
        gazebo_namespace: of the services.
        wait: model that is waited for first; empty for none.
        unpause: whether time is let go on afterwards.
        joints: positions of joints to begin with, in rad or m.
        package_to_model: whether meshes in package:// are looked up in model://.
        bond: whether the model is deleted when this process ends.
    """

    urdf: bool
    source: str
    source_name: str
    model: str
    pose: Pose
    reference_frame: str
    robot_namespace: str
    gazebo_namespace: str
    wait: str
    unpause: bool
    joints: Mapping[str, float]
    package_to_model: bool
    bond: bool


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise SpawnArgumentsError(message)


def parse_spawn_arguments(words: Sequence[str], namespace: str = "/") -> SpawnArguments:
    """Read spawn_model's arguments, those of gazebo_ros for Noetic, less those of ROS.

    Args:
        words: the arguments.
        namespace: of the node; the robot's, if nothing else is said.

    Raises:
        SpawnArgumentsError: something is unknown, missing, said twice or no number.
    """
    found = _parser(namespace).parse_args(_with_numbers_joined(words))
    source = next(key for key in ("file", "param", "database", "stdin") if getattr(found, key))
    name = "" if source == "stdin" else getattr(found, source)
    x, y, z, roll, pitch, yaw = (getattr(found, option[1:]) for option in NUMBERS)
    return SpawnArguments(
        found.urdf,
        source,
        name,
        found.model,
        Pose.from_rpy((x, y, z), (roll, pitch, yaw)),
        found.reference_frame,
        found.robot_namespace,
        found.gazebo_namespace.rstrip("/"),
        found.wait,
        found.unpause,
        {joint: _finite(position) for joint, position in found.J},
        found.package_to_model,
        found.b,
    )


def database_text(model: str) -> str:
    """Return the description that stands for a model of the model folders."""
    return DATABASE.format(escape(model))


def packages_to_models(text: str) -> str:
    """Return a URDF whose meshes are looked up in model:// instead of package://."""
    return PACKAGE_MESH.sub(r"\1model://", text)


def _parser(namespace: str) -> _Parser:
    parser = _Parser(prog="spawn_model", add_help=False, allow_abbrev=False)
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument("-urdf", action="store_true")
    kind.add_argument("-sdf", "-gazebo", action="store_true")
    source = parser.add_mutually_exclusive_group(required=True)
    for name in ("-file", "-param", "-database"):
        source.add_argument(name, type=_filled)
    source.add_argument("-stdin", action="store_true")
    parser.add_argument("-model", type=_filled, required=True)
    parser.add_argument("-reference_frame", default="")
    parser.add_argument("-gazebo_namespace", default=GAZEBO)
    parser.add_argument("-robot_namespace", "-namespace", default=namespace)
    parser.add_argument("-wait", default="")
    for flag in ("-unpause", "-package_to_model", "-b"):
        parser.add_argument(flag, action="store_true")
    for number in NUMBERS:
        parser.add_argument(number, type=_finite, default=0.0)
    parser.add_argument("-J", action="append", nargs=2, default=[])
    return parser


def _with_numbers_joined(words: Sequence[str]) -> List[str]:
    """Return the arguments with numbers such as -1e-3, which look like options, after a "="."""
    joined: List[str] = []
    for word in words:
        if joined and joined[-1] in NUMBERS:
            joined[-1] += f"={word}"
        elif len(joined) > 1 and joined[-2] == "-J" and _is_number(word):
            # argparse knows -1 for a number, and not -1e-3.
            joined.append(f"{float(word):.17f}")
        else:
            joined.append(word)
    return joined


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _finite(text: str) -> float:
    if not _is_number(text):
        raise SpawnArgumentsError(f"'{text}' is not a finite number")
    return float(text)


def _filled(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("it is empty")
    return text
