"""What nodes that drive share: commands that can be stopped at any moment, goals by actionlib."""

from __future__ import annotations

import threading
from typing import Any, Callable, Optional, Tuple

import rospy
from actionlib import ActionServer, ServerGoalHandle, SimpleActionServer
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import Twist

from bullet_lab.ros.node.lock_step import in_lock_step
from bullet_lab.ros.node.publishers import Publisher


class StoppableSender:
    """Sends commands; a stop takes effect at once and voids those that were on their way.

    All methods may be called from any thread.
    """

    def __init__(self, publisher: Publisher):
        self._publisher = publisher
        self._lock = threading.RLock()
        self._stops = 0
        self._ended = False

    def ticket(self) -> int:
        """Return what `send` wants to see, from before the command was thought of."""
        return self._stops

    def send(self, command: Tuple[float, float], ticket: Optional[int] = None) -> None:
        """Send a command (m/s, rad/s), unless there was a stop after the ticket that is given."""
        with self._lock:
            if ticket in (None, self._stops) and not self._ended:
                self._publish(command)

    def stop(self) -> None:
        """Have the robot stand still."""
        with self._lock:
            self._stops += 1
            if not self._ended:
                self._publish((0.0, 0.0))

    def end(self) -> None:
        """Have the robot stand still, and send nothing ever after."""
        with self._lock:
            self.stop()
            self._ended = True

    def _publish(self, command: Tuple[float, float]) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = command
        self._publisher.publish(twist)


class GoalServer(SimpleActionServer):
    """A SimpleActionServer that is polled, and for which the goal that comes last counts.

    actionlib's own drops goals that are stamped before the last one. That is all of them once
    simulated time was set back, and those of machines whose clock is late.

    Args:
        name: of the action.
        kind: its class, such as MoveBaseAction.
        on_goal: called when a goal has come, with its handle, before the loop takes it up.
        on_cancel: called when the goal that is pursued is cancelled.

    Both are called from threads of rospy, which hold actionlib's lock.
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
        """Serve, and go on saying how goals stand where time is set back.

        actionlib's own timer ends there.
        """
        super().start()
        server = self.action_server
        if server.status_frequency > 0.0:
            server.status_timer.shutdown()
            period = rospy.Duration(1.0 / server.status_frequency)
            server.status_timer = rospy.Timer(period, server.publish_status_async, reset=True)

    @property
    def is_cancelled(self) -> bool:
        """Whether the goal that is pursued was cancelled, and not for a new one."""
        # In this order: a new goal is noted before the request to give up the old one.
        return self.is_active() and self.is_preempt_requested() and not self.is_new_goal_available()

    def tell(self, feedback: Any, stamp: rospy.Time) -> None:
        """Publish feedback of the goal that is pursued, as of a time.

        actionlib's own has the time of the last /clock that has come, which may be one before.
        """
        server, status = self.action_server, self.current_goal.get_goal_status()
        message = server.ActionFeedback(status=status, feedback=feedback)
        message.header.stamp = stamp
        with server.lock:
            if not rospy.is_shutdown():
                server.feedback_pub.publish(message)

    def end(self, status: int, result: Optional[Any] = None, text: str = "") -> None:
        """End the goal that is pursued, with one of these three states, and a text for people."""
        ends = {
            GoalStatus.SUCCEEDED: self.set_succeeded,
            GoalStatus.PREEMPTED: self.set_preempted,
            GoalStatus.ABORTED: self.set_aborted,
        }
        ends[status](result, text)

    def forget_cancels(self) -> None:
        """Take goals from before the last cancellation as well: time was set back."""
        self.action_server.last_cancel = rospy.Time()

    def internal_goal_callback(self, goal: ServerGoalHandle) -> None:
        """Take a goal, whatever its stamp; called by actionlib."""
        with self.lock:
            for earlier in (self.current_goal, self.next_goal):
                if earlier.get_goal():
                    goal_id = earlier.get_goal_id()
                    goal_id.stamp = min(goal_id.stamp, goal.get_goal_id().stamp)
        super().internal_goal_callback(goal)
        if in_lock_step():
            # actionlib itself answers as ROS time passes, and that may stand meanwhile.
            self.action_server.publish_status()

    def _cancel(self, goal_id: GoalID) -> None:
        """Cancel goals, as actionlib does.

        It remembers the cancellation of a goal that has not come yet without a goal, and logs an
        error for it at each later cancellation: such an entry gets an empty goal.
        """
        server = self.action_server
        with server.lock:
            ActionServer.internal_cancel_callback(server, goal_id)
            for tracker in server.status_list:
                tracker.goal = tracker.goal or server.ActionGoal()

    def _preempt(self) -> None:
        if not self.is_new_goal_available():
            self._on_cancel()
