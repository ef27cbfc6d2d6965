import math

import pytest
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3

from bullet_lab.core.pose import Pose as PlainPose
from bullet_lab.ros.messages.poses import InputError, normalised_pose, twist_message, twist_of
from bullet_lab.simulation.world.description import FrameState


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        ((0.0, 0.0, 3.0, 4.0), (0.0, 0.0, 0.6, 0.8)),
        ((0.0, 0.0, 3e200, 4e200), (0.0, 0.0, 0.6, 0.8)),
        ((0.0, 0.0, -3e-200, 4e-200), (0.0, 0.0, -0.6, 0.8)),
    ],
)
def test_quaternions_are_normalised(given, expected):
    pose = normalised_pose(Pose(Point(1.0, 2.0, 3.0), Quaternion(*given)))
    assert pose.position == (1.0, 2.0, 3.0)
    assert pose.quaternion == pytest.approx(expected)


@pytest.mark.parametrize("value", [math.nan, -math.inf])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(InputError, match="the position is not finite"):
        normalised_pose(Pose(Point(0.0, value, 0.0), Quaternion()))
    with pytest.raises(InputError, match="the orientation is not finite"):
        normalised_pose(Pose(Point(), Quaternion(value, 0.0, 0.0, 1.0)))
    with pytest.raises(InputError, match="the linear velocity is not finite"):
        twist_of(Twist(Vector3(value, 0.0, 0.0), Vector3()))
    with pytest.raises(InputError, match="the angular velocity is not finite"):
        twist_of(Twist(Vector3(), Vector3(0.0, 0.0, value)))


def test_a_velocity_is_the_same_there_and_back():
    state = FrameState(PlainPose(), (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    assert twist_of(twist_message(state)) == (state.linear, state.angular)
