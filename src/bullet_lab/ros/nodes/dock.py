"""Drives a robot into a dock and out of it, on request.

:ROS Parameters: see `DockParameters`.
:ROS Actions:
    - dock (bullet_lab/DockAction): drive into a dock
    - undock (bullet_lab/UndockAction): drive out of it
    A new goal of either replaces the one before.
:ROS Publishers:
    - cmd_vel (geometry_msgs/Twist), or the topic ~cmd_vel
    - ~dock_pose (geometry_msgs/PoseStamped): pose of the dock in the frame of the odometry
    - ~plan (nav_msgs/Path), latched: the planned path
    - ~finished (std_msgs/Time), latched: when the last goal ended
    - /tf: the frame of the dock in that of the odometry
:ROS Subscribers, while there is a goal (in lock step: always):
    - odom (nav_msgs/Odometry), or the topic ~odom
    - aruco/detections (bullet_lab/MarkerDetectionArray), or the topic ~detections
    - mycamera/camera_info (sensor_msgs/CameraInfo), or the topic ~camera_info
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any, Callable, NamedTuple

import rospy
import tf2_ros
from actionlib import ServerGoalHandle
from geometry_msgs.msg import PoseStamped, Transform, TransformStamped, Twist, Vector3
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header, Time

from bullet_lab.core.parameters import ParameterError, integer, number, text
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.docking.database import (
    Dock,
    DockTolerance,
    UnknownDockError,
    find_dock,
    read_docks,
)
from bullet_lab.docking.task import DockingTask, UndockingTask
from bullet_lab.docking.types import (
    CameraMount,
    DockingError,
    DockingResult,
    DockingSettings,
    DockingStatus,
    Observation,
    PlanarPose,
)
from bullet_lab.errors import LabError
from bullet_lab.msg import (
    DockAction,
    DockGoal,
    MarkerDetectionArray,
    UndockAction,
    UndockGoal,
)
from bullet_lab.ros.messages.poses import InputError, stamped_pose
from bullet_lab.ros.node.driving import GoalServer, StoppableSender
from bullet_lab.ros.node.lock_step import rate
from bullet_lab.ros.node.node import node
from bullet_lab.ros.node.odometry import FrameError, FrameFinder, MessageQueue, own_frame
from bullet_lab.ros.node.publishers import Publisher, publisher
from bullet_lab.ros.nodes.dock_messages import (
    GoalError,
    NotYetError,
    camera_of,
    check_dock_goal,
    check_undock_goal,
    dock_feedback,
    dock_result,
    mount_of,
    odometry_of,
    rough_pose,
    sightings_of,
    status_of,
    undock_feedback,
    undock_result,
)
from bullet_lab.simulation.world.resources import ResourceFinder

USUAL = DockingSettings()


@dataclass(frozen=True)
class DockParameters:
    """Private parameters of dock."""

    docks: str = text(
        "package://bullet_lab/config/docks.yaml", "dock database: a path or package://"
    )
    dock: str = text("dock", "dock of the database for goals that have only a pose")
    odom: str = text("odom", "topic of the odometry, perfect or noisy")
    cmd_vel: str = text("cmd_vel", "topic of the commands")
    detections: str = text("aruco/detections", "topic of the detected markers")
    camera_info: str = text("mycamera/camera_info", "topic of the camera's calibration")
    base_frame: str = text("base_footprint", "frame of the robot on the floor")
    dock_frame: str = text("dock", "frame of the dock on TF; empty: not published")
    rate: float = number(
        20.0, "commands per simulated second", minimum=10.0, maximum=100.0
    )
    odom_rate: float = number(
        20.0, "lock step: messages of odometry per second", above=0.0, maximum=1000.0
    )
    image_rate: float = number(
        30.0, "lock step: images per second", above=0.0, maximum=1000.0
    )
    patience: float = number(
        3.0, "s to wait for odometry, camera and transforms at the start", above=0.0
    )
    time_limit: float = number(USUAL.time_limit, "s for a docking", above=0.0)
    max_retries: int = integer(
        USUAL.max_retries, "how often to retreat and try again", minimum=0, maximum=1000
    )
    drive_speed: float = number(
        USUAL.drive_speed, "m/s, far from the dock", above=0.0, maximum=1.0
    )
    approach_speed: float = number(
        USUAL.approach_speed, "m/s on the dock's axis", above=0.0, maximum=1.0
    )
    turn_speed: float = number(
        USUAL.turn_speed, "rad/s on the spot", above=0.0, maximum=2.0
    )
    tolerance_distance: float = number(
        0.0, "m, of the docked pose along the axis; 0: that of the database", minimum=0.0
    )
    tolerance_lateral: float = number(
        0.0, "m, across the axis; 0: that of the database", minimum=0.0
    )
    tolerance_yaw: float = number(
        0.0, "rad, of the yaw; 0: that of the database", minimum=0.0
    )
    seed: int = integer(0, "of the random draws of docking", minimum=0)

    def settings(self) -> DockingSettings:
        """Return the settings of docking."""
        names = ("time_limit", "max_retries", "drive_speed", "approach_speed", "turn_speed")
        return replace(USUAL, **{name: getattr(self, name) for name in names})

    def database(self) -> dict[str, Dock]:
        """Return the docks, with the frames and tolerances of this node.

        Raises:
            ParameterError: they cannot be read, or ~dock is not one of them.
        """
        try:
            docks = read_docks(ResourceFinder.anywhere().find(self.docks))
        except LabError as error:
            raise ParameterError(f"~docks: {error}") from error
        if self.dock not in docks:
            known = ", ".join(sorted(docks))
            raise ParameterError(f"~dock is '{self.dock}': it must be one of {known}")
        tolerances = (self.tolerance_distance, self.tolerance_lateral, self.tolerance_yaw)
        for name, dock in docks.items():
            own = replace(dock, frame=own_frame(dock.frame))
            docks[name] = with_tolerances(own, *tolerances)
        return docks


def with_tolerances(dock: Dock, *tolerances: float) -> Dock:
    """Return a dock with other tolerances (m along its axis, m across, rad); 0 changes nothing."""
    pairs = zip(tolerances, astuple(dock.tolerance))
    return replace(dock, tolerance=DockTolerance(*(given or own for given, own in pairs)))


class DockTopics:
    """Publishes ~dock_pose, ~plan and, on /tf, the frame of the dock.

    Args:
        child: name of the dock's frame on TF; empty for none.
    """

    def __init__(self, child: str):
        self._child = child
        self._pose = Publisher("~dock_pose", PoseStamped, queue_size=10)
        self._plan = Publisher("~plan", Path, queue_size=1, latch=True)
        self._tf = tf2_ros.TransformBroadcaster() if child else None
        self._shown: Any = None

    def publish(self, stamp: rospy.Time, frame: str, status: DockingStatus) -> None:
        """Publish the pose of the dock, if it is known, and the planned path if it has changed."""
        if status.dock_pose is not None:
            message = stamped_pose(stamp, frame, status.dock_pose)
            self._pose.publish(message)
            if self._tf is not None:
                self._tf.sendTransform(self._transform(message))
        if status.plan != self._shown:
            self._shown = status.plan
            poses = [stamped_pose(stamp, frame, (x, y, 0.0)) for x, y in status.plan]
            self._plan.publish(Path(Header(0, stamp, frame), poses))

    def _transform(self, pose: PoseStamped) -> TransformStamped:
        place = Vector3(pose.pose.position.x, pose.pose.position.y, 0.0)
        transform = Transform(place, pose.pose.orientation)
        return TransformStamped(pose.header, self._child, transform)


class Action(NamedTuple):
    """One of the two actions of the node.

    Attributes:
        server: of the action.
        needs_camera: whether a task needs the pose of the camera.
        check: raises GoalError for an invalid goal.
        make_task: returns the task for a goal and a camera, or raises GoalError.
        feedback: returns the action's feedback for a task.
        result: returns the action's result.
    """

    server: GoalServer
    needs_camera: bool
    check: Callable[[Any], None]
    make_task: Callable[[Any, CameraMount | None], DockingTask | UndockingTask]
    feedback: Callable[[Any], Any]
    result: Callable[[DockingResult], Any]


def _queue(topic: str, kind: type, read: Callable[[Any], Any], rate: float) -> MessageQueue:
    """Return a queue of the messages of a topic, each as its header and its content."""
    return MessageQueue(topic, kind, lambda message: (message.header, read(message)), rate)


class DockNode:
    """Pursues one goal of the two actions at a time.

    Goals and cancellations come in threads of actionlib, where they only stop the robot; the loop
    starts and ends them.
    """

    def __init__(self, parameters: DockParameters):
        self._parameters = parameters
        self._docks = parameters.database()
        self._settings = parameters.settings()
        self._base_frame = own_frame(parameters.base_frame)
        self._odometry = _queue(parameters.odom, OdometryMessage, odometry_of, parameters.odom_rate)
        self._camera_info = _queue(
            parameters.camera_info, CameraInfo, camera_of, parameters.image_rate
        )
        self._detections = _queue(
            parameters.detections, MarkerDetectionArray, sightings_of, parameters.image_rate
        )
        self._queues = (self._odometry, self._camera_info, self._detections)
        self._commands = publisher(parameters.cmd_vel, Twist)
        self._sender = StoppableSender(self._commands)
        rospy.on_shutdown(self._sender.end)
        self._finished = publisher("~finished", Time, latch=True)
        self._topics = DockTopics(own_frame(parameters.dock_frame))
        self._frames = FrameFinder()
        self._frame = ""
        # The frame of the camera, and its calibration.
        self._camera: tuple[str, PinholeCamera] | None = None
        self._last_dock: PlanarPose | None = None
        # The action whose goal is pursued, the goal, and the task once its messages have come.
        self._action: Action | None = None
        self._goal: Any = None
        self._task: Any = None
        self._begun = 0.0
        callbacks = (self._stop_for_new_goal, self._sender.stop)
        docking = GoalServer("dock", DockAction, *callbacks)
        undocking = GoalServer("undock", UndockAction, *callbacks)
        self._actions = (
            Action(docking, True, check_dock_goal, self._docking, dock_feedback, dock_result),
            Action(
                undocking, False, check_undock_goal, self._undocking, undock_feedback, undock_result
            ),
        )

    def run(self) -> None:
        """Serve until ROS shuts down."""
        ticks = rate(self._parameters.rate, self._is_connected, "odometry, camera and the bridge")
        for action in self._actions:
            action.server.start()
        last = ticks.now
        while not rospy.is_shutdown():
            ticks.sleep()
            if ticks.now < last:
                self._time_was_set_back()
            last = ticks.now
            self._tick(ticks.now)

    def _is_connected(self) -> bool:
        return self._commands.has_connections() and all(
            queue.is_connected() for queue in self._queues
        )

    def _stop_for_new_goal(self, _: ServerGoalHandle) -> None:
        if self._action is not None:
            self._sender.stop()

    # The loop

    def _tick(self, now: rospy.Time) -> None:
        ticket = self._sender.ticket()
        self._handle_requests(now)
        for queue in self._queues:
            queue.wait(now)
        odometry = self._take_odometry(now)
        observations = self._take_observations(now)
        if self._action is None:
            return
        try:
            if self._task is None and not self._start(now):
                return
            for message in odometry:
                self._task.add_odometry(message)
            for observation in observations:
                self._task.add_observation(observation)
            command = self._task.tick(now.to_sec())
        except LabError as error:
            reason = error.error if isinstance(error, GoalError) else DockingError.UNKNOWN
            self._end(now, DockingResult(False, reason, str(error)))
            return
        self._sender.send(command, ticket)
        self._show(now)
        if self._task.result is not None:
            self._end(now, self._task.result)

    def _handle_requests(self, now: rospy.Time) -> None:
        """Accept new goals, the newest last, and end a cancelled goal."""
        new = [one for one in self._actions if one.server.is_new_goal_available()]
        for action in sorted(new, key=lambda one: one.server.next_goal.get_goal_id().stamp):
            self._preempt("replaced by another goal", now)
            self._accept(action, now)
        if self._action is not None and self._action.server.is_cancelled:
            self._preempt("cancelled on request", now)

    def _accept(self, action: Action, now: rospy.Time) -> None:
        self._action = action
        self._goal = action.server.accept_new_goal()
        self._task = None
        self._begun = now.to_sec()
        try:
            action.check(self._goal)
        except GoalError as error:
            self._end(now, DockingResult(False, error.error, str(error)))
            return
        opened = [queue.open() for queue in self._queues]
        if any(opened):
            self._frame, self._camera = "", None

    def _preempt(self, why: str, now: rospy.Time) -> None:
        if self._action is not None:
            self._end(now, DockingResult(False, DockingError.PREEMPTED, why))

    def _take_odometry(self, now: rospy.Time) -> list:
        taken = self._odometry.take(now)
        if taken:
            self._frame = taken[-1][0].frame_id
        return [message for _, message in taken]

    def _take_observations(self, now: rospy.Time) -> list[Observation]:
        cameras = self._camera_info.take(now)
        if cameras:
            header, camera = cameras[-1]
            self._camera = (header.frame_id, camera)
        taken = self._detections.take(now)
        if self._camera is None:
            return []
        camera = self._camera[1]
        return [Observation(header.stamp.to_sec(), camera, seen) for header, seen in taken]

    def _start(self, now: rospy.Time) -> bool:
        """Make the task once its messages have come; raises GoalError after ~patience."""
        may_wait = now.to_sec() - self._begun < self._parameters.patience
        try:
            if not self._frame:
                what = self._odometry.trouble or "no messages"
                raise NotYetError(DockingError.ODOMETRY_LOST, f"{self._odometry.topic}: {what}")
            mount = self._mount(may_wait or self._action.needs_camera)
            self._task = self._action.make_task(self._goal, mount)
        except NotYetError:
            if may_wait:
                return False
            raise
        return True

    def _mount(self, needed: bool) -> CameraMount | None:
        """Return the pose of the camera on the robot; None if it is unknown and not needed."""
        try:
            if self._camera is None:
                what = self._camera_info.trouble or "no messages"
                raise InputError(f"{self._camera_info.topic}: {what}")
            return mount_of(self._lookup(self._base_frame, self._camera[0]))
        except (FrameError, InputError) as error:
            if needed:
                raise NotYetError(DockingError.CAMERA_LOST, str(error)) from None
            return None

    def _docking(self, goal: DockGoal, mount: CameraMount | None) -> DockingTask:
        """Return the task that drives into a dock; raises GoalError."""
        try:
            dock = find_dock(self._docks, goal.dock_id or self._parameters.dock)
        except UnknownDockError as error:
            raise GoalError(DockingError.NOT_IN_DATABASE, str(error)) from None
        return DockingTask(
            dock,
            rough_pose(goal, dock, self._frame, self._lookup),
            mount,
            self._settings,
            search=goal.search,
            max_retries=goal.max_retries,
            seed=self._parameters.seed,
        )

    def _undocking(self, goal: UndockGoal, mount: CameraMount | None) -> UndockingTask:
        """Return the task that drives backwards out of a dock, on its axis if it is visible."""
        dock = self._docks[self._parameters.dock]
        pose = self._last_dock or rough_pose(DockGoal(), dock, self._frame, self._lookup)
        return UndockingTask(
            goal.distance, dock=dock, dock_pose=pose, mount=mount, settings=self._settings
        )

    def _lookup(self, target: str, source: str) -> Pose:
        return self._frames.pose_in(target, source, wait=False)

    def _show(self, now: rospy.Time) -> None:
        self._action.server.tell(self._action.feedback(self._task), now)
        if isinstance(self._task, DockingTask):
            status = self._task.status
            self._topics.publish(now, self._frame, status)
            self._last_dock = status.dock_pose or self._last_dock

    def _end(self, now: rospy.Time, result: DockingResult) -> None:
        """Stop the robot and report the result."""
        action, self._action = self._action, None
        self._sender.stop()
        for queue in self._queues:
            queue.close()
        log = rospy.loginfo if result.success else rospy.logwarn
        log("%s: %s (%s)", action.server.name, result.message, result.error.name)
        action.server.end(status_of(result), action.result(result), result.message)
        self._finished.publish(Time(now))

    def _time_was_set_back(self) -> None:
        for queue in self._queues:
            queue.clear()
        for action in self._actions:
            action.server.forget_cancels()
        self._frames.clear()
        self._last_dock = None
        if self._action is not None:
            message = "simulated time was set back"
            self._end(rospy.Time(0), DockingResult(False, DockingError.UNKNOWN, message))


@node
def dock(parameters: DockParameters) -> None:
    """Run until ROS shuts down."""
    DockNode(parameters).run()
