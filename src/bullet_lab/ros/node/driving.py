"""Commands that can be stopped, action servers, and the loop of nodes that drive."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from typing import Any, Callable

import rospy
from actionlib import ActionServer, ServerGoalHandle
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import Twist

from bullet_lab.drive import STANDSTILL, Command
from bullet_lab.ros.node.lock_step import Publisher, Rate, in_lock_step, publisher
from bullet_lab.ros.node.odometry import FrameFinder, MessageQueue

REPLACED = "replaced by another goal"


class StoppableSender:
    """Sends commands; a stop takes effect at once and voids the command being computed.

    When the node ends, it stops the robot. Thread-safe.
    """

    def __init__(self, publisher: Publisher):
        self._publisher = publisher
        self._lock = threading.RLock()
        self._stops = 0
        self._ended = False
        rospy.on_shutdown(self.end)

    def ticket(self) -> int:
        """Return a ticket for `send`; called before a command is computed."""
        return self._stops

    def send(self, command: Command, ticket: int | None = None) -> None:
        """Send a command (m/s, rad/s), unless there was a stop after its ticket."""
        with self._lock:
            if ticket in (None, self._stops) and not self._ended:
                self._publish(command)

    def stop(self) -> None:
        """Stop the robot."""
        with self._lock:
            self._stops += 1
            if not self._ended:
                self._publish(STANDSTILL)

    def end(self) -> None:
        """Stop the robot and send no further commands."""
        with self._lock:
            self.stop()
            self._ended = True

    def _publish(self, command: Command) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = command
        self._publisher.publish(twist)


class LastingServer(ActionServer):
    """An action server that outlives resets of time, and cancellations of unknown goals."""

    def initialize(self) -> None:
        """Connect, with a timer for the status that survives a reset of time."""
        super().initialize()
        if self.status_frequency > 0.0:
            self.status_timer.shutdown()
            period = rospy.Duration(1.0 / self.status_frequency)
            self.status_timer = rospy.Timer(period, self.publish_status_async, reset=True)

    def internal_cancel_callback(self, goal_id: GoalID) -> None:
        """Cancel goals as actionlib does.

        actionlib stores the cancellation of a goal that has not arrived yet without a goal, and
        logs an error at each later cancellation: such an entry gets an empty goal here.
        """
        with self.lock:
            super().internal_cancel_callback(goal_id)
            for tracker in self.status_list:
                tracker.goal = tracker.goal or self.ActionGoal()


class GoalServer(LastingServer):
    """An action server that is polled, in which the newest goal to arrive counts.

    `on_goal` is called with the handle of a new goal, before the loop accepts it, and `on_cancel`
    when the goal that is pursued is cancelled; both in threads of rospy that hold actionlib's lock.

    Attributes:
        next_goal: handle of the goal that waits to be accepted; None without one.
        goal: that of the goal that is pursued.
    """

    def __init__(
        self,
        name: str,
        kind: type,
        on_goal: Callable[[ServerGoalHandle], None],
        on_cancel: Callable[[], None],
    ):
        self.name = name
        self._on_goal, self._on_cancel = on_goal, on_cancel
        self.next_goal: ServerGoalHandle | None = None
        self.goal: ServerGoalHandle | None = None
        super().__init__(name, kind, self._receive, self._cancel, auto_start=False)
        self.start()

    @property
    def is_cancelled(self) -> bool:
        """Whether the goal that is pursued was cancelled."""
        if self.goal is None:
            return False
        return self.goal.get_goal_status().status == GoalStatus.PREEMPTING

    def accept(self) -> Any:
        """Pursue the goal that waits, and return it."""
        with self.lock:
            self.goal, self.next_goal = self.next_goal, None
            self.goal.set_accepted()
            return self.goal.get_goal()

    def tell(self, feedback: Any, stamp: rospy.Time) -> None:
        """Publish feedback on the goal that is pursued, with a stamp.

        actionlib's stamp is the time of the last message on /clock, which may be out of date.
        """
        message = self.ActionFeedback(status=self.goal.get_goal_status(), feedback=feedback)
        message.header.stamp = stamp
        with self.lock:
            if not rospy.is_shutdown():
                self.feedback_pub.publish(message)

    def end(self, status: int, result: Any | None = None, text: str = "") -> None:
        """End the goal as succeeded, preempted or aborted, with a text for the user."""
        with self.lock:
            goal, self.goal = self.goal, None
            ends = {
                GoalStatus.SUCCEEDED: goal.set_succeeded,
                GoalStatus.PREEMPTED: goal.set_canceled,
                GoalStatus.ABORTED: goal.set_aborted,
            }
            ends[status](result, text)

    def _receive(self, goal: ServerGoalHandle) -> None:
        if self.next_goal is not None:
            self.next_goal.set_canceled(None, REPLACED)
        self.next_goal = goal
        self._on_goal(goal)
        if in_lock_step():
            # actionlib publishes the status by ROS time, which may be held.
            self.publish_status()

    def _cancel(self, goal: ServerGoalHandle) -> None:
        if self.goal is not None and goal == self.goal:
            self._on_cancel()


class GoalNode(ABC):
    """A node that drives to the goals of action servers, one goal at a time.

    Goals and cancellations come in threads of rospy, where they only stop the robot; the loop
    starts and ends them.

    Args:
        cmd_vel: topic of the commands.
        odometry: messages that are read as frame and content, see `framed`.
        others: other messages that the node needs.
    """

    def __init__(self, cmd_vel: str, odometry: MessageQueue, *others: MessageQueue):
        self._commands = publisher(cmd_vel, Twist)
        self._sender = StoppableSender(self._commands)
        self._frames = FrameFinder()
        self._odometry = odometry
        self._queues = (odometry, *others)
        # Of the odometry; empty before the first message.
        self._frame = ""
        self._servers: list[GoalServer] = []
        # The server of the goal that is pursued, and the goal.
        self._server: GoalServer | None = None
        self._goal: Any = None

    def run(self, hz: float) -> None:
        """Work at a rate of simulated time until ROS shuts down.

        In lock step, time starts when everything is connected.
        """
        topics = [*(queue.topic for queue in self._queues), self._commands.name]
        ticks = Rate(hz, self._is_connected, ", ".join(topics))
        last = ticks.now
        while not rospy.is_shutdown():
            ticks.sleep()
            if ticks.now < last:
                last = ticks.now
                self._time_was_set_back()
            ticket = self._sender.ticket()
            self._handle_requests(ticks.now)
            for queue in self._queues:
                queue.wait(ticks.now)
            self._tick(ticks.now, (ticks.now - last).to_sec(), ticket)
            last = ticks.now

    def _is_connected(self) -> bool:
        queues = all(queue.is_connected() for queue in self._queues)
        return queues and self._commands.has_connections()

    def _handle_requests(self, now: rospy.Time) -> None:
        """Accept new goals, the newest last, and end a cancelled goal."""
        new = [one for one in self._servers if one.next_goal is not None]
        for server in sorted(new, key=lambda one: one.next_goal.get_goal_id().stamp):
            if self._server is not None:
                self._replace(now)
            self._server, self._goal = server, server.accept()
            self._accept(now)
        if self._server is not None and self._server.is_cancelled:
            self._end(now, GoalStatus.PREEMPTED, "cancelled on request")

    def _take_odometry(self, now: rospy.Time) -> list[Any]:
        taken = self._odometry.take(now)
        if taken:
            self._frame, _ = taken[-1]
        return [content for _, content in taken]

    def _replace(self, now: rospy.Time) -> None:
        self._end(now, GoalStatus.PREEMPTED, REPLACED)

    def _time_was_set_back(self) -> None:
        for queue in self._queues:
            queue.clear()
        for server in self._servers:
            # Accept goals with stamps before the last cancellation.
            server.last_cancel = rospy.Time()
        self._frames.clear()
        if self._server is not None:
            self._end(rospy.Time(0), GoalStatus.ABORTED, "simulated time was set back")

    @abstractmethod
    def _accept(self, now: rospy.Time) -> None:
        """Begin to pursue the goal."""

    @abstractmethod
    def _tick(self, now: rospy.Time, seconds: float, ticket: int) -> None:
        """Take messages and send a command with a ticket; `seconds` are those since the last."""

    @abstractmethod
    def _end(self, now: rospy.Time, status: int, text: str) -> None:
        """End the goal that is pursued, stop the robot, and report the outcome."""
