"""Commands and goals that come from the page, on the topics of the robot that is chosen there."""

from __future__ import annotations

import threading
from typing import Collection, Dict, Tuple

from geometry_msgs.msg import PoseStamped, Twist
from move_base_msgs.msg import MoveBaseActionGoal

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.view.panel import Panel
from bullet_lab.view.page import STILL, Shares

SIMPLE_GOAL, ACTION_GOAL = "move_base_simple/goal", "move_base/goal"


class Driver:
    """Publishes commands and goals, each on a topic that somebody on the page has chosen."""

    def __init__(self, panel: Panel):
        self._panel = panel
        self._publishers: Dict[Tuple[str, type], Publisher] = {}
        self._driven = ""
        self._lock = threading.Lock()

    def drive(self, shares: Shares) -> None:
        """Drive with shares of the full speeds, on the topic that is chosen; from any thread."""
        with self._lock:
            topic = self._panel.drive_topic
            if self._driven and self._driven != topic:
                self._send(self._driven, STILL)
            self._driven = topic if shares != STILL else ""
            if topic:
                self._send(topic, shares)

    def stop(self) -> None:
        """Have the robot stand still that is driven, if one is."""
        with self._lock:
            if self._driven:
                self._send(self._driven, STILL)
                self._driven = ""

    def send_goal(self, heard: Collection[str], frame: str, pose: Pose) -> str:
        """Send a goal to who listens beside the robot that is chosen; return what became of it."""
        namespace = self._panel.drive_topic.rpartition("/")[0]
        goal = PoseStamped(pose=pose_message(pose))
        goal.header.frame_id = frame
        action = MoveBaseActionGoal(header=goal.header)
        action.goal.target_pose = goal
        for name, message in ((SIMPLE_GOAL, goal), (ACTION_GOAL, action)):
            topic = f"{namespace}/{name}"
            if topic in heard:
                self._publisher(topic, type(message)).publish(message)
                x, y, _ = pose.position
                return f"goal: ({x:.2f}, {y:.2f}) m"
        return f"nobody listens to {namespace}/{SIMPLE_GOAL}"

    def _send(self, topic: str, shares: Shares) -> None:
        forward, left = shares
        twist = Twist()
        twist.linear.x = forward * self._panel.full_speed
        twist.angular.z = left * self._panel.full_turn_rate
        self._publisher(topic, Twist).publish(twist)

    def _publisher(self, topic: str, kind: type) -> Publisher:
        key = (topic, kind)
        if key not in self._publishers:
            # Latched: who listens is connected a moment later.
            self._publishers[key] = Publisher(topic, kind, queue_size=10, latch=kind is not Twist)
        return self._publishers[key]
