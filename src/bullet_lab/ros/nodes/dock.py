"""The node that drives a robot into a dock and out of it again, on request.

:ROS Parameters: see `DockParameters`.
:ROS Actions:
    - dock (bullet_lab/DockAction): drive into a dock
    - undock (bullet_lab/UndockAction): drive out of it
    A new goal of either takes the place of the one before.
:ROS Publishers:
    - cmd_vel (geometry_msgs/Twist), or what ~cmd_vel says
    - ~dock_pose (geometry_msgs/PoseStamped): where the dock is, in the frame of the odometry
    - ~plan (nav_msgs/Path), latched: the way that is planned
    - ~finished (std_msgs/Time), latched: when the last goal came to its end
    - /tf: the frame of the dock in that of the odometry
:ROS Subscribers, while there is a goal (in lock step: always):
    - odom (nav_msgs/Odometry), or what ~odom says
    - aruco/detections (bullet_lab/MarkerDetectionArray), or what ~detections says
    - mycamera/camera_info (sensor_msgs/CameraInfo), or what ~camera_info says
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import rospy
import tf2_ros
from actionlib import ServerGoalHandle
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped, TransformStamped, Twist
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Time

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.docking.database import Dock, read_docks
from bullet_lab.docking.task import DockingTask, UndockingTask
from bullet_lab.docking.types import (
    CameraMount,
    DockingError,
    DockingResult,
    DockingSettings,
    Observation,
    PlanarPose,
)
from bullet_lab.errors import LabError
from bullet_lab.msg import (
    DockAction,
    DockGoal,
    MarkerDetectionArray,
    UndockAction,
    UndockFeedback,
    UndockGoal,
)
from bullet_lab.ros.messages.poses import InputError, stamped_pose
from bullet_lab.core import parameters
from bullet_lab.ros.node.commands import StoppableSender
from bullet_lab.ros.node.goal_server import GoalServer
from bullet_lab.ros.node.lock_step import rate
from bullet_lab.ros.node.message_queue import MessageQueue
from bullet_lab.ros.node.node import private_parameters, run_node
from bullet_lab.core.parameters import ParameterError
from bullet_lab.ros.node.publishers import Publisher, publisher
from bullet_lab.ros.node.transforms import FrameError, FrameFinder, own_frame
from bullet_lab.ros.nodes.dock_messages import (
    GoalError,
    Lookup,
    NotYetError,
    camera_of,
    check_dock_goal,
    check_undock_goal,
    dock_feedback,
    dock_of,
    dock_result,
    mount_of,
    odometry_of,
    rough_pose,
    sightings_of,
    undock_result,
)
from bullet_lab.simulation.world.resources import ResourceFinder

USUAL = DockingSettings()


@dataclass(frozen=True)
class DockParameters:
    """Private parameters of dock."""

    docks: str = parameters.text(
        "package://bullet_lab/config/docks.yaml", "dock database: a path or package://"
    )
    dock: str = parameters.text("dock", "what a dock is like that is given by its pose alone")
    odom: str = parameters.text("odom", "topic of the odometry, perfect or noisy")
    cmd_vel: str = parameters.text("cmd_vel", "topic of the commands")
    detections: str = parameters.text("aruco/detections", "topic of the markers seen")
    camera_info: str = parameters.text("mycamera/camera_info", "topic of the camera's geometry")
    base_frame: str = parameters.text("base_footprint", "frame of the robot on the floor")
    dock_frame: str = parameters.text("dock", "frame of the dock on TF; empty: none is published")
    rate: float = parameters.number(
        20.0, "commands per simulated second", minimum=10.0, maximum=100.0
    )
    odom_rate: float = parameters.number(
        20.0, "lock step: messages of odometry per second", above=0.0, maximum=1000.0
    )
    image_rate: float = parameters.number(
        30.0, "lock step: images per second", above=0.0, maximum=1000.0
    )
    patience: float = parameters.number(
        3.0, "s that odometry, camera and transforms may be missing at the start", above=0.0
    )
    time_limit: float = parameters.number(USUAL.time_limit, "s for a docking", above=0.0)
    max_retries: int = parameters.integer(
        USUAL.max_retries, "how often to retreat and try again", minimum=0, maximum=1000
    )
    drive_speed: float = parameters.number(
        USUAL.drive_speed, "m/s in the open", above=0.0, maximum=1.0
    )
    approach_speed: float = parameters.number(
        USUAL.approach_speed, "m/s on the dock's axis", above=0.0, maximum=1.0
    )
    turn_speed: float = parameters.number(
        USUAL.turn_speed, "rad/s on the spot", above=0.0, maximum=2.0
    )
    tolerance_distance: float = parameters.number(
        0.0, "m, what counts as docked along the axis; 0: as the database says", minimum=0.0
    )
    tolerance_lateral: float = parameters.number(
        0.0, "m, across the axis; 0: as the database says", minimum=0.0
    )
    tolerance_yaw: float = parameters.number(
        0.0, "rad, against the axis; 0: as the database says", minimum=0.0
    )
    seed: int = parameters.integer(0, "of what is random in docking", minimum=0)

    def settings(self) -> DockingSettings:
        """Return the settings of docking."""
        names = ("time_limit", "max_retries", "drive_speed", "approach_speed", "turn_speed")
        return replace(USUAL, **{name: getattr(self, name) for name in names})

    def database(self) -> Dict[str, Dock]:
        """Return the docks, with their frames and tolerances for this node.

        Raises:
            ParameterError: they cannot be read, or ~dock is none of them.
        """
        try:
            docks = read_docks(ResourceFinder.anywhere().find(self.docks))
        except LabError as error:
            raise ParameterError(f"~docks: {error}") from error
        if self.dock not in docks:
            known = ", ".join(sorted(docks))
            raise ParameterError(f"~dock is '{self.dock}': the database has {known}")
        tolerances = (self.tolerance_distance, self.tolerance_lateral, self.tolerance_yaw)
        return {
            name: with_tolerances(replace(dock, frame=own_frame(dock.frame)), *tolerances)
            for name, dock in docks.items()
        }


def with_tolerances(dock: Dock, distance: float, lateral: float, yaw: float) -> Dock:
    """Return a dock with other tolerances (m, m, rad) where they are not 0."""
    own = dock.tolerance
    tolerance = replace(
        own,
        distance=distance or own.distance,
        lateral=lateral or own.lateral,
        yaw=yaw or own.yaw,
    )
    return replace(dock, tolerance=tolerance)


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
        self._shown: Optional[Tuple[Tuple[float, float], ...]] = None

    def publish(
        self,
        stamp: rospy.Time,
        frame: str,
        pose: Optional[PlanarPose],
        plan: Sequence[Tuple[float, float]],
    ) -> None:
        """Show the filtered pose of the dock, if there is one, and the way that is planned.

        Args:
            stamp: the present time.
            frame: of the odometry, in which the others are given.
            pose: of the dock, m and rad.
            plan: points in m.
        """
        if pose is not None:
            message = stamped_pose(stamp, frame, pose)
            self._pose.publish(message)
            if self._tf is not None:
                self._tf.sendTransform(self._transform(message))
        plan = tuple(plan)
        if plan != self._shown:
            self._shown = plan
            self._plan.publish(_path(stamp, frame, plan))

    def _transform(self, pose: PoseStamped) -> TransformStamped:
        message = TransformStamped(header=pose.header, child_frame_id=self._child)
        place = message.transform.translation
        place.x, place.y = pose.pose.position.x, pose.pose.position.y
        message.transform.rotation = pose.pose.orientation
        return message


def _path(stamp: rospy.Time, frame: str, points: Sequence[Tuple[float, float]]) -> Path:
    path = Path()
    path.header.stamp, path.header.frame_id = stamp, frame
    path.poses = [stamped_pose(stamp, frame, (x, y, 0.0)) for x, y in points]
    return path


@dataclass(frozen=True)
class Surroundings:
    """What is known when a task begins.

    Attributes:
        docks: the database.
        usual: name of the dock that one given by its pose is like.
        settings: of docking.
        seed: of what is random in it.
        frame: of the odometry.
        lookup: returns the pose of its second frame in its first, or raises LabError.
        mount: where the camera is; None for unknown.
        last_dock: where the robot has docked last, in the odometry frame; None for nowhere.
    """

    docks: Mapping[str, Dock]
    usual: str
    settings: DockingSettings
    seed: int
    frame: str
    lookup: Lookup
    mount: Optional[CameraMount]
    last_dock: Optional[PlanarPose]


class DockServer(GoalServer):
    """The action of driving into a dock."""

    needs_camera = True
    check = staticmethod(check_dock_goal)

    def make_task(self, goal: DockGoal, around: Surroundings) -> DockingTask:
        """Return the task that pursues a goal; raises GoalError."""
        dock = dock_of(goal, around.docks, around.usual)
        return DockingTask(
            dock,
            rough_pose(goal, dock, around.frame, around.lookup),
            around.mount,
            around.settings,
            search=goal.search,
            max_retries=goal.max_retries,
            seed=around.seed,
        )

    def tell(self, task: DockingTask) -> None:
        """Tell the client how it goes."""
        self.publish_feedback(dock_feedback(task.status))

    def end_with(self, result: DockingResult) -> None:
        """Tell the client how it ended."""
        self.end(_status_of(result), dock_result(result), result.message)


class UndockServer(GoalServer):
    """The action of driving backwards out of a dock, on its axis where the camera shows it."""

    needs_camera = False
    check = staticmethod(check_undock_goal)

    def make_task(self, goal: UndockGoal, around: Surroundings) -> UndockingTask:
        """Return the task that pursues a goal; raises GoalError."""
        usual = DockGoal(dock_id=around.usual)
        dock = dock_of(usual, around.docks, around.usual)
        pose = around.last_dock
        if pose is None:
            pose = rough_pose(usual, dock, around.frame, around.lookup)
        return UndockingTask(
            goal.distance, dock=dock, dock_pose=pose, mount=around.mount, settings=around.settings
        )

    def tell(self, task: UndockingTask) -> None:
        """Tell the client how it goes."""
        self.publish_feedback(UndockFeedback(task.remaining))

    def end_with(self, result: DockingResult) -> None:
        """Tell the client how it ended."""
        self.end(_status_of(result), undock_result(result), result.message)


def _status_of(result: DockingResult) -> int:
    if result.success:
        return GoalStatus.SUCCEEDED
    preempted = result.error == DockingError.PREEMPTED
    return GoalStatus.PREEMPTED if preempted else GoalStatus.ABORTED


class DockNode:
    """Pursues one goal of the two actions at a time.

    Goals and cancellations come in threads of actionlib, where they stop the robot; the loop
    takes them up and ends them.
    """

    def __init__(self, parameters: DockParameters):
        self._parameters = parameters
        self._docks = parameters.database()
        self._settings = parameters.settings()
        self._base_frame = own_frame(parameters.base_frame)
        self._odometry: MessageQueue = MessageQueue(
            parameters.odom,
            OdometryMessage,
            lambda message: (message.header.frame_id, odometry_of(message)),
            parameters.odom_rate,
        )
        self._camera_info: MessageQueue = MessageQueue(
            parameters.camera_info,
            CameraInfo,
            lambda message: (message.header.frame_id, camera_of(message)),
            parameters.image_rate,
        )
        self._detections: MessageQueue = MessageQueue(
            parameters.detections,
            MarkerDetectionArray,
            lambda message: (message.header.stamp.to_sec(), sightings_of(message)),
            parameters.image_rate,
        )
        self._queues = (self._odometry, self._camera_info, self._detections)
        self._commands = publisher(parameters.cmd_vel, Twist)
        self._sender = StoppableSender(self._commands)
        rospy.on_shutdown(self._sender.end)
        self._finished = publisher("~finished", Time, latch=True)
        self._topics = DockTopics(own_frame(parameters.dock_frame))
        self._frames = FrameFinder()
        self._frame = ""
        self._camera: Optional[Tuple[str, PinholeCamera]] = None
        self._last_dock: Optional[PlanarPose] = None
        # The action whose goal is pursued, the goal, and the task once all is there for it.
        self._server: Any = None
        self._goal: Any = None
        self._task: Any = None
        self._begun = 0.0
        callbacks = (self._stop_for_another, self._sender.stop)
        self._servers = (
            DockServer("dock", DockAction, *callbacks),
            UndockServer("undock", UndockAction, *callbacks),
        )

    def run(self) -> None:
        """Serve until ROS shuts down."""
        ticks = rate(self._parameters.rate, self._is_connected, "odometry, camera and the bridge")
        for server in self._servers:
            server.start()
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

    def _stop_for_another(self, _: ServerGoalHandle) -> None:
        if self._server is not None:
            self._sender.stop()

    # The loop

    def _tick(self, now: rospy.Time) -> None:
        ticket = self._sender.ticket()
        self._look_at_requests(now)
        for queue in self._queues:
            queue.wait(now)
        odometry = self._take_odometry(now)
        observations = self._take_observations(now)
        if self._server is None:
            return
        try:
            if self._task is None and not self._start(now):
                return
            for message in odometry:
                self._task.add_odometry(message)
            for observation in observations:
                self._task.add_observation(observation)
            command = self._task.tick(now.to_sec())
        except GoalError as error:
            self._end(now, DockingResult(False, error.error, str(error)))
            return
        except LabError as error:
            self._end(now, DockingResult(False, DockingError.UNKNOWN, str(error)))
            return
        self._sender.send(command, ticket)
        self._show(now)
        if self._task.result is not None:
            self._end(now, self._task.result)

    def _look_at_requests(self, now: rospy.Time) -> None:
        """Take up what is new, of several the newest, and end what was cancelled."""
        new = [server for server in self._servers if server.is_new_goal_available()]
        for server in sorted(new, key=lambda server: server.next_goal.get_goal_id().stamp):
            self._give_up("another goal has taken its place", now)
            self._take_up(server, now)
        if self._server is not None and self._server.is_cancelled:
            self._give_up("stopped on request", now)

    def _take_up(self, server: Any, now: rospy.Time) -> None:
        self._server, self._goal, self._task = server, server.accept_new_goal(), None
        self._begun = now.to_sec()
        try:
            server.check(self._goal)
        except GoalError as error:
            self._end(now, DockingResult(False, error.error, str(error)))
            return
        opened = [queue.open() for queue in self._queues]
        if any(opened):
            self._frame, self._camera = "", None

    def _give_up(self, why: str, now: rospy.Time) -> None:
        if self._server is not None:
            self._end(now, DockingResult(False, DockingError.PREEMPTED, why))

    def _take_odometry(self, now: rospy.Time) -> list:
        taken = self._odometry.take(now)
        if taken:
            self._frame = taken[-1][0]
        return [message for _, message in taken]

    def _take_observations(self, now: rospy.Time) -> List[Observation]:
        cameras = self._camera_info.take(now)
        if cameras:
            self._camera = cameras[-1]
        taken = self._detections.take(now)
        if self._camera is None:
            return []
        return [Observation(stamp, self._camera[1], seen) for stamp, seen in taken]

    def _start(self, now: rospy.Time) -> bool:
        """Make the task, if all is there; raises GoalError if it has not come in time."""
        patient = now.to_sec() - self._begun < self._parameters.patience
        try:
            if not self._frame:
                what = self._odometry.trouble or "nothing comes"
                raise NotYetError(DockingError.ODOMETRY_LOST, f"{self._odometry.topic}: {what}")
            mount = self._mount(patient or self._server.needs_camera)
            self._task = self._server.make_task(self._goal, self._surroundings(mount))
        except NotYetError:
            if patient:
                return False
            raise
        return True

    def _mount(self, needed: bool) -> Optional[CameraMount]:
        """Return where the camera is on the robot; None if it is not needed and not there."""
        try:
            if self._camera is None:
                what = self._camera_info.trouble or "nothing comes"
                raise InputError(f"{self._camera_info.topic}: {what}")
            return mount_of(self._lookup(self._base_frame, self._camera[0]))
        except (FrameError, InputError) as error:
            if needed:
                raise NotYetError(DockingError.CAMERA_LOST, str(error)) from None
            return None

    def _surroundings(self, mount: Optional[CameraMount]) -> Surroundings:
        return Surroundings(
            self._docks,
            self._parameters.dock,
            self._settings,
            self._parameters.seed,
            self._frame,
            self._lookup,
            mount,
            self._last_dock,
        )

    def _lookup(self, target: str, source: str) -> Pose:
        return self._frames.pose_in(target, source, wait=False)

    def _show(self, now: rospy.Time) -> None:
        self._server.tell(self._task)
        if isinstance(self._task, DockingTask):
            status = self._task.status
            self._topics.publish(now, self._frame, status.dock_pose, status.plan)
            if status.dock_pose is not None:
                self._last_dock = status.dock_pose

    def _end(self, now: rospy.Time, result: DockingResult) -> None:
        """Stop, and tell how it ended."""
        server, self._server = self._server, None
        self._sender.stop()
        for queue in self._queues:
            queue.close()
        say = rospy.loginfo if result.success else rospy.logwarn
        say("%s: %s (%s)", server.name, result.message, result.error.name)
        server.end_with(result)
        self._finished.publish(Time(now))

    def _time_was_set_back(self) -> None:
        for queue in self._queues:
            queue.clear()
        for server in self._servers:
            server.forget_cancels()
        self._frames.clear()
        self._last_dock = None
        if self._server is not None:
            message = "simulated time was set back"
            self._end(rospy.Time(0), DockingResult(False, DockingError.UNKNOWN, message))


def main() -> None:
    """Run the node."""
    run_node("dock", lambda: DockNode(private_parameters(DockParameters)).run())
