"""Spawns a model with the command line of gazebo_ros's spawn_model, as in launch files.

Usage: spawn_model -urdf|-sdf -file FILE|-param NAME|-database MODEL|-stdin -model NAME
    [-x -y -z -R -P -Y NUMBER] [-reference_frame NAME] [-robot_namespace NAME]
    [-gazebo_namespace NAME] [-wait MODEL] [-unpause] [-J JOINT POSITION] [-package_to_model] [-b]

-database looks in the GAZEBO_MODEL_PATH of the simulation; there is no database on the network.

:ROS Service clients: /gazebo/spawn_urdf_model or spawn_sdf_model (gazebo_msgs/SpawnModel),
    set_model_configuration, unpause_physics, delete_model
:ROS Subscribers: /gazebo/model_states (gazebo_msgs/ModelStates), with -wait
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import re
import sys
from pathlib import Path
from typing import Sequence

import rospy
from std_srvs.srv import Empty

from bullet_lab.core.parameters import ArgumentParser, ArgumentsError
from bullet_lab.core.pose import Pose
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.node import NodeError, run_node, spin, wait_until
from bullet_lab.ros.nodes.populate import inclusion_of
from bullet_lab.simulation.world.xml import read_text

NUMBERS = ("x", "y", "z", "R", "P", "Y")
PACKAGE_MESH = re.compile(r"""(<\s*mesh\b[^>]*\bfilename\s*=\s*["'])package://""")
USAGE_STATUS = 2


def parse_spawn_arguments(words: Sequence[str], namespace: str = "/") -> argparse.Namespace:
    """Read the arguments of spawn_model, as in gazebo_ros for Noetic, without those of ROS.

    Args:
        words: the arguments.
        namespace: of the node; it is also the robot's by default.

    Returns:
        The values of the options by their names, and
            source: of the description and its name there, such as "file" and the file's name.
            pose: in the reference frame.
            joints: initial positions by name, in rad or m.
            bond: whether the model is deleted when this process ends.

    Raises:
        ArgumentsError: an option is unknown, missing or given twice, or its value invalid.
    """
    found = _parser(namespace).parse_args(words)
    x, y, z, roll, pitch, yaw = (getattr(found, name) for name in NUMBERS)
    found.pose = Pose.from_rpy((x, y, z), (roll, pitch, yaw))
    found.gazebo_namespace = found.gazebo_namespace.rstrip("/")
    found.joints = {joint: _finite(position) for joint, position in found.J}
    return found


def _parser(namespace: str) -> ArgumentParser:
    parser = ArgumentParser(prog="spawn_model", add_help=False, allow_abbrev=False)
    # By default, argparse takes -1e-3 for an option.
    parser._negative_number_matcher = re.compile(r"-(\d|\.|inf|nan)", re.IGNORECASE)
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument("-urdf", action="store_true")
    kind.add_argument("-sdf", "-gazebo", action="store_true")
    source = parser.add_mutually_exclusive_group(required=True)
    for name in ("file", "param", "database"):
        read = functools.partial(_named, name)
        source.add_argument(f"-{name}", dest="source", type=read)
    source.add_argument("-stdin", dest="source", action="store_const", const=("stdin", ""))
    parser.add_argument("-model", type=_filled, required=True)
    parser.add_argument("-reference_frame", default="")
    parser.add_argument("-gazebo_namespace", default="/gazebo")
    parser.add_argument("-robot_namespace", "-namespace", default=namespace)
    parser.add_argument("-wait", default="")
    parser.add_argument("-unpause", action="store_true")
    parser.add_argument("-package_to_model", action="store_true")
    parser.add_argument("-b", dest="bond", action="store_true")
    for name in NUMBERS:
        parser.add_argument(f"-{name}", type=_finite, default=0.0)
    parser.add_argument("-J", action="append", nargs=2, default=[])
    return parser


def _finite(text: str) -> float:
    with contextlib.suppress(ValueError):
        if math.isfinite(float(text)):
            return float(text)
    raise ArgumentsError(f"'{text}' is not a finite number")


def _named(source: str, name: str) -> tuple[str, str]:
    return source, _filled(name)


def _filled(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("it is empty")
    return text


def spawn(arguments: argparse.Namespace) -> str:
    """Spawn the model and return the answer of the service; raises LabError."""
    gazebo = arguments.gazebo_namespace
    if arguments.wait:
        _wait_for(arguments.wait, f"{gazebo}/model_states")
    service = f"{gazebo}/spawn_{'urdf' if arguments.urdf else 'sdf'}_model"
    place = (arguments.robot_namespace, pose_message(arguments.pose), arguments.reference_frame)
    text = description_of(arguments)
    answer = call(service, srv.SpawnModel, arguments.model, text, *place)
    if arguments.joints:
        names, positions = zip(*arguments.joints.items())
        configure = f"{gazebo}/set_model_configuration"
        call(configure, srv.SetModelConfiguration, arguments.model, "", names, positions)
    if arguments.unpause:
        call(f"{gazebo}/unpause_physics", Empty)
    return answer.status_message


def description_of(arguments: argparse.Namespace) -> str:
    """Return the description of the model; raises LabError if it is empty."""
    source, name = arguments.source
    if source == "file":
        text = read_text(Path(name))
    elif source == "param":
        text = str(rospy.get_param(name, ""))
    elif source == "database":
        text = inclusion_of(f"model://{name}")
    else:
        text = sys.stdin.read()
    if not text.strip():
        raise NodeError(f"-{source} {name}: it is empty")
    return packages_to_models(text) if arguments.package_to_model else text


def packages_to_models(text: str) -> str:
    """Replace package:// by model:// in the meshes of a URDF."""
    return PACKAGE_MESH.sub(r"\1model://", text)


def _wait_for(model: str, topic: str) -> None:
    """Wait until a model is in the world; in wall time, since simulated time may stand still."""
    names: set[str] = set()
    subscriber = rospy.Subscriber(topic, msg.ModelStates, lambda states: names.update(states.name))
    wait_until(lambda: model in names, f"model '{model}'")
    subscriber.unregister()


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

    def delete() -> None:
        # The simulation may have ended already.
        with contextlib.suppress(rospy.ServiceException, rospy.ROSException):
            service = f"{arguments.gazebo_namespace}/delete_model"
            rospy.ServiceProxy(service, srv.DeleteModel)(arguments.model)

    def body() -> None:
        rospy.loginfo("spawn_model: %s", spawn(arguments))
        if arguments.bond:
            rospy.on_shutdown(delete)
            spin()

    run_node("spawn_model", body)
