import math

import genpy
import numpy as np
import pytest
from geometry_msgs.msg import Twist, Vector3
from message_fields import check, message, message_of, plain
from nav_msgs.msg import Odometry

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import COMMANDS
from bullet_lab.ros.messages.poses import InputError, first_step_at, pose_message, time_of
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, planar_pose
from bullet_lab.simulation.plugins.samples import (
    JointSample,
    OdometrySample,
    PlanarCommand,
    TransformSample,
)

POSE = Pose.from_rpy((1.0, 2.0, 3.0), (0.0, 0.0, 0.5))


@pytest.mark.parametrize("step", [0, 999, 2**31])
def test_steps_are_milliseconds(step):
    assert time_of(step).to_nsec() == step * 1_000_000
    assert first_step_at(time_of(step)) == step


@pytest.mark.parametrize("time, step", [((1, 1), 1001), ((0, 999_999_999), 1000)])
def test_time_between_two_steps_is_the_later_one(time, step):
    assert first_step_at(genpy.Time(*time)) == step


def test_quaternions_have_a_w_that_is_not_negative():
    turned = pose_message(Pose(quaternion=(-0.6, 0.0, 0.0, -0.8))).orientation
    assert plain(turned) == [0.6, 0.0, 0.0, 0.8]


def test_odometry_says_what_the_sample_says():
    variances = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    of_twist = (7.0, 8.0, 9.0, 10.0, 11.0, 12.0)
    twist = PlanarCommand(0.1, 0.2, 0.3)
    made = message_of(OdometrySample(1050, "odom", "base", POSE, twist, variances, of_twist))
    fields = """
        header.stamp: 1.05
        header.frame_id: odom
        child_frame_id: base
        twist.twist.linear: [0.1, 0.2, 0.0]
        twist.twist.angular: [0.0, 0.0, 0.3]
    """
    check(made, fields)
    assert planar_pose(made) == pytest.approx((1.0, 2.0, 0.5))
    for part, expected in ((made.pose, variances), (made.twist, of_twist)):
        assert np.reshape(part.covariance, (6, 6)).tolist() == np.diag(expected).tolist()


def test_transform_says_what_the_sample_says():
    (transform,) = message_of(TransformSample(50, "odom", "base", POSE)).transforms
    check(transform, "{header.stamp: 0.05, header.frame_id: odom, child_frame_id: base}")
    assert plain(transform.transform) == [list(POSE.position), list(POSE.quaternion)]


def test_joints_say_what_the_sample_says():
    made = message_of(JointSample(7, ("a", "b"), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0)))
    fields = """
        header.stamp: 0.007
        name: [a, b]
        position: [1.0, 2.0]
        velocity: [3.0, 4.0]
        effort: [5.0, 6.0]
    """
    check(made, fields)


def test_twist_keeps_its_planar_part():
    _, command_of = COMMANDS[PlanarCommand]
    twist = Twist(Vector3(1.0, 2.0, 9.0), Vector3(9.0, 0.0, 3.0))
    assert command_of(twist) == PlanarCommand(1.0, 2.0, 3.0)


def odometry(pose="orientation: {w: 1.0}", frame="odom", child="base"):
    """Return odometry with a pose, or with the identity."""
    text = f"{{header: {{frame_id: {frame}}}, child_frame_id: {child}, pose: {{pose: {{{pose}}}}}}}"
    return message(Odometry, text)


@pytest.mark.parametrize(
    "bad",
    [
        "position: {x: .nan}, orientation: {w: 1.0}",
        "position: {x: .inf}, orientation: {w: 1.0}",
        "orientation: {w: .nan}",
        "orientation: {w: 0.0}",
        "orientation: {w: 1.1}",
        "orientation: {z: 1.0e+308, w: 1.0e+308}",
    ],
)
def test_poses_that_are_none_are_refused(bad):
    with pytest.raises(InputError):
        planar_pose(odometry(bad))


def test_quaternions_may_be_rounded():
    rounded = odometry("orientation: {z: 0.7071, w: 0.7071}")
    assert planar_pose(rounded)[2] == pytest.approx(0.5 * math.pi)


def test_frames_are_those_of_the_first_message():
    guard = FrameGuard()
    guard.check(odometry())
    guard.check(odometry("position: {x: 1.0}, orientation: {w: 1.0}"))
    for bad in ({"frame": "map"}, {"child": "wheel"}, {"frame": "''"}):
        with pytest.raises(OdometryError):
            guard.check(odometry(**bad))
    guard.check(odometry())
