"""Commands that can be stopped, action servers, and the loop of nodes that drive."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from typing import Any, Callable

import rospy
from actionlib import ActionServer, ServerGoalHandle, SimpleActionServer
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import Twist

from bullet_lab.ros.node.lock_step import in_lock_step, rate
from bullet_lab.ros.node.odometry import FrameFinder, MessageQueue
from bullet_lab.ros.node.publishers import Publisher, publisher

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

    def send(self, command: tuple[float, float], ticket: int | None = None) -> None:
        """Send a command (m/s, rad/s), unless there was a stop after its ticket."""
        with self._lock:
            if ticket in (None, self._stops) and not self._ended:
                self._publish(command)

    def stop(self) -> None:
        """Stop the robot."""
        with self._lock:
            self._stops += 1
            if not self._ended:
                self._publish((0.0, 0.0))

    def end(self) -> None:
        """Stop the robot and send no further commands."""
        with self._lock:
            self.stop()
            self._ended = True

    def _publish(self, command: tuple[float, float]) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = command
        self._publisher.publish(twist)


class GoalServer(SimpleActionServer):
    """A SimpleActionServer that is polled, and in which the newest goal to arrive counts.

    actionlib's drops goals with an earlier stamp than the last one: all goals after a reset of
    time, and those of machines whose clock is late.

    Args:
        name: of the action.
        kind: its class, such as MoveBaseAction.
        on_goal: called with the handle of a new goal, before the loop accepts it.
        on_cancel: called when the current goal is cancelled.

    Threads of rospy that hold actionlib's lock call both functions.
    """

    def __init__(
        self,
        name: str,
        kind: type,
        on_goal: Callable[[ServerGoalHandle], None],
        on_cancel: Callable[[], None],
    ):
        self.name = name
        self._on_cancel = on_cancel
        super().__init__(name, kind, auto_start=False)
        self.register_goal_callback(lambda: on_goal(self.next_goal))
        self.register_preempt_callback(self._preempt)
        self.action_server.internal_cancel_callback = self._cancel

    def start(self) -> None:
        """Start the server, with a timer for the status that survives a reset of time."""
        super().start()
        server = self.action_server
        if server.status_frequency > 0.0:
            server.status_timer.shutdown()
            period = rospy.Duration(1.0 / server.status_frequency)
            server.status_timer = rospy.Timer(period, server.publish_status_async, reset=True)

    @property
    def is_cancelled(self) -> bool:
        """Whether the current goal was cancelled, and not replaced by a new one."""
        # In this order: actionlib stores a new goal before it requests to preempt the old one.
        return self.is_active() and self.is_preempt_requested() and not self.is_new_goal_available()

    def tell(self, feedback: Any, stamp: rospy.Time) -> None:
        """Publish feedback on the current goal, with a stamp.

        actionlib's stamp is the time of the last message on /clock, which may be out of date.
        """
        server, status = self.action_server, self.current_goal.get_goal_status()
        message = server.ActionFeedback(status=status, feedback=feedback)
        message.header.stamp = stamp
        with server.lock:
            if not rospy.is_shutdown():
                server.feedback_pub.publish(message)

    def end(self, status: int, result: Any | None = None, text: str = "") -> None:
        """End the current goal as succeeded, preempted or aborted, with a text for the user."""
        if status == GoalStatus.SUCCEEDED:
            self.set_succeeded(result, text)
        elif status == GoalStatus.PREEMPTED:
            self.set_preempted(result, text)
        else:
            self.set_aborted(result, text)

    def internal_goal_callback(self, goal: ServerGoalHandle) -> None:
        """Accept a goal whatever its stamp; called by actionlib."""
        with self.lock:
            for earlier in (self.current_goal, self.next_goal):
                if earlier.get_goal():
                    goal_id = earlier.get_goal_id()
                    goal_id.stamp = min(goal_id.stamp, goal.get_goal_id().stamp)
        super().internal_goal_callback(goal)
        if in_lock_step():
            # actionlib publishes the status by ROS time, which may be held.
            self.action_server.publish_status()

    def _cancel(self, goal_id: GoalID) -> None:
        """Cancel goals as actionlib does.

        actionlib stores the cancellation of a goal that has not arrived yet without a goal, and
        logs an error at each later cancellation: such an entry gets an empty goal here.
        """
        server = self.action_server
        with server.lock:
            ActionServer.internal_cancel_callback(server, goal_id)
            for tracker in server.status_list:
                tracker.goal = tracker.goal or server.ActionGoal()

    def _preempt(self) -> None:
        if not self.is_new_goal_available():
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

    def run(self, hz: float, what: str) -> None:
        """Work at a rate of simulated time until ROS shuts down.

        In lock step, time starts when everything is connected; `what` describes that in the log.
        """
        ticks = rate(hz, self._is_connected, what)
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
        new = [one for one in self._servers if one.is_new_goal_available()]
        for server in sorted(new, key=lambda one: one.next_goal.get_goal_id().stamp):
            if self._server is not None:
                self._replace(now)
            self._server, self._goal = server, server.accept_new_goal()
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
            server.action_server.last_cancel = rospy.Time()
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
