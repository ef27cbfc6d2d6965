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

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any, Callable

import numpy as np
import rospy
from actionlib import ServerGoalHandle
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped, Transform, TransformStamped, Vector3
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header, Time

from bullet_lab.core.parameters import ParameterError, integer, number, part_of, text
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.database import Dock, find_dock, read_docks
from bullet_lab.docking.progress import DockingFailureError
from bullet_lab.docking.task import DockingTask, UndockingTask
from bullet_lab.docking.types import (
    CalibrationErrors,
    CameraMount,
    DockingError,
    DockingResult,
    DockingSettings,
    Learned,
    Observation,
    Odometry,
    Sighting,
)
from bullet_lab.errors import LabError
from bullet_lab.msg import (
    DockAction,
    DockCalibration,
    DockFeedback,
    DockGoal,
    DockResult,
    MarkerDetectionArray,
    UndockAction,
    UndockFeedback,
    UndockGoal,
    UndockResult,
)
from bullet_lab.ros.messages import images
from bullet_lab.ros.messages.poses import InputError, pose_of, stamped_pose
from bullet_lab.ros.node.driving import GoalNode, GoalServer
from bullet_lab.ros.node.lock_step import Publisher, publisher
from bullet_lab.ros.node.node import node
from bullet_lab.ros.node.odometry import (
    FrameError,
    MessageQueue,
    framed,
    own_frame,
    planar_pose,
)
from bullet_lab.simulation.world.resources import ResourceFinder

# Indices of vx, vy and wz in the 6x6 covariances of ROS (REP 103).
_PLANAR = (0, 1, 5)
# Pose of the optical frame in the camera's frame, x ahead and z up (REP 103).
OPTICAL = Pose.from_rpy((0.0, 0.0, 0.0), (-math.pi / 2, 0.0, -math.pi / 2))
# rad; a dock on the floor is upright, and a larger tilt is a mistake.
LARGEST_TILT = 0.2
# m.
LONGEST_UNDOCK = 10.0
# Ends of a goal; after other errors it is aborted.
_ENDS = {DockingError.NONE: GoalStatus.SUCCEEDED, DockingError.PREEMPTED: GoalStatus.PREEMPTED}

Lookup = Callable[[str, str], Pose]


