"""What docking shows of itself in RViz."""

from __future__ import annotations

from typing import Optional, Sequence, Tuple

import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from bullet_lab.docking.types import PlanarPose
from bullet_lab.ros.dock_goals import stamped_pose, stamped_transform
from bullet_lab.ros.publishers import Publisher


class DockTopics:
    """Publishes ~dock_pose, ~plan and, on /tf, the frame of the dock.

    Args:
        child: name of the dock's frame on TF; empty for none.
    """

    def __init__(self, child: str):
        self._child = child
        self._pose = Publisher("~dock_pose", PoseStamped, queue_size=10)
        self._plan = Publisher("~plan", Path, queue_size=1, latch=True)
        self._tf = tf2_ros.TransformBroadcaster() if child else None
        self._shown: Optional[Tuple[Tuple[float, float], ...]] = None

    def publish(
        self,
        stamp: rospy.Time,
        frame: str,
        pose: Optional[PlanarPose],
        plan: Sequence[Tuple[float, float]],
    ) -> None:
        """Show the filtered pose of the dock, if there is one, and the way that is planned.

        Args:
            stamp: the present time.
            frame: of the odometry, in which the others are given.
            pose: of the dock, m and rad.
            plan: points in m.
        """
        if pose is not None:
            message = stamped_pose(stamp, frame, pose)
            self._pose.publish(message)
            if self._tf is not None:
                self._tf.sendTransform(stamped_transform(message, self._child))
        plan = tuple(plan)
        if plan != self._shown:
            self._shown = plan
            self._plan.publish(_path(stamp, frame, plan))


def _path(stamp: rospy.Time, frame: str, points: Sequence[Tuple[float, float]]) -> Path:
    path = Path()
    path.header.stamp, path.header.frame_id = stamp, frame
    path.poses = [stamped_pose(stamp, frame, (x, y, 0.0)) for x, y in points]
    return path
