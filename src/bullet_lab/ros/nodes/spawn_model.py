"""gazebo_ros's spawn_model: puts a model into the running world, as launch files have it.

Usage: spawn_model -urdf|-sdf -file FILE|-param NAME|-database MODEL|-stdin -model NAME
    [-x -y -z -R -P -Y NUMBER] [-reference_frame NAME] [-robot_namespace NAME]
    [-gazebo_namespace NAME] [-wait MODEL] [-unpause] [-J JOINT POSITION] [-package_to_model] [-b]

There is no database on the network: -database looks in the simulation's GAZEBO_MODEL_PATH.

:ROS Service clients: /gazebo/spawn_urdf_model or spawn_sdf_model (gazebo_msgs/SpawnModel),
    set_model_configuration, unpause_physics, delete_model
:ROS Subscribers: /gazebo/model_states (gazebo_msgs/ModelStates), with -wait
"""

from __future__ import annotations

import argparse
import contextlib
import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, List, Mapping, Sequence
from xml.sax.saxutils import escape

import rospy
from std_srvs.srv import Empty

from bullet_lab.core.arguments import ArgumentParser, ArgumentsError
from bullet_lab.core.pose import Pose
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.node import NodeError, run_node, wait_until
from bullet_lab.simulation.world.xml import read_text

GAZEBO = "/gazebo"
NUMBERS = ("-x", "-y", "-z", "-R", "-P", "-Y")
DATABASE = '<sdf version="1.6"><include><uri>model://{}</uri></include></sdf>'
PACKAGE_MESH = re.compile(r"""(<\s*mesh\b[^>]*\bfilename\s*=\s*["'])package://""")
USAGE_STATUS = 2


@dataclass(frozen=True)
class SpawnArguments:
    """The command line of spawn_model.

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


def parse_spawn_arguments(words: Sequence[str], namespace: str = "/") -> SpawnArguments:
    """Read spawn_model's arguments, those of gazebo_ros for Noetic, less those of ROS.

    Args:
        words: the arguments.
        namespace: of the node; the robot's, if nothing else is said.

    Raises:
        ArgumentsError: something is unknown, missing, said twice or no number.
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


def _parser(namespace: str) -> ArgumentParser:
    parser = ArgumentParser(prog="spawn_model", add_help=False, allow_abbrev=False)
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
        raise ArgumentsError(f"'{text}' is not a finite number")
    return float(text)


def _filled(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("it is empty")
    return text


def spawn(arguments: SpawnArguments) -> str:
    """Put the model into the world and return what was answered; raises LabError."""
    gazebo = arguments.gazebo_namespace
    if arguments.wait:
        _wait_for(arguments.wait, f"{gazebo}/model_states")
    service = f"{gazebo}/spawn_{'urdf' if arguments.urdf else 'sdf'}_model"
    answer = call(
        service,
        srv.SpawnModel,
        arguments.model,
        description_of(arguments),
        arguments.robot_namespace,
        pose_message(arguments.pose),
        arguments.reference_frame,
    )
    if arguments.joints:
        names, positions = zip(*arguments.joints.items())
        configure = f"{gazebo}/set_model_configuration"
        call(configure, srv.SetModelConfiguration, arguments.model, "", names, positions)
    if arguments.unpause:
        _unpause(f"{gazebo}/unpause_physics")
    return answer.status_message


def description_of(arguments: SpawnArguments) -> str:
    """Return the text that describes the model; raises LabError where there is none."""
    if arguments.source == "file":
        text = read_text(Path(arguments.source_name))
    elif arguments.source == "param":
        text = str(rospy.get_param(arguments.source_name, ""))
    elif arguments.source == "database":
        text = database_text(arguments.source_name)
    else:
        text = sys.stdin.read()
    if not text.strip():
        raise NodeError(f"-{arguments.source} {arguments.source_name}: there is nothing in it")
    return packages_to_models(text) if arguments.package_to_model else text


def database_text(model: str) -> str:
    """Return the description that stands for a model of the model folders."""
    return DATABASE.format(escape(model))


def packages_to_models(text: str) -> str:
    """Return a URDF whose meshes are looked up in model:// instead of package://."""
    return PACKAGE_MESH.sub(r"\1model://", text)


def _unpause(service: str) -> None:
    rospy.wait_for_service(service)
    try:
        rospy.ServiceProxy(service, Empty)()
    except rospy.ServiceException as error:
        raise NodeError(f"{service}: {error}") from error


def _wait_for(model: str, topic: str) -> None:
    """Wait until a model is in the world; in wall time, since simulated time may stand still."""
    seen: List[Any] = []

    def look(states: Any) -> None:
        if model in states.name:
            seen.append(model)

    subscriber = rospy.Subscriber(topic, msg.ModelStates, look, queue_size=1)
    wait_until(lambda: seen, f"model '{model}'")
    subscriber.unregister()


def _delete_at_the_end(arguments: SpawnArguments) -> None:
    """Wait until ROS shuts down, then take the model out again."""

    def delete() -> None:
        # The simulation may be gone already.
        with contextlib.suppress(rospy.ServiceException, rospy.ROSException):
            rospy.ServiceProxy(f"{arguments.gazebo_namespace}/delete_model", srv.DeleteModel)(
                arguments.model
            )

    rospy.on_shutdown(delete)
    rospy.spin()


def main() -> None:
    """Run the node."""
    words = rospy.myargv(sys.argv)[1:]
    if not words or words[0] in ("-h", "-help", "--help"):
        print(__doc__.split("\n\n")[1])
        sys.exit(0 if words else USAGE_STATUS)
    try:
        arguments = parse_spawn_arguments(words, rospy.get_namespace())
    except ArgumentsError as error:
        print(f"spawn_model: {error}", file=sys.stderr)
        sys.exit(USAGE_STATUS)

    def body() -> None:
        rospy.loginfo("spawn_model: %s", spawn(arguments))
        if arguments.bond:
            _delete_at_the_end(arguments)

    run_node("spawn_model", body)
