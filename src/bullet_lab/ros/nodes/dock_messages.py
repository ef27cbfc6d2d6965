"""Conversions of the dock node: between messages of ROS and what bullet_lab.docking takes."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Callable, Optional, Tuple

import numpy as np
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import CameraInfo

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.docking.database import Dock
from bullet_lab.docking.task import DockingTask, UndockingTask
from bullet_lab.docking.types import (
    Calibration,
    CameraMount,
    DockingError,
    DockingResult,
    Learned,
    Odometry,
    PlanarPose,
    Sighting,
)
from bullet_lab.errors import LabError
from bullet_lab.msg import (
    DockCalibration,
    DockFeedback,
    DockGoal,
    DockResult,
    MarkerDetectionArray,
    UndockFeedback,
    UndockGoal,
    UndockResult,
)
from bullet_lab.ros.messages import images
from bullet_lab.ros.messages.poses import InputError, pose_of
from bullet_lab.ros.node.odometry import planar_pose

# Where vx, vy and wz stand in the 6x6 covariances of ROS (REP 103).
_PLANAR = (0, 1, 5)
# Of the optical frame in the camera's own, x ahead and z up (REP 103).
OPTICAL = Pose.from_rpy((0.0, 0.0, 0.0), (-math.pi / 2, 0.0, -math.pi / 2))
# A robot on a floor: a dock pose that leans by more than this (rad) is a mistake.
LARGEST_LEAN = 0.2
LONGEST_UNDOCK = 10.0

Lookup = Callable[[str, str], Pose]


def odometry_of(message: OdometryMessage) -> Odometry:
    """Return a message of odometry as docking takes it; raises OdometryError."""
    twist = message.twist.twist
    covariance = np.asarray(message.twist.covariance, dtype=float).reshape(6, 6)
    return Odometry(
        message.header.stamp.to_sec(),
        planar_pose(message),
        (twist.linear.x, twist.angular.z),
        covariance[np.ix_(_PLANAR, _PLANAR)],
    )


def camera_of(message: CameraInfo) -> PinholeCamera:
    """Return the geometry of raw images; raises CameraGeometryError."""
    return images.camera_of(message, message.width, message.height)


def sightings_of(message: MarkerDetectionArray) -> Tuple[Sighting, ...]:
    """Return the markers in an image; those with corners that are not finite are left out.

    So are those of which it is told how far off they may be, but not by finite numbers.
    """
    found = []
    for detection in message.detections:
        corners = np.array(detection.corners, dtype=float).reshape(4, 2)
        deviations = np.array(detection.deviations, dtype=float).reshape(4, 2)
        if np.isfinite((corners, deviations)).all():
            found.append(Sighting(detection.id, detection.dictionary, corners, deviations))
    return tuple(found)


def mount_of(optical: Pose) -> CameraMount:
    """Return where the camera is, of the pose of its optical frame in the robot's base."""
    mount = optical * OPTICAL.inverse()
    return CameraMount(*mount.position, *mount.rpy())


class GoalError(LabError):
    """A goal that cannot be pursued; `error` says why."""

    def __init__(self, error: DockingError, message: str):
        super().__init__(message)
        self.error = error


class NotYetError(GoalError):
    """What a goal needs has not come so far."""


def check_dock_goal(goal: DockGoal) -> None:
    """Raise GoalError for a goal that makes no sense by itself."""
    if goal.max_retries < -1:
        raise GoalError(DockingError.NOT_VALID, f"max_retries is {goal.max_retries}")
    if not goal.dock_id and not goal.dock_pose.header.frame_id:
        raise GoalError(DockingError.NOT_VALID, "neither dock_id nor the frame of dock_pose")
    if goal.dock_pose.header.frame_id:
        _given_pose(goal.dock_pose)


