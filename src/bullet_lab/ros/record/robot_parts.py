"""What a robot in a running simulator has: found by its master, and by what the bridge says."""

from __future__ import annotations

import contextlib
import os
import struct
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Set, Tuple

import rosgraph
import roslib.message
import rospy
import rosservice
from sensor_msgs.msg import Image

from bullet_lab.errors import LabError
from bullet_lab.msg import ModelDescription
from bullet_lab.reports.robot import Controller, PluginRow, Robot, RobotReport
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.node.node import MASTER_ERRORS, NodeError
from bullet_lab.ros.node.publishers import subscriber
from bullet_lab.srv import DescribeModels, DescribeModelsResponse

SERVICE = "/bullet_lab/describe_models"
VELOCITIES, ODOMETRY, PICTURES = "geometry_msgs/Twist", "nav_msgs/Odometry", "sensor_msgs/Image"
CONTROLLERS = "/list_controllers"
# What is listened to for so many messages only: drawing and sending it takes long.
HEAVY = (PICTURES, "sensor_msgs/CompressedImage", "sensor_msgs/PointCloud2")
ENOUGH = 10
# What is for programs that change settings.
SETTINGS = "dynamic_reconfigure/"
# What the simulator itself says.
OWN_TOPICS = ("/clock", "/rosout", "/tf", "/tf_static", "/gazebo/", "/bullet_lab/")
TOUCHED = "/bullet_lab/touched"
# rad/s or m/s, of a joint that moves.
TURNING = 0.05
# Models in a line.
MOST_NAMES = 10
# What a header begins with: its number, and the stamp in s and ns.
HEADER = struct.Struct("<III")


class Master:
    """What a ROS master knows at a moment of the node that gives the time.

    Attributes:
        heard: the topics that it listens to, with their types.
        spoken: those that it speaks on.
        services: that somebody offers.
    """

    def __init__(self):
        master = rosgraph.Master(rospy.get_name())
        try:
            published, subscribed, services = master.getSystemState()
            kinds = dict(master.getTopicTypes())
        except MASTER_ERRORS as error:
            raise NodeError(f"the ROS master does not answer: {error}") from error
        simulators = set(dict(published).get("/clock", ()))
        self.services = {name for name, _ in services}
        self.heard = _of(simulators, subscribed, kinds)
        self.spoken = _of(simulators, published, kinds)


def _of(nodes: Set[str], topics: Iterable[Any], kinds: Mapping[str, str]) -> Dict[str, str]:
    found = sorted(topic for topic, users in topics if nodes.intersection(users))
    others = [t for t in found if not (t.startswith(OWN_TOPICS) or t.endswith(TOUCHED))]
    return {topic: kinds.get(topic, "*") for topic in others}


def described(name: str = "") -> DescribeModelsResponse:
    """Return what the bridge says of a model, or of all; raises NodeError."""
    return call(SERVICE, DescribeModels, name)


def choose(
    models: Iterable[ModelDescription],
    name: str,
    drives: Iterable[str],
    of_world_file: bool = False,
) -> Optional[ModelDescription]:
    """Return the model that is the robot; None while there is none.

    Args:
        models: of the world.
        name: that it has; if empty, one that can be driven is preferred, then one with plugins,
            and of several the first by name.
        drives: the topics with velocities that the simulator listens to.
        of_world_file: whether a robot of the world file will do where nothing was spawned: one
            that moves, has plugins and can be driven.
    """
    if name:
        return next((model for model in models if model.name == name), None)
    there = sorted(models, key=lambda model: (model.is_static, model.name))
    spawned = [model for model in there if not model.of_world_file]
    found = spawned
    if of_world_file and drives and not spawned:
        found = [model for model in there if model.plugins and not model.is_static]
    lively = [model for model in found if model.plugins]
    return next(iter([*drivable(found, drives), *lively, *found]), None)


def drivable(models: Iterable[ModelDescription], drives: Iterable[str]) -> List[ModelDescription]:
    """Return the models with a plugin that takes velocities, by name."""
    found = [m for m in models if set(drives) & {t for p in m.plugins for t in p.inputs}]
    return sorted(found, key=lambda model: model.name)


def candidates(models: Iterable[ModelDescription]) -> str:
    """Return which models the argument `model` may name, those with plugins first."""
    moving = sorted((m for m in models if not m.is_static), key=lambda m: not m.plugins)
    names = ", ".join(model.name for model in moving[:MOST_NAMES])
    return f"model:=NAME takes one of {names}" if names else "no model in the world can move"


def why_it_stands(model: ModelDescription, drive: str, is_heard: bool) -> List[str]:
    """Return what is known of why a robot does not move while it is told to on a topic."""
    if model.is_static:
        return ["the model is static"]
    if not is_heard:
        return [f"nothing listens to {drive}"]
    ask = rospy.ServiceProxy("/gazebo/get_joint_properties", srv.GetJointProperties)
    rates = {joint: ask(f"{model.name}::{joint}").rate for joint in model.joints}
    turning = [joint for joint, rate in rates.items() if rate and abs(rate[0]) > TURNING]
    found = [f"{', '.join(turning) or 'none'} of its joints turn"] if rates else []
    return [*found, f"it stands on {', '.join(model.stands_on) or 'nothing'}"]


