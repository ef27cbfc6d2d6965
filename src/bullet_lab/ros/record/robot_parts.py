"""A robot in a running simulation: its parts and topics, the messages on them, and a picture.

The ROS master knows the topics and services, the bridge describes the models.
"""

from __future__ import annotations

import contextlib
import math
import os
import struct
import time
from dataclasses import fields
from typing import Any, Callable, Iterable, Mapping, Sequence

import numpy as np
import rosgraph
import roslib.message
import rospy
import rosservice
from sensor_msgs.msg import Image

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.msg import ModelDescription
from bullet_lab.reports.robot import Controller, PluginRow, Robot, RobotReport
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.lock_step import publishers_know_this_node
from bullet_lab.ros.node.node import MASTER_ERRORS, NodeError
from bullet_lab.ros.node.publishers import subscriber
from bullet_lab.srv import DescribeModels, DescribeModelsResponse

SERVICE = "/bullet_lab/describe_models"
VELOCITIES = "geometry_msgs/Twist"
ODOMETRY = "nav_msgs/Odometry"
PICTURES = "sensor_msgs/Image"
CONTROLLERS = "/list_controllers"
# Of these, `ENOUGH` messages are received: rendering and sending them takes long.
HEAVY = (PICTURES, "sensor_msgs/CompressedImage", "sensor_msgs/PointCloud2")
ENOUGH = 10
# Types of messages for programs that change settings.
SETTINGS = "dynamic_reconfigure/"
# Topics of the simulator itself.
OWN_TOPICS = ("/clock", "/rosout", "/tf", "/tf_static", "/gazebo/", "/bullet_lab/")
TOUCHED = "/bullet_lab/touched"
# rad/s or m/s; a joint above it turns.
TURNING = 0.05
# Models that a line names.
MOST_NAMES = 10
# The beginning of a serialized header: sequence number, stamp in s and ns.
HEADER = struct.Struct("<III")


class Master:
    """The simulator's topics and all services, as the ROS master knows them at a moment.

    Attributes:
        subscribed: topics that the simulator subscribes to, with their types.
        published: topics that it publishes, with their types.
        services: names of all services.
    """

    def __init__(self):
        master = rosgraph.Master(rospy.get_name())
        try:
            published, subscribed, services = master.getSystemState()
            kinds = dict(master.getTopicTypes())
        except MASTER_ERRORS as error:
            raise NodeError(f"the ROS master does not answer: {error}") from error
        # The simulator is the node that publishes the time.
        simulators = set(dict(published).get("/clock", ()))
        self.services = {name for name, _ in services}
        self.subscribed = _topics_with(simulators, subscribed, kinds)
        self.published = _topics_with(simulators, published, kinds)


def _topics_with(
    nodes: set[str], topics: Iterable[Any], kinds: Mapping[str, str]
) -> dict[str, str]:
    found = sorted(topic for topic, users in topics if nodes.intersection(users))
    others = [t for t in found if not (t.startswith(OWN_TOPICS) or t.endswith(TOUCHED))]
    return {topic: kinds.get(topic, "*") for topic in others}


def described(name: str = "") -> DescribeModelsResponse:
    """Return the bridge's description of a model, or of all; raises NodeError."""
    return call(SERVICE, DescribeModels, name)


def choose(
    models: Iterable[ModelDescription],
    name: str,
    drives: Iterable[str],
    of_world_file: bool = False,
) -> ModelDescription | None:
    """Return the model that is the robot; None while there is none.

    Args:
        models: of the world.
        name: of the robot; if empty, models that can be driven come first, then those with
            plugins, each in the order of their names.
        drives: the topics with velocities that the simulator subscribes to.
        of_world_file: whether a model of the world file may be chosen if nothing was spawned:
            one that moves and has plugins, if something can be driven.
    """
    if name:
        return next((model for model in models if model.name == name), None)
    there = sorted(models, key=lambda model: (model.is_static, model.name))
    found = [model for model in there if not model.of_world_file]
    if of_world_file and drives and not found:
        found = [model for model in there if model.plugins and not model.is_static]
    with_plugins = [model for model in found if model.plugins]
    return next(iter([*drivable(found, drives), *with_plugins, *found]), None)


