"""Poses and velocities between Gazebo's messages and the simulation."""

from __future__ import annotations

import math
from typing import Any, Tuple

from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import Twist

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.conversions import set_pose
from bullet_lab.simulation.world.description import FrameState


class MessageError(LabError):
    """A message holds what cannot be meant."""


def vector_of(message: Any, what: str) -> Vector:
    """Return x, y and z of a message; raises MessageError for what is not finite."""
    values = (message.x, message.y, message.z)
    if not all(map(math.isfinite, values)):
        raise MessageError(f"{what} is not finite: {values}")
    return values


def pose_of(message: PoseMessage) -> Pose:
    """Return a pose with its quaternion normalised, as Gazebo does it.

    (0, 0, 0, 0), which messages start with, means no rotation.

    Raises:
        MessageError: a number is not finite.
    """
    turn = message.orientation
    quaternion = (turn.x, turn.y, turn.z, turn.w)
    if not all(map(math.isfinite, quaternion)):
        raise MessageError(f"the orientation is not finite: {quaternion}")
    # Scaled first: the squares of huge numbers overflow.
    largest = max(map(abs, quaternion))
    position = vector_of(message.position, "the position")
    if largest == 0.0:
        return Pose(position)
    scaled = [value / largest for value in quaternion]
    length = math.sqrt(sum(value * value for value in scaled))
    x, y, z, w = (value / length for value in scaled)
    return Pose(position, (x, y, z, w))


def twist_of(message: Twist) -> Tuple[Vector, Vector]:
    """Return linear and angular velocity; raises MessageError for what is not finite."""
    linear = vector_of(message.linear, "the linear velocity")
    return linear, vector_of(message.angular, "the angular velocity")


def state_of(message: Any) -> FrameState:
    """Return pose and velocity of a ModelState or LinkState message; raises MessageError."""
    return FrameState(pose_of(message.pose), *twist_of(message.twist))


def twist_message(state: FrameState) -> Twist:
    """Return a velocity as a message."""
    twist = Twist()
    twist.linear.x, twist.linear.y, twist.linear.z = state.linear
    twist.angular.x, twist.angular.y, twist.angular.z = state.angular
    return twist


def set_state(message: Any, state: FrameState) -> None:
    """Write a state into a message with a pose and a twist."""
    set_pose(message.pose, state.pose)
    message.twist = twist_message(state)
