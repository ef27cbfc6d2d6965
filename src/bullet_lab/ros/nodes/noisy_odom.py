"""Adds noise and systematic errors to perfect odometry, so that it is like real odometry.

:ROS Parameters: see `NoisyOdomParameters`.
:ROS Subscribers: odom (nav_msgs/Odometry)
:ROS Publishers:
    - noisy_odom (nav_msgs/Odometry), one message for each on odom, with its stamp
    - noisy_odom_ellipse (visualization_msgs/Marker): 95 % ellipse of the position
    - left_ticks, right_ticks (std_msgs/Int32), with ~ticks_per_metre: counts of the encoders
:ROS Services: noisy_odom_node/set_noise (bullet_lab/SetNoise): change the noise

With ~robots, one node serves that many robots, each in its namespace: robot1 and so on.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from io import BytesIO

import numpy as np
import rospy
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry
from std_msgs.msg import ColorRGBA, Int32
from visualization_msgs.msg import Marker

from bullet_lab.core.parameters import boolean, check_parameters, choice, integer, number
from bullet_lab.core.se2 import PlanarPose, ellipse_points, quaternion_from_yaw
from bullet_lab.errors import LabError
from bullet_lab.noise.noisy_odom import OdometryNoise, preset
from bullet_lab.noise.odometry_noise import (
    MODELS,
    NoisyStep,
    ReportRule,
    derived_seed,
    named_alphas,
    noise_parameters,
    rule_of,
)
from bullet_lab.noise.published_noise import PUBLISHED_RATE
from bullet_lab.noise.systematic import SystematicErrors, SystematicSpread
from bullet_lab.ros.messages.poses import marker
from bullet_lab.ros.node.lock_step import Publisher, join_when, publisher, subscriber
from bullet_lab.ros.node.node import Refusals, node, spin
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, check_twist
from bullet_lab.ros.nodes.drive_squares import MOST_ROBOTS, robot_names
from bullet_lab.srv import SetNoise, SetNoiseRequest, SetNoiseResponse

# Indices of x, y and yaw in the 6x6 covariances of ROS (REP 103).
PLANAR_AXES = (0, 1, 5)
QUEUE_SIZE = 100
BLUE = ColorRGBA(0.0, 0.45, 0.7, 1.0)


@dataclass(frozen=True)
class NoisyOdomParameters(noise_parameters(), SystematicErrors, SystematicSpread):
    """Private parameters of noisy_odom, with those of noise models, systematic errors and spread.

    The noise is added to the odometry with the systematic errors.
    """

    model: str = choice("report", "rule of the noise", MODELS)
    noise: str = preset()
    seed: int = integer(0, "of the random draws", minimum=0)
    robots: int = integer(
        0, "serve robot1 … robot<n>, each with a seed of its own derived from ~seed", 0, MOST_ROBOTS
    )
    as_published: bool = boolean(False, "run the report's algorithm with its defects")
    rate: float = number(
        PUBLISHED_RATE, "Hz at which as_published samples the odometry", above=0.0
    )


class NoisyOdometry:
    """Adds noise to odom and publishes noisy_odom.

    Args:
        parameters: of this robot.
        namespace: of the robot, with a slash at its end; empty for the node's own.
    """

    def __init__(self, parameters: NoisyOdomParameters, namespace: str = ""):
        self._noise = OdometryNoise(parameters, parameters.rate)
        parameters = self._noise.parameters
        self.std = parameters.std
        self.msg: Odometry | None = None
        self._model = parameters.model
        self._values = asdict(parameters)
        self._as_published = parameters.as_published
        self._frames = FrameGuard()
        self._refusals = Refusals()
        self.pub = publisher(f"{namespace}noisy_odom", Odometry, QUEUE_SIZE)
        sides = ("left", "right") if parameters.ticks_per_metre else ()
        self._ticks = [publisher(f"{namespace}{side}_ticks", Int32, QUEUE_SIZE) for side in sides]
        self._ellipse = Publisher(f"{namespace}noisy_odom_ellipse", Marker, queue_size=1)
        self._service = rospy.Service(_service_name(namespace), SetNoise, self.set_noise)
        self._topic = f"{namespace}odom"
        # No queue size: each message is a step of the noisy path.
        self.sub = subscriber(self._topic, Odometry, self.odom_callback)

    def odom_callback(self, msg: Odometry) -> None:
        """Take the next message; refuse one that is invalid or has other frames than the first."""
        with self._refusals.on(self._topic):
            check_twist(msg)
            pose = self._frames.check(msg)
            seconds = self._seconds_before(msg)
            self.msg = msg
            step = self._noise.update(msg.header.stamp.to_sec(), pose)
            for ticks, count in zip(self._ticks, self._noise.ticks):
                # As a counter of 32 bits.
                ticks.publish(Int32((count + 2**31) % 2**32 - 2**31))
            if step is None:
                return
            noisy = _at(msg, step.pose)
            _add_noise(noisy, step, seconds)
            self.pub.publish(noisy)
            if self._ellipse.has_connections() and not self._as_published:
                self._ellipse.publish(ellipse_marker(noisy, step.covariance))

    def set_noise(self, request: SetNoiseRequest) -> SetNoiseResponse:
        """Change the noise from the next message on."""
        if self._as_published:
            return SetNoiseResponse(False, "set_noise: as_published has the report's noise only")
        model, noise = request.model or self._model, {**self._values, "std": request.std}
        try:
            # Also for a model without it: the next request may name another one.
            check_parameters(ReportRule(request.std))
            if request.alphas:
                noise.update(named_alphas(model, request.alphas))
            rule = rule_of(model, noise)
            check_parameters(rule)
        except LabError as error:
            return SetNoiseResponse(False, str(error))
        self._noise.path.change_rule(rule)
        self.std = request.std
        self._model = model
        self._values = noise
        rospy.loginfo("noise is now %s with std %g", model, request.std)
        return SetNoiseResponse(True, "")

    def _seconds_before(self, msg: Odometry) -> float | None:
        """Return the time from the message before, None for the first one of a path.

        If time was set back, a new path starts. Raises OdometryError for a duplicate stamp.
        """
        if self.msg is None:
            return None
        seconds = (msg.header.stamp - self.msg.header.stamp).to_sec()
        if seconds == 0.0:
            raise OdometryError(f"duplicate stamp {msg.header.stamp.to_sec():.9f} s")
        if seconds > 0.0:
            return seconds
        rospy.loginfo("time was set back: starting a new noisy path")
        self._noise.restart()
        return None


def _service_name(namespace: str) -> str:
    """Return the name of set_noise, as if a node ran in each namespace."""
    if not namespace:
        return "~set_noise"
    own = rospy.get_name().rsplit("/", 1)[-1]
    return f"{namespace}{own}/set_noise"


def robots_of(parameters: NoisyOdomParameters) -> dict[str, NoisyOdomParameters]:
    """Return the parameters of each robot by its namespace, with a slash at its end."""
    if not parameters.robots:
        return {"": parameters}
    return {
        f"{name}/": replace(parameters, seed=derived_seed(parameters.seed, index))
        for index, name in enumerate(robot_names(parameters.robots))
    }


def _at(msg: Odometry, pose: PlanarPose) -> Odometry:
    """Return a copy of a message at another pose; nothing that may change is shared.

    The node in the report changed the message that it also kept as the last perfect one.
    """
    data = BytesIO()
    msg.serialize(data)
    moved = Odometry().deserialize(data.getvalue())
    x, y, yaw = pose
    moved.pose.pose.position.x = x
    moved.pose.pose.position.y = y
    moved.pose.pose.orientation = Quaternion(*quaternion_from_yaw(yaw))
    moved.pose.covariance = list(moved.pose.covariance)
    moved.twist.covariance = list(moved.twist.covariance)
    return moved


def _add_noise(message: Odometry, step: NoisyStep, seconds: float | None) -> None:
    """Add the errors of a step to the twist, and its covariances to those of the odometry."""
    _add_covariance(message.pose.covariance, step.covariance, 1.0)
    if seconds is None:
        return
    dx, dy, dyaw = step.motion_error
    twist = message.twist.twist
    twist.linear.x += dx / seconds
    twist.linear.y += dy / seconds
    twist.angular.z += dyaw / seconds
    _add_covariance(message.twist.covariance, step.motion_covariance, 1.0 / seconds**2)


def _add_covariance(entries: list[float], covariance, factor: float) -> None:
    values = covariance.tolist()
    for i, row in enumerate(PLANAR_AXES):
        for j, column in enumerate(PLANAR_AXES):
            entries[6 * row + column] += factor * values[i][j]


def ellipse_marker(noisy: Odometry, covariance: np.ndarray) -> Marker:
    """Return the 95 % ellipse around a noisy pose, by its 3x3 covariance (m, m, rad)."""
    place = noisy.pose.pose.position
    points = [(x, y, 0.0) for x, y in ellipse_points(covariance).tolist()]
    width, centre = (0.01, 0.0, 0.0), (place.x, place.y, place.z)
    return marker(noisy.header, "noisy_odom", Marker.LINE_STRIP, BLUE, width, centre, points)


@node
def noisy_odom_node(parameters: NoisyOdomParameters) -> None:
    """Run until ROS shuts down."""
    robots = [NoisyOdometry(its, name) for name, its in robots_of(parameters).items()]
    join_when(
        lambda: all(robot.sub.get_num_connections() > 0 for robot in robots), "a publisher of odom"
    )
    spin()
