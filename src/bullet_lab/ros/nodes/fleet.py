"""Puts several robots into the running world and drives all of them in squares at once.

Robot k is the model robot<k> with the namespace robot<k> and, if none is set there, the
tf_prefix robot<k>; k counts from 1.

:ROS Parameters: see `FleetParameters`.
:ROS Publishers:
    - robot<k>/cmd_vel (geometry_msgs/Twist)
    - fleet/finished (std_msgs/Time), latched: when all squares were finished
:ROS Subscribers: robot<k>/odom (nav_msgs/Odometry), in closed loop only
:ROS Service clients: /gazebo/spawn_urdf_model (gazebo_msgs/SpawnModel)
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import List, Optional

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Twist
from std_msgs.msg import Time
from tqdm import tqdm

from bullet_lab.core import patterns
from bullet_lab.drive.square import MODES, OPEN_LOOP, Square, SquareCourse
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.lock_step import CountedPublisher, LockStepRate, Rate
from bullet_lab.ros.node.node import private_parameters, run_node, wait_until
from bullet_lab.ros.node.odometry import NewestOdometry
from bullet_lab.ros.node.publishers import lossless_publisher
from bullet_lab.ros.node.tf_prefix import PARAMETER as TF_PREFIX
from bullet_lab.ros.nodes.populate import description_of

MOST_ROBOTS = 100


def robot_names(count: int) -> List[str]:
    """Return the names of so many robots, which are their namespaces as well; from robot1 on."""
    return [f"robot{number}" for number in range(1, count + 1)]


SERVICE = "/gazebo/spawn_urdf_model"
# At rest before and after, so that a recording shows where the robots stood.
REST_SECONDS = 0.5
# Wall seconds for a latched message to reach subscribers that are still connecting.
GOODBYE_SECONDS = 0.5


@dataclass(frozen=True)
class FleetParameters:
    """Private parameters of fleet."""

    robots: int = parameters.integer(8, "how many there are", 1, MOST_ROBOTS)
    robot: str = parameters.text(
        "package://bullet_lab/urdf/block_robot.urdf", "URDF of each: a path or package://"
    )
    spacing: float = parameters.number(2.5, "m from one start to the next, in a grid", above=0.0)
    mode: str = parameters.choice(OPEN_LOOP, "what ends a side", MODES)
    sides: int = parameters.integer(4, "number of sides", minimum=1)
    side: float = parameters.number(2.0, "length of a side in m", above=0.0)
    lock_step: bool = parameters.boolean(False, "hold simulated time back while working")


def spawn(wanted: FleetParameters) -> None:
    """Put the robots into the world; raises LabError."""
    text = description_of(wanted.robot)
    places = patterns.grid(wanted.robots, wanted.spacing)
    for name, (x, y, _) in zip(robot_names(wanted.robots), places):
        space = rospy.resolve_name(name)
        if not rospy.has_param(f"{space}/{TF_PREFIX}"):
            rospy.set_param(f"{space}/{TF_PREFIX}", name)
        pose = Pose(Point(x, y, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
        call(SERVICE, srv.SpawnModel, name, text, space, pose, "")


class _Driver:
    """Drives one robot.

    Args:
        name: of the robot, its namespace.
        course: what it drives.
    """

    def __init__(self, name: str, course: SquareCourse):
        self.course = course
        self.done = False
        # Written out at once, so that the last command is on its way before the node ends.
        self.commands = CountedPublisher(lossless_publisher(f"{name}/cmd_vel", Twist))
        self._odometry = NewestOdometry(f"{name}/odom") if course.needs_pose else None

    def next(self, now: Optional[rospy.Time]) -> Twist:
        """Return the next command; with the one to stand still, the robot is done.

        Args:
            now: in lock step, the simulated time.
        """
        twist = Twist()
        pose = None if self._odometry is None else self._odometry.newest(now)
        command = self.course.command(pose)
        if command is None:
            self.done = True
        else:
            twist.linear.x, twist.angular.z = command
        return twist


class Fleet:
    """Drives all robots, tick by tick."""

    def __init__(self, wanted: FleetParameters):
        square = Square(wanted.sides, wanted.side)
        self._sides = wanted.sides * wanted.robots
        self._drivers = [
            _Driver(name, SquareCourse(square, wanted.mode)) for name in robot_names(wanted.robots)
        ]
        self._finished = lossless_publisher("~finished", Time, latch=True)
        self._sending = threading.RLock()
        self._ended = False
        rospy.on_shutdown(self._end)
        wait_until(
            lambda: all(driver.commands.is_connected() for driver in self._drivers),
            "somebody to listen to the commands",
        )
        self._rate = self._make_rate(self._drivers[0].course.rate, wanted.lock_step)

    @property
    def count(self) -> int:
        """How many commands have been sent, to all robots together."""
        return sum(driver.commands.count for driver in self._drivers)

    def drive(self) -> None:
        """Drive all squares, stop, and say that it is done."""
        self._rest()
        with tqdm(total=self._sides, unit="side", desc="driving", disable=None) as progress:
            while not all(driver.done for driver in self._drivers):
                self._send()
                done = sum(driver.course.sides_done for driver in self._drivers)
                progress.update(done - progress.n)
                if not all(driver.done for driver in self._drivers):
                    self._sleep()
        self._rest()
        self._finished.publish(Time(rospy.Time.now() if self._now is None else self._now))

    def leave(self) -> None:
        """Let the world go on without this node."""
        if isinstance(self._rate, LockStepRate):
            self._rate.leave()
        else:
            rospy.rostime.wallsleep(GOODBYE_SECONDS)

    @property
    def _now(self) -> Optional[rospy.Time]:
        return self._rate.now if isinstance(self._rate, LockStepRate) else None

    def _make_rate(self, hz: float, lock_step: bool) -> Rate:
        self._hz = hz
        return LockStepRate(hz, self) if lock_step else rospy.Rate(hz)

    def _rest(self) -> None:
        for _ in range(round(REST_SECONDS * self._hz)):
            self._sleep()

    def _sleep(self) -> None:
        self._rate.sleep()
        # rospy.Rate says nothing of a shutdown where time is the wall clock's.
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")

    def _send(self) -> None:
        for driver in [driver for driver in self._drivers if not driver.done]:
            twist = driver.next(self._now)
            with self._sending:
                if not self._ended:
                    driver.commands.publish(twist)

    def _end(self) -> None:
        """Stop all robots for good: whoever ends the node, nothing is sent after this."""
        with self._sending:
            self._ended = True
            for driver in self._drivers:
                driver.commands.publish(Twist())


def main() -> None:
    """Run the node."""

    def body() -> None:
        wanted = private_parameters(FleetParameters)
        spawn(wanted)
        fleet = Fleet(wanted)
        fleet.drive()
        fleet.leave()

    run_node("fleet", body)
