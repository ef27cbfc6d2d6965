"""Replaces Gazebo: steps the simulation and offers its topics and services.

:ROS Parameters: see `BridgeParameters`.
:ROS Publishers:
    - /clock (rosgraph_msgs/Clock), 100 Hz of simulated time
    - /bullet_lab/world (visualization_msgs/MarkerArray): the shapes of the world, all of them
      for a new subscriber, then the changes
    - /gazebo/model_states, /gazebo/link_states, while there is a subscriber
    - /bullet_lab/touched, in each robot's namespace (bullet_lab/TouchedModels): the models that it
      has touched
    - /tf, and with ~publish_world_tf also /tf_static
    - the topics of the robots' plugins, such as odom (nav_msgs/Odometry)
:ROS Subscribers: the topics of the robots' plugins, such as cmd_vel (geometry_msgs/Twist)
:ROS Services:
    - /gazebo/pause_physics, unpause_physics, reset_world, reset_simulation (std_srvs/Empty)
    - the other services of /gazebo: see `bullet_lab.ros.gazebo`
    - controller_manager/… of robots with controllers: see `bullet_lab.ros.gazebo.devices`
    - /bullet_lab/save_world (bullet_lab/SaveWorld): write the running world to a file
    - /bullet_lab/describe_models (bullet_lab/DescribeModels): which plugins and tags are simulated
    - /bullet_lab/set_rtf (bullet_lab/SetRtf): change the speed of simulated time
    - /bullet_lab/step (bullet_lab/Step): advance by exactly n steps of 1 ms, paused or not
    - /bullet_lab/advance (bullet_lab/Advance): lock step, see `bullet_lab.ros.node.lock_step`
"""

from __future__ import annotations

import logging
import math
import os
import sys
import time
import xmlrpc.client
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Sequence
from xml.etree.ElementTree import Element

import rosgraph
import rospkg
import rospy
import rospy.rostime
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Empty

from bullet_lab.core.parameters import (
    boolean,
    choice,
    integer,
    name_list,
    number,
    number_list,
    text,
)
from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import (
    OdometryFrames,
    RunningWorld,
    TouchCounter,
    tf_prefixes,
)
from bullet_lab.ros.bridge.stepper import FOR_EVER, Pace, Stepper, StepperError, TimeGate
from bullet_lab.ros.bridge.topics import DeviceTopics, Route
from bullet_lab.ros.gazebo.interface import Warnings, offer_all
from bullet_lab.ros.gazebo.services import offer
from bullet_lab.ros.messages.poses import first_step_at, set_time, time_of
from bullet_lab.ros.node.node import (
    MASTER_ERRORS,
    NodeError,
    ignore_clock,
    private_parameters,
    run_node,
)
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.video import Video
from bullet_lab.simulation.world.resources import ResourceFinder, listed_folders
from bullet_lab.simulation.world.urdf import read_urdf, read_urdf_file
from bullet_lab.simulation.world.xml import parse_text, read_text
from bullet_lab.srv import Advance, AdvanceResponse, Step

LOG = logging.getLogger(__name__)

# Hz; setting the time of this node's log takes longer than a message on /clock.
LOG_TIME_RATE = 5.0
# A member of the lock step that fails to answer this often in a row is dead.
SILENCES = 3
# Environment variables that packages extend, by the attributes of their exports.
EXPORTED = {
    "gazebo_model_path": "GAZEBO_MODEL_PATH",
    "gazebo_media_path": "GAZEBO_RESOURCE_PATH",
}
EXPORTER = "gazebo_ros"
# Wall seconds within which a node that is alive answers.
ANSWER_SECONDS = 5.0
# What ~friction means for a simulation; None: as the world says.
COULOMB = {"world": None, "ode": False, "coulomb": True}
CALLER = "/bullet_lab"
NOT_REACHED = "the world or time was reset, or the bridge shuts down"
# s; a grant up to the end of ROS time is for ever.
END_OF_TIME = 2**31 - 1


@dataclass(frozen=True)
class BridgeParameters:
    """Private parameters of the bridge."""

    world: str = text(
        "package://bullet_lab/worlds/empty.world", "SDF world: a path, package:// or model://"
    )
    robot: str = text("", "URDF robot: a path or package://; empty for that of ~robot_description")
    robot_description: str = text(
        "robot_description", "parameter that holds the robot's URDF; empty for no robot"
    )
    robot_namespace: str = text("", "robotNamespace of plugins that have none")
    robot_pose: tuple[float, ...] = number_list(
        (0.0,) * 6, "pose of the robot at the start: x y z in metres, roll pitch yaw in radians"
    )
    rtf: float = number(
        1.0, "simulated seconds per wall second; 0 for as fast as possible", minimum=0.0
    )
    clock_rate: float = number(
        100.0, "messages on /clock per simulated second", above=0.0, maximum=1000.0
    )
    camera_rate: float = number(
        0.0,
        "images per second of the robot's cameras; 0: as in its description",
        minimum=0.0,
        maximum=1000.0,
    )
    seed: int = integer(0, "seed of the noise of all sensors", minimum=0)
    friction: str = choice(
        "world",
        "limit of friction: along each of two axes, as Gazebo's engine, or for all directions; "
        "world: as its <friction_model> says",
        tuple(COULOMB),
    )
    states_rate: float = number(
        100.0,
        "messages on /gazebo/model_states and link_states per simulated second",
        above=0.0,
        maximum=1000.0,
    )
    paused: bool = boolean(False, "start paused")
    lock_step: tuple[str, ...] = name_list("nodes that time waits for")
    save_folder: str = text("results", "the only folder into which /bullet_lab/save_world writes")
    video: str = text("", "mp4 file for a video in simulated time; empty: none")
    world_frame: str = text("world", "frame of the markers on /bullet_lab/world")
    publish_world_tf: bool = boolean(
        False, "publish on /tf_static that the odometry frames are at the world frame"
    )