def drivable(models: Iterable[ModelDescription], drives: Iterable[str]) -> list[ModelDescription]:
    """Return the models with a plugin that takes velocities, by name."""
    found = [m for m in models if set(drives) & {t for p in m.plugins for t in p.inputs}]
    return sorted(found, key=lambda model: model.name)


def candidates(models: Iterable[ModelDescription]) -> str:
    """Return which models the argument `model` may name, those with plugins first."""
    moving = sorted((m for m in models if not m.is_static), key=lambda m: not m.plugins)
    names = ", ".join(model.name for model in moving[:MOST_NAMES])
    return f"model:=NAME takes one of {names}" if names else "no model in the world can move"


def why_it_stands(model: ModelDescription, drive: str, is_connected: bool) -> list[str]:
    """Return known reasons why a robot does not move although velocities are sent to it."""
    if model.is_static:
        return ["the model is static"]
    if not is_connected:
        return [f"nothing listens to {drive}"]
    ask = rospy.ServiceProxy("/gazebo/get_joint_properties", srv.GetJointProperties)
    rates = {joint: ask(f"{model.name}::{joint}").rate for joint in model.joints}
    turning = [joint for joint, rate in rates.items() if rate and abs(rate[0]) > TURNING]
    found = [f"{', '.join(turning) or 'none'} of its joints turn"] if rates else []
    return [*found, f"it stands on {', '.join(model.stands_on) or 'nothing'}"]


def robot_of(
    model: ModelDescription,
    others: Sequence[ModelDescription],
    warnings: Iterable[str],
    master: Master,
) -> Robot:
    """Return the parts of a robot and the topics that it is driven by.

    Args:
        model: of the robot.
        others: all other models.
        warnings: of the simulation about all models.
        master: which has the topics.
    """
    own, strange = _topics([model]), _topics(others)
    drives = of_kind(master.subscribed, VELOCITIES)
    drive = _nearest(drives, own, strange, "")
    odometry = ""
    if drive:
        # The odometry of a plugin that drives is its own; that of a controller is no plugin's.
        beside = {t for plugin in model.plugins if drive in plugin.inputs for t in plugin.outputs}
        if drive not in own:
            strange = strange | own
        odometry = _nearest(of_kind(master.published, ODOMETRY), beside, strange, drive)
    of_world = [other.name for other in others if other.of_world_file]
    kin = [other for other in others if other.of_world_file == model.of_world_file]
    return Robot(
        name=model.name,
        links=tuple(model.links),
        joints=tuple(model.joints),
        plugins=plugins_of([model]),
        controllers=tuple(controllers(master)),
        drive=drive,
        odometry=odometry,
        said=tuple(w for w in warnings if not any(f"'{name}'" in w for name in of_world)),
        choice=tuple(other.name for other in drivable([model, *kin], drives)),
    )


def plugins_of(models: Iterable[ModelDescription]) -> tuple[PluginRow, ...]:
    """Return the plugins of models."""
    return tuple(_row(plugin) for model in models for plugin in model.plugins)


def _row(plugin: Any) -> PluginRow:
    values = [getattr(plugin, field.name) for field in fields(PluginRow)]
    return PluginRow(*(tuple(one) if isinstance(one, list) else one for one in values))


def _topics(models: Iterable[ModelDescription]) -> set[str]:
    plugins = [plugin for model in models for plugin in model.plugins]
    return {topic for plugin in plugins for topic in (*plugin.inputs, *plugin.outputs)}


def of_kind(topics: Mapping[str, str], kind: str) -> list[str]:
    """Return the topics of a type."""
    return [topic for topic, has in topics.items() if has == kind]


