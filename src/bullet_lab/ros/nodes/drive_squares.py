"""Drives robots in squares, in open loop or by their odometry.

drive_squares drives one robot.

:ROS Parameters: see `DriveSquaresParameters`.
:ROS Publishers:
    - cmd_vel (geometry_msgs/Twist), or the topic ~cmd_vel
    - drive_squares/finished (std_msgs/Time), latched: when the square was finished
:ROS Subscribers: odom (nav_msgs/Odometry), or the topic ~odom; in closed loop only

fleet spawns several robots and drives all of them. Robot k, counted from 1, is the model robot<k>
with the namespace robot<k> and, if none is set there, the tf_prefix robot<k>.

:ROS Parameters: see `FleetParameters`.
:ROS Publishers: robot<k>/cmd_vel and fleet/finished, as above
:ROS Subscribers: robot<k>/odom
:ROS Service clients: /gazebo/spawn_urdf_model (gazebo_msgs/SpawnModel)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import rospy
from geometry_msgs.msg import Twist
from std_msgs.msg import Time

from bullet_lab.core import se2
from bullet_lab.core.parameters import choice, integer, number, text
from bullet_lab.core.pose import Pose
from bullet_lab.drive import MODES, OPEN_LOOP, Square, SquareDriver, SquareSize
from bullet_lab.ros.node.driving import StoppableSender
from bullet_lab.ros.node.lock_step import Rate, publisher
from bullet_lab.ros.node.node import TF_PREFIX, node, wait_until
from bullet_lab.ros.node.odometry import NewestOdometry
from bullet_lab.ros.nodes.spawn import description_of, spawn

SPAWN_SERVICE = "/gazebo/spawn_urdf_model"
MOST_ROBOTS = 100
# Simulated seconds at rest before and after the drive, for recordings.
REST_SECONDS = 0.5


@dataclass(frozen=True)
class DriveSquaresParameters(Square):
    """Private parameters of drive_squares, with those of the square."""

    mode: str = choice(OPEN_LOOP, "what ends a side", MODES)
    cmd_vel: str = text("cmd_vel", "topic of the commands")
    odom: str = text("odom", "topic of the odometry that closes the loop")


@dataclass(frozen=True)
class FleetParameters(SquareSize):
    """Private parameters of fleet, with the size of the squares."""

    mode: str = choice(OPEN_LOOP, "what ends a side", MODES)
    robots: int = integer(8, "how many there are", 1, MOST_ROBOTS)
    robot: str = text(
        "package://bullet_lab/urdf/block_robot.urdf", "URDF of each: a path or package://"
    )
    spacing: float = number(2.5, "m from one start to the next, in a grid", above=0.0)


class _Robot:
    """One robot, with the topics of its commands and its odometry."""

    def __init__(self, driver: SquareDriver, cmd_vel: str, odom: str):
        self.driver = driver
        # Without a queue, so that the last command is sent before the node ends.
        commands = publisher(cmd_vel, Twist)
        self._sender = StoppableSender(commands)
        self._odometry = NewestOdometry(odom) if driver.needs_pose else None
        wait_until(commands.has_connections, f"a subscriber to {cmd_vel}")

    def tick(self, now: rospy.Time) -> bool:
        """Send the next command, after the last one stop; return whether there is another."""
        pose = None
        if self._odometry is not None:
            if self._odometry.is_stale():
                # `newest` waits, and time may run meanwhile.
                self._sender.stop()
            pose = self._odometry.newest(now)
        command = self.driver.command(pose)
        if command is None:
            self._sender.stop()
        else:
            self._sender.send(command)
        return command is not None


class DriveSquares:
    """Drives several robots, each with topics (cmd_vel, odom), in squares at the same time."""

    def __init__(self, square: Square, mode: str, robots: Sequence[tuple[str, str]]):
        self._square = square
        self._robots = [_Robot(SquareDriver(square, mode), *topics) for topics in robots]
        self._finished = publisher("~finished", Time, latch=True)
        self._side = 0
        self._hz = self._robots[0].driver.rate
        self._rate = Rate(self._hz)

    def drive(self) -> None:
        """Drive all sides, stop, publish the end, and leave the lock step."""
        self._rest()
        driving = self._robots
        while driving:
            driving = [robot for robot in driving if robot.tick(self._rate.now)]
            self._report()
            if driving:
                self._rate.sleep()
        self._rest()
        self._finished.publish(Time(self._rate.now))
        self._rate.leave()

    def _report(self) -> None:
        side = 1 + min(robot.driver.sides_done for robot in self._robots)
        if self._side < side <= self._square.sides:
            self._side = side
            rospy.loginfo("side %d of %d", side, self._square.sides)

    def _rest(self) -> None:
        for _ in range(round(REST_SECONDS * self._hz)):
            self._rate.sleep()


def robot_names(count: int) -> list[str]:
    """Return the names of the robots of a fleet, robot1 and so on; they are also namespaces."""
    return [f"robot{number}" for number in range(1, count + 1)]


@node
def fleet(parameters: FleetParameters) -> None:
    """Spawn the robots and drive them; raises LabError."""
    text = description_of(parameters.robot)
    names = robot_names(parameters.robots)
    for name, (x, y, _) in zip(names, se2.grid(parameters.robots, parameters.spacing)):
        space = rospy.resolve_name(name)
        if not rospy.has_param(f"{space}/{TF_PREFIX}"):
            rospy.set_param(f"{space}/{TF_PREFIX}", name)
        spawn(name, text, space, Pose((x, y, 0.0)), SPAWN_SERVICE)
    square = Square(parameters.sides, parameters.side)
    topics = [(f"{name}/cmd_vel", f"{name}/odom") for name in names]
    DriveSquares(square, parameters.mode, topics).drive()


@node
def drive_squares(parameters: DriveSquaresParameters) -> None:
    """Drive one robot."""
    topics = [(parameters.cmd_vel, parameters.odom)]
    DriveSquares(parameters, parameters.mode, topics).drive()
