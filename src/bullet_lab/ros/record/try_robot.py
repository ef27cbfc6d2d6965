"""Tries a robot in a running simulation: which plugins act, what it publishes, how it drives.

:ROS Parameters: see `TryRobotParameters`.
:ROS Publishers: velocities (geometry_msgs/Twist), on the topic that the robot subscribes to
:ROS Subscribers: all topics that the robot publishes
:ROS Service clients: /bullet_lab/describe_models, /gazebo/get_model_state, unpause_physics, and
    list_controllers

Writes robot.md, robot.png, truth.tum, odom.tum and summary.json.
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import roslib.message
import rospy
from geometry_msgs.msg import Twist

from bullet_lab.core.parameters import number, text
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.drive import STANDSTILL, Command
from bullet_lab.errors import LabError
from bullet_lab.msg import ModelDescription
from bullet_lab.reports import Reading, save_all
from bullet_lab.reports.robot import ODOMETRY, TRUTH, Leg, RobotReport
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.messages.poses import pose_of
from bullet_lab.ros.node.driving import StoppableSender
from bullet_lab.ros.node.lock_step import Rate, publisher, publishers_know_this_node, subscriber
from bullet_lab.ros.node.node import NodeError, node
from bullet_lab.ros.node.odometry import ODOMETRY_TIMEOUT, NewestOdometry, planar_pose
from bullet_lab.ros.record.recorder import RecordParameters
from bullet_lab.ros.record.robot_parts import (
    SETTLED,
    Launched,
    Master,
    described,
    find_robot,
    robot_of,
    topics_of,
    why_it_stands,
)

# Hz of commands, as those of teleoperation.
COMMANDS = 20.0
# Simulated seconds that the robot stands, before and after each part of the drive.
STAND = 1.0
# A part of the drive is aborted after this many times the time that it should take.
LATEST = 3.0
METRE = 1.0
TURN = 360.0
PICTURES = "sensor_msgs/Image"
# Of these, `ENOUGH` messages are received: rendering and sending them takes long.
HEAVY = (PICTURES, "sensor_msgs/CompressedImage", "sensor_msgs/PointCloud2")
ENOUGH = 10
# All messages have arrived when none came for this many wall seconds.
QUIET = 0.2
# While simulated time runs, messages always come: the wait is repeated this often at most.
MOST_WAITS = 5


@dataclass(frozen=True)
class TryRobotParameters(RecordParameters):
    """Private parameters of try_robot."""

    out: str = text("results/robot", "folder for the files")
    launch_file: str = text("", "launch file that brings the robot up; empty if it is there")
    args: str = text("", "arguments of the xacro or launch file: 'name:=value …'")
    model: str = text("", "name of the robot's model; empty for one that can be driven")
    speed: float = number(0.2, "m/s", above=0.0, maximum=10.0)
    turn_rate: float = number(0.5, "rad/s", above=0.0, maximum=10.0)


@node
def try_robot(parameters: TryRobotParameters) -> None:
    """Find the robot, record its topics, drive it, and write the report."""
    with contextlib.closing(Launched(parameters.launch_file, parameters.args)) as launched:
        model = find_robot(parameters.model, launched)
        for line in launched.failures():
            rospy.logwarn("%s", line)
        try:
            Trial(parameters, model.name, launched).run()
        except (NodeError, rospy.ServiceException) as error:
            launched.check()
            raise NodeError(str(error)) from error


class Trial:
    """Records and drives one robot."""

    def __init__(self, parameters: TryRobotParameters, name: str, launched: Launched):
        self._parameters = parameters
        self._name = name
        self._launched = launched
        answer, master = described(), Master()
        model = next(model for model in answer.models if model.name == name)
        others = [other for other in answer.models if other.name != name]
        self._robot = robot_of(model, others, answer.said, master)
        topics = topics_of(model, others, master.published)
        other_plugins = [plugin for other in others for plugin in other.plugins]
        self._report = RobotReport(Path(parameters.out), self._robot, topics, other_plugins)
        self._report.about = parameters.about
        # The present part of the drive.
        self._leg: Leg | None = None
        self._pauses = False
        self._rate: Rate | None = None
        self._connected_since = time.monotonic()
        if self._robot.odometry:
            of_plugins = {topic for plugin in self._robot.plugins for topic in plugin.outputs}
            is_late = self._robot.odometry not in of_plugins
            self._odometry = NewestOdometry(self._robot.odometry, is_late)
        self._subscribers = {
            topic: subscriber(topic, _class_of(count.kind), partial(self._receive, topic))
            for topic, count in self._report.counts.items()
        }
        if self._robot.drive:
            self._velocities = publisher(self._robot.drive, Twist, 10)
            self._sender = StoppableSender(self._velocities)
        self._state = rospy.ServiceProxy(
            "/gazebo/get_model_state", srv.GetModelState, persistent=True
        )
        self._rate = Rate(COMMANDS, self._is_connected, "the robot's topics")

    def run(self) -> None:
        """Drive and write the report; after Ctrl-C, report what was done until then."""
        report, finished = self._report, False
        try:
            self._stand()
            self._photograph()
            if self._robot.drive:
                speed, turn_rate = self._parameters.speed, self._parameters.turn_rate
                self._drive(Leg("metre", "ahead_m", METRE), (speed, 0.0), METRE / speed)
                seconds = math.radians(TURN) / turn_rate
                if self._robot.is_steered():
                    rospy.loginfo("turn: left out; the robot steers, and cannot turn on the spot")
                else:
                    self._drive(Leg("turn", "turned_deg", TURN), (0.0, turn_rate), seconds)
            else:
                self._stand()
            finished = True
        finally:
            self._unsubscribe()
            report.not_started = self._launched.failures()
            summary = save_all(report, finished)
            print(report.table())
            if not report.has_failed(summary):
                rospy.loginfo("%s", report.line(summary))
        # With complete results, the launcher ends the bridge.
        with contextlib.suppress(NodeError):
            self._rate.leave()
        if report.has_failed(summary):
            raise NodeError(report.line(summary))

    def _photograph(self) -> None:
        try:
            picture = described(self._name, with_picture=True).picture
            self._report.picture = pixels_of(picture, "bgr8")
        except LabError as error:
            rospy.logwarn("continuing without a picture of the robot: %s", error)

    def _model(self) -> ModelDescription:
        (model,) = described(self._name).models
        return model

    def _now(self) -> int:
        # Latched messages come before the first tick.
        now = rospy.Time.now() if self._rate is None else self._rate.now
        return now.to_nsec()

    # The robot's topics

    def _receive(self, topic: str, message: Any) -> None:
        """Count a message, and keep the odometry and the first image of each camera."""
        count = self._report.counts[topic]
        header = getattr(message, "header", None)
        count.note(self._now() if header is None else header.stamp.to_nsec())
        # Odometry may be invalid, and a depth image cannot be shown as a picture.
        with contextlib.suppress(LabError):
            if topic == self._robot.odometry:
                reading = Reading(header.stamp.to_nsec(), planar_pose(message))
                self._report.take(ODOMETRY, reading)
            elif count.kind == PICTURES and count.messages == 1:
                self._report.seen[topic] = pixels_of(message, "bgr8")
        # Not while the connections are waited for.
        if count.kind in HEAVY and count.messages >= ENOUGH and self._rate is not None:
            self._subscribers[topic].unregister()

    def _is_connected(self) -> bool:
        """Return whether both ends know of all connections; other nodes may not report theirs."""
        if not all(one.get_num_connections() > 0 for one in self._subscribers.values()):
            self._connected_since = time.monotonic()
            return False
        waited = time.monotonic() - self._connected_since
        return waited > SETTLED or publishers_know_this_node()

    def _unsubscribe(self) -> None:
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

    # The drive

    def _drive(self, leg: Leg, velocity: Command, seconds: float) -> None:
        """Drive until the odometry, or without any the truth, has reached the target."""
        self._leg = leg
        touched: set[str] = set()
        start = self._rate.now
        self._observe()
        for tick in range(1, round((LATEST * seconds + STAND) * COMMANDS) + 1):
            self._tick(velocity)
            leg.late = not leg.is_done(self._pauses)
            if tick % COMMANDS == 0:
                touched.update(self._model().touches)
            if not leg.late:
                break
        leg.seconds = (self._rate.now - start).to_sec()
        model = self._model()
        leg.touched = sorted(touched.union(model.touches))
        if not leg.has_moved():
            is_connected = self._velocities.has_connections()
            leg.causes = why_it_stands(model, self._robot.drive, is_connected)
        self._stand()
        self._report.legs.append(leg)

    def _stand(self) -> None:
        for _ in range(round(STAND * COMMANDS)):
            self._tick(STANDSTILL)

    def _tick(self, velocity: Command) -> None:
        if self._robot.drive:
            self._sender.send(velocity)
        self._rate.sleep()
        self._observe()

    def _observe(self) -> None:
        """Record the robot's true pose, and add it and the odometry to the displacements."""
        state = self._state(self._name, "world")
        if not state.success:
            raise NodeError(f"'{self._name}' was deleted: {state.status_message}")
        pose = pose_of(state.pose.position, state.pose.orientation)
        _, _, upright = pose.rotate((0.0, 0.0, 1.0))
        self._report.tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, upright))))
        true = pose.planar
        self._report.take(TRUTH, Reading(self._now(), true))
        odometry = self._newest_odometry() if self._robot.odometry else None
        if self._leg is not None:
            self._leg.truth.append(true)
            if odometry is not None:
                self._leg.odometry.append(odometry)

    def _newest_odometry(self) -> PlanarPose | None:
        """Return the newest odometry; None while it pauses, which is waited for only once."""
        try:
            pose = self._odometry.newest(self._rate.now, 0.0 if self._pauses else ODOMETRY_TIMEOUT)
        except NodeError as error:
            if not self._pauses:
                rospy.logwarn("%s: driving by the truth until it comes again", error)
                self._report.pauses += 1
            self._pauses = True
            return None
        self._pauses = False
        return pose


def _class_of(kind: str) -> type:
    """Return the class of a type of messages; that of any message if it is not installed."""
    with contextlib.suppress(ImportError, ValueError):
        return roslib.message.get_message_class(kind) or rospy.AnyMsg
    return rospy.AnyMsg
