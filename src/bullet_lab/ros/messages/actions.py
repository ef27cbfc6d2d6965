"""Conversions for controllers with actions: goals, feedback and results; trajectories."""

from __future__ import annotations

from typing import Any, Callable, NamedTuple

import genpy
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from bullet_lab.ros.messages.gazebo_types import arm_msg
from bullet_lab.ros.messages.poses import set_time
from bullet_lab.simulation.plugins.samples import (
    GripperGoal,
    GripperSample,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
    TrajectorySample,
)


class ActionKind(NamedTuple):
    """The class of an action, and functions between its messages and plain data."""

    kind: type
    goal_of: Callable[[Any], Any]
    feedback: Callable[[Any], Any]
    result: Callable[[Any], Any]


def trajectory_of(message: JointTrajectory) -> Trajectory:
    """Return the trajectory in a message."""
    points = tuple(
        TrajectoryPoint(
            point.time_from_start.to_sec(), point.positions, point.velocities, point.accelerations
        )
        for point in message.points
    )
    return Trajectory(message.header.stamp.to_sec(), tuple(message.joint_names), points)


def fill_trajectory_state(message: Any, sample: TrajectorySample) -> None:
    """Write a sample into a state, or into feedback."""
    message.joint_names = sample.names
    for name in ("desired", "actual", "error"):
        setattr(message, name, _point(getattr(sample, name)))


def _point(point: TrajectoryPoint) -> JointTrajectoryPoint:
    seconds = genpy.Duration.from_sec(point.seconds)
    return JointTrajectoryPoint(point.positions, point.velocities, point.accelerations, (), seconds)


def _goal_of(message: Any) -> TrajectoryGoal:
    tolerances = (
        {one.name: (one.position, one.velocity) for one in ones}
        for ones in (message.path_tolerance, message.goal_tolerance)
    )
    seconds = message.goal_time_tolerance.to_sec()
    return TrajectoryGoal(trajectory_of(message.trajectory), *tolerances, seconds)


def _feedback(sample: TrajectorySample) -> Any:
    message = arm_msg.FollowJointTrajectoryFeedback()
    set_time(message.header.stamp, sample.step)
    fill_trajectory_state(message, sample)
    return message


def _gripper(kind: type) -> Callable[[GripperSample], Any]:
    return lambda one: kind(one.position, one.effort, one.stalled, one.reached)


# By the classes of goals; empty without the package control_msgs.
ACTIONS: dict[type, ActionKind] = {}
if arm_msg is not None:
    ACTIONS = {
        TrajectoryGoal: ActionKind(
            arm_msg.FollowJointTrajectoryAction,
            _goal_of,
            _feedback,
            lambda result: arm_msg.FollowJointTrajectoryResult(*result),
        ),
        GripperGoal: ActionKind(
            arm_msg.GripperCommandAction,
            lambda goal: GripperGoal(goal.command.position, goal.command.max_effort),
            _gripper(arm_msg.GripperCommandFeedback),
            _gripper(arm_msg.GripperCommandResult),
        ),
    }
