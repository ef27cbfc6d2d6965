import pytest
from geometry_msgs.msg import Point, Pose, Quaternion, Twist
from message_fields import message
from shared import cases, refuses

from bullet_lab.core.pose import Pose as PlainPose
from bullet_lab.ros.messages.poses import InputError, normalised_pose, twist_message, twist_of
from bullet_lab.simulation.world.description import FrameState


@cases("""
given, expected:
  # Quaternions, and what they become.
  - [[0, 0, 0, 0], [0.0, 0.0, 0.0, 1.0]]
  - [[0, 0, 3, 4], [0.0, 0.0, 0.6, 0.8]]
  - [[0, 0, 3.0e+200, 4.0e+200], [0.0, 0.0, 0.6, 0.8]]
  - [[0, 0, -3.0e-200, 4.0e-200], [0.0, 0.0, -0.6, 0.8]]
""")
def test_quaternions_are_normalised(given, expected):
    pose = normalised_pose(Pose(Point(1.0, 2.0, 3.0), Quaternion(*given)))
    assert pose.position == (1.0, 2.0, 3.0)
    assert pose.quaternion == pytest.approx(expected)


@cases("""
value:
  - ".nan"
  - "-.inf"
""")
@pytest.mark.parametrize(
    "read, kind, field, what",
    [
        (normalised_pose, Pose, "position: {y: VALUE}", "position"),
        (normalised_pose, Pose, "orientation: {x: VALUE, w: 1.0}", "orientation"),
        (twist_of, Twist, "linear: {x: VALUE}", "linear velocity"),
        (twist_of, Twist, "angular: {z: VALUE}", "angular velocity"),
    ],
)
def test_numbers_that_are_not_finite_are_refused(read, kind, field, what, value):
    with refuses(f"the {what} is not finite", InputError):
        read(message(kind, field.replace("VALUE", value)))


def test_a_velocity_is_the_same_there_and_back():
    state = FrameState(PlainPose(), (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    assert twist_of(twist_message(state)) == (state.linear, state.angular)