def _nearest(topics: Iterable[str], own: set[str], strange: set[str], drive: str) -> str:
    """Return the robot's topic: an own one, else the one of no other model named like `drive`."""

    def rank(topic: str) -> tuple[bool, int, bool]:
        shared = os.path.commonprefix([topic, drive])
        return topic in own, shared.count("/"), "odom" in topic

    possible = [topic for topic in topics if topic in own or topic not in strange]
    return max(possible, key=rank, default="")


def topics_of(
    model: ModelDescription, others: Iterable[ModelDescription], master: Master
) -> dict[str, str]:
    """Return the topics that a robot publishes, with their types.

    Topics that no model's plugin names are those of its controllers.
    """
    strange = _topics(others) - _topics([model])
    return {
        topic: kind
        for topic, kind in master.published.items()
        if topic not in strange and not kind.startswith(SETTINGS)
    }


def controllers(master: Master) -> list[Controller]:
    """Return the controllers of ros_control that are loaded."""
    found = []
    for name in sorted(name for name in master.services if name.endswith(CONTROLLERS)):
        try:
            kind = rosservice.get_service_class_by_name(name)
            answer = rospy.ServiceProxy(name, kind)()
        except (rosservice.ROSServiceException, rospy.ServiceException, OSError) as error:
            rospy.logwarn("%s: %s", name, error)
            continue
        found += [Controller(one.name, one.type, one.state) for one in answer.controller]
    return found


# All messages have arrived when none came for this many wall seconds.
QUIET = 0.2
# While simulated time runs, messages always come: the wait is repeated this often at most.
MOST_WAITS = 5


class Listeners:
    """Counts the messages on a robot's topics, and keeps the first image of each camera.

    Args:
        report: of the robot, which has the topics and their counts.
        now: returns the time in ns, for messages without a stamp.
        take: is called with the messages of the robot's odometry.
    """

    def __init__(self, report: RobotReport, now: Callable[[], int], take: Callable[[Any], None]):
        self._report = report
        self._now = now
        self._take = take
        # Serialized: most of them are only counted.
        self._subscribers = {
            topic: subscriber(topic, rospy.AnyMsg, self._receiver(topic, count.kind))
            for topic, count in report.counts.items()
        }

    def are_connected(self) -> bool:
        """Return whether every topic has its publisher."""
        return all(one.get_num_connections() > 0 for one in self._subscribers.values())

    def close(self) -> None:
        """Wait for messages that were already sent, then unsubscribe."""
        before = -1
        for _ in range(MOST_WAITS):
            received = sum(count.messages for count in self._report.counts.values())
            if received == before:
                break
            before = received
            rospy.rostime.wallsleep(QUIET)
        for one in self._subscribers.values():
            one.unregister()

    def _receiver(self, topic: str, kind: str) -> Callable[[rospy.AnyMsg], None]:
        count, message_class = self._report.counts[topic], _class_of(kind)
        has_header = message_class is not None and message_class._has_header
        is_odometry = topic == self._report.robot.odometry

        def receive(raw: rospy.AnyMsg) -> None:
            if has_header:
                _, seconds, nanoseconds = HEADER.unpack_from(raw._buff)
                count.note(seconds * 10**9 + nanoseconds)
            else:
                count.note(self._now())
            if is_odometry:
                self._take(message_class().deserialize(raw._buff))
            elif kind == PICTURES and count.messages == 1:
                # A depth image cannot be shown as a picture.
                with contextlib.suppress(LabError):
                    image = Image().deserialize(raw._buff)
                    self._report.seen[topic] = pixels_of(image, "bgr8")
            if kind in HEAVY and count.messages == ENOUGH:
                self._subscribers[topic].unregister()

        return receive


def _class_of(kind: str) -> type | None:
    """Return the class of a type of messages; None if its package is not installed."""
    try:
        return roslib.message.get_message_class(kind)
    except (ImportError, ValueError):
        return None