def robot_of(model: ModelDescription, answer: DescribeModelsResponse, master: Master) -> Robot:
    """Return what a robot is made of, and the topics that it is driven by."""
    rows = tuple(_row(plugin) for plugin in model.plugins)
    others = _topics(other for other in answer.models if other.name != model.name)
    own = _topics([model])
    drives = of_kind(master.heard, VELOCITIES)
    drive = _nearest(drives, own, others, "")
    # A drive's odometry is its own plugin's; a controller's that of no plugin.
    beside = {t for row in rows if drive in row.inputs for t in row.outputs}
    strange = others if drive in own else others | own
    odometry = _nearest(of_kind(master.spoken, ODOMETRY), beside, strange, drive) if drive else ""
    names = {m.name for m in answer.models if m.of_world_file and m.name != model.name}
    kin = [other for other in answer.models if other.of_world_file == model.of_world_file]
    said = [line for line in answer.said if not any(f"'{name}'" in line for name in names)]
    return Robot(
        name=model.name,
        links=tuple(model.links),
        joints=tuple(model.joints),
        plugins=rows,
        controllers=tuple(controllers(master)),
        drive=drive,
        odometry=odometry,
        said=tuple(said),
        choice=tuple(other.name for other in drivable(kin, drives)),
    )


def rows_of_others(model: ModelDescription, models: Iterable[ModelDescription]) -> List[PluginRow]:
    """Return the plugins of all models but one."""
    return [_row(p) for other in models if other.name != model.name for p in other.plugins]


def _row(plugin: Any) -> PluginRow:
    fields = {name: getattr(plugin, name) for name in PluginRow._fields}
    lists = {name: tuple(value) for name, value in fields.items() if isinstance(value, list)}
    return PluginRow(**{**fields, **lists})


def _topics(models: Iterable[ModelDescription]) -> Set[str]:
    plugins = [plugin for model in models for plugin in model.plugins]
    return {topic for plugin in plugins for topic in (*plugin.inputs, *plugin.outputs)}


def of_kind(topics: Mapping[str, str], kind: str) -> List[str]:
    """Return the topics of a type."""
    return [topic for topic, has in topics.items() if has == kind]


def _nearest(topics: Iterable[str], own: Set[str], others: Set[str], drive: str) -> str:
    """Return the topic that is the robot's; of several, the one named most like its drive."""

    def rank(topic: str) -> Tuple[bool, int, bool]:
        shared = os.path.commonprefix([topic, drive])
        return topic in own, shared.count("/"), "odom" in topic

    return max(
        (topic for topic in topics if topic in own or topic not in others), key=rank, default=""
    )


def topics_of(
    model: ModelDescription, models: Iterable[ModelDescription], master: Master
) -> Dict[str, str]:
    """Return the topics that a robot speaks on, with their types.

    Its controllers' are those that no model's plugin names.
    """
    others = _topics(other for other in models if other.name != model.name) - _topics([model])
    return {
        topic: kind
        for topic, kind in master.spoken.items()
        if topic not in others and not kind.startswith(SETTINGS)
    }


def controllers(master: Master) -> List[Controller]:
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


# Nothing is on its way any more if nothing has come for so many wall seconds; where time does not
# stand still that is never so, and it is looked so often.
QUIET, LOOKS = 0.2, 5


class Listeners:
    """Counts what comes on a robot's topics, and keeps the first picture of each that has some.

    `now` gives the time in ns for what has no stamp; `take` gets the messages on the topic of the
    robot's odometry.
    """

    def __init__(self, report: RobotReport, now: Callable[[], int], take: Callable[[Any], None]):
        self._report, self._now, self._take = report, now, take
        # As they come: most of them are only counted.
        self._subscribers = {
            topic: subscriber(topic, rospy.AnyMsg, self._receiver(topic, count.kind))
            for topic, count in report.counts.items()
        }

    def are_connected(self) -> bool:
        """Return whether every topic has its publisher."""
        return all(one.get_num_connections() > 0 for one in self._subscribers.values())

    def close(self) -> None:
        """Take what was sent before and is still on its way, and listen no longer."""
        before = -1
        for _ in range(LOOKS):
            heard = sum(count.messages for count in self._report.counts.values())
            if heard == before:
                break
            before = heard
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
                self._keep(topic, Image().deserialize(raw._buff))
            if kind in HEAVY and count.messages == ENOUGH:
                self._subscribers[topic].unregister()

        return receive

    def _keep(self, topic: str, image: Image) -> None:
        # Depth is no picture to look at.
        with contextlib.suppress(LabError):
            self._report.seen[topic] = pixels_of(image, "bgr8")


def _class_of(kind: str) -> Optional[type]:
    """Return the class of a type of messages; None where its package is not here."""
    try:
        return roslib.message.get_message_class(kind)
    except (ImportError, ValueError):
        return None
