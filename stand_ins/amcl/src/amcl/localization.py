"""The nodes fake_localization and amcl: where the robot is on the map, by the truth.

:ROS Parameters: see `FakeLocalizationParameters` and `AmclParameters`; others are ignored
:ROS Subscribers:
    - base_pose_ground_truth (nav_msgs/Odometry): the truth. If nothing comes there, the robot's
      link ~base_frame_id tells it, by /gazebo/get_link_state
    - initialpose (geometry_msgs/PoseWithCovarianceStamped)
:ROS Publishers:
    - amcl_pose (geometry_msgs/PoseWithCovarianceStamped)
    - particlecloud (geometry_msgs/PoseArray): one pose
    - /tf: from the map's frame to the odometry's
:ROS Services, of amcl: global_localization (std_srvs/Empty)
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import rospy
import tf2_ros
from gazebo_msgs.srv import GetLinkState
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped, Transform, TransformStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from std_srvs.srv import Empty

from bullet_lab.core.parameters import integer, number, read_parameters, text
from bullet_lab.core.pose import Vector
from bullet_lab.core.se2 import PlanarPose, between, compose, inverse, wrap
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import pose_of, stamped_pose
from bullet_lab.ros.node.lock_step import Publisher
from bullet_lab.ros.node.node import NodeError, Refusals, run_node
from bullet_lab.ros.node.odometry import planar_pose
from bullet_lab.ros.node.tf_buffer import CarefulBuffer

LINK_STATE = "/gazebo/get_link_state"
RATE = 20.0
# Wall seconds without base_pose_ground_truth after which the simulator is asked.
PATIENCE = 2.0
# m and rad within which amcl's particles would come to the truth from a pose that was given.
NEAR, NEAR_YAW = 1.0, 0.8


@dataclass(frozen=True)
class FakeLocalizationParameters:
    """Private parameters of fake_localization; frames without a leading slash."""

    odom_frame_id: str = text("odom", "frame of the odometry")
    global_frame_id: str = text("map", "frame of the map")
    base_frame_id: str = text("base_link", "frame of the robot")
    transform_tolerance: float = number(0.1, "s by which /tf is dated ahead", minimum=0.0)
    delta_x: float = number(0.0, "m, of the world's origin in the map")
    delta_y: float = number(0.0, "m, of the world's origin in the map")
    delta_yaw: float = number(0.0, "rad, of the world in the map")


@dataclass(frozen=True)
class AmclParameters(FakeLocalizationParameters):
    """Private parameters of amcl, and of the noise that it may have here."""

    update_min_d: float = number(0.2, "m after which the error is drawn anew", minimum=0.0)
    update_min_a: float = number(0.5236, "rad after which the error is drawn anew", minimum=0.0)
    truth_std: float = number(0.0, "standard deviation of x and y, m", minimum=0.0)
    truth_yaw_std: float = number(0.0, "standard deviation of the yaw, rad", minimum=0.0)
    seed: int = integer(0, "of the errors", minimum=0)


class Localization:
    """Publishes the frame of the odometry in that of the map, so that the robot is where it is.

    Args:
        parameters: of the node.
        converges: whether a pose that is given near the truth changes nothing, as with amcl.
        noise: standard deviations of the pose: m, m, rad.
    """

    def __init__(
        self,
        parameters: FakeLocalizationParameters,
        converges: bool = False,
        noise: Vector = (0.0, 0.0, 0.0),
    ):
        self._parameters, self._converges, self._noise = parameters, converges, noise
        self._delta = (parameters.delta_x, parameters.delta_y, parameters.delta_yaw)
        self._offset: Any = self._delta
        self._random = np.random.default_rng(getattr(parameters, "seed", 0))
        self._error = np.zeros(3)
        self._drawn: PlanarPose | None = None
        # s and pose in the world, the newest last.
        self._truths: deque[tuple[float, PlanarPose]] = deque(maxlen=200)
        self._has_topic = False
        self._sent = rospy.Time(0)
        self._refusals = Refusals()
        self._buffer = CarefulBuffer()
        self._sender = tf2_ros.TransformBroadcaster()
        self._pose = Publisher("amcl_pose", PoseWithCovarianceStamped, queue_size=1, latch=True)
        self._cloud = Publisher("particlecloud", PoseArray, queue_size=1, latch=True)
        rospy.Subscriber("base_pose_ground_truth", Odometry, self._take, queue_size=50)
        rospy.Subscriber("initialpose", PoseWithCovarianceStamped, self._place, queue_size=1)
        self._ask = rospy.ServiceProxy(LINK_STATE, GetLinkState)

    def run(self, start: PlanarPose | None = None) -> None:
        """Publish until ROS shuts down; the robot starts at a pose, if one is given."""
        rospy.rostime.wallsleep(PATIENCE)
        while not rospy.is_shutdown():
            if not self._has_topic:
                self._ask_for_truth()
            if start is not None and self._truths:
                self.put(start)
                start = None
            self._publish()
            rospy.sleep(1.0 / RATE)

    def reset(self, _request: Any = None) -> list:
        """Return to where the parameters say that the map is."""
        self._offset = self._delta
        return []

    # The truth

    def _take(self, message: Odometry) -> None:
        with self._refusals.on("base_pose_ground_truth"):
            self._has_topic = True
            self._add(message.header.stamp.to_sec(), planar_pose(message))

    def _add(self, seconds: float, pose: PlanarPose) -> None:
        if self._truths and seconds < self._truths[-1][0]:
            self._truths.clear()
        self._truths.append((seconds, pose))

    def _ask_for_truth(self) -> None:
        link = self._parameters.base_frame_id
        try:
            state = self._ask(link, "world")
            if not state.success:
                raise NodeError(state.status_message)
            pose = pose_of(state.link_state.pose.position, state.link_state.pose.orientation)
        except (rospy.ServiceException, LabError) as error:
            rospy.logwarn_throttle(10.0, f"no true pose yet: {LINK_STATE}: {error}")
        else:
            self._add(rospy.get_time(), (*pose.position[:2], pose.yaw))

    def _truth_at(self, seconds: float) -> PlanarPose | None:
        """Return the truth at a time, between two poses; None if it is not known."""
        truths = list(self._truths)
        if not truths or seconds < truths[0][0]:
            return None
        times = [time for time, _ in truths]
        poses = np.array([pose for _, pose in truths])
        poses[:, 2] = np.unwrap(poses[:, 2])
        return tuple(float(np.interp(seconds, times, column)) for column in poses.T)

    # The map

    def _place(self, message: PoseWithCovarianceStamped) -> None:
        """Take a pose that is given: where the robot is on the map."""
        with self._refusals.on("initialpose"):
            pose = pose_of(message.pose.pose.position, message.pose.pose.orientation)
            self.put((*pose.position[:2], pose.yaw))

    def put(self, pose: PlanarPose) -> None:
        """Have the robot at a pose on the map; amcl's stays with the truth if it is near."""
        if not self._truths:
            return
        truth = self._truths[-1][1]
        dx, dy, turn = between(compose(self._offset, truth), pose).tolist()
        if self._converges and math.hypot(dx, dy) <= NEAR and abs(wrap(turn)) <= NEAR_YAW:
            return
        self._offset = compose(pose, inverse(truth))
        rospy.loginfo("the map now has the robot at (%.2f, %.2f) m, %.2f rad", *pose)

    def _draw(self, truth: PlanarPose) -> np.ndarray:
        """Return the error of the robot's pose, which is drawn anew when it has moved."""
        spread, least = self._noise, self._parameters
        if any(spread) and (self._drawn is None or _has_moved(self._drawn, truth, least)):
            self._drawn = truth
            self._error = self._random.normal(0.0, spread)
        return self._error

    def _publish(self) -> None:
        frames = self._parameters
        names = [name.lstrip("/") for name in (frames.odom_frame_id, frames.base_frame_id)]
        try:
            found = self._buffer.lookup_transform(*names, rospy.Time(0))
            robot = pose_of(found.transform.translation, found.transform.rotation)
        except (tf2_ros.TransformException, LabError) as error:
            rospy.logwarn_throttle(10.0, f"no odometry on /tf: {error}")
            return
        stamp, world = found.header.stamp, frames.global_frame_id.lstrip("/")
        truth = self._truth_at(stamp.to_sec())
        if truth is None or stamp == self._sent:
            return
        self._sent = stamp
        there = compose(compose(self._offset, truth), self._draw(truth))
        header = Header(stamp=stamp, frame_id=world)
        message = PoseWithCovarianceStamped(header=header)
        message.pose.pose = stamped_pose(stamp, world, tuple(there.tolist())).pose
        covariance = np.zeros((6, 6))
        covariance[[0, 1, 5], [0, 1, 5]] = np.square(self._noise)
        message.pose.covariance = covariance.ravel().tolist()
        self._pose.publish(message)
        self._cloud.publish(PoseArray(header, [message.pose.pose]))
        origin = compose(there, inverse((*robot.position[:2], robot.yaw)))
        placed = stamped_pose(stamp, world, tuple(origin.tolist())).pose
        moved = Transform(rotation=placed.orientation)
        moved.translation.x, moved.translation.y = placed.position.x, placed.position.y
        later = Header(stamp=stamp + rospy.Duration(frames.transform_tolerance), frame_id=world)
        self._sender.sendTransform(TransformStamped(later, names[0], moved))


def _has_moved(before: PlanarPose, now: PlanarPose, least: AmclParameters) -> bool:
    away = math.dist(before[:2], now[:2])
    return away >= least.update_min_d or abs(wrap(now[2] - before[2])) >= least.update_min_a


def _parameters(kind: type) -> Any:
    # Those of the real node that have no meaning here are ignored.
    return read_parameters(kind, rospy.get_param)


def _run_amcl() -> None:
    parameters = _parameters(AmclParameters)
    noise = (parameters.truth_std, parameters.truth_std, parameters.truth_yaw_std)
    rospy.logwarn("this amcl localizes by the true pose of the simulation, not by the laser")
    localization = Localization(parameters, True, noise)
    rospy.Service("global_localization", Empty, localization.reset)
    given = tuple(float(rospy.get_param(f"~initial_pose_{axis}", 0.0)) for axis in "xya")
    # Zeros are amcl's defaults, and those of launch files whose user gives the pose in RViz.
    localization.run(given if any(given) else None)


def amcl() -> None:
    """Run amcl."""
    run_node("amcl", _run_amcl)


def fake_localization() -> None:
    """Run fake_localization."""
    run_node(
        "fake_localization",
        lambda: Localization(_parameters(FakeLocalizationParameters)).run(),
    )
