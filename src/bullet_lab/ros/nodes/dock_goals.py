"""From the goals of the dock actions to tasks, and from their state to messages."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Callable, Mapping, Optional, Tuple

from geometry_msgs.msg import PoseStamped, TransformStamped

from bullet_lab.core.angles import quaternion_from_yaw
from bullet_lab.core.pose import Pose
from bullet_lab.docking.database import Dock, UnknownDockError, find_dock
from bullet_lab.docking.types import DockingError, DockingResult, DockingStatus, PlanarPose
from bullet_lab.errors import LabError
from bullet_lab.msg import DockFeedback, DockGoal, DockResult, UndockGoal, UndockResult
from bullet_lab.ros.messages.poses import InputError, pose_of

# A robot on a floor: a dock pose that leans by more than this (rad) is a mistake.
LARGEST_LEAN = 0.2
LONGEST_UNDOCK = 10.0

Lookup = Callable[[str, str], Pose]


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


def dock_of(goal: DockGoal, docks: Mapping[str, Dock], usual: str) -> Dock:
    """Return the dock that is meant, of the database; `usual` says what one given by pose is like.

    Raises:
        GoalError: there is none of that name.
    """
    try:
        return find_dock(docks, goal.dock_id or usual)
    except UnknownDockError as error:
        raise GoalError(DockingError.NOT_IN_DATABASE, str(error)) from None


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


def with_tolerances(dock: Dock, distance: float, lateral: float, yaw: float) -> Dock:
    """Return a dock with other tolerances (m, m, rad) where they are not 0."""
    own = dock.tolerance
    wanted = replace(
        own,
        distance=distance or own.distance,
        lateral=lateral or own.lateral,
        yaw=yaw or own.yaw,
    )
    return replace(dock, tolerance=wanted)


def dock_result(result: DockingResult) -> DockResult:
    """Return a result as the action sends it."""
    return DockResult(
        result.success,
        int(result.error),
        result.message,
        result.retries,
        result.distance,
        result.lateral,
        result.yaw,
    )


def undock_result(result: DockingResult) -> UndockResult:
    """Return a result as the action sends it."""
    return UndockResult(result.success, int(result.error), result.message)


def dock_feedback(status: DockingStatus) -> DockFeedback:
    """Return how it goes as the action sends it."""
    return DockFeedback(
        int(status.state), status.distance, status.lateral, status.yaw, status.retries
    )


def stamped_pose(stamp, frame: str, pose: PlanarPose) -> PoseStamped:
    """Return a planar pose as a message."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = stamp, frame
    message.pose.position.x, message.pose.position.y = pose[:2]
    turn = message.pose.orientation
    turn.x, turn.y, turn.z, turn.w = quaternion_from_yaw(pose[2])
    return message


def stamped_transform(pose: PoseStamped, child: Optional[str]) -> TransformStamped:
    """Return where a frame is as TF sends it."""
    message = TransformStamped(header=pose.header, child_frame_id=child)
    place = message.transform.translation
    place.x, place.y = pose.pose.position.x, pose.pose.position.y
    message.transform.rotation = pose.pose.orientation
    return message
