"""Messages as what reports take: stamp, numbers, and what else they say."""

from __future__ import annotations

from typing import Any, Callable, Dict, Tuple

from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import Image, Imu, LaserScan, Range
from std_msgs.msg import Time

from bullet_lab.core.angles import yaw_from_quaternion
from bullet_lab.docking.types import DockingState
from bullet_lab.msg import DockActionFeedback, ImagePoints, MarkerDetectionArray, TouchedModels
from bullet_lab.reports import Reading
from bullet_lab.reports.goal import GoalAnswer
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.node.odometry import FrameGuard, planar_pose

Reader = Callable[[Any], Reading]


def reader_of(kind: str) -> Tuple[type, Reader]:
    """Return the class of a type of messages, and what reads those of one topic."""
    message_type, read = _READERS[kind]
    return message_type, _odometry_reader() if message_type is Odometry else read


def _odometry_reader() -> Reader:
    """Return a reader of poses in the frames of the first one."""
    guard = FrameGuard()

    def read(message: Odometry) -> Reading:
        pose = planar_pose(message)
        guard.check(message)
        entries = message.pose.covariance
        return _reading(message, pose, ((entries[0], entries[1]), (entries[6], entries[7])))

    return read


def _reading(message: Any, values: Tuple[float, ...] = (), detail: Any = None) -> Reading:
    return Reading(message.header.stamp.to_nsec(), values, detail)


def _scan(message: LaserScan) -> Reading:
    """Ranges; the detail is the angle of the first ray and the step to the next."""
    return _reading(message, message.ranges, (message.angle_min, message.angle_increment))


def _inertial(message: Imu) -> Reading:
    force, rate = message.linear_acceleration, message.angular_velocity
    return _reading(message, (force.x, force.y, force.z, rate.x, rate.y, rate.z))


def _contacts(message: msg.ContactsState) -> Reading:
    """Number of points and the sum of the forces; the detail is who was touched."""
    points = sum(len(state.contact_positions) for state in message.states)
    forces = [state.total_wrench.force for state in message.states]
    sums = (sum(getattr(force, axis) for force in forces) for axis in "xyz")
    names = [state.collision2_name.split("::")[0] for state in message.states]
    return _reading(message, (points, *sums), names)


def _goal(message: PoseStamped) -> Reading:
    place, turn = message.pose.position, message.pose.orientation
    return _reading(
        message, (place.x, place.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w))
    )


def _goal_status(message: GoalStatus) -> Reading:
    """The detail is a GoalAnswer."""
    status, text = message.status, message.text
    rejected = status in (GoalStatus.REJECTED, GoalStatus.RECALLED)
    reached = status == GoalStatus.SUCCEEDED
    return Reading(0, (), GoalAnswer(message.goal_id.id, text, rejected, reached))


def _touched(message: TouchedModels) -> Reading:
    """The detail is how often each model was touched."""
    return _reading(message, (), dict(zip(message.models, message.touches)))


def _docking_state(message: DockActionFeedback) -> Reading:
    """The detail is what the robot is doing."""
    return _reading(message, (), DockingState(message.feedback.state).label)


def _plan(message: Path) -> Reading:
    """The detail is x and y (m) of each pose."""
    places = (stamped.pose.position for stamped in message.poses)
    return _reading(message, (), [(place.x, place.y) for place in places])


def _points(message: ImagePoints) -> Reading:
    """The detail is x and y (px) of each point."""
    return _reading(message, (), [(point.x, point.y) for point in message.points])


_READERS: Dict[str, Tuple[type, Reader]] = {
    # The detail is the covariance of x and y, m².
    "nav_msgs/Odometry": (Odometry, _odometry_reader()),
    "sensor_msgs/Range": (Range, lambda m: _reading(m, (m.range,))),
    "sensor_msgs/LaserScan": (LaserScan, _scan),
    "sensor_msgs/Imu": (Imu, _inertial),
    "gazebo_msgs/ContactsState": (msg.ContactsState, _contacts),
    "geometry_msgs/PoseStamped": (PoseStamped, _goal),
    "actionlib_msgs/GoalStatus": (GoalStatus, _goal_status),
    "std_msgs/Time": (Time, lambda m: Reading(m.data.to_nsec())),
    "bullet_lab/TouchedModels": (TouchedModels, _touched),
    # The detail is the picture, (h, w, 3) uint8, blue green red.
    "sensor_msgs/Image": (Image, lambda m: _reading(m, (), pixels_of(m, "bgr8"))),
    "bullet_lab/DockActionFeedback": (DockActionFeedback, _docking_state),
    "nav_msgs/Path": (Path, _plan),
    "bullet_lab/ImagePoints": (ImagePoints, _points),
    # The detail is the detections as they are.
    "bullet_lab/MarkerDetectionArray": (
        MarkerDetectionArray,
        lambda m: _reading(m, (), m.detections),
    ),
}
