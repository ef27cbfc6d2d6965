"""Drives a robot in squares, by the clock or by its odometry.

:ROS Parameters: see `DriveSquaresParameters`.
:ROS Publishers:
    - cmd_vel (geometry_msgs/Twist), or what ~cmd_vel says
    - drive_squares/finished (std_msgs/Time), latched: when the square was finished
:ROS Subscribers: odom (nav_msgs/Odometry), or what ~odom says; in closed loop only
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any, Optional, Tuple

import rospy
from geometry_msgs.msg import Twist
from std_msgs.msg import Time
from tqdm import tqdm

from bullet_lab.drive.square import (
    CLOSED_LOOP_RATE,
    OPEN_LOOP_RATE,
    ClosedLoopSide,
    Square,
    open_loop_side,
)
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.lock_step import CountedPublisher, LockStepRate, Rate
from bullet_lab.ros.node.node import private_parameters, run_node, wait_until
from bullet_lab.ros.node.odometry import NewestOdometry
from bullet_lab.ros.node.publishers import lossless_publisher

# At rest before and after, so that a recording shows where the robot stood.
REST_SECONDS = 0.5
# Wall seconds for a latched message to reach subscribers that are still connecting.
GOODBYE_SECONDS = 0.5


def _accept_turn_speed(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value) or value == 0.0:
        raise ValueError
    return float(value)


@dataclass(frozen=True)
class DriveSquaresParameters:
    """Private parameters of drive_squares."""

    cmd_vel: str = parameters.text("cmd_vel", "topic of the commands")
    odom: str = parameters.text("odom", "topic of the odometry that closes the loop")
    mode: str = parameters.choice("open_loop", "what ends a side", ("open_loop", "closed_loop"))
    sides: int = parameters.integer(4, "number of sides", minimum=1)
    side: float = parameters.number(2.0, "length of a side in m", above=0.0)
    speed: float = parameters.number(0.2, "on the sides, m/s", above=0.0)
    turn_speed: float = parameters.checked(
        -0.5236,
        "at the corners, rad/s; negative is clockwise",
        "a number other than 0",
        _accept_turn_speed,
    )
    turn_commands: int = parameters.integer(34, "open loop: commands of a turn at 10 Hz", minimum=0)
    lock_step: bool = parameters.boolean(False, "hold simulated time back while working")


class DriveSquares:
    """Drives the square."""

    def __init__(self, wanted: DriveSquaresParameters):
        self.square = Square(
            wanted.sides, wanted.side, wanted.speed, wanted.turn_speed, wanted.turn_commands
        )
        self._closed_loop = wanted.mode == "closed_loop"
        # Written out at once, so that the last command is on its way before the node ends.
        self.pub = CountedPublisher(lossless_publisher(wanted.cmd_vel, Twist))
        self._finished = lossless_publisher("~finished", Time, latch=True)
        self._odometry = NewestOdometry(wanted.odom) if self._closed_loop else None
        self._heading: Optional[float] = None
        self._progress: Optional[tqdm] = None
        self._sending = threading.RLock()
        self._ended = False
        rospy.on_shutdown(self._end)
        wait_until(self.pub.is_connected, f"somebody to listen to {wanted.cmd_vel}")
        self.rate = self._make_rate(wanted.lock_step)

    def drive(self, cmd_vel: str) -> None:
        """Drive all sides, stop, and say that it is done."""
        self._rest()
        total = self.square.sides * self.square.side
        with tqdm(
            total=total, unit="m", desc="driving", disable=None, bar_format=PROGRESS_FORMAT
        ) as self._progress:
            for side in range(self.square.sides):
                self._report(f"side {side + 1} of {self.square.sides}")
                self.drive_squares(cmd_vel)
        self.stop()
        self._rest()
        self._finished.publish(Time(rospy.Time.now() if self._now is None else self._now))

    def drive_squares(self, cmd_vel: str) -> None:
        """Drive one side and turn the corner after it; `cmd_vel` names the topic in the log."""
        rospy.logdebug("publishing on %s", cmd_vel)
        if self._closed_loop:
            self._drive_by_odometry()
        else:
            self._drive_by_clock()

    def _report(self, where: str) -> None:
        """Say where the drive is, on the progress bar or, without a terminal, in the log."""
        if self._progress.disable:
            rospy.loginfo(where)
        else:
            self._progress.set_description(where)

    def stop(self) -> None:
        """Tell the robot to stand still."""
        self.pub.publish(Twist())

    def leave(self) -> None:
        """Let the world go on without this node."""
        if isinstance(self.rate, LockStepRate):
            self.rate.leave()
        else:
            rospy.rostime.wallsleep(GOODBYE_SECONDS)

    @property
    def _now(self) -> Optional[rospy.Time]:
        return self.rate.now if isinstance(self.rate, LockStepRate) else None

    def _make_rate(self, lock_step: bool) -> Rate:
        self._hz = CLOSED_LOOP_RATE if self._closed_loop else OPEN_LOOP_RATE
        return LockStepRate(self._hz, self.pub) if lock_step else rospy.Rate(self._hz)

    def _rest(self) -> None:
        for _ in range(round(REST_SECONDS * self._hz)):
            self._sleep()

    def _drive_by_clock(self) -> None:
        step = self.square.side / self.square.side_commands
        for ahead, turn in open_loop_side(self.square):
            self._send(ahead, turn)
            self._sleep()
            self._progress.update(step if ahead else 0.0)

    def _drive_by_odometry(self) -> None:
        pose = self._newest_pose()
        if self._heading is None:
            self._heading = pose[2]
        side = ClosedLoopSide(self.square, pose, self._heading)
        driven = 0.0
        while not side.done:
            self._send(*side.command(pose))
            self._sleep()
            pose = self._newest_pose()
            farther = min(max(driven, side.progress(pose)), self.square.side)
            self._progress.update(farther - driven)
            driven = farther
        self._heading = side.next_heading

    def _newest_pose(self) -> Tuple[float, float, float]:
        if self._now is None and self._odometry.is_stale():
            # Time goes on while it is waited for the next one.
            self.stop()
        return self._odometry.newest(self._now)

    def _sleep(self) -> None:
        self.rate.sleep()
        # rospy.Rate says nothing of a shutdown where time is the wall clock's.
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException("shutdown")

    def _send(self, ahead: float, turn: float) -> None:
        twist = Twist()
        twist.linear.x = ahead
        twist.angular.z = turn
        with self._sending:
            if not self._ended:
                self.pub.publish(twist)

    def _end(self) -> None:
        """Stop the robot for good: whoever ends the node, nothing is sent after this."""
        with self._sending:
            self._ended = True
            self.stop()


PROGRESS_FORMAT = "{desc} {percentage:3.0f}%|{bar:30}| {n:.1f} of {total:.1f} m, {elapsed}"


def main() -> None:
    """Run the node."""

    def body() -> None:
        wanted = private_parameters(DriveSquaresParameters)
        driver = DriveSquares(wanted)
        driver.drive(wanted.cmd_vel)
        driver.leave()

    run_node("drive_squares", body)