def check_undock_goal(goal: UndockGoal) -> None:
    """Raise GoalError for a goal that makes no sense by itself."""
    if not 0.0 <= goal.distance <= LONGEST_UNDOCK:
        what = f"a distance of {goal.distance:g} m is not from 0 to {LONGEST_UNDOCK:g}"
        raise GoalError(DockingError.NOT_VALID, what)


def rough_pose(goal: DockGoal, dock: Dock, frame: str, lookup: Lookup) -> PlanarPose:
    """Return the rough pose of the dock in the odometry frame.

    Args:
        goal: its dock_pose counts where it has a frame, otherwise that of the database.
        dock: of the database.
        frame: of the odometry.
        lookup: returns the pose of its second frame in its first, or raises LabError.

    Raises:
        GoalError: the pose is none of a dock; NotYetError: nobody knows its frame so far.
    """
    if goal.dock_pose.header.frame_id:
        given, pose = _given_pose(goal.dock_pose)
    else:
        x, y, yaw = dock.pose
        given, pose = dock.frame, Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw))
    if given.lstrip("/") != frame.lstrip("/"):
        try:
            pose = lookup(frame, given) * pose
        except LabError as error:
            raise NotYetError(DockingError.NOT_VALID, str(error)) from None
    if pose.rotate((0.0, 0.0, 1.0))[2] < math.cos(LARGEST_LEAN):
        raise GoalError(DockingError.NOT_VALID, "the pose of the dock does not stand upright")
    return pose.position[0], pose.position[1], pose.yaw


def _given_pose(message: PoseStamped) -> Tuple[str, Pose]:
    try:
        pose = pose_of(message.pose.position, message.pose.orientation)
    except InputError as error:
        raise GoalError(DockingError.NOT_VALID, f"dock_pose is {error}") from None
    return message.header.frame_id, pose


def dock_result(result: DockingResult) -> DockResult:
    """Return a result as the action sends it."""
    said = {field.name: getattr(result, field.name) for field in fields(result)}
    error, calibration = said.pop("error"), said.pop("calibration")
    told = _calibration_message(calibration)
    return DockResult(error_code=int(error), calibration=told, **said)


def docking_result(message: DockResult) -> DockingResult:
    """Return a result that the action has sent, as docking knows it."""
    said = {name: getattr(message, name) for name in DockResult.__slots__ if name != "error_code"}
    said["calibration"] = _calibration_of(message.calibration)
    return DockingResult(error=DockingError(message.error_code), **said)


def _calibration_message(calibration: Optional[Calibration]) -> DockCalibration:
    values = {}
    for field in fields(Calibration):
        learned = getattr(calibration, field.name, Learned(math.nan, math.nan))
        values.update({field.name: learned.value, f"{field.name}_deviation": learned.deviation})
    return DockCalibration(**values)


def _calibration_of(message: DockCalibration) -> Optional[Calibration]:
    if math.isnan(message.roll):
        return None
    names = [field.name for field in fields(Calibration)]
    pairs = ((getattr(message, n), getattr(message, f"{n}_deviation")) for n in names)
    return Calibration(*(Learned(*pair) for pair in pairs))


def undock_result(result: DockingResult) -> UndockResult:
    """Return a result as the action sends it."""
    return UndockResult(result.success, int(result.error), result.message)


def status_of(result: DockingResult) -> int:
    """Return what a result is as a GoalStatus of actionlib."""
    if result.success:
        return GoalStatus.SUCCEEDED
    preempted = result.error == DockingError.PREEMPTED
    return GoalStatus.PREEMPTED if preempted else GoalStatus.ABORTED


def dock_feedback(task: DockingTask) -> DockFeedback:
    """Return how it goes as the action sends it."""
    status = task.status
    return DockFeedback(
        int(status.state), status.distance, status.lateral, status.yaw, status.retries
    )


def undock_feedback(task: UndockingTask) -> UndockFeedback:
    """Return how it goes as the action sends it."""
    return UndockFeedback(task.remaining)
