"""Drives a robot to the goals that it is given, such as by RViz's "2D Nav Goal".

:ROS Parameters: see `DriveToGoalParameters`.
:ROS Subscribers:
    - move_base_simple/goal (geometry_msgs/PoseStamped): where to; takes the place of the one before
    - move_base/cancel (actionlib_msgs/GoalID): stop; an empty message, as actionlib has it, gives
      up whatever goal there is
    - odom (nav_msgs/Odometry), or what ~odom says
:ROS Publishers:
    - cmd_vel (geometry_msgs/Twist), or what ~cmd_vel says
    - ~status (actionlib_msgs/GoalStatus), latched: what has become of the newest goal
    - ~finished (std_msgs/Time), latched: when the last goal came to its end
    - ~current_goal (geometry_msgs/PoseStamped), latched: the goal in the odometry's frame
    - ~remaining (std_msgs/Float64): m to the goal
    - ~markers (visualization_msgs/MarkerArray), ~plan, ~path (nav_msgs/Path), latched: for RViz
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass, fields
from typing import List, Optional, Union

import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import PoseStamped, Twist, Vector3
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import ColorRGBA, Float64, Header, Time
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.drive.goal import (
    LEAST_TOLERANCE,
    STANDSTILL,
    Command,
    DrivePhase,
    GoalDriver,
    GoalLimits,
    PlanarPose,
)
from bullet_lab.errors import LabError
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.commands import StoppableSender
from bullet_lab.ros.node.lock_step import rate
from bullet_lab.ros.node.node import Refusals, private_parameters, run_node
from bullet_lab.ros.node.odometry import OdometryError, planar_pose
from bullet_lab.ros.node.publishers import Publisher, publisher
from bullet_lab.ros.node.transforms import FrameFinder
from bullet_lab.ros.nodes.dock_goals import stamped_pose
from bullet_lab.ros.nodes.dock_inputs import Inbox

USUAL = GoalLimits()


@dataclass(frozen=True)
class DriveToGoalParameters:
    """Private parameters of drive_to_goal."""

    cmd_vel: str = parameters.text("cmd_vel", "topic of the commands")
    odom: str = parameters.text("odom", "topic of the odometry, perfect or noisy")
    speed: float = parameters.number(USUAL.speed, "at most, m/s", above=0.0)
    turn_speed: float = parameters.number(USUAL.turn_speed, "at most, rad/s", above=0.0)
    acceleration: float = parameters.number(USUAL.acceleration, "at most, m/s²", above=0.0)
    turn_acceleration: float = parameters.number(
        USUAL.turn_acceleration, "at most, rad/s²", above=0.0
    )
    gain: float = parameters.number(USUAL.gain, "m/s for each m to the goal", above=0.0)
    turn_gain: float = parameters.number(USUAL.turn_gain, "rad/s for each rad", above=0.0)
    tolerance: float = parameters.number(
        USUAL.tolerance, "m from the goal to stop within", minimum=LEAST_TOLERANCE
    )
    yaw_tolerance: float = parameters.number(
        USUAL.yaw_tolerance, "rad from its heading to stop within", minimum=LEAST_TOLERANCE
    )
    heading: bool = parameters.boolean(True, "turn to the goal's heading at the end")
    rate: float = parameters.number(20.0, "commands per second", minimum=5.0, maximum=100.0)
    odom_rate: float = parameters.number(
        20.0, "lock step: messages of odometry per second", above=0.0, maximum=1000.0
    )
    stale: float = parameters.number(
        0.5, "s without odometry after which the robot is stopped", above=0.0
    )
    patience: float = parameters.number(
        5.0, "s without odometry after which the goal is given up", above=0.0
    )

    def limits(self) -> GoalLimits:
        """Return how fast and how exactly to drive."""
        names = (field.name for field in fields(GoalLimits))
        return GoalLimits(**{name: getattr(self, name) for name in names})


# Of the path that was driven: m between two points, and how many are kept.
PATH_STEP = 0.02
MOST_POINTS = 5000
# Messages for RViz per tick of the driver.
SHOW_EVERY = 4
COLOURS = {
    GoalStatus.ACTIVE: ColorRGBA(0.0, 0.45, 0.7, 0.9),
    GoalStatus.SUCCEEDED: ColorRGBA(0.0, 0.62, 0.45, 0.9),
}
GIVEN_UP = ColorRGBA(0.84, 0.37, 0.0, 0.9)


class GoalTopics:
    """Publishes what becomes of goals: for machines at once, for RViz some times a second."""

    def __init__(self):
        self._status = publisher("~status", GoalStatus, latch=True)
        self._finished = publisher("~finished", Time, latch=True)
        self._goal = publisher("~current_goal", PoseStamped, latch=True)
        self._remaining = Publisher("~remaining", Float64, queue_size=10)
        self._markers = Publisher("~markers", MarkerArray, queue_size=1, latch=True)
        self._plan = Publisher("~plan", Path, queue_size=1, latch=True)
        self._path = Publisher("~path", Path, queue_size=1, latch=True)
        self._driven: List[PoseStamped] = []
        self._ticks = 0

    def say(self, goal_id: GoalID, status: int, text: str) -> None:
        """Tell what has become of a goal; `status` is one of actionlib's."""
        self._status.publish(GoalStatus(goal_id, status, text))

    def begin(self, stamp: rospy.Time, frame: str, goal: PlanarPose) -> None:
        """Tell which goal is driven to."""
        self._goal.publish(stamped_pose(stamp, frame, goal))
        self._driven = []
        self._ticks = 0

    def progress(
        self, stamp: rospy.Time, frame: str, pose: PlanarPose, goal: PlanarPose, tolerance: float
    ) -> None:
        """Tell how far it is, and show it now and then."""
        left = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        self._remaining.publish(Float64(left))
        self._note(stamped_pose(stamp, frame, pose))
        if self._ticks % SHOW_EVERY == 0:
            self._show(stamp, frame, goal, tolerance, GoalStatus.ACTIVE, left, pose)
        self._ticks += 1

    def end(
        self,
        stamp: rospy.Time,
        frame: str,
        goal: PlanarPose,
        tolerance: float,
        status: int,
        pose: Optional[PlanarPose],
    ) -> None:
        """Show how it ended and tell when."""
        left = math.nan
        if pose is not None:
            left = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
            self._remaining.publish(Float64(left))
        self._show(stamp, frame, goal, tolerance, status, left, None)
        self._finished.publish(Time(stamp))

    def _note(self, place: PoseStamped) -> None:
        if self._driven:
            last, new = self._driven[-1].pose.position, place.pose.position
            if math.hypot(new.x - last.x, new.y - last.y) < PATH_STEP:
                return
        self._driven.append(place)
        del self._driven[:-MOST_POINTS]

    def _show(
        self,
        stamp: rospy.Time,
        frame: str,
        goal: PlanarPose,
        tolerance: float,
        status: int,
        left: float,
        pose: Optional[PlanarPose],
    ) -> None:
        header = Header(0, stamp, frame)
        ahead = [] if pose is None else [stamped_pose(stamp, frame, p) for p in (pose, goal)]
        self._plan.publish(Path(header, ahead))
        self._path.publish(Path(header, list(self._driven)))
        colour = COLOURS.get(status, GIVEN_UP)
        # Not frame_locked: odometry frames stand still.
        self._markers.publish(MarkerArray(goal_markers(header, goal, tolerance, colour, left)))


