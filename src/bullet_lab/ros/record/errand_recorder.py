"""What nodes share that send a robot somewhere and record its true path until it has come."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import List, Optional

import rospy
from nav_msgs.msg import Odometry

from bullet_lab.core.files import FileError
from bullet_lab.reports.dock import DockingRunError, PathRecording
from bullet_lab.ros.node.lock_step import LockStep
from bullet_lab.ros.node.node import NodeError, Refusals, wait_until
from bullet_lab.ros.node.odometry import OdometryError, planar_pose
from bullet_lab.ros.record.recorder import PATIENCE, Stopwatch

# Simulated time of the goal: between two ticks of the server, which has seen the one before.
GOAL_TIME = rospy.Time(0, 525_000_000)
# What comes before is not recorded: somebody may not have been connected yet.
BEGINNING = rospy.Time(0, 500_000_000)
# Wall seconds for the server to take the goal.
ACCEPTANCE = 30.0
POLL_SECONDS = 0.02


class ErrandRecorder:
    """Sends a goal and records until some time after its end.

    A subclass makes subscribers, that to odom among them by `_listen_to_odometry`, and says how
    the goal is sent, when all has come, and what is left behind.

    Args:
        folder: for truth.tum, which is written row by row.
        lock_step: whether simulated time is held back until the goal is taken.
        server: name of the node that takes it, for messages.
    """

    def __init__(self, folder: Path, lock_step: bool, server: str):
        self._in_lock_step, self._server = lock_step, server
        self._lock = threading.Lock()
        self._refusals = Refusals()
        self._stopwatch = Stopwatch()
        self._truth = PathRecording(folder / "truth.tum")
        self._failure: Optional[FileError] = None
        self._subscribers: List[rospy.Subscriber] = []

    def run(self) -> None:
        """Send the goal, record until some time after its end, and write everything.

        Raises:
            NodeError: the goal was not taken, or not reached.
        """
        try:
            self._begin()
            self._wait_for_the_end()
        finally:
            self._write()
        self._judge()

    # What a subclass says

    def _is_connected(self) -> bool:
        """Return whether all that is heard and sent to is there."""
        return all(one.get_num_connections() > 0 for one in self._subscribers)

    def _send(self) -> None:
        """Send the goal."""
        raise NotImplementedError

    def _is_taken(self) -> bool:
        """Return whether the server has taken the goal."""
        raise NotImplementedError

    def _until(self) -> Optional[int]:
        """Return the time in ns that is recorded up to; None while that is not known."""
        raise NotImplementedError

    def _is_complete(self) -> bool:
        """Return whether all has come up to the end."""
        raise NotImplementedError

    def _meanwhile(self) -> None:
        """Do what is to be done now and then."""

    def _write(self) -> None:
        """Leave everything behind."""
        raise NotImplementedError

    def _judge(self) -> None:
        """Raise NodeError where the robot has come to an end, but not to its goal."""

    # The errand

    def _begin(self) -> None:
        wait_until(self._is_connected, f"the bridge and {self._server}")
        lock_step = LockStep() if self._in_lock_step else None
        if lock_step is not None:
            lock_step.advance(GOAL_TIME)
        self._send()
        # In lock step, time stands until the server has the goal: it is taken up at its next tick.
        self._await_acceptance()
        if lock_step is not None:
            lock_step.listen_only()

    def _await_acceptance(self) -> None:
        deadline = time.monotonic() + ACCEPTANCE
        while not self._is_taken():
            if rospy.is_shutdown():
                raise rospy.ROSInterruptException("shutdown")
            if time.monotonic() > deadline:
                raise NodeError(f"{self._server} has not taken the goal for {ACCEPTANCE:g} s")
            time.sleep(POLL_SECONDS)

    def _wait_for_the_end(self) -> None:
        announced: Optional[float] = None
        while not self._is_complete():
            if rospy.is_shutdown():
                return
            if self._failure is not None:
                raise self._failure
            self._meanwhile()
            if self._until() is not None:
                announced = announced or time.monotonic()
                if time.monotonic() - announced > PATIENCE:
                    rospy.logwarn("the end was announced and nothing more comes")
                    return
            time.sleep(POLL_SECONDS)

    # The true path

    def _listen_to_odometry(self) -> rospy.Subscriber:
        return rospy.Subscriber("odom", Odometry, self._receive_odometry, tcp_nodelay=True)

    def _receive_odometry(self, message: Odometry) -> None:
        if message.header.stamp < BEGINNING:
            return
        try:
            pose = planar_pose(message)
            with self._lock:
                self._truth.add(message.header.stamp.to_nsec(), pose)
        except (OdometryError, DockingRunError) as error:
            self._refusals.refuse("odom", str(error))
        except FileError as error:
            self._failure = error
        else:
            self._stopwatch.note()
