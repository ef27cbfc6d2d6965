"""Conversions for controllers with actions: goals, feedback and results; trajectories."""

from __future__ import annotations

from typing import Any

import genpy
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from bullet_lab.ros.messages.gazebo_types import arm_msg
from bullet_lab.ros.messages.poses import set_time
from bullet_lab.simulation.plugins.samples import (
    GripperSample,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
    TrajectorySample,
)


def trajectory_of(message: JointTrajectory) -> Trajectory:
    """Return the trajectory in a message."""
    points = tuple(
        TrajectoryPoint(
            one.time_from_start.to_sec(), one.positions, one.velocities, one.accelerations
        )
        for one in message.points
    )
    return Trajectory(message.header.stamp.to_sec(), tuple(message.joint_names), points)


def fill_trajectory_state(message: Any, sample: TrajectorySample) -> None:
    """Write a sample into a state, or into feedback."""
    message.joint_names = sample.joints
    for name in ("desired", "actual", "error"):
        seconds, *lists = getattr(sample, name)
        point = JointTrajectoryPoint(*lists, (), genpy.Duration.from_sec(seconds))
        setattr(message, name, point)


def _goal_of(message: Any) -> TrajectoryGoal:
    path, goal = (
        {one.name: (one.position, one.velocity) for one in ones}
        for ones in (message.path_tolerance, message.goal_tolerance)
    )
    seconds = message.goal_time_tolerance.to_sec()
    return TrajectoryGoal(trajectory_of(message.trajectory), path, goal, seconds)


def _feedback(*fields: Any) -> Any:
    sample, message = TrajectorySample(*fields), arm_msg.FollowJointTrajectoryFeedback()
    set_time(message.header.stamp, sample.step)
    fill_trajectory_state(message, sample)
    return message


# By the name of an action: its class, a function that reads a goal, and those that make feedback
# and a result of their fields. Empty without the package control_msgs.
ACTIONS: dict[str, tuple] = {}
if arm_msg is not None:
    ACTIONS = {
        "follow_joint_trajectory": (
            arm_msg.FollowJointTrajectoryAction,
            _goal_of,
            _feedback,
            arm_msg.FollowJointTrajectoryResult,
        ),
        "gripper_cmd": (
            arm_msg.GripperCommandAction,
            lambda message: GripperSample(message.command.position, message.command.max_effort),
            arm_msg.GripperCommandFeedback,
            arm_msg.GripperCommandResult,
        ),
    }
