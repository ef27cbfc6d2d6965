"""Conversions between ROS messages and the types of bullet_lab.docking, for the dock node."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Callable

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

# Indices of vx, vy and wz in the 6x6 covariances of ROS (REP 103).
_PLANAR = (0, 1, 5)
# Pose of the optical frame in the camera's frame, x ahead and z up (REP 103).
OPTICAL = Pose.from_rpy((0.0, 0.0, 0.0), (-math.pi / 2, 0.0, -math.pi / 2))
# rad; a dock on the floor is upright, and a larger tilt is a mistake.
LARGEST_TILT = 0.2
# m.
LONGEST_UNDOCK = 10.0

Lookup = Callable[[str, str], Pose]


def odometry_of(message: OdometryMessage) -> Odometry:
    """Convert a message of odometry; raises OdometryError."""
    twist = message.twist.twist
    covariance = np.asarray(message.twist.covariance, dtype=float).reshape(6, 6)
    return Odometry(
        message.header.stamp.to_sec(),
        planar_pose(message),
        (twist.linear.x, twist.angular.z),
        covariance[np.ix_(_PLANAR, _PLANAR)],
    )


def camera_of(message: CameraInfo) -> PinholeCamera:
    """Return the camera of raw images; raises CameraGeometryError."""
    return images.camera_of(message, message.width, message.height)


def sightings_of(message: MarkerDetectionArray) -> tuple[Sighting, ...]:
    """Return the markers in an image whose corners and deviations are finite."""
    found = []
    for detection in message.detections:
        corners = np.array(detection.corners, dtype=float).reshape(4, 2)
        deviations = np.array(detection.deviations, dtype=float).reshape(4, 2)
        if np.isfinite((corners, deviations)).all():
            found.append(Sighting(detection.id, detection.dictionary, corners, deviations))
    return tuple(found)


def mount_of(optical: Pose) -> CameraMount:
    """Return the pose of the camera on the robot, from that of its optical frame."""
    mount = optical * OPTICAL.inverse()
    return CameraMount(*mount.position, *mount.rpy())


class GoalError(LabError):
    """A goal cannot be pursued; `error` is the reason."""

    def __init__(self, error: DockingError, message: str):
        super().__init__(message)
        self.error = error


class NotYetError(GoalError):
    """A message or transform that a goal needs has not come yet."""


def check_dock_goal(goal: DockGoal) -> None:
    """Raise GoalError for an invalid goal."""
    if goal.max_retries < -1:
        what = f"max_retries is {goal.max_retries}; it must be -1 or more"
        raise GoalError(DockingError.NOT_VALID, what)
    if not goal.dock_id and not goal.dock_pose.header.frame_id:
        what = "neither dock_id nor the frame of dock_pose is set"
        raise GoalError(DockingError.NOT_VALID, what)
    if goal.dock_pose.header.frame_id:
        _given_pose(goal.dock_pose)


def check_undock_goal(goal: UndockGoal) -> None:
    """Raise GoalError for an invalid goal."""
    if not 0.0 <= goal.distance <= LONGEST_UNDOCK:
        what = f"distance is {goal.distance:g} m; it must be from 0 to {LONGEST_UNDOCK:g} m"
        raise GoalError(DockingError.NOT_VALID, what)


def rough_pose(goal: DockGoal, dock: Dock, frame: str, lookup: Lookup) -> PlanarPose:
    """Return the rough pose of the dock in the odometry frame.

    Args:
        goal: its dock_pose, if it has a frame, replaces that of the database.
        dock: of the database.
        frame: of the odometry.
        lookup: returns the pose of its second frame in its first, or raises LabError.

    Raises:
        GoalError: the dock is not upright.
        NotYetError: no transform to the frame of the pose has come yet.
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
    if pose.rotate((0.0, 0.0, 1.0))[2] < math.cos(LARGEST_TILT):
        raise GoalError(DockingError.NOT_VALID, "the pose of the dock is not upright")
    return pose.position[0], pose.position[1], pose.yaw


def _given_pose(message: PoseStamped) -> tuple[str, Pose]:
    try:
        pose = pose_of(message.pose.position, message.pose.orientation)
    except InputError as error:
        raise GoalError(DockingError.NOT_VALID, f"dock_pose is {error}") from None
    return message.header.frame_id, pose


def dock_result(result: DockingResult) -> DockResult:
    """Convert a result into a message of the action dock."""
    values = {field.name: getattr(result, field.name) for field in fields(result)}
    error, calibration = values.pop("error"), values.pop("calibration")
    calibration = _calibration_message(calibration)
    return DockResult(error_code=int(error), calibration=calibration, **values)


def docking_result(message: DockResult) -> DockingResult:
    """Convert a message of the action dock into a result."""
    values = {name: getattr(message, name) for name in DockResult.__slots__}
    values["error"] = DockingError(values.pop("error_code"))
    values["calibration"] = _calibration_of(message.calibration)
    return DockingResult(**values)


def _calibration_message(calibration: Calibration | None) -> DockCalibration:
    values = {}
    for field in fields(Calibration):
        learned = getattr(calibration, field.name, Learned(math.nan, math.nan))
        values.update({field.name: learned.value, f"{field.name}_deviation": learned.deviation})
    return DockCalibration(**values)


def _calibration_of(message: DockCalibration) -> Calibration | None:
    if math.isnan(message.roll):
        return None
    names = [field.name for field in fields(Calibration)]
    return Calibration(
        *(Learned(getattr(message, n), getattr(message, f"{n}_deviation")) for n in names)
    )


def undock_result(result: DockingResult) -> UndockResult:
    """Convert a result into a message of the action undock."""
    return UndockResult(result.success, int(result.error), result.message)


def status_of(result: DockingResult) -> int:
    """Return the status of actionlib for a result."""
    if result.success:
        return GoalStatus.SUCCEEDED
    preempted = result.error == DockingError.PREEMPTED
    return GoalStatus.PREEMPTED if preempted else GoalStatus.ABORTED


def dock_feedback(task: DockingTask) -> DockFeedback:
    """Return the feedback of the action."""
    status = task.status
    return DockFeedback(
        int(status.state), status.distance, status.lateral, status.yaw, status.retries
    )


def undock_feedback(task: UndockingTask) -> UndockFeedback:
    """Return the feedback of the action."""
    return UndockFeedback(task.remaining)
