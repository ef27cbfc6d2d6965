import math

import pytest

pytest.importorskip("rospy")

import genpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import COMMANDS, Converter
from bullet_lab.ros.messages.poses import first_step_at, time_of
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, planar_pose
from bullet_lab.simulation.plugins.samples import (
    JointSample,
    OdometrySample,
    PlanarCommand,
    TransformSample,
)

POSE = Pose.from_rpy((1.0, 2.0, 3.0), (0.0, 0.0, 0.5))


def message_of(sample):
    return Converter(type(sample)).convert(sample)


@pytest.mark.parametrize("step", [0, 1, 999, 1000, 123456789, 2**31])
def test_steps_are_milliseconds(step):
    assert time_of(step).to_nsec() == step * 1_000_000
    assert first_step_at(time_of(step)) == step


def test_time_between_two_steps_is_the_later_one():
    assert first_step_at(genpy.Time(1, 1)) == 1001
    assert first_step_at(genpy.Time(0, 999_999_999)) == 1000


def test_odometry_says_what_the_sample_says():
    variances = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    sample = OdometrySample(1050, "odom", "base", POSE, PlanarCommand(0.1, 0.2, 0.3), variances)
    message = message_of(sample)
    assert message.header.stamp == genpy.Time(1, 50_000_000)
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base")
    assert planar_pose(message) == pytest.approx((1.0, 2.0, 0.5))
    twist = message.twist.twist
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (0.1, 0.2, 0.3)
    diagonal = [message.pose.covariance[7 * axis] for axis in range(6)]
    assert diagonal == list(variances)
    assert sum(message.pose.covariance) == sum(variances)


def test_transform_says_what_the_sample_says():
    (transform,) = message_of(TransformSample(50, "odom", "base", POSE)).transforms
    assert transform.header.stamp == genpy.Time(0, 50_000_000)
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base")
    place, turn = transform.transform.translation, transform.transform.rotation
    assert (place.x, place.y, place.z) == POSE.position
    assert (turn.x, turn.y, turn.z, turn.w) == POSE.quaternion


def test_joints_say_what_the_sample_says():
    message = message_of(JointSample(7, ("a", "b"), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0)))
    assert message.header.stamp == genpy.Time(0, 7_000_000)
    assert (message.name, message.position) == (("a", "b"), (1.0, 2.0))
    assert (message.velocity, message.effort) == ((3.0, 4.0), (5.0, 6.0))


def test_twist_keeps_its_planar_part():
    twist = Twist()
    twist.linear.x, twist.linear.y, twist.linear.z = 1.0, 2.0, 9.0
    twist.angular.x, twist.angular.z = 9.0, 3.0
    _, command_of = COMMANDS[PlanarCommand]
    assert command_of(twist) == PlanarCommand(1.0, 2.0, 3.0)


def odometry(x=0.0, quaternion=(0.0, 0.0, 0.0, 1.0), frame="odom", child="base"):
    message = Odometry()
    message.header.frame_id, message.child_frame_id = frame, child
    message.pose.pose.position.x = x
    turn = message.pose.pose.orientation
    turn.x, turn.y, turn.z, turn.w = quaternion
    return message


@pytest.mark.parametrize(
    "bad",
    [
        {"x": math.nan},
        {"x": math.inf},
        {"quaternion": (0.0, 0.0, 0.0, math.nan)},
        {"quaternion": (0.0, 0.0, 0.0, 0.0)},
        {"quaternion": (0.0, 0.0, 0.0, 1.1)},
        {"quaternion": (0.0, 0.0, 1e308, 1e308)},
    ],
)
def test_poses_that_are_none_are_refused(bad):
    with pytest.raises(OdometryError):
        planar_pose(odometry(**bad))


def test_quaternions_may_be_rounded():
    assert planar_pose(odometry(quaternion=(0.0, 0.0, 0.7071, 0.7071)))[2] == pytest.approx(
        0.5 * math.pi
    )


def test_frames_are_those_of_the_first_message():
    guard = FrameGuard()
    guard.check(odometry())
    guard.check(odometry(x=1.0))
    for bad in ({"frame": "map"}, {"child": "wheel"}, {"frame": ""}):
        with pytest.raises(OdometryError):
            guard.check(odometry(**bad))
    guard.check(odometry())