CAMERA_NAME = "bullet_lab_photographer"
FIELD_OF_VIEW = 0.8
# Direction from the middle of the model to the camera: ahead, left, up.
DIRECTION = (0.72, 0.52, 0.46)
# Distance in units of the half diagonal: the whole model is in the picture with some margin.
DISTANCE = 1.25 / math.sin(0.5 * FIELD_OF_VIEW * 0.75)
# Nothing nearer than this share of the distance is drawn, such as walls of narrow rooms.
CLEARANCE = 0.5
# m; half diagonal that is assumed for a model without size.
SMALLEST = 0.1
# Wall seconds for a connection, or a picture that has been taken.
LATEST = 2.0
CAMERA = """<sdf version="1.6"><model name="{name}"><static>true</static><link name="link">
  <sensor name="camera" type="camera"><update_rate>2</update_rate><camera>
    <horizontal_fov>{fov}</horizontal_fov>
    <image><width>800</width><height>600</height><format>R8G8B8</format></image>
    <clip><near>{near}</near><far>{far}</far></clip>
  </camera>
  <plugin name="camera" filename="libgazebo_ros_camera.so">
    <cameraName>{name}</cameraName><imageTopicName>image_raw</imageTopicName>
    <cameraInfoTopicName>camera_info</cameraInfoTopicName><frameName>{name}</frameName>
    <robotNamespace>/</robotNamespace><samples>4</samples>
  </plugin></sensor></link></model></sdf>"""


def camera_pose(least: Vector, greatest: Vector) -> Pose:
    """Return a pose from which a camera sees the whole of a box (m), looking along its x."""
    middle = 0.5 * (np.array(least) + greatest)
    away = distance_to(least, greatest) * np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    yaw = math.atan2(-away[1], -away[0])
    pitch = math.atan2(away[2], math.hypot(away[0], away[1]))
    return Pose.from_rpy(tuple((middle + away).tolist()), (0.0, pitch, yaw))


def distance_to(least: Vector, greatest: Vector) -> float:
    """Return the distance (m) of the camera from the middle of a box."""
    half = 0.5 * float(np.linalg.norm(np.subtract(greatest, least)))
    return DISTANCE * max(half, SMALLEST)


def photograph(
    least: Vector, greatest: Vector, wait: Callable[[], None], patience: int
) -> np.ndarray | None:
    """Take a picture of a box of the world (m) with a camera that is spawned for it.

    Args:
        least: lower corner of the box.
        greatest: upper corner.
        wait: lets a twentieth of a second of simulated time pass.
        patience: how often that is called, so that the picture always takes the same time.

    Returns:
        The picture, (h, w, 3) uint8, BGR; None if none comes.
    """
    distance = distance_to(least, greatest)
    near = CLEARANCE * distance
    text = CAMERA.format(name=CAMERA_NAME, fov=FIELD_OF_VIEW, near=near, far=distance + 100.0)
    pose = pose_message(camera_pose(least, greatest))
    pictures: list[Image] = []
    call("/gazebo/spawn_sdf_model", srv.SpawnModel, CAMERA_NAME, text, "/", pose, "world")
    listener = subscriber(f"/{CAMERA_NAME}/image_raw", Image, pictures.append)
    try:
        _wait_until(lambda: publishers_know_this_node(listener.resolved_name))
        for _ in range(patience):
            wait()
        _wait_until(lambda: pictures)
    finally:
        listener.unregister()
        if not rospy.is_shutdown():
            call("/gazebo/delete_model", srv.DeleteModel, CAMERA_NAME)
    return pixels_of(pictures[0], "bgr8") if pictures else None


def _wait_until(holds: Callable[[], Any]) -> None:
    deadline = time.monotonic() + LATEST
    while not holds() and time.monotonic() < deadline and not rospy.is_shutdown():
        rospy.rostime.wallsleep(0.01)
