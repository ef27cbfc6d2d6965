"""Drives a robot to goals, as move_base does, such as those of RViz's "2D Nav Goal".

:ROS Parameters: see `DriveToGoalParameters`.
:ROS Actions:
    - move_base (move_base_msgs/MoveBaseAction): drive to a goal. A new goal replaces the one
      before; a goal that cannot be reached is aborted with a reason
:ROS Subscribers:
    - move_base_simple/goal (geometry_msgs/PoseStamped): likewise; an invalid goal is refused, and
      the robot goes on to the one before
    - odom (nav_msgs/Odometry), or the topic ~odom
    - with ~map, those of `map_floor`, whose topics and services the node has as well
:ROS Publishers:
    - cmd_vel (geometry_msgs/Twist), or the topic ~cmd_vel
    - ~status (actionlib_msgs/GoalStatus), latched: status of the newest goal
    - ~finished (std_msgs/Time), latched: when the last goal ended
    - ~current_goal (geometry_msgs/PoseStamped), latched: the goal in the odometry's frame
    - ~remaining (std_msgs/Float64): m to the goal
    - ~markers (visualization_msgs/MarkerArray), ~plan, ~path (nav_msgs/Path), latched: for RViz
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import dataclass

import rospy
from actionlib import GoalIDGenerator, ServerGoalHandle
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import PoseStamped, Quaternion
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseFeedback, MoveBaseGoal
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import ColorRGBA, Float64, Header, Time
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.parameters import number, text
from bullet_lab.core.se2 import PlanarPose, quaternion_from_yaw
from bullet_lab.drive import STANDSTILL, DrivePhase, GoalDriver, GoalLimits
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import marker, stamped_pose
from bullet_lab.ros.node.driving import REPLACED, GoalNode, GoalServer
from bullet_lab.ros.node.lock_step import Publisher, publisher
from bullet_lab.ros.node.node import Refusals, holds_within, node
from bullet_lab.ros.node.odometry import FrameError, MessageQueue, OdometryError, framed
from bullet_lab.ros.nodes.map_floor import Floor, MapParameters, read_place

ACTION = "move_base"
SIMPLE_GOAL = "move_base_simple/goal"
# Wall seconds that a goal waits for the first odometry, which has the frame, and for TF.
PATIENCE = 5.0
# m between two points of the driven path.
PATH_STEP = 0.02
# Points of the driven path that are kept.
MOST_POINTS = 5000
# Messages for RViz are published at every fourth tick.
SHOW_EVERY = 4
COLOURS = {
    GoalStatus.ACTIVE: ColorRGBA(0.0, 0.45, 0.7, 0.9),
    GoalStatus.SUCCEEDED: ColorRGBA(0.0, 0.62, 0.45, 0.9),
}
FAILED = ColorRGBA(0.84, 0.37, 0.0, 0.9)
WHITE = ColorRGBA(1.0, 1.0, 1.0, 1.0)
# The final status of a goal that the robot never drove to.
NOT_BEGUN = {
    GoalStatus.ABORTED: GoalStatus.REJECTED,
    GoalStatus.PREEMPTED: GoalStatus.RECALLED,
}


@dataclass(frozen=True)
class DriveToGoalParameters(MapParameters, GoalLimits):
    """Private parameters of drive_to_goal, with the limits of the drive."""

    cmd_vel: str = text("cmd_vel", "topic of the commands")
    odom: str = text("odom", "topic of the odometry, perfect or noisy")
    rate: float = number(20.0, "commands per second", minimum=5.0, maximum=100.0)
    odom_rate: float = number(
        20.0, "lock step: messages of odometry per second, 1000/51 for planar_move's 20", above=0.0,
        maximum=1000.0,
    )
    stale: float = number(0.5, "s without odometry after which the robot is stopped", above=0.0)
    patience: float = number(5.0, "s without odometry after which the goal is aborted", above=0.0)


class GoalTopics:
    """Publishes the status of goals, and the drive for RViz a few times a second.

    The names of the topics begin with `prefix`.
    """

    def __init__(self, tolerance: float, prefix: str = "~"):
        self._tolerance = tolerance
        self._status = publisher(f"{prefix}status", GoalStatus, latch=True)
        self._finished = publisher(f"{prefix}finished", Time, latch=True)
        self._goal = publisher(f"{prefix}current_goal", PoseStamped, latch=True)
        self._remaining = Publisher(f"{prefix}remaining", Float64, queue_size=10)
        self._markers = Publisher(f"{prefix}markers", MarkerArray, queue_size=1, latch=True)
        self._plan = Publisher(f"{prefix}plan", Path, queue_size=1, latch=True)
        self._path = Publisher(f"{prefix}path", Path, queue_size=1, latch=True)
        self._lock = threading.Lock()
        self._active: GoalStatus | None = None
        self._frame = ""
        self._target: PlanarPose = (0.0, 0.0, 0.0)
        self._driven: deque[PoseStamped] = deque(maxlen=MOST_POINTS)
        self._ticks = 0

    def report(self, goal_id: GoalID, status: int, text: str) -> None:
        """Publish the status of a goal; may be called from any thread."""
        message = GoalStatus(goal_id, status, text)
        with self._lock:
            self._status.publish(message)
            if status == GoalStatus.ACTIVE:
                self._active = message
            elif self._active is not None and self._active.goal_id.id == goal_id.id:
                self._active = None
            elif self._active is not None and status == GoalStatus.REJECTED:
                # The latched status is that of the goal that is still pursued.
                self._status.publish(self._active)

    def begin(self, stamp: rospy.Time, frame: str, goal: PlanarPose) -> None:
        """Publish the goal that is driven to."""
        self._frame = frame
        self._target = goal
        self._goal.publish(stamped_pose(stamp, frame, goal))
        self._driven.clear()
        self._ticks = 0

    def progress(self, stamp: rospy.Time, pose: PlanarPose) -> None:
        """Publish the distance to the goal, and every few ticks the drive."""
        left = self._publish_remaining(pose)
        last = self._driven[-1].pose.position if self._driven else None
        if last is None or math.hypot(pose[0] - last.x, pose[1] - last.y) >= PATH_STEP:
            self._driven.append(stamped_pose(stamp, self._frame, pose))
        if self._ticks % SHOW_EVERY == 0:
            self._show(stamp, GoalStatus.ACTIVE, left, [pose, self._target])
        self._ticks += 1

    def end(self, stamp: rospy.Time, status: int, pose: PlanarPose | None) -> None:
        """Publish the outcome and the time of the end."""
        left = math.nan if pose is None else self._publish_remaining(pose)
        self._show(stamp, status, left, [])
        self._finished.publish(Time(stamp))

    def _publish_remaining(self, pose: PlanarPose) -> float:
        left = math.dist(self._target[:2], pose[:2])
        self._remaining.publish(Float64(left))
        return left

    def _show(self, stamp: rospy.Time, status: int, left: float, ahead: list[PlanarPose]) -> None:
        header = Header(0, stamp, self._frame)
        plan = [stamped_pose(stamp, self._frame, pose) for pose in ahead]
        self._plan.publish(Path(header, plan))
        self._path.publish(Path(header, list(self._driven)))
        # Not frame_locked, as odometry frames do not move.
        self._markers.publish(MarkerArray(self._draw(header, COLOURS.get(status, FAILED), left)))

    def _draw(self, header: Header, colour: ColorRGBA, left: float) -> list[Marker]:
        """Return an arrow at the goal, a disc for its tolerance and a label with the distance."""
        (x, y, yaw), wide = self._target, 2.0 * self._tolerance
        arrow, disc, label = made = [
            marker(header, "goal", kind, its_colour, size, (x, y, height))
            for kind, its_colour, size, height in (
                (Marker.ARROW, colour, (0.4, 0.05, 0.05), 0.1),
                (Marker.CYLINDER, colour, (wide, wide, 0.01), 0.0),
                (Marker.TEXT_VIEW_FACING, WHITE, (0.0, 0.0, 0.2), 0.4),
            )
        ]
        arrow.pose.orientation = Quaternion(*quaternion_from_yaw(yaw))
        label.text = "" if math.isnan(left) else f"{left:.2f} m"
        disc.id, label.id = 1, 2
        # RViz warns of a label without text.
        return made if label.text else [arrow, disc]


class DriveToGoal(GoalNode):
    """Drives to one goal at a time; a cancellation stops the robot at once.

    The names of the topics that are its own begin with `prefix`.
    """

    def __init__(self, parameters: DriveToGoalParameters, prefix: str = "~"):
        self._parameters = parameters
        odometry = MessageQueue(parameters.odom, Odometry, framed(read_place), parameters.odom_rate)
        super().__init__(parameters.cmd_vel, odometry)
        self._floor: Floor | None = None
        if parameters.map:
            self._floor = Floor(parameters, self._frames)
            self._queues += (self._floor.scans,) if self._floor.scans else ()
        self._topics = GoalTopics(parameters.tolerance, prefix)
        self._refusals = Refusals()
        # The newest odometry, when it came, and whether the robot waits for the next one.
        self._pose: PlanarPose | None = None
        self._seen = rospy.Time(0)
        self._waiting = False
        # Wall time until which the goal that was accepted waits for its frame.
        self._deadline = 0.0
        # The command at the end of the goal before.
        self._moving = STANDSTILL
        self._driver: GoalDriver | None = None
        # Goals that have come, but are not accepted yet.
        self._pending: deque[GoalID] = deque()
        self._odometry.open()
        self._servers.append(
            GoalServer(ACTION, MoveBaseAction, self._receive_goal, self._sender.stop)
        )
        self._goals = rospy.Subscriber(
            SIMPLE_GOAL, PoseStamped, self._receive_simple_goal, queue_size=10
        )

    # In threads of rospy

    def _receive_goal(self, handle: ServerGoalHandle) -> None:
        goal_id = handle.get_goal_id()
        self._topics.report(goal_id, GoalStatus.PENDING, "waits for the next tick")
        self._pending.append(goal_id)

    def _receive_simple_goal(self, message: PoseStamped) -> None:
        try:
            # The first message of the odometry has the frame.
            holds_within(self._is_ready, PATIENCE)
            self._frames.planar(message, self._known_frame())
        except LabError as error:
            self._refusals.refuse(SIMPLE_GOAL, str(error))
            goal_id = GoalIDGenerator().generate_ID()
            self._topics.report(goal_id, GoalStatus.REJECTED, f"refused: {error}")
            return
        goal = MoveBaseActionGoal(header=message.header, goal=MoveBaseGoal(message))
        self._servers[0].internal_goal_callback(goal)

    def _is_ready(self) -> bool:
        try:
            return bool(self._known_frame())
        except OdometryError:
            return False

    def _known_frame(self) -> str:
        """Return the frame in which goals are: the map's, or that of the odometry."""
        if not self._frame:
            what = self._odometry.trouble or "no messages"
            raise OdometryError(f"no odometry on {self._parameters.odom}: {what}")
        return self._floor.frame() if self._floor else self._frame

    # The loop

    def _tick(self, now: rospy.Time, seconds: float, ticket: int) -> None:
        odometry = self._take_odometry(now)
        pose = odometry[-1].pose if odometry else None
        if self._floor:
            placed = self._floor.place(odometry, self._frame, now)
            pose = pose and placed
            self._floor.show(now, self._driver)
        if pose is not None:
            self._pose, self._seen = pose, now
            if self._waiting:
                self._waiting = False
                rospy.loginfo("odometry is back")
        if self._driver is None and self._server is not None:
            self._begin(now)
        if self._driver is None or not self._has_fresh_odometry(now):
            return
        self._sender.send(self._driver.command(self._pose, seconds), ticket)
        self._topics.progress(now, self._pose)
        frame = self._known_frame()
        self._server.tell(MoveBaseFeedback(stamped_pose(now, frame, self._pose)), now)
        if self._floor and self._driver.failure:
            self._end(now, GoalStatus.ABORTED, self._driver.failure)
        elif self._driver.phase is DrivePhase.ARRIVED:
            left = self._driver.distance(self._pose)
            turn = math.degrees(self._driver.turn_left(self._pose))
            text = f"there, {left:.3f} m and {abs(turn):.1f} degrees from the goal"
            self._end(now, GoalStatus.SUCCEEDED, text)

    def _replace(self, now: rospy.Time) -> None:
        """End the goal, but not the motion: that of the next goal begins with it."""
        moving = STANDSTILL if self._driver is None else self._driver.moving
        self._end(now, GoalStatus.PREEMPTED, REPLACED, stop=False)
        self._moving = moving

    def _accept(self, now: rospy.Time) -> None:
        accepted = self._server.goal.get_goal_id().id
        while self._pending:
            goal_id = self._pending.popleft()
            if goal_id.id == accepted:
                break
            self._topics.report(goal_id, GoalStatus.RECALLED, REPLACED)
        self._deadline = time.monotonic() + PATIENCE

    def _begin(self, now: rospy.Time) -> None:
        """Start to drive, once the goal is known in the frame of the odometry."""
        try:
            frame = self._known_frame()
            goal = self._frames.planar(self._goal.target_pose, frame, wait=False)
        except LabError as error:
            if self._moving != STANDSTILL:
                # The robot still moves towards the goal before.
                self._moving = STANDSTILL
                self._sender.stop()
            may_wait = isinstance(error, (OdometryError, FrameError))
            if not may_wait or time.monotonic() > self._deadline:
                self._end(now, GoalStatus.ABORTED, str(error))
            return
        make = self._floor.driver if self._floor else GoalDriver
        self._driver = make(goal, self._parameters, self._moving)
        # A pause of the odometry before the goal does not count.
        self._seen = now
        self._waiting = False
        x, y, yaw = goal
        rospy.loginfo("driving to (%.2f, %.2f) m, %.0f degrees", x, y, math.degrees(yaw))
        goal_id = self._server.goal.get_goal_id()
        self._topics.report(goal_id, GoalStatus.ACTIVE, "driving")
        self._topics.begin(now, frame, goal)

    def _has_fresh_odometry(self, now: rospy.Time) -> bool:
        """Return whether the odometry is recent; if not, stop the robot, or abort the goal."""
        odom, patience = self._parameters.odom, self._parameters.patience
        silence = (now - self._seen).to_sec()
        if self._pose is not None and silence <= self._parameters.stale:
            return True
        if silence > patience:
            self._end(now, GoalStatus.ABORTED, f"no odometry on {odom} for {patience:g} s")
        elif not self._waiting and silence > self._parameters.stale:
            self._waiting = True
            self._sender.stop()
            self._driver.moving = STANDSTILL
            rospy.logwarn("no odometry on %s: the robot is stopped", odom)
        return False

    def _end(self, now: rospy.Time, status: int, text: str, stop: bool = True) -> None:
        begun, self._driver, self._moving = self._driver is not None, None, STANDSTILL
        server, self._server = self._server, None
        if stop:
            self._sender.stop()
        log = rospy.loginfo if status == GoalStatus.SUCCEEDED else rospy.logwarn
        log("%s", text)
        goal_id = server.goal.get_goal_id()
        if begun:
            self._topics.report(goal_id, status, text)
            self._topics.end(now, status, self._pose)
        else:
            self._topics.report(goal_id, NOT_BEGUN[status], text)
        server.end(status, text=text)

    def _time_was_set_back(self) -> None:
        self._pose = None
        self._seen = rospy.Time(0)
        if self._floor:
            self._floor.clear()
        super()._time_was_set_back()


@node
def drive_to_goal(parameters: DriveToGoalParameters) -> None:
    """Run until ROS shuts down."""
    DriveToGoal(parameters).run(parameters.rate)
