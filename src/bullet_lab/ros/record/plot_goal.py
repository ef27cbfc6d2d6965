"""Sends a robot to a goal, records how it goes, and leaves what came of it.

:ROS Parameters: see `PlotGoalParameters`.
:ROS Publishers: move_base_simple/goal (geometry_msgs/PoseStamped): the first goal
:ROS Subscribers:
    - odom (nav_msgs/Odometry): the true pose, as the simulation sends it
    - drive_to_goal/current_goal, status, finished: what is driven to, whoever wants it
    - /bullet_lab/world (visualization_msgs/MarkerArray): the beacons

Leaves truth.tum, written row by row, path.png and summary.json.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

import rospy
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Time
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.angles import yaw_from_quaternion
from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports.goal import GoalRecord, goal_figure, goal_figures, greatest_speed, title_of
from bullet_lab.ros.gazebo.client import numbered
from bullet_lab.ros.gazebo.standing_models import TOPIC as WORLD
from bullet_lab.ros.gazebo.standing_models import StandingModels
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.node import NodeError, private_parameters, run_node
from bullet_lab.ros.node.publishers import Publisher
from bullet_lab.ros.nodes.dock_goals import stamped_pose
from bullet_lab.ros.nodes.drive_to_goal import DriveToGoalParameters
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.errand_recorder import ErrandRecorder

# Simulated seconds that are recorded after the end: a robot that should stand, stands.
REST = rospy.Duration(1)


@dataclass(frozen=True)
class PlotGoalParameters:
    """Private parameters of plot_goal."""

    out: str = parameters.text("results/goal", "folder for the files")
    about: Mapping[str, Any] = parameters.mapping(
        "what else summary.json shall say", DriveToGoalParameters, NoisyOdomParameters
    )
    goal: Tuple[float, ...] = parameters.number_list(
        (1.0, 1.0, 0.0), "where to: x y in m, yaw in rad"
    )
    frame: str = parameters.text("world", "frame of the goal")
    tolerance: float = parameters.number(0.05, "m, for the picture", above=0.0)
    stay: bool = parameters.boolean(False, "wait for more goals, such as RViz's, until Ctrl-C")
    lock_step: bool = parameters.boolean(False, "hold simulated time back until the goal is sent")


class PlotGoal(ErrandRecorder):
    """Sends the first goal and records what is driven."""

    def __init__(self, wanted: PlotGoalParameters):
        self._wanted = wanted
        self._folder = make_folder(Path(wanted.out))
        super().__init__(self._folder, wanted.lock_step, "drive_to_goal")
        # What the driver says of its goals, in their order.
        self._poses: List[PoseStamped] = []
        self._ends: List[float] = []
        self._answers: Dict[str, GoalStatus] = {}
        self._refused: List[str] = []
        self._missed = ""
        self._standing = StandingModels()
        self._sender = Publisher("move_base_simple/goal", PoseStamped, queue_size=10)
        self._subscribers = [
            self._listen_to_odometry(),
            rospy.Subscriber("drive_to_goal/current_goal", PoseStamped, self._receive_goal),
            rospy.Subscriber("drive_to_goal/status", GoalStatus, self._receive_status),
            rospy.Subscriber("drive_to_goal/finished", Time, self._receive_finished),
        ]
        self._world = rospy.Subscriber(WORLD, MarkerArray, self._standing.take)

    def _send(self) -> None:
        goal = stamped_pose(rospy.Time.now(), self._wanted.frame, self._wanted.goal)
        self._sender.publish(goal)

    def _is_connected(self) -> bool:
        return super()._is_connected() and self._sender.has_connections()

    def _is_taken(self) -> bool:
        with self._lock:
            return bool(self._answers or self._refused)

    def _is_complete(self) -> bool:
        if self._wanted.stay:
            return False
        with self._lock:
            if self._refused:
                return True
            until = self._until()
            return until is not None and (self._truth.last or 0) >= until

    def _until(self) -> Optional[int]:
        if self._wanted.stay or not self._ends:
            return None
        return rospy.Time.from_sec(self._ends[0]).to_nsec() + REST.to_nsec()

    # What comes in

    def _receive_goal(self, message: PoseStamped) -> None:
        with self._lock:
            self._poses.append(message)

    def _receive_finished(self, message: Time) -> None:
        with self._lock:
            self._ends.append(message.data.to_sec())

    def _receive_status(self, message: GoalStatus) -> None:
        with self._lock:
            if message.status == GoalStatus.REJECTED:
                self._refused.append(message.text)
            else:
                self._answers[message.goal_id.id] = message

    # What is left behind

    def _records(self) -> List[GoalRecord]:
        """Return the goals: the k-th id, pose and end belong together, one goal at a time."""
        records = []
        for index, (message, answer) in enumerate(zip(self._poses, self._answers.values())):
            place, turn = message.pose.position, message.pose.orientation
            goal = (place.x, place.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w))
            record = GoalRecord(goal, message.header.stamp.to_sec())
            if index < len(self._ends):
                record.ended, record.text = self._ends[index], answer.text
                record.reached = answer.status == GoalStatus.SUCCEEDED
            records.append(record)
        return records

    def _write(self) -> None:
        for subscriber in (*self._subscribers, self._world):
            subscriber.unregister()
        with self._lock:
            until = self._until()
            self._truth.finish(until)
            truth = self._truth.until(until)
            records = self._records()
        figures = [goal_figures(record, truth) for record in records]
        title = self._refused[0] if self._refused and not figures else title_of(figures)
        beacons = [
            (name, *self._standing.origin(name)[:2])
            for name in numbered(self._standing.names(), "beacon")
        ]
        picture = goal_figure(truth, records, beacons, self._wanted.tolerance, title)
        save(picture, self._folder / "path.png")
        write_json(self._folder / "summary.json", self._summary(figures, truth))
        missed = bool(self._refused) or any(
            one.ended is not None and not one.reached for one in records
        )
        if missed and not self._wanted.stay:
            self._missed = title
        else:
            rospy.loginfo("%s", title)

    def _judge(self) -> None:
        if self._missed:
            raise NodeError(self._missed)

    def _summary(self, figures: List[Dict[str, Any]], truth: Optional[Trajectory]) -> Dict:
        seconds = 0.0 if truth is None else float(truth.stamps[-1] - truth.stamps[0])
        return {
            **self._wanted.about,
            "finished": bool(figures) and all(one["seconds"] is not None for one in figures),
            "goals": figures,
            "refused_goals": self._refused,
            "greatest_speed_mps": None if truth is None else greatest_speed(truth),
            **self._stopwatch.figures(seconds),
            "refused_messages": self._refusals.total,
        }


def main() -> None:
    """Run the node."""
    run_node("plot_goal", lambda: PlotGoal(private_parameters(PlotGoalParameters)).run())