def goal_markers(
    header: Header, goal: PlanarPose, tolerance: float, colour: ColorRGBA, left: float
) -> List[Marker]:
    """Return an arrow at the goal, its tolerance as a disc and what is left as a label.

    Args:
        header: stamp and frame.
        goal: m, m, rad.
        tolerance: m.
        colour: of arrow and disc.
        left: m to the goal; NaN for unknown.
    """
    pose = stamped_pose(header.stamp, header.frame_id, goal).pose
    arrow = Marker(header=header, ns="goal", id=0, type=Marker.ARROW, color=colour)
    arrow.scale = Vector3(0.4, 0.05, 0.05)
    disc = Marker(header=header, ns="goal", id=1, type=Marker.CYLINDER, color=colour)
    disc.scale = Vector3(2.0 * tolerance, 2.0 * tolerance, 0.01)
    label = Marker(header=header, ns="goal", id=2, type=Marker.TEXT_VIEW_FACING)
    label.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
    label.scale.z = 0.2
    label.text = "" if math.isnan(left) else f"{left:.2f} m"
    for marker in (arrow, disc, label):
        marker.pose.position.x, marker.pose.position.y = goal[:2]
        marker.pose.orientation = pose.orientation
    arrow.pose.position.z, label.pose.position.z = 0.1, 0.4
    # RViz complains of a label without text.
    return [arrow, disc, label] if label.text else [arrow, disc]


