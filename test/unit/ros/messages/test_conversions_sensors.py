import math

import numpy as np
import pytest

pytest.importorskip("rospy")
pytest.importorskip("gazebo_msgs.msg")

from io import BytesIO

import genpy
from sensor_msgs.msg import Range

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import Converter
from bullet_lab.simulation.plugins.samples import (
    ContactsSample,
    ImuSample,
    LaserSample,
    MotionSample,
    OdometrySample,
    PlanarCommand,
    RangeSample,
    ShapeContact,
)

POSE = Pose.from_rpy((1.0, 2.0, 3.0), (0.1, 0.2, 0.5))


def message_of(sample):
    """The message as it comes out at the other end."""
    converter = Converter(type(sample))
    buffer = BytesIO()
    converter.convert(sample).serialize(buffer)
    message = converter.message_kind()
    message.deserialize(buffer.getvalue())
    return message


def numbers(vector):
    return (vector.x, vector.y, vector.z)


def test_scans():
    ranges = np.array([1.5, math.inf, -math.inf])
    sample = LaserSample(2001, "laser", -1.0, 1.5, 1.25, 0.2, 8.0, ranges, np.zeros(3))
    message = message_of(sample)
    assert message.header.stamp == genpy.Time(2, 1_000_000)
    assert message.header.frame_id == "laser"
    assert (message.angle_min, message.angle_max, message.angle_increment) == (-1.0, 1.5, 1.25)
    assert (message.time_increment, message.scan_time) == (0.0, 0.0)
    assert (message.range_min, message.range_max) == (pytest.approx(0.2), 8.0)
    assert message.ranges == (1.5, math.inf, -math.inf)
    assert message.intensities == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("infrared", "kind"), [(True, Range.INFRARED), (False, Range.ULTRASOUND)]
)
def test_ranges(infrared, kind):
    message = message_of(RangeSample(50, "sonar", infrared, 0.5, 0.25, 4.0, 1.5))
    assert (message.header.stamp, message.header.frame_id) == (genpy.Time(0, 50_000_000), "sonar")
    assert message.radiation_type == kind
    assert (message.field_of_view, message.min_range, message.max_range) == (0.5, 0.25, 4.0)
    assert message.range == 1.5


def test_inertial_units():
    turn = POSE.quaternion
    sample = ImuSample(10, "imu", turn, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.1, 0.2, 0.3)
    message = message_of(sample)
    assert (message.header.stamp, message.header.frame_id) == (genpy.Time(0, 10_000_000), "imu")
    assert (*numbers(message.orientation), message.orientation.w) == turn
    assert numbers(message.angular_velocity) == (1.0, 2.0, 3.0)
    assert numbers(message.linear_acceleration) == (4.0, 5.0, 6.0)
    for matrix, variance in (
        (message.orientation_covariance, 0.1),
        (message.angular_velocity_covariance, 0.2),
        (message.linear_acceleration_covariance, 0.3),
    ):
        assert np.reshape(matrix, (3, 3)) == pytest.approx(variance * np.eye(3))


def test_true_poses():
    sample = MotionSample(5, "world", "base", POSE, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.25)
    message = message_of(sample)
    assert message.header.stamp == genpy.Time(0, 5_000_000)
    assert (message.header.frame_id, message.child_frame_id) == ("world", "base")
    assert numbers(message.pose.pose.position) == POSE.position
    turn = message.pose.pose.orientation
    assert (*numbers(turn), turn.w) == POSE.quaternion
    assert numbers(message.twist.twist.linear) == (1.0, 2.0, 3.0)
    assert numbers(message.twist.twist.angular) == (4.0, 5.0, 6.0)
    for matrix in (message.pose.covariance, message.twist.covariance):
        assert np.reshape(matrix, (6, 6)) == pytest.approx(0.25 * np.eye(6))


def test_variances_of_a_twist():
    zeros = (0.0,) * 6
    variances = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    sample = OdometrySample(5, "odom", "base", POSE, PlanarCommand(), zeros, variances)
    assert np.reshape(message_of(sample).twist.covariance, (6, 6)).tolist() == (
        np.diag(variances).tolist()
    )


def test_contacts():
    contact = ShapeContact(
        "a::b::c",
        "d::e::f",
        ((1.0, 0.0, 2.0), (3.0, 0.0, 4.0)),
        ((0.0, 1.0, 0.0), (0.0, 2.0, 0.5)),
        ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
        ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
        (1e-3, 2e-3),
    )
    message = message_of(ContactsSample(1, "world", (contact, contact)))
    assert (message.header.stamp, message.header.frame_id) == (genpy.Time(0, 1_000_000), "world")
    state, other = message.states
    assert state == other
    assert (state.collision1_name, state.collision2_name) == ("a::b::c", "d::e::f")
    assert [numbers(wrench.force) for wrench in state.wrenches] == list(contact.forces)
    assert [numbers(wrench.torque) for wrench in state.wrenches] == list(contact.torques)
    assert numbers(state.total_wrench.force) == (4.0, 0.0, 6.0)
    assert numbers(state.total_wrench.torque) == (0.0, 3.0, 0.5)
    assert [numbers(place) for place in state.contact_positions] == list(contact.positions)
    assert [numbers(normal) for normal in state.contact_normals] == list(contact.normals)
    assert state.depths == (1e-3, 2e-3)


def test_no_contacts():
    assert message_of(ContactsSample(1, "world", ())).states == []


def test_a_message_is_made_anew_for_each_sample():
    convert = Converter(ContactsSample).convert
    full = ContactsSample(1, "a", (ShapeContact("a", "b", (), (), (), (), ()),))
    assert len(convert(full).states) == 1
    assert convert(ContactsSample(2, "b", ())).states == []


def test_types_are_gazebos():
    kind = Converter(ContactsSample).message_kind
    assert kind._type == "gazebo_msgs/ContactsState"
    assert kind._md5sum == "acbcb1601a8e525bf72509f18e6f668d"
