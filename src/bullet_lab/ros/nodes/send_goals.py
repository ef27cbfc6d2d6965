"""A client of move_base that sends goals drawn by a seed, and puts boxes in the way of some.

:ROS Parameters: see `SendGoalsParameters`
:ROS Actions: calls move_base (move_base_msgs/MoveBaseAction)
:ROS Publishers:
    - ~boxes (geometry_msgs/PoseStamped): each box, when it is put there
    - ~finished (std_msgs/Time), latched: when the last goal has ended
:ROS Service clients: /gazebo/spawn_sdf_model, /gazebo/delete_model
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

import numpy as np
import rospy
from actionlib import CommState, SimpleActionClient
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from std_msgs.msg import Time

from bullet_lab.core.parameters import integer, number, text
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.navigation.occupancy import FREE, RobotCostmap, read_map
from bullet_lab.navigation.paths import Point, points_of
from bullet_lab.reports.goal import BOX
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import pose_message, stamped_pose
from bullet_lab.ros.node.lock_step import Rate, publisher
from bullet_lab.ros.node.node import NodeError, holds_within, node, spin

# Looks per simulated second at whether a goal has ended, and wall seconds for its result to come.
RATE, ARRIVAL = 1.0, 0.01
# Wall seconds for the server to accept or refuse a goal.
ACCEPTANCE = 2.0
# m between a goal and the one before, at least.
LEAST_WAY = 1.0
# m between a box and both ends of the way, at least.
LEAST_ROOM = 0.9
MOST_DRAWS = 10_000
# Of the robot on the map.
START: PlanarPose = (0.0, 0.0, 0.0)
NAME = "unknown_box"
MODEL = f"""<sdf version="1.6"><model name="{NAME}"><static>true</static><link name="link">
<collision name="box"><geometry><box><size>{BOX} {BOX} {BOX}</size></box></geometry></collision>
<visual name="box"><geometry><box><size>{BOX} {BOX} {BOX}</size></box></geometry></visual>
</link></model></sdf>"""


@dataclass(frozen=True)
class SendGoalsParameters:
    """Private parameters of send_goals."""

    map: str = text("", "YAML file of the map")
    frame: str = text("map", "its frame")
    goals: int = integer(20, "how many", minimum=1)
    box_every: int = integer(2, "put a box in the way of each so many-th goal; 0: none", minimum=0)
    seed: int = integer(1, "of the goals", minimum=0)
    radius: float = number(0.25, "m, of the robot, as of drive_to_goal", above=0.0)


def draw_goal(costmap: RobotCostmap, robot: PlanarPose, random: np.random.Generator) -> PlanarPose:
    """Return a pose on known free floor to which there is a way; raises NodeError."""
    known = costmap.map
    rows, columns = np.nonzero(known.cells == FREE)
    for _ in range(MOST_DRAWS if len(rows) else 0):
        cell = int(random.integers(len(rows)))
        place = np.array([columns[cell], rows[cell]]) + random.uniform(0.0, 1.0, 2)
        x, y = (place * known.resolution + known.origin[:2]).tolist()
        is_far = np.hypot(x - robot[0], y - robot[1]) >= LEAST_WAY
        if is_far and costmap.plan(robot, (x, y)) is not None:
            return x, y, float(random.uniform(-np.pi, np.pi))
    raise NodeError(f"no goal on the map has a way from ({robot[0]:.2f}, {robot[1]:.2f}) m")


def spot_in_the_way(
    costmap: RobotCostmap, robot: Sequence[float], goal: Sequence[float], size: float
) -> Point | None:
    """Return where on its way something (m wide) makes a robot drive another one.

    None if there is no such place with room around start and goal. The costmap is cleared.
    """
    way = costmap.plan(robot, goal)
    if way is None:
        return None
    points, _ = points_of(way, 0.05)
    square = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 12) * size] * 2), axis=-1).reshape(-1, 2)
    for share in (0.5, 0.4, 0.6, 0.3, 0.7):
        spot = points[int(share * len(points))]
        if min(math.dist(spot, way[0]), math.dist(spot, way[-1])) > LEAST_ROOM:
            costmap.mark(spot + square)
            other = costmap.plan(robot, goal)
            costmap.clear()
            if other is not None:
                return tuple(spot.tolist())
    return None


class GoalSender:
    """Sends one goal after the other, and waits for each."""

    def __init__(self, parameters: SendGoalsParameters):
        self._parameters = parameters
        self._boxes = publisher("~boxes", PoseStamped)
        self._finished = publisher("~finished", Time, latch=True)
        self._client = SimpleActionClient("move_base", MoveBaseAction)
        self._frame = parameters.frame
        self._costmap = RobotCostmap(read_map(Path(parameters.map)), parameters.radius)
        self._random = np.random.default_rng(parameters.seed)

    def run(self) -> None:
        """Send all goals."""
        parameters, robot, reached = self._parameters, START, 0
        self._ticks = Rate(RATE, self._is_connected, "move_base")
        self._ticks.sleep()
        for count in range(1, parameters.goals + 1):
            goal = draw_goal(self._costmap, robot, self._random)
            has_box = parameters.box_every and count % parameters.box_every == 0
            box = spot_in_the_way(self._costmap, robot, goal, BOX) if has_box else None
            if box is not None:
                place = pose_message(Pose((*box, 0.5 * BOX)))
                call("/gazebo/spawn_sdf_model", srv.SpawnModel, NAME, MODEL, "", place, "")
                self._boxes.publish(stamped_pose(self._ticks.now, self._frame, (*box, 0.0)))
            status = self._drive(goal)
            self._client.stop_tracking_goal()
            if box is not None:
                call("/gazebo/delete_model", srv.DeleteModel, NAME)
            reached += status == GoalStatus.SUCCEEDED
            log = rospy.loginfo if status == GoalStatus.SUCCEEDED else rospy.logwarn
            log("goal %d of %d: %s", count, parameters.goals, self._text)
            robot = goal if status == GoalStatus.SUCCEEDED else robot
        self._finished.publish(Time(self._ticks.now))
        rospy.loginfo("%d of %d goals reached", reached, parameters.goals)
        self._ticks.leave()
        spin()

    def _is_connected(self) -> bool:
        ends = self._client.action_client
        return ends.pub_goal.get_num_connections() > 0 < ends.result_sub.get_num_connections()

    def _drive(self, goal: PlanarPose) -> int:
        """Send a goal, wait for its end, and return its status."""
        pose = stamped_pose(self._ticks.now, self._frame, goal)
        self._client.send_goal(MoveBaseGoal(pose))
        # In lock step, time stands still: chance shall not decide when the server begins.
        handle = self._client.gh
        holds_within(lambda: handle.get_comm_state() != CommState.WAITING_FOR_GOAL_ACK, ACCEPTANCE)
        while self._client.get_state() in (GoalStatus.PENDING, GoalStatus.ACTIVE):
            self._ticks.sleep()
            rospy.rostime.wallsleep(ARRIVAL)
        self._text = self._client.get_goal_status_text()
        return self._client.get_state()


@node
def send_goals(parameters: SendGoalsParameters) -> None:
    """Run until ROS shuts down."""
    GoalSender(parameters).run()
