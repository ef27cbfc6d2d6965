"""Tries a robot in a running simulation: which plugins act, what it publishes, how it drives.

:ROS Parameters: see `TryRobotParameters`.
:ROS Publishers: velocities (geometry_msgs/Twist), on the topic that the robot subscribes to
:ROS Subscribers: all topics that the robot publishes
:ROS Service clients: /bullet_lab/describe_models, /gazebo/get_model_state, spawn_sdf_model and
    delete_model (a camera, for a picture of the robot), unpause_physics, and list_controllers

Writes robot.md, robot.png, truth.tum, odom.tum and summary.json.
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_srvs.srv import Empty

from bullet_lab.core.parameters import number, text
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.errors import LabError
from bullet_lab.msg import ModelDescription
from bullet_lab.reports import Reading
from bullet_lab.reports.robot import ODOMETRY, STANDING, TRUTH, Displacement, Leg, RobotReport
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import pose_of
from bullet_lab.ros.node.driving import StoppableSender
from bullet_lab.ros.node.lock_step import Rate, publishers_know_this_node
from bullet_lab.ros.node.node import NodeError, node
from bullet_lab.ros.node.odometry import ODOMETRY_TIMEOUT, NewestOdometry, planar_pose
from bullet_lab.ros.node.publishers import publisher
from bullet_lab.ros.record.launch_file import Launched
from bullet_lab.ros.record.recorder import RecordParameters, save_all
from bullet_lab.ros.record.robot_parts import (
    SERVICE,
    VELOCITIES,
    Listeners,
    Master,
    candidates,
    choose,
    described,
    of_kind,
    photograph,
    plugins_of,
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
# It ends at this many times the target by the truth, whatever the odometry reports.
FARTHEST = 1.5
# Wall seconds for the simulation to start, and for the robot to be spawned.
SIMULATION = 60.0
ARRIVAL = 120.0
# A launch file has started everything when nothing new came for this many wall seconds; the wait is
# longer without a subscriber to velocities.
SETTLED = 3.0
SETTLED_WITHOUT_DRIVE = 20.0
# Wall seconds between two checks.
CHECK_PERIOD = 0.5
METRE = 1.0
TURN = 360.0


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
        model = _find_robot(parameters.model, launched)
        for line in launched.failures():
            rospy.logwarn("%s", line)
        try:
            Trial(parameters, model.name, launched).run()
        except (NodeError, rospy.ServiceException) as error:
            launched.check()
            raise NodeError(str(error)) from error


def _find_robot(name: str, launched: Launched) -> ModelDescription:
    """Wait for the robot, and until nothing new comes: controllers are loaded after their robot."""
    start = since = time.monotonic()
    models: list[ModelDescription] = []
    found: ModelDescription | None = None
    before: Any = None
    while True:
        launched.check()
        master = Master()
        if SERVICE in master.services:
            models = described().models
        now = (vars(master), [model.name for model in models])
        if now != before:
            since, before = time.monotonic(), now
        quiet = time.monotonic() - since
        waited = time.monotonic() - start
        drives = of_kind(master.subscribed, VELOCITIES)
        if found is None and launched.path and choose(models, name, drives, True) is not None:
            with contextlib.suppress(rospy.ServiceException):
                rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()
        found = choose(models, name, drives, quiet > SETTLED_WITHOUT_DRIVE)
        patience = SETTLED if drives else SETTLED_WITHOUT_DRIVE
        if found is not None and (quiet > patience or not launched.path):
            return found
        if waited > SIMULATION and not models and SERVICE not in master.services:
            hint = "a launch file that only spawns the robot needs world:=… beside it"
            raise NodeError(f"no simulation has started within {SIMULATION:g} s; {hint}")
        if waited > ARRIVAL and found is None:
            what = f"no model '{name}'" if name else "no robot"
            raise NodeError(f"{what} was spawned within {ARRIVAL:g} s; {candidates(models)}")
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")
        time.sleep(CHECK_PERIOD)


class Trial:
    """Records and drives one robot."""

    def __init__(self, parameters: TryRobotParameters, name: str, launched: Launched):
        self._parameters = parameters
        self._name = name
        self._launched = launched
        answer, master = described(), Master()
        model = next(model for model in answer.models if model.name == name)
        others = [other for other in answer.models if other.name != name]
        robot = robot_of(model, others, answer.said, master)
        topics = topics_of(model, others, master)
        self._report = RobotReport(Path(parameters.out), robot, topics, plugins_of(others))
        self._report.about = parameters.about
        self._odometry = NewestOdometry(robot.odometry, subscribed=False)
        self._pauses = False
        self._moved = _no_displacement()
        self._rate: Rate | None = None
        self._connected_since = time.monotonic()
        self._listeners = Listeners(self._report, self._now, self._take_odometry)
        if robot.drive:
            self._velocities = publisher(robot.drive, Twist, 10)
            self._sender = StoppableSender(self._velocities)
            # The robot stops however the node ends.
            rospy.on_shutdown(self._sender.end)
        self._state = rospy.ServiceProxy(
            "/gazebo/get_model_state", srv.GetModelState, persistent=True
        )
        self._rate = Rate(COMMANDS, self._is_connected, "the robot's topics")

    def run(self) -> None:
        """Drive and write the report; after Ctrl-C, report what was done until then."""
        finished = False
        try:
            self._stand(STAND)
            self._photograph()
            if self._report.robot.drive:
                self._drive()
            else:
                self._stand(STAND)
            finished = True
        finally:
            self._listeners.close()
            summary = self._save(finished)
        self._rate.leave()
        if self._report.has_failed(summary):
            raise NodeError(self._report.line(summary))

    def _save(self, finished: bool) -> Mapping[str, Any]:
        report = self._report
        report.not_started = self._launched.failures()
        summary = save_all(report, finished)
        print(report.table())
        if not report.has_failed(summary):
            rospy.loginfo("%s", report.line(summary))
        return summary

    def _photograph(self) -> None:
        model = self._model()
        box = [(corner.x, corner.y, corner.z) for corner in (model.least, model.greatest)]
        try:
            self._report.picture = photograph(*box, self._rate.sleep, round(COMMANDS * STAND))
        except LabError as error:
            rospy.logwarn("no picture of the robot: %s", error)

    def _model(self) -> ModelDescription:
        (model,) = described(self._name).models
        return model

    def _is_connected(self) -> bool:
        """Return whether both ends know of all connections; other nodes may not report theirs."""
        if not self._listeners.are_connected():
            self._connected_since = time.monotonic()
            return False
        waited = time.monotonic() - self._connected_since
        return waited > SETTLED or publishers_know_this_node()

    def _now(self) -> int:
        # Latched messages come before the first tick.
        now = rospy.Time.now() if self._rate is None else self._rate.now
        return now.to_nsec()

    # The drive

    def _drive(self) -> None:
        speed, turn_rate = self._parameters.speed, self._parameters.turn_rate
        self._leg("metre", "ahead_m", METRE, (speed, 0.0), METRE / speed)
        self._leg("turn", "turned_deg", TURN, (0.0, turn_rate), math.radians(TURN) / turn_rate)

    def _leg(
        self, name: str, quantity: str, asked: float, velocity: tuple[float, float], seconds: float
    ) -> None:
        """Drive until the odometry, or without any the truth, has reached the target."""
        self._moved = _no_displacement()
        touched: set[str] = set()
        start = self._rate.now
        self._observe()
        for tick in range(1, round((LATEST * seconds + STAND) * COMMANDS) + 1):
            self._sender.send(velocity)
            self._rate.sleep()
            self._observe()
            is_late = not self._is_enough(quantity, asked)
            if tick % COMMANDS == 0:
                touched.update(self._model().touches)
            if not is_late:
                break
        took = (self._rate.now - start).to_sec()
        model = self._model()
        touched.update(model.touches)
        causes: list[str] = []
        if abs(self._moved[TRUTH].figures()[quantity]) < STANDING * asked:
            is_connected = self._velocities.has_connections()
            causes = why_it_stands(model, self._report.robot.drive, is_connected)
        self._stand(STAND)
        odometry, truth = self._moved[ODOMETRY].figures(), self._moved[TRUTH].figures()
        known = (is_late, tuple(sorted(touched)), tuple(causes))
        self._report.legs.append(Leg(name, quantity, asked, odometry, truth, took, *known))

    def _is_enough(self, quantity: str, asked: float) -> bool:
        """Return whether the odometry, or the truth while that pauses, has reached the target."""
        truth = self._moved[TRUTH].figures()
        odometry = None if self._pauses else self._moved[ODOMETRY].figures()
        return (odometry or truth)[quantity] >= asked or truth[quantity] >= FARTHEST * asked

    def _stand(self, seconds: float) -> None:
        for _ in range(round(seconds * COMMANDS)):
            if self._report.robot.drive:
                self._sender.send((0.0, 0.0))
            self._rate.sleep()
            self._observe()

    def _observe(self) -> None:
        """Record the robot's true pose, and add it and the odometry to the displacements."""
        state = self._state(self._name, "world")
        if not state.success:
            raise NodeError(f"'{self._name}' was deleted: {state.status_message}")
        pose = pose_of(state.pose.position, state.pose.orientation)
        x, y, _ = pose.position
        _, _, upright = pose.rotate((0.0, 0.0, 1.0))
        self._report.tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, upright))))
        true = (x, y, pose.yaw)
        self._report.take(TRUTH, Reading(self._now(), true))
        self._moved[TRUTH].add(true)
        odometry = self._newest_odometry()
        if odometry is not None:
            self._moved[ODOMETRY].add(odometry)

    def _newest_odometry(self) -> PlanarPose | None:
        """Return the newest odometry; None while it pauses, which is waited for only once."""
        if not self._report.robot.odometry:
            return None
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

    def _take_odometry(self, message: Odometry) -> None:
        self._odometry.take(message)
        with contextlib.suppress(LabError):
            stamp = message.header.stamp.to_nsec()
            self._report.take(ODOMETRY, Reading(stamp, planar_pose(message)))


def _no_displacement() -> dict[str, Displacement]:
    return {TRUTH: Displacement(), ODOMETRY: Displacement()}
