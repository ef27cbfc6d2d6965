"""What drive_to_goal says and shows of its goals."""

from __future__ import annotations

import math
from typing import List, Optional

import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import PoseStamped, Vector3
from nav_msgs.msg import Path
from std_msgs.msg import ColorRGBA, Float64, Header, Time
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.numerics.goal_driver import PlanarPose
from bullet_lab.ros.dock_goals import stamped_pose
from bullet_lab.ros.publishers import Publisher, lossless_publisher

# Of the path that was driven: m between two points, and how many are kept.
PATH_STEP = 0.02
MOST_POINTS = 5000
# Messages for RViz per tick of the driver.
SHOW_EVERY = 4
COLOURS = {
    GoalStatus.ACTIVE: ColorRGBA(0.0, 0.45, 0.7, 0.9),
    GoalStatus.SUCCEEDED: ColorRGBA(0.0, 0.62, 0.45, 0.9),
}
GIVEN_UP = ColorRGBA(0.84, 0.37, 0.0, 0.9)


class GoalTopics:
    """Publishes what becomes of goals: for machines at once, for RViz some times a second."""

    def __init__(self):
        self._status = lossless_publisher("~status", GoalStatus, latch=True)
        self._finished = lossless_publisher("~finished", Time, latch=True)
        self._goal = lossless_publisher("~current_goal", PoseStamped, latch=True)
        self._remaining = Publisher("~remaining", Float64, queue_size=10)
        self._markers = Publisher("~markers", MarkerArray, queue_size=1, latch=True)
        self._plan = Publisher("~plan", Path, queue_size=1, latch=True)
        self._path = Publisher("~path", Path, queue_size=1, latch=True)
        self._driven: List[PoseStamped] = []
        self._ticks = 0

    def say(self, goal_id: GoalID, status: int, text: str) -> None:
        """Tell what has become of a goal; `status` is one of actionlib's."""
        self._status.publish(GoalStatus(goal_id, status, text))

    def begin(self, stamp: rospy.Time, frame: str, goal: PlanarPose) -> None:
        """Tell which goal is driven to."""
        self._goal.publish(stamped_pose(stamp, frame, goal))
        self._driven = []
        self._ticks = 0

    def progress(
        self, stamp: rospy.Time, frame: str, pose: PlanarPose, goal: PlanarPose, tolerance: float
    ) -> None:
        """Tell how far it is, and show it now and then."""
        left = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        self._remaining.publish(Float64(left))
        self._note(stamped_pose(stamp, frame, pose))
        if self._ticks % SHOW_EVERY == 0:
            self._show(stamp, frame, goal, tolerance, GoalStatus.ACTIVE, left, pose)
        self._ticks += 1

    def end(
        self, stamp: rospy.Time, frame: str, goal: PlanarPose, tolerance: float, status: int,
        pose: Optional[PlanarPose],
    ) -> None:
        """Show how it ended and tell when."""
        left = math.nan
        if pose is not None:
            left = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
            self._remaining.publish(Float64(left))
        self._show(stamp, frame, goal, tolerance, status, left, None)
        self._finished.publish(Time(stamp))

    def _note(self, place: PoseStamped) -> None:
        if self._driven:
            last, new = self._driven[-1].pose.position, place.pose.position
            if math.hypot(new.x - last.x, new.y - last.y) < PATH_STEP:
                return
        self._driven.append(place)
        del self._driven[:-MOST_POINTS]

    def _show(
        self,
        stamp: rospy.Time,
        frame: str,
        goal: PlanarPose,
        tolerance: float,
        status: int,
        left: float,
        pose: Optional[PlanarPose],
    ) -> None:
        header = Header(0, stamp, frame)
        ahead = [] if pose is None else [stamped_pose(stamp, frame, p) for p in (pose, goal)]
        self._plan.publish(Path(header, ahead))
        self._path.publish(Path(header, list(self._driven)))
        colour = COLOURS.get(status, GIVEN_UP)
        # Not frame_locked: odometry frames stand still.
        self._markers.publish(MarkerArray(goal_markers(header, goal, tolerance, colour, left)))


def goal_markers(
    header: Header, goal: PlanarPose, tolerance: float, colour: ColorRGBA, left: float
) -> List[Marker]:
    """Return an arrow at the goal, its tolerance as a disc and what is left as a label.

    Args:
        header: stamp and frame.
        goal: m, m, rad.
        tolerance: m.
        colour: of arrow and disc.
        left: m to the goal; NaN for unknown.
    """
    pose = stamped_pose(header.stamp, header.frame_id, goal).pose
    arrow = Marker(header=header, ns="goal", id=0, type=Marker.ARROW, color=colour)
    arrow.scale = Vector3(0.4, 0.05, 0.05)
    disc = Marker(header=header, ns="goal", id=1, type=Marker.CYLINDER, color=colour)
    disc.scale = Vector3(2.0 * tolerance, 2.0 * tolerance, 0.01)
    label = Marker(header=header, ns="goal", id=2, type=Marker.TEXT_VIEW_FACING)
    label.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
    label.scale.z = 0.2
    label.text = "" if math.isnan(left) else f"{left:.2f} m"
    for marker in (arrow, disc, label):
        marker.pose.position.x, marker.pose.position.y = goal[:2]
        marker.pose.orientation = pose.orientation
    arrow.pose.position.z, label.pose.position.z = 0.1, 0.4
    # RViz complains of a label without text.
    return [arrow, disc, label] if label.text else [arrow, disc]
