"""Conversions of times, poses and velocities to messages and back, and markers for RViz."""

from __future__ import annotations

import math
from typing import Any, Iterable

import genpy
from geometry_msgs.msg import Point, PoseStamped, Twist, Vector3
from geometry_msgs.msg import Pose as PoseMessage
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from bullet_lab.core.pose import Pose, Quaternion, Vector
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.core.se2 import PlanarPose, quaternion_from_yaw
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import FrameState

NANOSECONDS_PER_STEP = 1_000_000_000 // STEPS_PER_SECOND
# Largest deviation of a quaternion's length from 1; a larger one is an error, such as all zeros.
NORM_TOLERANCE = 1e-2


class InputError(LabError):
    """A message has invalid values."""


def set_time(stamp: genpy.Time, step: int) -> None:
    """Set a stamp to the simulated time of a step."""
    stamp.secs, rest = divmod(step, STEPS_PER_SECOND)
    stamp.nsecs = rest * NANOSECONDS_PER_STEP


def time_of(step: int) -> genpy.Time:
    """Return the simulated time of a step."""
    stamp = genpy.Time()
    set_time(stamp, step)
    return stamp


def first_step_at(stamp: genpy.Time) -> int:
    """Return the first step at or after a simulated time."""
    return stamp.secs * STEPS_PER_SECOND - (-stamp.nsecs // NANOSECONDS_PER_STEP)


def set_vector(message: Any, vector: Vector) -> None:
    """Write x, y and z into a message."""
    message.x, message.y, message.z = vector


def set_quaternion(message: Any, quaternion: Quaternion) -> None:
    """Write a unit quaternion into a message, with w >= 0: its negative means the same."""
    x, y, z, w = quaternion
    message.x, message.y, message.z, message.w = (-x, -y, -z, -w) if w < 0.0 else quaternion


def set_pose(message: PoseMessage, pose: Pose) -> None:
    """Write a pose into a message."""
    set_vector(message.position, pose.position)
    set_quaternion(message.orientation, pose.quaternion)


def pose_message(pose: Pose) -> PoseMessage:
    """Return a pose as a message."""
    message = PoseMessage()
    set_pose(message, pose)
    return message


def pose_of(point: Any, orientation: Any) -> Pose:
    """Return the pose of a position and a quaternion; raises InputError."""
    position = (point.x, point.y, point.z)
    quaternion = (orientation.x, orientation.y, orientation.z, orientation.w)
    if not all(map(math.isfinite, position + quaternion)):
        raise InputError("a pose that is not finite")
    norm = math.sqrt(sum(value * value for value in quaternion))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise InputError(f"an orientation of length {norm:.3g} is no unit quaternion")
    return Pose(position, tuple(value / norm for value in quaternion))


def vector_of(message: Any, what: str) -> Vector:
    """Return x, y and z of a message; raises InputError if one is not finite."""
    values = (message.x, message.y, message.z)
    if not all(map(math.isfinite, values)):
        raise InputError(f"{what} is not finite: {values}")
    return values


def normalised_pose(message: PoseMessage) -> Pose:
    """Return a pose with its quaternion normalised, as Gazebo does.

    (0, 0, 0, 0), the default of a message, means no rotation.

    Raises:
        InputError: a number is not finite.
    """
    orientation = message.orientation
    quaternion = (orientation.x, orientation.y, orientation.z, orientation.w)
    length = math.hypot(*quaternion)
    if not math.isfinite(length):
        raise InputError(f"the orientation is not finite: {quaternion}")
    position = vector_of(message.position, "the position")
    if length == 0.0:
        return Pose(position)
    return Pose(position, tuple(value / length for value in quaternion))


def twist_of(message: Twist) -> tuple[Vector, Vector]:
    """Return linear and angular velocity; raises InputError if one is not finite."""
    linear = vector_of(message.linear, "the linear velocity")
    angular = vector_of(message.angular, "the angular velocity")
    return linear, angular


def twist_message(state: FrameState) -> Twist:
    """Return a velocity as a message."""
    return Twist(Vector3(*state.linear), Vector3(*state.angular))


def stamped_pose(stamp: genpy.Time, frame: str, pose: PlanarPose) -> PoseStamped:
    """Return x (m), y (m) and yaw (rad) in a frame as a message."""
    x, y, yaw = pose
    placed = Pose((x, y, 0.0), quaternion_from_yaw(yaw))
    return PoseStamped(Header(0, stamp, frame), pose_message(placed))


def marker(
    header: Header,
    name: str,
    kind: int,
    colour: ColorRGBA,
    scale: Vector,
    position: Vector = (0.0, 0.0, 0.0),
    points: Iterable[Vector] = (),
) -> Marker:
    """Return marker 0 of a namespace, in the directions of its frame."""
    made = Marker(header=header, ns=name, type=kind, color=colour)
    made.scale = Vector3(*scale)
    made.pose = pose_message(Pose(position))
    made.points = [Point(*point) for point in points]
    return made
