"""Tries somebody's robot in a running simulation: what acts, what it sends, how it drives.

:ROS Parameters: see `TryRobotParameters`.
:ROS Publishers: velocities (geometry_msgs/Twist), on the topic that the robot listens to
:ROS Subscribers: all that the robot speaks on
:ROS Service clients: /bullet_lab/describe_models, /gazebo/get_model_state, spawn_sdf_model and
    delete_model (a camera, for a picture of the robot), unpause_physics, and list_controllers

Leaves robot.md, robot.png, truth.tum, odom.tum and summary.json.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shlex
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Iterator, List, Optional, Tuple

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_srvs.srv import Empty

from bullet_lab.core.parameters import number, text
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.errors import LabError
from bullet_lab.msg import ModelDescription
from bullet_lab.reports import Reading
from bullet_lab.reports.robot import ODOMETRY, TRUTH, Leg, RobotReport, Way
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import pose_of
from bullet_lab.ros.node.driving import StoppableSender
from bullet_lab.ros.node.lock_step import Rate, publishers_know_this_node
from bullet_lab.ros.node.node import NodeError, node
from bullet_lab.ros.node.odometry import NewestOdometry, planar_pose
from bullet_lab.ros.node.publishers import publisher
from bullet_lab.ros.record.photograph import photograph
from bullet_lab.ros.record.recorder import RecordParameters, save_figures, save_summary
from bullet_lab.ros.record.robot_parts import (
    SERVICE,
    VELOCITIES,
    Listeners,
    Master,
    choose,
    described,
    robot_of,
    topics_of,
)

# Hz of commands, as those of teleoperation.
COMMANDS = 20.0
# Simulated seconds that the robot stands, before and after each part of the drive.
STAND = 1.0
# A part of the drive is given up after this many times its time, or at this part of the way.
LATEST, FARTHEST = 3.0, 1.5
# Wall seconds for the robot to come, and for the simulation that it comes into; without anything
# new, for what a launch file starts to be all there; and the same while nothing listens to
# velocities yet.
ARRIVAL, SIMULATION, SETTLED, SETTLED_WITHOUT_DRIVE = 120.0, 60.0, 3.0, 20.0
LOOK = 0.5
# Wall seconds for what roslaunch has started to end, of the six that this node has itself.
GOODBYE = 5.0
METRE, TURN = 1.0, 360.0
# What is in a line of roslaunch's that tells what went wrong.
TELLING = re.compile(r"rror\b|Exception|not found|died")


@dataclass(frozen=True)
class TryRobotParameters(RecordParameters):
    """Private parameters of try_robot."""

    out: str = text("results/robot", "folder for the files")
    launch_file: str = text("", "launch file that brings the robot up; empty if it is there")
    args: str = text("", "arguments of the xacro or launch file: 'name:=value …'")
    model: str = text("", "name of the robot's model; empty for one that can be driven")
    speed: float = number(0.2, "m/s", above=0.0, maximum=10.0)
    turn_rate: float = number(0.5, "rad/s", above=0.0, maximum=10.0)


def assignments(words: str) -> List[str]:
    """Return words like name:=value or name=value, as roslaunch has them."""
    return [re.sub("^([^=:]+):?=", r"\1:=", word) for word in shlex.split(words)]


def reason_in(log: str) -> str:
    """Return the line in what roslaunch has printed that says most about why it has ended."""
    lines = [
        line for line in re.sub(r"\x1b(\[[\d;]*m|\][^\x07]*\x07)", "", log).splitlines() if line
    ]
    telling = (n for n, line in enumerate(lines) if re.search(TELLING, line))
    first = next(telling, 0)
    # What ends with a colon is told in the line below.
    last = next((n for n in range(first, len(lines)) if not lines[n].endswith(":")), first)
    return " ".join(line.strip() for line in lines[first : last + 1]) or "without a word"


class Launched:
    """A launch file that runs as long as this is open, by a roslaunch of its own."""

    def __init__(self, path: str, arguments: str):
        folder = Path(os.environ.get("ROS_LOG_DIR") or ".")
        self._path, self._log = path, folder / "launch_file.log"
        words = ["roslaunch", "--sigint-timeout", "3", "--sigterm-timeout", "1", path]
        with self._log.open("w") as log:
            self._process = subprocess.Popen(
                words + assignments(arguments), stdout=log, stderr=subprocess.STDOUT
            )

    def check(self) -> None:
        """Raise NodeError if it has ended."""
        if self._process.poll() is not None:
            reason = reason_in(self._log.read_text(errors="replace"))
            raise NodeError(f"{self._path} has ended, see {self._log}: {reason}")

    def close(self) -> None:
        """End all that it has started."""
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(GOODBYE)


@node
def try_robot(parameters: TryRobotParameters) -> None:
    """Find the robot, listen to it, drive it, and leave what came of it."""
    with contextlib.ExitStack() as stack:
        check: Callable[[], None] = lambda: None  # noqa: E731
        if parameters.launch_file:
            launched = Launched(parameters.launch_file, parameters.args)
            stack.callback(launched.close)
            check = launched.check
        model = _wait_for_robot(parameters.model, check)
        if parameters.launch_file:
            _settle(check)
        Trial(parameters, model.name).run()


def _wait_for_robot(name: str, check: Callable[[], None]) -> ModelDescription:
    start = time.monotonic()
    simulated = False
    while True:
        check()
        master = Master()
        simulated = simulated or SERVICE in master.services
        if SERVICE in master.services:
            found = choose(described().models, name, master.heard)
            if found is not None:
                return found
        waited = time.monotonic() - start
        if waited > SIMULATION and not simulated:
            hint = "a launch file that only spawns wants world:=… beside it"
            raise NodeError(f"no simulation has come within {SIMULATION:g} s: {hint}")
        if waited > ARRIVAL:
            what = f"no model '{name}'" if name else "no robot"
            raise NodeError(f"{what} has come within {ARRIVAL:g} s")
        _look_again()


def _settle(check: Callable[[], None]) -> None:
    """Wait until nothing new comes: controllers are loaded after their robot."""
    with contextlib.suppress(rospy.ServiceException):
        rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()
    before, since = Master(), time.monotonic()
    while True:
        _look_again()
        check()
        now = Master()
        if now != before:
            before, since = now, time.monotonic()
        patience = SETTLED if VELOCITIES in now.heard.values() else SETTLED_WITHOUT_DRIVE
        if time.monotonic() - since > patience:
            return


def _look_again() -> None:
    if rospy.is_shutdown():
        raise rospy.ROSInterruptException("shutdown")
    time.sleep(LOOK)


class Trial:
    """One robot that is listened to and driven."""

    def __init__(self, parameters: TryRobotParameters, name: str):
        self._parameters, self._name = parameters, name
        answer, master = described(), Master()
        model = next(model for model in answer.models if model.name == name)
        robot = robot_of(model, answer, master)
        topics = topics_of(model, answer.models, master)
        self._report = RobotReport(Path(parameters.out), robot, topics)
        self._report.about = parameters.about
        self._odometry = NewestOdometry(robot.odometry, subscribed=False)
        self._speaks = bool(robot.odometry)
        self._rate: Optional[Rate] = None
        self._connected_since = time.monotonic()
        self._listeners = Listeners(self._report, self._now, self._take_odometry)
        if robot.drive:
            self._sender = StoppableSender(publisher(robot.drive, Twist, 10))
            # However it ends, the robot stands.
            rospy.on_shutdown(self._sender.end)
        self._ways: List[Tuple[str, Way]] = []
        self._state = rospy.ServiceProxy(
            "/gazebo/get_model_state", srv.GetModelState, persistent=True
        )
        self._rate = Rate(COMMANDS, self._is_heard, "what the robot speaks on")

    def run(self) -> None:
        """Do all of it, and write what came of it; on Ctrl-C as far as it went."""
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
            self._save(finished)
        self._rate.leave()

    def _save(self, finished: bool) -> None:
        report = self._report
        report.finish()
        summary = report.summary(finished, {})
        save_figures(report, report.figures(summary))
        save_summary(report, summary)
        print(report.table())
        rospy.loginfo("%s", report.line(summary))

    def _photograph(self) -> None:
        (model,) = [one for one in described().models if one.name == self._name]
        box = [(corner.x, corner.y, corner.z) for corner in (model.least, model.greatest)]
        try:
            self._report.picture = photograph(*box, self._rate.sleep, round(COMMANDS * STAND))
        except LabError as error:
            rospy.logwarn("there is no picture of the robot: %s", error)

    def _is_heard(self) -> bool:
        """Whether all is connected, at both ends; others' nodes may not tell of theirs."""
        if not self._listeners.are_connected():
            self._connected_since = time.monotonic()
            return False
        waited = time.monotonic() - self._connected_since
        return waited > SETTLED or publishers_know_this_node()

    def _now(self) -> int:
        # What was said before, and is kept for who comes later, comes before the first tick.
        now = rospy.Time.now() if self._rate is None else self._rate.now
        return now.to_nsec()

    # The drive

    def _drive(self) -> None:
        speed, turn_rate = self._parameters.speed, self._parameters.turn_rate
        self._leg("metre", "ahead_m", METRE, (speed, 0.0), METRE / speed)
        self._leg("turn", "turned_deg", TURN, (0.0, turn_rate), math.radians(TURN) / turn_rate)

    def _leg(
        self, name: str, quantity: str, asked: float, velocity: Tuple[float, float], seconds: float
    ) -> None:
        """Drive until the odometry, or without any the truth, says that it is enough."""
        ways = {TRUTH: Way(), ODOMETRY: Way()}
        with self._followed(ways):
            start = self._rate.now
            latest = start + rospy.Duration(LATEST * seconds + STAND)
            self._look()
            while self._rate.now < latest and not _is_enough(ways, quantity, asked):
                self._sender.send(velocity)
                self._rate.sleep()
                self._look()
            took = (self._rate.now - start).to_sec()
            self._stand(STAND)
        said, true = ways[ODOMETRY].figures(), ways[TRUTH].figures()
        self._report.legs.append(Leg(name, quantity, asked, said, true, took))

    @contextlib.contextmanager
    def _followed(self, ways) -> Iterator[None]:
        self._ways = list(ways.items())
        yield
        self._ways = []

    def _stand(self, seconds: float) -> None:
        for _ in range(round(seconds * COMMANDS)):
            if self._report.robot.drive:
                self._sender.send((0.0, 0.0))
            self._rate.sleep()
            self._look()

    def _look(self) -> None:
        """Take note of where the robot is."""
        state = self._state(self._name, "world")
        pose = pose_of(state.pose.position, state.pose.orientation)
        (x, y, _), yaw = pose.position, pose.yaw
        _, _, upright = pose.rotate((0.0, 0.0, 1.0))
        self._report.tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, upright))))
        self._report.take(TRUTH, Reading(self._now(), (x, y, yaw)))
        known = {TRUTH: (x, y, yaw), ODOMETRY: self._newest_odometry()}
        for name, way in self._ways:
            if known[name] is not None:
                way.add(known[name])

    def _newest_odometry(self) -> Optional[PlanarPose]:
        """What the odometry says by now; None, and from then on, where it says nothing."""
        if not self._speaks:
            return None
        try:
            return self._odometry.newest(self._rate.now)
        except NodeError:
            self._speaks = False
            return None

    def _take_odometry(self, message: Odometry) -> None:
        self._odometry.take(message)
        with contextlib.suppress(LabError):
            stamp = message.header.stamp.to_nsec()
            self._report.take(ODOMETRY, Reading(stamp, planar_pose(message)))


def _is_enough(ways, quantity: str, asked: float) -> bool:
    said, true = (ways[name].figures() for name in (ODOMETRY, TRUTH))
    return (said or true)[quantity] >= asked or true[quantity] >= FARTHEST * asked