GOAL, CANCEL = "move_base_simple/goal", "move_base/cancel"
# Wall seconds that a goal waits for the first odometry, which names the frame.
ODOMETRY_PATIENCE = 5.0
POLL_SECONDS = 0.02


@dataclass(frozen=True)
class _Request:
    """A goal that is to be taken up, in the odometry's frame."""

    goal_id: GoalID
    frame: str
    goal: PlanarPose


class DriveToGoal:
    """Pursues one goal at a time.

    Goals and cancellations come in threads of rospy; they are noted there, and the loop does
    the rest. Only stopping is not left to the loop.
    """

    def __init__(self, wanted: DriveToGoalParameters):
        self._wanted = wanted
        self._limits = wanted.limits()
        self._commands = publisher(wanted.cmd_vel, Twist)
        self._sender = StoppableSender(self._commands)
        rospy.on_shutdown(self._sender.end)
        self._topics = GoalTopics()
        self._refusals = Refusals()
        self._frames = FrameFinder()
        self._frame = ""
        self._pose: Optional[PlanarPose] = None
        self._seen = rospy.Time(0)
        self._waiting = False
        self._noted = threading.Lock()
        self._events: List[Union[_Request, GoalID]] = []
        self._request: Optional[_Request] = None
        self._driver: Optional[GoalDriver] = None
        self._numbers = 0
        self._odometry: Inbox = Inbox(wanted.odom, Odometry, _read_odometry, wanted.odom_rate)
        self._odometry.open()
        self._subscribers = [
            rospy.Subscriber(CANCEL, GoalID, self._receive_cancel),
            rospy.Subscriber(GOAL, PoseStamped, self._receive_goal, queue_size=10),
        ]

    def run(self) -> None:
        """Serve until ROS shuts down."""
        ticks = rate(self._wanted.rate, self._is_connected, "odometry and the bridge")
        last = ticks.now
        while not rospy.is_shutdown():
            ticks.sleep()
            if ticks.now < last:
                self._time_was_set_back()
                last = ticks.now
            self._tick(ticks.now, (ticks.now - last).to_sec())
            last = ticks.now

    def _is_connected(self) -> bool:
        return self._commands.has_connections() and self._odometry.is_connected()

    # From rospy's threads

    def _receive_goal(self, message: PoseStamped) -> None:
        try:
            frame = self._await_frame()
            goal = self._frames.planar(message, frame)
        except LabError as error:
            self._refuse(message, str(error))
            return
        with self._noted:
            request = _Request(self._make_id(message), frame, goal)
            self._topics.say(request.goal_id, GoalStatus.PENDING, "taken up at the next tick")
            self._events.append(request)

    def _receive_cancel(self, message: GoalID) -> None:
        with self._noted:
            self._events.append(message)
            concerned = self._request is not None and _concerns(message, self._request.goal_id)
        if concerned:
            self._sender.stop()

    def _await_frame(self) -> str:
        """Return the frame of the odometry; raises OdometryError if none comes."""
        deadline = time.monotonic() + ODOMETRY_PATIENCE
        while not self._frame:
            if time.monotonic() > deadline or rospy.is_shutdown():
                what = self._odometry.trouble or "nothing comes"
                raise OdometryError(f"no odometry on {self._wanted.odom}: {what}")
            time.sleep(POLL_SECONDS)
        return self._frame

    def _refuse(self, message: PoseStamped, why: str) -> None:
        self._refusals.refuse(GOAL, why)
        with self._noted:
            self._topics.say(self._make_id(message), GoalStatus.REJECTED, f"refused: {why}")
            if self._request is not None:
                # What is latched is about the goal that is still driven to.
                self._topics.say(self._request.goal_id, GoalStatus.ACTIVE, "driving")

    def _make_id(self, message: PoseStamped) -> GoalID:
        self._numbers += 1
        stamp = message.header.stamp
        return GoalID(stamp, f"{rospy.get_name()}-{self._numbers}-{stamp.to_sec():.3f}")

    # The loop

    def _tick(self, now: rospy.Time, seconds: float) -> None:
        ticket = self._sender.ticket()
        self._take_up_requests(now)
        self._odometry.wait(now)
        self._take_odometry(now)
        if self._driver is None or not self._knows_where_it_is(now):
            return
        command = self._driver.command(self._pose, seconds)
        self._sender.send(command, ticket)
        request = self._request
        self._topics.progress(now, request.frame, self._pose, request.goal, self._limits.tolerance)
        if self._driver.phase is DrivePhase.ARRIVED:
            left = self._driver.distance(self._pose)
            turn = math.degrees(self._driver.turn_left(self._pose))
            text = f"there, {left:.3f} m and {abs(turn):.1f} degrees from the goal"
            self._end(now, GoalStatus.SUCCEEDED, text)

    def _take_up_requests(self, now: rospy.Time) -> None:
        with self._noted:
            events, self._events = self._events, []
        for event in events:
            if isinstance(event, _Request):
                self._take_up(event, now)
            elif self._request is not None and _concerns(event, self._request.goal_id):
                self._end(now, GoalStatus.PREEMPTED, "given up on request")

    def _take_up(self, request: _Request, now: rospy.Time) -> None:
        moving = STANDSTILL if self._driver is None else self._driver.moving
        if self._request is not None:
            self._end(now, GoalStatus.PREEMPTED, "another goal has taken its place", stop=False)
        self._begin(now, request, moving)

    def _begin(self, now: rospy.Time, request: _Request, moving: Command) -> None:
        with self._noted:
            self._request = request
            self._topics.say(request.goal_id, GoalStatus.ACTIVE, "driving")
        self._driver = GoalDriver(request.goal, self._limits, moving)
        # Odometry may have paused while nobody asked for it.
        self._seen = now
        self._waiting = False
        x, y, yaw = request.goal
        rospy.loginfo("driving to (%.2f, %.2f) m, %.0f degrees", x, y, math.degrees(yaw))
        self._topics.begin(now, request.frame, request.goal)

    def _take_odometry(self, now: rospy.Time) -> None:
        taken = self._odometry.take(now)
        if taken:
            self._frame, self._pose = taken[-1]
            self._seen = now
            if self._waiting:
                self._waiting = False
                rospy.loginfo("odometry is back")

    def _knows_where_it_is(self, now: rospy.Time) -> bool:
        """Return whether there is fresh odometry; stop the robot, or give up, where not."""
        silence = (now - self._seen).to_sec()
        if self._pose is not None and silence <= self._wanted.stale:
            return True
        if silence > self._wanted.patience:
            line = f"no odometry on {self._wanted.odom} for {self._wanted.patience:g} s"
            self._end(now, GoalStatus.ABORTED, line)
        elif not self._waiting and silence > self._wanted.stale:
            self._waiting = True
            self._sender.stop()
            self._driver.stopped()
            rospy.logwarn("no odometry on %s: the robot is stopped", self._wanted.odom)
        return False

    def _end(self, now: rospy.Time, status: int, text: str, stop: bool = True) -> None:
        """Stop, and tell how it ended."""
        with self._noted:
            request, self._request = self._request, None
        self._driver = None
        if stop:
            self._sender.stop()
        say = rospy.loginfo if status == GoalStatus.SUCCEEDED else rospy.logwarn
        say("%s", text)
        self._topics.say(request.goal_id, status, text)
        tolerance = self._limits.tolerance
        self._topics.end(now, request.frame, request.goal, tolerance, status, self._pose)

    def _time_was_set_back(self) -> None:
        self._odometry.clear()
        self._frames.clear()
        self._pose, self._seen = None, rospy.Time(0)
        if self._request is not None:
            self._end(rospy.Time(0), GoalStatus.ABORTED, "simulated time was set back")


def _read_odometry(message: Odometry) -> tuple:
    frame = message.header.frame_id.lstrip("/")
    if not frame:
        raise OdometryError("it has no frame_id")
    return frame, planar_pose(message)


def _concerns(cancel: GoalID, goal_id: GoalID) -> bool:
    """Return whether a cancellation is about a goal, by the rules of actionlib."""
    if not cancel.id and cancel.stamp.is_zero():
        return True
    if cancel.id == goal_id.id:
        return True
    return not cancel.stamp.is_zero() and goal_id.stamp <= cancel.stamp


def main() -> None:
    """Run the node."""
    run_node("drive_to_goal", lambda: DriveToGoal(private_parameters(DriveToGoalParameters)).run())
