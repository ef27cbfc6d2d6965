"""Commands and goals that come from the page, on the topics of the robot that is chosen there."""

from __future__ import annotations

import threading
from typing import Collection, Dict, Optional, Tuple

from geometry_msgs.msg import PoseStamped, Twist
from move_base_msgs.msg import MoveBaseActionGoal

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.publishers import COMMAND_TIMEOUT, Publisher
from bullet_lab.ros.view.panel import TabControls
from bullet_lab.view.pad import HOLD, STILL, Shares

# The bridge stops what a command of ours drives unless the next one comes within this time.
HEADERS = {Twist: {COMMAND_TIMEOUT: str(HOLD)}}
SIMPLE_GOAL, ACTION_GOAL = "move_base_simple/goal", "move_base/goal"


class Driver:
    """Publishes commands and goals, each on the topic that is chosen on the tab that drives."""

    def __init__(self) -> None:
        self._publishers: Dict[Tuple[str, type], Publisher] = {}
        self._driven = ""
        self._lock = threading.Lock()

    def drive(self, controls: Optional[TabControls], shares: Shares) -> None:
        """Drive with shares of a tab's full speeds, on its topic; from any thread.

        Without controls, as the tab is closed, what was driven is stopped.
        """
        with self._lock:
            topic = "" if controls is None or shares == STILL else controls.drive_topic
            if self._driven and self._driven != topic:
                self._publisher(self._driven, Twist).publish(Twist())
            self._driven = topic
            if topic:
                twist = Twist()
                twist.linear.x = shares[0] * controls.full_speed
                twist.angular.z = shares[1] * controls.full_turn_rate
                self._publisher(topic, Twist).publish(twist)

    def stop(self) -> None:
        """Have the robot stand still that is driven, if one is."""
        self.drive(None, STILL)

    def send_goal(self, drive_topic: str, heard: Collection[str], frame: str, pose: Pose) -> str:
        """Send a goal to who listens beside a robot's drive; return what became of it."""
        namespace = drive_topic.rpartition("/")[0]
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

    def _publisher(self, topic: str, kind: type) -> Publisher:
        key = (topic, kind)
        if key not in self._publishers:
            # Latched: who listens is connected a moment later.
            self._publishers[key] = Publisher(
                topic, kind, queue_size=10, latch=kind is not Twist, headers=HEADERS.get(kind)
            )
        return self._publishers[key]
