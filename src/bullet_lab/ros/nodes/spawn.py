"""Spawns models: in a pattern, at points clicked in RViz, or with gazebo_ros's command line.

populate and depopulate spawn models in a pattern and delete them; place_beacon spawns a beacon at
each point that is clicked in RViz; spawn_model spawns one model, as in launch files for Gazebo:
see `USAGE`. Its -database looks in the GAZEBO_MODEL_PATH of the simulation; there is no database on
the network.

:ROS Parameters: see `PopulateParameters`, `DepopulateParameters` and `PlaceBeaconParameters`.
:ROS Service clients:
    - all: /gazebo/spawn_sdf_model (gazebo_msgs/SpawnModel)
    - depopulate: /gazebo/get_world_properties, delete_model
    - place_beacon: /gazebo/get_world_properties, get_model_state
    - spawn_model: /gazebo/spawn_urdf_model, set_model_configuration, unpause_physics, delete_model
:ROS Subscribers of place_beacon:
    - /clicked_point (geometry_msgs/PointStamped): in any frame; the height is ignored
    - /bullet_lab/world (visualization_msgs/MarkerArray): the models of the world
:ROS Subscribers of spawn_model, with -wait: /gazebo/model_states (gazebo_msgs/ModelStates)
:ROS Publishers of place_beacon: ~placed (std_msgs/String), latched: name of the last beacon
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import itertools
import math
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Collection, Sequence
from xml.sax.saxutils import escape

import rospy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import String
from std_srvs.srv import Empty
from visualization_msgs.msg import MarkerArray

from bullet_lab.core import se2
from bullet_lab.core.parameters import (
    ArgumentParser,
    ArgumentsError,
    ParameterError,
    checked,
    choice,
    integer,
    number,
    text,
)
from bullet_lab.core.pose import Pose
from bullet_lab.ros.gazebo.client import WORLD, StandingModels, call, numbered
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import InputError, pose_message, vector_of
from bullet_lab.ros.node.lock_step import Publisher, subscriber
from bullet_lab.ros.node.node import NodeError, node, run_node, spin, wait_until
from bullet_lab.ros.node.odometry import FrameFinder
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.xml import read_text

CLICKED = "/clicked_point"
# Frame of the world.
FRAME = "world"
# m from a point to other models: a beacon's radius and a margin.
CLEARANCE = 0.3
# m
ROBOT_RADIUS = 0.3
# The three beacons of the report.
BEACONS: tuple[se2.PlanarPose, ...] = ((1.0, 1.0, 0.0), (5.0, 1.0, 0.0), (-5.0, 1.0, 0.0))
NUMBERS = ("x", "y", "z", "R", "P", "Y")
PACKAGE_MESH = re.compile(r"""(<\s*mesh\b[^>]*\bfilename\s*=\s*["'])package://""")
USAGE_STATUS = 2
USAGE = """\
Usage: spawn_model -urdf|-sdf -file FILE|-param NAME|-database MODEL|-stdin -model NAME
    [-x -y -z -R -P -Y NUMBER] [-reference_frame NAME] [-robot_namespace NAME]
    [-gazebo_namespace NAME] [-wait MODEL] [-unpause] [-J JOINT POSITION] [-package_to_model] [-b]
"""


def accept_poses(value: Any) -> tuple[se2.PlanarPose, ...]:
    """Return the poses of a list of [x, y] or [x, y, yaw]; raises ValueError or TypeError."""
    poses = []
    for entry in value:
        if len(entry) not in (2, 3) or any(isinstance(part, (bool, str)) for part in entry):
            raise ValueError(entry)
        x, y, yaw = (float(part) for part in (*entry, 0.0)[:3])
        if not all(map(math.isfinite, (x, y, yaw))):
            raise ValueError(entry)
        poses.append((x, y, yaw))
    return tuple(poses)


@dataclass(frozen=True)
class DepopulateParameters:
    """Private parameters of depopulate."""

    prefix: str = text("beacon", "first part of the models' names: beacon_0, beacon_1 …")


@dataclass(frozen=True)
class PlaceBeaconParameters(DepopulateParameters):
    """Private parameters of place_beacon."""

    model: str = text(
        "model://beacon", "what to place: model://…, or an SDF or URDF file, a path or package://"
    )


@dataclass(frozen=True)
class PopulateParameters(PlaceBeaconParameters):
    """Private parameters of populate."""

    pattern: str = choice("poses", "how they are arranged", ("poses", "line", "grid", "circle"))
    poses: tuple[se2.PlanarPose, ...] = checked(
        BEACONS,
        "their poses, for the pattern poses",
        "a list of [x, y] or [x, y, yaw] with finite numbers in m and rad",
        accept_poses,
    )
    count: int = integer(3, "how many, for the other patterns", 1, 100_000)
    spacing: float = number(1.0, "m between neighbours in a line or grid", above=0.0)
    radius: float = number(3.0, "of the circle, in m", above=0.0)
    name: str = text("", "name of the model, if it is only one")


def places_of(parameters: PopulateParameters) -> dict[str, se2.PlanarPose]:
    """Return the poses of the models by name; raises ParameterError if ~name is for several."""
    poses = list(parameters.poses)
    if parameters.pattern == "line":
        poses = se2.line(parameters.count, parameters.spacing)
    elif parameters.pattern == "grid":
        poses = se2.grid(parameters.count, parameters.spacing)
    elif parameters.pattern == "circle":
        poses = se2.circle(parameters.count, parameters.radius)
    name, count = parameters.name, len(poses)
    if name and count != 1:
        raise ParameterError(f"~name is '{name}': {count} models cannot share one name")
    names = [name] if name else [f"{parameters.prefix}_{index}" for index in range(count)]
    return dict(zip(names, poses))


def description_of(model: str) -> str:
    """Return a model as text for the spawn service; raises LabError.

    For a model:// URI or a folder, the text is an include, which the simulator resolves.
    """
    if model.startswith("model://"):
        return inclusion_of(model)
    path = ResourceFinder.anywhere().find(model)
    return inclusion_of(path.as_uri()) if os.path.isdir(path) else read_text(path)


def spawn(
    name: str,
    description: str,
    namespace: str,
    pose: Pose,
    service: str = "/gazebo/spawn_sdf_model",
    frame: str = "",
) -> str:
    """Spawn a model and return the answer of the service; raises NodeError."""
    place = (namespace, pose_message(pose), frame)
    return call(service, srv.SpawnModel, name, description, *place).status_message


def inclusion_of(uri: str) -> str:
    """Return SDF that includes a model."""
    return f'<sdf version="1.6"><include><uri>{escape(uri)}</uri></include></sdf>'


@node
def populate(parameters: PopulateParameters) -> None:
    """Spawn the models; raises LabError."""
    places = places_of(parameters)
    text = description_of(parameters.model)
    for name, (x, y, yaw) in places.items():
        pose = Pose((x, y, 0.0), se2.quaternion_from_yaw(yaw))
        try:
            spawn(name, text, rospy.get_namespace(), pose)
        except NodeError as error:
            raise NodeError(f"cannot place '{name}': {error}") from error
    rospy.loginfo("%d models placed: %s …", len(places), "".join([*places][:1]))


@node
def depopulate(parameters: DepopulateParameters) -> None:
    """Delete the models; raises LabError."""
    world = call("/gazebo/get_world_properties", srv.GetWorldProperties)
    names = numbered(world.model_names, parameters.prefix)
    for name in names:
        call("/gazebo/delete_model", srv.DeleteModel, name)
    rospy.loginfo("%d models deleted", len(names))


def free_name(prefix: str, taken: Collection[str]) -> str:
    """Return the first of prefix_0, prefix_1 … that is not taken."""
    names = (f"{prefix}_{number}" for number in itertools.count())
    return next(name for name in names if name not in taken)


class PlaceBeacon:
    """Spawns a beacon for each click."""

    def __init__(self, parameters: PlaceBeaconParameters):
        self._prefix = parameters.prefix
        self._text = description_of(parameters.model)
        self._frames = FrameFinder()
        self._standing = StandingModels()
        self._placed = Publisher("~placed", String, queue_size=10, latch=True)
        # The first message has all models, later ones have changes.
        self._world = rospy.Subscriber(WORLD, MarkerArray, self._standing.take)
        wait_until(self._standing.is_known, f"a publisher of {WORLD}")
        subscriber(CLICKED, PointStamped, self._receive, 10)

    def _receive(self, message: PointStamped) -> None:
        point = vector_of(message.point, "the point")
        x, y, _ = self._frames.bring(Pose(point), message.header.frame_id, FRAME).position
        name = self._spawn(x, y)
        rospy.loginfo("%s placed at (%.2f, %.2f) m", name, x, y)
        self._placed.publish(String(name))

    def _spawn(self, x: float, y: float) -> str:
        names = call("/gazebo/get_world_properties", srv.GetWorldProperties).model_names
        nearest, distance = self._standing.nearest(x, y)
        if distance < CLEARANCE:
            raise InputError(f"({x:.2f}, {y:.2f}) m is too near to {nearest}")
        # The markers leave out the robot, which RViz draws from its description.
        for name in set(names) - set(self._standing.names()):
            place = call("/gazebo/get_model_state", srv.GetModelState, name, "").pose.position
            if math.hypot(place.x - x, place.y - y) < CLEARANCE + ROBOT_RADIUS:
                raise InputError(f"({x:.2f}, {y:.2f}) m is too near to {name}")
        name = free_name(self._prefix, names)
        spawn(name, self._text, "", Pose((x, y, 0.0)))
        return name


@node
def place_beacon(parameters: PlaceBeaconParameters) -> None:
    """Run until ROS shuts down."""
    PlaceBeacon(parameters)
    spin()


def parse_spawn_arguments(words: Sequence[str], namespace: str = "/") -> argparse.Namespace:
    """Read the arguments of spawn_model, as in gazebo_ros for Noetic, without those of ROS.

    Return the values of the options by their names, and the source of the description with its name
    there, the pose in the reference frame, and initial positions of joints in rad or m. By default,
    the robot has the namespace of the node.

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
    parser.add_argument("-gazebo_namespace", default="/gazebo")
    parser.add_argument("-robot_namespace", "-namespace", default=namespace)
    for option in ("-reference_frame", "-wait"):
        parser.add_argument(option, default="")
    for option in ("-unpause", "-package_to_model"):
        parser.add_argument(option, action="store_true")
    # The model is deleted when this process ends.
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


def spawn_by(arguments: argparse.Namespace) -> str:
    """Spawn the model and return the answer of the service; raises LabError."""
    gazebo = arguments.gazebo_namespace
    if arguments.wait:
        _wait_for(arguments.wait, f"{gazebo}/model_states")
    service = f"{gazebo}/spawn_{'urdf' if arguments.urdf else 'sdf'}_model"
    answer = spawn(
        arguments.model,
        described_by(arguments),
        arguments.robot_namespace,
        arguments.pose,
        service,
        arguments.reference_frame,
    )
    if arguments.joints:
        names, positions = zip(*arguments.joints.items())
        configure = f"{gazebo}/set_model_configuration"
        call(configure, srv.SetModelConfiguration, arguments.model, "", names, positions)
    if arguments.unpause:
        call(f"{gazebo}/unpause_physics", Empty)
    return answer


def described_by(arguments: argparse.Namespace) -> str:
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
    states = rospy.Subscriber(topic, msg.ModelStates, lambda message: names.update(message.name))
    wait_until(lambda: model in names, f"model '{model}'")
    states.unregister()


def spawn_model() -> None:
    """Run the node."""
    words = rospy.myargv(sys.argv)[1:]
    if not words or words[0] in ("-h", "-help", "--help"):
        print(USAGE, end="")
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
        rospy.loginfo("spawn_model: %s", spawn_by(arguments))
        if arguments.bond:
            rospy.on_shutdown(delete)
            spin()

    run_node("spawn_model", body)
