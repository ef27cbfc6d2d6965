"""Drives a robot into a dock and out of it again, on request.

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

import threading
from dataclasses import dataclass, replace
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import rospy
import tf2_ros
from actionlib import ActionServer, ServerGoalHandle
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Time

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.docking.database import Dock, read_docks
from bullet_lab.docking.types import (
    CameraMount,
    DockingError,
    DockingResult,
    DockingSettings,
    Observation,
    PlanarPose,
)
from bullet_lab.errors import LabError
from bullet_lab.msg import DockAction, MarkerDetectionArray, UndockAction
from bullet_lab.ros.messages.poses import InputError, pose_of
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.commands import StoppableSender
from bullet_lab.ros.node.lock_step import rate
from bullet_lab.ros.node.node import private_parameters, run_node
from bullet_lab.ros.node.parameters import ParameterError
from bullet_lab.ros.node.publishers import Publisher, publisher
from bullet_lab.ros.node.transforms import FrameError, FrameFinder, own_frame
from bullet_lab.ros.nodes.dock_errands import DockErrand, Errand, Surroundings, UndockErrand
from bullet_lab.ros.nodes.dock_goals import (
    GoalError,
    NotYetError,
    stamped_pose,
    stamped_transform,
    with_tolerances,
)
from bullet_lab.ros.nodes.dock_inputs import (
    Inbox,
    camera_of,
    mount_of,
    odometry_of,
    sightings_of,
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
                self._tf.sendTransform(stamped_transform(message, self._child))
        plan = tuple(plan)
        if plan != self._shown:
            self._shown = plan
            self._plan.publish(_path(stamp, frame, plan))


def _path(stamp: rospy.Time, frame: str, points: Sequence[Tuple[float, float]]) -> Path:
    path = Path()
    path.header.stamp, path.header.frame_id = stamp, frame
    path.poses = [stamped_pose(stamp, frame, (x, y, 0.0)) for x, y in points]
    return path


class DockServer:
    """Pursues one goal at a time.

    Goals and cancellations come in threads of actionlib, which hold its lock; they are noted
    and stop the robot, and the loop does the rest.
    """

    def __init__(self, wanted: DockParameters):
        self._wanted = wanted
        self._docks = _read_docks(wanted.docks)
        self._base_frame = own_frame(wanted.base_frame)
        if wanted.dock not in self._docks:
            known = ", ".join(sorted(self._docks))
            raise ParameterError(f"~dock is '{wanted.dock}': the database has {known}")
        self._settings = replace(
            USUAL,
            time_limit=wanted.time_limit,
            max_retries=wanted.max_retries,
            drive_speed=wanted.drive_speed,
            approach_speed=wanted.approach_speed,
            turn_speed=wanted.turn_speed,
        )
        self._odometry: Inbox = Inbox(
            wanted.odom,
            OdometryMessage,
            lambda message: (message.header.frame_id, odometry_of(message)),
            wanted.odom_rate,
        )
        self._camera_info: Inbox = Inbox(
            wanted.camera_info,
            CameraInfo,
            lambda message: (message.header.frame_id, camera_of(message)),
            wanted.image_rate,
        )
        self._detections: Inbox = Inbox(
            wanted.detections,
            MarkerDetectionArray,
            lambda message: (message.header.stamp.to_sec(), sightings_of(message)),
            wanted.image_rate,
        )
        self._inboxes = (self._odometry, self._camera_info, self._detections)
        self._commands = publisher(wanted.cmd_vel, Twist)
        self._sender = StoppableSender(self._commands)
        rospy.on_shutdown(self._sender.end)
        self._finished = publisher("~finished", Time, latch=True)
        self._topics = DockTopics(own_frame(wanted.dock_frame))
        self._frames = FrameFinder()
        self._noted = threading.Lock()
        self._new: List[Errand] = []
        self._cancelled: List[ServerGoalHandle] = []
        self._errand: Optional[Errand] = None
        self._frame = ""
        self._camera: Optional[Tuple[str, PinholeCamera]] = None
        self._last_dock = None
        self._begun = 0.0
        self._servers = (
            self._server("dock", DockAction, lambda handle: DockErrand(handle, self._refined)),
            self._server("undock", UndockAction, UndockErrand),
        )

    def run(self) -> None:
        """Serve until ROS shuts down."""
        ticks = rate(self._wanted.rate, self._is_connected, "odometry, camera and the bridge")
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
        return self._commands.has_connections() and all(box.is_connected() for box in self._inboxes)

    # From the action servers' threads

    def _server(
        self, name: str, kind: type, make: Callable[[ServerGoalHandle], Errand]
    ) -> ActionServer:
        def accept(handle: ServerGoalHandle) -> None:
            handle.set_accepted()
            with self._noted:
                self._new.append(make(handle))
                moving = self._errand is not None
            if moving:
                self._sender.stop()

        def cancel(handle: ServerGoalHandle) -> None:
            with self._noted:
                self._cancelled.append(handle)
            self._sender.stop()

        return ActionServer(name, kind, accept, cancel, auto_start=False)

    # The loop

    def _tick(self, now: rospy.Time) -> None:
        ticket = self._sender.ticket()
        self._look_at_requests(now)
        for inbox in self._inboxes:
            inbox.wait(now)
        odometry = self._take_odometry(now)
        observations = self._take_observations(now)
        errand = self._errand
        if errand is None:
            return
        try:
            if errand.task is None and not self._start(errand, now):
                return
            command = errand.step(now.to_sec(), odometry, observations)
        except GoalError as error:
            self._end(now, DockingResult(False, error.error, str(error)))
            return
        except LabError as error:
            self._end(now, DockingResult(False, DockingError.UNKNOWN, str(error)))
            return
        self._sender.send(command, ticket)
        self._show(errand, now)
        if errand.task.result is not None:
            self._end(now, errand.task.result)

    def _look_at_requests(self, now: rospy.Time) -> None:
        """End what was cancelled, and take up what is new; of several, the newest."""
        with self._noted:
            new, self._new = self._new, []
            cancelled, self._cancelled = self._cancelled, []
        for errand in new:
            self._give_up("another goal has taken its place", now)
            self._take_up(errand, now)
        if self._errand is not None and any(h == self._errand.handle for h in cancelled):
            self._give_up("stopped on request", now)

    def _take_up(self, errand: Errand, now: rospy.Time) -> None:
        self._errand = errand
        self._begun = now.to_sec()
        try:
            errand.check()
        except GoalError as error:
            self._end(now, DockingResult(False, error.error, str(error)))
            return
        opened = [inbox.open() for inbox in self._inboxes]
        if any(opened):
            self._frame, self._camera = "", None

    def _give_up(self, why: str, now: rospy.Time) -> None:
        if self._errand is not None:
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

    def _start(self, errand: Errand, now: rospy.Time) -> bool:
        """Make the errand's task, if all is there; raises GoalError if it has not come in time."""
        patient = now.to_sec() - self._begun < self._wanted.patience
        try:
            self._check_odometry()
            errand.start(self._surroundings(self._mount(patient or errand.needs_camera)))
        except NotYetError:
            if patient:
                return False
            raise
        return True

    def _check_odometry(self) -> None:
        if not self._frame:
            what = self._odometry.trouble or "nothing comes"
            raise NotYetError(DockingError.ODOMETRY_LOST, f"{self._odometry.topic}: {what}")

    def _mount(self, needed: bool) -> Optional[CameraMount]:
        """Return where the camera is on the robot; None if it is not needed and not there."""
        try:
            if self._camera is None:
                what = self._camera_info.trouble or "nothing comes"
                raise InputError(f"{self._camera_info.topic}: {what}")
            return mount_of(self._transform(self._base_frame, self._camera[0]))
        except InputError as error:
            if needed:
                raise NotYetError(DockingError.CAMERA_LOST, str(error)) from None
            return None

    def _surroundings(self, mount: Optional[CameraMount]) -> Surroundings:
        return Surroundings(
            self._docks,
            self._wanted.dock,
            self._settings,
            self._wanted.seed,
            self._frame,
            self._lookup,
            mount,
            self._last_dock,
        )

    def _lookup(self, target: str, source: str) -> Pose:
        transform = self._transform(target, source)
        return pose_of(transform.translation, transform.rotation)

    def _transform(self, target: str, source: str):
        """Return the newest transform; raises InputError if nobody knows one."""
        try:
            return self._frames.newest(target, source).transform
        except FrameError as error:
            raise InputError(str(error)) from error

    def _show(self, errand: Errand, now: rospy.Time) -> None:
        errand.publish_feedback()
        if isinstance(errand, DockErrand):
            status = errand.task.status
            self._topics.publish(now, self._frame, status.dock_pose, status.plan)
            if status.dock_pose is not None:
                self._last_dock = status.dock_pose

    def _end(self, now: rospy.Time, result: DockingResult) -> None:
        """Stop, and tell how it ended."""
        errand, self._errand = self._errand, None
        self._sender.stop()
        for inbox in self._inboxes:
            inbox.close()
        say = rospy.loginfo if result.success else rospy.logwarn
        say("%s: %s (%s)", type(errand).__name__, result.message, result.error.name)
        errand.end(result)
        self._finished.publish(Time(now))

    def _time_was_set_back(self) -> None:
        for inbox in self._inboxes:
            inbox.clear()
        self._frames.clear()
        self._last_dock = None
        if self._errand is not None:
            message = "simulated time was set back"
            self._end(rospy.Time(0), DockingResult(False, DockingError.UNKNOWN, message))

    def _refined(self, dock: Dock) -> Dock:
        wanted = self._wanted
        return with_tolerances(
            dock, wanted.tolerance_distance, wanted.tolerance_lateral, wanted.tolerance_yaw
        )


def _read_docks(name: str) -> Dict[str, Dock]:
    """Read the database; its frames take the node's tf_prefix."""
    try:
        docks = read_docks(ResourceFinder.anywhere().find(name))
    except LabError as error:
        raise ParameterError(f"~docks: {error}") from error
    return {name: replace(dock, frame=own_frame(dock.frame)) for name, dock in docks.items()}


def main() -> None:
    """Run the node."""
    run_node("dock", lambda: DockServer(private_parameters(DockParameters)).run())