class PyBulletBridge:
    """Connects a simulation with ROS."""

    def __init__(self, parameters: BridgeParameters):
        warnings = Warnings()
        # The last reason why a device failed, and when it was logged.
        self._failures: dict[str, tuple[str, float]] = {}
        self.simulation = simulation = Simulation.of(
            parameters.world, parameters.seed, COULOMB[parameters.friction]
        )
        simulation.go_on_after(self._report_failure)
        self.stepper = Stepper(
            simulation,
            Pace(parameters.rtf),
            TimeGate(map(rospy.resolve_name, parameters.lock_step)),
            tick=max(1, round(STEPS_PER_SECOND / parameters.clock_rate)),
            paused=parameters.paused,
            is_over=rospy.is_shutdown,
            report_stall=self._report_stall,
            report_lag=lambda lag: rospy.logwarn("%s", lag),
        )
        self._silences: Counter = Counter()
        self._world = world = RunningWorld(self.stepper, DeviceTopics(self.stepper))
        ignore_clock()
        self._clock = Clock()
        self._clock_publisher = world.topics.publisher("/clock", Clock)
        simulation.every(parameters.clock_rate, self._publish_clock)
        # This node does not subscribe to /clock.
        set_log_time = rospy.rostime._set_rostime
        simulation.every(LOG_TIME_RATE, lambda step: set_log_time(time_of(step)))
        for instance in simulation.models.values():
            world.connect(instance)
        frame, hidden = parameters.world_frame, _add_robot(world, parameters)
        self._video = Video(simulation, Path(parameters.video)) if parameters.video else None
        folder = Path(parameters.save_folder)
        offer_all(world, frame, hidden, parameters.states_rate, folder, warnings)
        TouchCounter(world)
        OdometryFrames(world, frame if parameters.publish_world_tf else "")
        self._offer_services()

    def spin(self) -> None:
        """Run until ROS shuts down."""
        rospy.on_shutdown(self.stepper.wake)
        try:
            self.stepper.run()
        finally:
            if self._video is not None:
                self._video.close()
            self.simulation.close()

    def _publish_clock(self, step: int) -> None:
        set_time(self._clock.clock, step)
        self._clock_publisher.publish(self._clock)

    def _offer_services(self) -> None:
        stepper, simulation = self.stepper, self.simulation
        answers = {
            "pause_physics": lambda _: stepper.set_paused(True),
            "unpause_physics": lambda _: stepper.set_paused(False),
            "reset_world": lambda _: self._reset(simulation.reset_world),
            "reset_simulation": lambda _: self._reset(simulation.reset_simulation),
        }
        for name, answer in answers.items():
            offer(f"/gazebo/{name}", Empty, answer)
        offer("/bullet_lab/step", Step, self._step)
        rospy.Service("/bullet_lab/advance", Advance, self._advance)

    def _reset(self, reset: Callable[[], None]) -> None:
        self.stepper.reset(reset)
        self._world.do(lambda: self._world.notify(""))

    def _step(self, request: Any) -> dict[str, Any]:
        try:
            return {"now": time_of(self.stepper.advance_by(request.steps))}
        except StepperError as error:
            now = time_of(self.simulation.step)
            return {"now": now, "success": False, "status_message": str(error)}

    def _advance(self, request: Any) -> AdvanceResponse:
        try:
            return self._advance_for(request)
        except LabError as error:
            raise rospy.ServiceException(str(error)) from error

    def _advance_for(self, request: Any) -> AdvanceResponse:
        """Let a member join the lock step, or advance time for it."""
        caller = request._connection_header["callerid"]
        if request.node != caller and answers(request.node):
            line = f"{request.node} is alive and advances time itself"
            raise NodeError(f"{line}; request of {caller} refused")
        routes = zip(request.topics, request.receivers)
        sent = dict(zip((Route(request.node, *route) for route in routes), request.messages))
        counter, heard = self._world.topics.commands, set()
        has_left = request.until.secs >= END_OF_TIME
        if not request.epoch and not has_left:
            heard = counter.heard(sent)
            reached = self.stepper.join(request.node)
        else:
            for lost in counter.wait(sent):
                rospy.logwarn("commands of %s were lost (%s to %s)", *lost)
            until = FOR_EVER if has_left else first_step_at(request.until)
            reached = self.stepper.grant(request.node, until, request.epoch)
        return AdvanceResponse(
            now=time_of(reached.step),
            epoch=reached.epoch,
            success=reached.success,
            status_message="" if reached.success else NOT_REACHED,
            heard=sorted(heard),
        )

    def _report_failure(self, device: str, error: Exception) -> None:
        """Log a new reason why a device fails, once a second at most."""
        is_known, now = isinstance(error, LabError), time.monotonic()
        reason = str(error) if is_known else f"{type(error).__name__}: {error}"
        last, logged = self._failures.get(device, ("", -math.inf))
        if reason != last and now - logged >= 1.0 and not rospy.is_shutdown():
            self._failures[device] = reason, now
            line, trace = "%s: %s; the simulation continues", None if is_known else error
            LOG.error(line, device, reason, exc_info=trace)

    def _report_stall(self, holding: Sequence[str]) -> None:
        """Log the members that hold time back; drop those that have died."""
        for member in holding:
            joined = self.stepper.gate.has_joined(member)
            self._silences[member] = 0 if answers(member) else self._silences[member] + 1
            # A single silence may come from a busy machine; a living member must not be dropped.
            if joined and self._silences[member] >= SILENCES:
                rospy.logwarn("lock-step member %s has died; continuing without it", member)
                self.stepper.gate.leave(member)
            else:
                rospy.loginfo("simulated time waits for %s", member)