@dataclass(frozen=True)
class DockParameters(DockingSettings):
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
    rate: float = number(20.0, "commands per simulated second", minimum=10.0, maximum=100.0)
    odom_rate: float = number(
        20.0, "lock step: messages of odometry per second", above=0.0, maximum=1000.0
    )
    image_rate: float = number(30.0, "lock step: images per second", above=0.0, maximum=1000.0)
    patience: float = number(
        3.0, "s to wait for odometry, camera and transforms at the start", above=0.0
    )
    seed: int = integer(0, "of the random draws of docking", minimum=0)

    def database(self) -> dict[str, Dock]:
        """Return the docks, with the frames of this node.

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
        return {name: replace(dock, frame=own_frame(dock.frame)) for name, dock in docks.items()}


def odometry_of(message: OdometryMessage) -> Odometry:
    """Return the content of a message of odometry; raises InputError."""
    covariance = np.asarray(message.twist.covariance, dtype=float).reshape(6, 6)
    planar = covariance[np.ix_(_PLANAR, _PLANAR)]
    return Odometry(message.header.stamp.to_sec(), planar_pose(message), planar)


def camera_of(message: CameraInfo) -> tuple[str, PinholeCamera]:
    """Return the frame and the camera of raw images; raises CameraGeometryError."""
    camera = images.camera_of(message, message.width, message.height)
    return message.header.frame_id, camera


def sightings_of(message: MarkerDetectionArray) -> tuple[float, tuple[Sighting, ...]]:
    """Return the stamp and the markers in an image whose corners and deviations are finite."""
    found = []
    for detection in message.detections:
        corners = np.array(detection.corners, dtype=float).reshape(4, 2)
        deviations = np.array(detection.deviations, dtype=float).reshape(4, 2)
        if np.isfinite((corners, deviations)).all():
            found.append(Sighting(detection.id, detection.dictionary, corners, deviations))
    return message.header.stamp.to_sec(), tuple(found)


def mount_of(optical: Pose) -> CameraMount:
    """Return the pose of the camera on the robot, from that of its optical frame."""
    mount = optical * OPTICAL.inverse()
    return CameraMount(*mount.position, *mount.rpy())


class NotYetError(DockingFailureError):
    """A message or transform that a goal needs has not come yet."""


def check_goal(goal: DockGoal | UndockGoal) -> None:
    """Raise DockingFailureError for an invalid goal of either action."""
    trouble = ""
    if isinstance(goal, UndockGoal):
        if not 0.0 <= goal.distance <= LONGEST_UNDOCK:
            trouble = f"distance is {goal.distance:g} m; it must be from 0 to {LONGEST_UNDOCK:g} m"
    elif goal.max_retries < -1:
        trouble = f"max_retries is {goal.max_retries}; it must be -1 or more"
    elif goal.dock_pose.header.frame_id:
        _pose_given(goal)
    elif not goal.dock_id:
        trouble = "neither dock_id nor the frame of dock_pose is set"
    if trouble:
        raise DockingFailureError(DockingError.NOT_VALID, trouble)


def _pose_given(goal: DockGoal) -> Pose:
    pose = goal.dock_pose.pose
    try:
        return pose_of(pose.position, pose.orientation)
    except InputError as error:
        raise DockingFailureError(DockingError.NOT_VALID, f"dock_pose is {error}") from None


def rough_pose(goal: DockGoal, dock: Dock, frame: str, lookup: Lookup) -> PlanarPose:
    """Return the rough pose of the dock in the odometry frame.

    It is that of the goal, if it has a frame, or that of the database. `lookup` returns the pose of
    its second frame in its first, or raises LabError.

    Raises:
        DockingFailureError: the dock is not upright.
        NotYetError: no transform to the frame of the pose has come yet.
    """
    if goal.dock_pose.header.frame_id:
        given, pose = goal.dock_pose.header.frame_id, _pose_given(goal)
    else:
        given, pose = dock.frame, Pose.on_floor(*dock.pose)
    if given.lstrip("/") != frame:
        try:
            pose = lookup(frame, given) * pose
        except LabError as error:
            raise NotYetError(DockingError.NOT_VALID, str(error)) from None
    if pose.rotate((0.0, 0.0, 1.0))[2] < math.cos(LARGEST_TILT):
        raise DockingFailureError(DockingError.NOT_VALID, "the pose of the dock is not upright")
    return pose.planar


def result_message(goal: DockGoal | UndockGoal, result: DockingResult) -> DockResult | UndockResult:
    """Return a result as a message of the action of a goal."""
    head = (result.success, int(result.error), result.message)
    if isinstance(goal, UndockGoal):
        return UndockResult(*head)
    learned = result.calibration or [Learned(math.nan, math.nan)] * len(CalibrationErrors._fields)
    calibration = DockCalibration(*itertools.chain(*learned))
    place = (result.distance, result.lateral, result.yaw)
    return DockResult(*head, result.retries, *place, calibration)


def docking_result(message: DockResult) -> DockingResult:
    """Convert a message of the action dock into a result."""
    _, error, words, *place, learned = (getattr(message, name) for name in DockResult.__slots__)
    numbers = [getattr(learned, name) for name in DockCalibration.__slots__]
    # Value and deviation of each field of `CalibrationErrors`, in the same order.
    calibration = CalibrationErrors(*map(Learned, numbers[::2], numbers[1::2]))
    found = None if math.isnan(calibration.roll.value) else calibration
    return DockingResult(DockingError(error), words, *place, found)


def _missing(queue: MessageQueue) -> str:
    """Return why a queue has no messages."""
    return f"{queue.topic}: {queue.trouble or 'no messages'}"


class DockNode(GoalNode):
    """Pursues one goal of the two actions at a time."""

    def __init__(self, parameters: DockParameters):
        self._parameters = parameters
        self._docks = parameters.database()
        self._settings = part_of(DockingSettings, parameters)
        self._base_frame = own_frame(parameters.base_frame)
        odometry = MessageQueue(
            parameters.odom, OdometryMessage, framed(odometry_of), parameters.odom_rate
        )
        rate = parameters.image_rate
        self._camera_info = MessageQueue(parameters.camera_info, CameraInfo, camera_of, rate)
        self._detections = MessageQueue(
            parameters.detections, MarkerDetectionArray, sightings_of, rate
        )
        super().__init__(parameters.cmd_vel, odometry, self._camera_info, self._detections)
        self._finished = publisher("~finished", Time, latch=True)
        self._pose = Publisher("~dock_pose", PoseStamped, queue_size=10)
        self._plan = Publisher("~plan", Path, queue_size=1, latch=True)
        self._shown: Any = None
        self._dock_frame, self._tf = own_frame(parameters.dock_frame), None
        if self._dock_frame:
            # Imported late: recorders import this module before tf2 is installed.
            import tf2_ros

            self._tf = tf2_ros.TransformBroadcaster()
        # The frame of the camera, and its calibration.
        self._camera: tuple[str, PinholeCamera] | None = None
        self._last_dock: PlanarPose | None = None
        # That of the goal, once messages have come.
        self._task: DockingTask | UndockingTask | None = None
        self._begun = 0.0
        callbacks = (self._stop_for_new_goal, self._sender.stop)
        for name, kind in (("dock", DockAction), ("undock", UndockAction)):
            self._servers.append(GoalServer(name, kind, *callbacks))

    def _stop_for_new_goal(self, _: ServerGoalHandle) -> None:
        if self._server is not None:
            self._sender.stop()

    def _tick(self, now: rospy.Time, seconds: float, ticket: int) -> None:
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
        except LabError as error:
            reason = error.error if isinstance(error, DockingFailureError) else DockingError.UNKNOWN
            self._finish(now, DockingResult(reason, str(error)))
            return
        self._sender.send(command, ticket)
        self._show(now)
        if self._task.result is not None:
            self._finish(now, self._task.result)

    def _accept(self, now: rospy.Time) -> None:
        self._task = None
        self._begun = now.to_sec()
        opened = [queue.open() for queue in self._queues]
        if any(opened):
            self._frame, self._camera = "", None

    def _take_observations(self, now: rospy.Time) -> list[Observation]:
        cameras, taken = self._camera_info.take(now), self._detections.take(now)
        if cameras:
            self._camera = cameras[-1]
        if self._camera is None:
            return []
        return [Observation(stamp, self._camera[1], seen) for stamp, seen in taken]

    def _start(self, now: rospy.Time) -> bool:
        """Make the task once its messages have come; raises DockingFailureError."""
        check_goal(self._goal)
        may_wait = now.to_sec() - self._begun < self._parameters.patience
        try:
            if not self._frame:
                raise NotYetError(DockingError.ODOMETRY_LOST, _missing(self._odometry))
            if isinstance(self._goal, DockGoal):
                self._task = self._docking(self._goal)
            else:
                self._task = self._undocking(self._goal, may_wait)
        except NotYetError:
            if may_wait:
                return False
            raise
        return True

    def _docking(self, goal: DockGoal) -> DockingTask:
        """Return the task that drives into a dock; raises DockingFailureError."""
        mount = self._mount()
        try:
            dock = find_dock(self._docks, goal.dock_id or self._parameters.dock)
        except LabError as error:
            raise DockingFailureError(DockingError.NOT_IN_DATABASE, str(error)) from None
        retries = self._settings.max_retries if goal.max_retries < 0 else goal.max_retries
        settings = replace(self._settings, search=goal.search, max_retries=retries)
        pose = rough_pose(goal, dock, self._frame, self._lookup)
        return DockingTask(dock, pose, mount, settings, self._parameters.seed)

    def _undocking(self, goal: UndockGoal, may_wait: bool) -> UndockingTask:
        """Return the task that drives backwards out of a dock, on its axis if it is visible."""
        try:
            mount = self._mount()
        except NotYetError:
            if may_wait:
                raise
            mount = None
        dock = self._docks[self._parameters.dock]
        pose = self._last_dock or rough_pose(DockGoal(), dock, self._frame, self._lookup)
        return UndockingTask(goal.distance, dock, pose, mount, self._settings)

    def _mount(self) -> CameraMount:
        """Return the pose of the camera on the robot; raises NotYetError."""
        try:
            if self._camera is None:
                raise InputError(_missing(self._camera_info))
            return mount_of(self._lookup(self._base_frame, self._camera[0]))
        except (FrameError, InputError) as error:
            raise NotYetError(DockingError.CAMERA_LOST, str(error)) from None

    def _lookup(self, target: str, source: str) -> Pose:
        return self._frames.pose_in(target, source, wait=False)

    def _show(self, now: rospy.Time) -> None:
        """Publish how it goes; the path only if it has changed."""
        task = self._task
        if isinstance(task, UndockingTask):
            self._server.tell(UndockFeedback(task.remaining), now)
            return
        self._server.tell(DockFeedback(int(task.state), *task.place, task.retries), now)
        if task.dock_pose is not None:
            self._last_dock = task.dock_pose
            pose = stamped_pose(now, self._frame, self._last_dock)
            self._pose.publish(pose)
            if self._tf is not None:
                place = Vector3(pose.pose.position.x, pose.pose.position.y, 0.0)
                transform = Transform(place, pose.pose.orientation)
                self._tf.sendTransform(TransformStamped(pose.header, self._dock_frame, transform))
        if task.plan != self._shown:
            self._shown = task.plan
            poses = [stamped_pose(now, self._frame, (x, y, 0.0)) for x, y in self._shown]
            self._plan.publish(Path(Header(0, now, self._frame), poses))

    def _end(self, now: rospy.Time, status: int, text: str) -> None:
        is_preempted = status == GoalStatus.PREEMPTED
        error = DockingError.PREEMPTED if is_preempted else DockingError.UNKNOWN
        self._finish(now, DockingResult(error, text))

    def _finish(self, now: rospy.Time, result: DockingResult) -> None:
        """Stop the robot and report the result."""
        server, self._server = self._server, None
        self._sender.stop()
        for queue in self._queues:
            queue.close()
        log = rospy.loginfo if result.success else rospy.logwarn
        log("%s: %s (%s)", server.name, result.message, result.error.name)
        status = _ENDS.get(result.error, GoalStatus.ABORTED)
        server.end(status, result_message(self._goal, result), result.message)
        self._finished.publish(Time(now))

    def _time_was_set_back(self) -> None:
        self._last_dock = None
        super()._time_was_set_back()


@node
def dock(parameters: DockParameters) -> None:
    """Run until ROS shuts down."""
    DockNode(parameters).run(parameters.rate)