def _add_robot(world: RunningWorld, parameters: BridgeParameters) -> str:
    """Add the robot of the parameters, if there is one, and return its name."""
    if parameters.robot:
        model = read_urdf_file(ResourceFinder.anywhere().find(parameters.robot))
    else:
        name = parameters.robot_description
        text = rospy.get_param(name, "") if name else ""
        if not text:
            return ""
        model = read_urdf(str(text), name)
    pose = Pose.from_rpy(parameters.robot_pose[:3], parameters.robot_pose[3:])
    # As in spawn_model; the plugins' topics are not in a namespace of the model's name.
    namespace = parameters.robot_namespace or "/"
    robot = world.add(model, "", pose, namespace, tf_prefixes(model, namespace))
    for device in robot.plugins if parameters.camera_rate else ():
        if isinstance(device, Camera):
            device.set_rate(parameters.camera_rate, 0)
    return robot.name


class _Transport(xmlrpc.client.Transport):
    """Has a timeout, for nodes that do not answer."""

    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = ANSWER_SECONDS
        return connection


def answers(node: str) -> bool:
    """Return whether a node is registered with the master and alive."""
    try:
        uri = rosgraph.Master(CALLER).lookupNode(node)
        with xmlrpc.client.ServerProxy(uri, transport=_Transport()) as proxy:
            proxy.getPid(CALLER)
    except MASTER_ERRORS:
        return False
    return True


def refuse_second_simulator() -> None:
    """Raise NodeError if another node publishes /clock and is alive."""
    publishers, _, _ = rosgraph.Master(CALLER).getSystemState()
    for node in dict(publishers).get("/clock", ()):
        if answers(node):
            raise NodeError(
                f"{node} publishes /clock already; a ROS master can have only one simulator"
            )


def add_exported_paths() -> None:
    """Add the folders that packages export for Gazebo to the environment of this process.

    `<export><gazebo_ros gazebo_model_path="${prefix}/models"/></export>` in a package.xml adds a
    folder to GAZEBO_MODEL_PATH; gazebo_media_path adds one to GAZEBO_RESOURCE_PATH.
    """
    packages = rospkg.RosPack()
    found = {name: list(map(str, listed_folders(name))) for name in EXPORTED.values()}
    for package in sorted(packages.list()):
        prefix = packages.get_path(package)
        for element in _exports(Path(prefix, "package.xml")):
            for attribute, name in EXPORTED.items():
                value = element.get(attribute, "").replace("${prefix}", prefix)
                found[name] += filter(None, value.split(os.pathsep))
    for name, folders in found.items():
        os.environ[name] = os.pathsep.join(dict.fromkeys(folders))


def _exports(manifest: Path) -> list[Element]:
    """Return the elements of a package.xml for Gazebo; none if it is invalid."""
    try:
        text = read_text(manifest)
        # A quick test first: of hundreds of packages, few export anything for Gazebo.
        if EXPORTER not in text:
            return []
        return parse_text(text, str(manifest)).findall(f"export/{EXPORTER}")
    except LabError:
        return []


def serve(name: str, read: Callable[[], BridgeParameters]) -> None:
    """Run the bridge as a node; `read` returns its parameters once the node has started."""
    add_exported_paths()
    # A waiting thread waits for 0.5 ms instead of 5 ms, which are many steps at full speed.
    sys.setswitchinterval(5e-4)
    run_node(name, lambda: PyBulletBridge(read()).spin(), before=refuse_second_simulator)


def main() -> None:
    """Run the node."""
    serve("pybullet_bridge", lambda: private_parameters(BridgeParameters))
