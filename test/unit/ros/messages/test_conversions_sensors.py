import math

import numpy as np
import pytest
from message_fields import check, message_of, plain
from sensor_msgs.msg import Range

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import Converter
from bullet_lab.simulation.plugins.samples import (
    ContactsSample,
    ImuSample,
    LaserSample,
    MotionSample,
    RangeSample,
    ShapeContact,
)

POSE = Pose.from_rpy((1.0, 2.0, 3.0), (0.1, 0.2, 0.5))


def test_scans():
    ranges = np.array([1.5, math.inf, -math.inf])
    sample = LaserSample(2001, "laser", -1.0, 1.5, 1.25, 0.2, 8.0, ranges, np.zeros(3))
    fields = """
        header.stamp: 2.001
        header.frame_id: laser
        angle_min: -1.0
        angle_max: 1.5
        angle_increment: 1.25
        time_increment: 0.0
        scan_time: 0.0
        range_min: 0.2
        range_max: 8.0
        ranges: [1.5, .inf, -.inf]
        intensities: [0.0, 0.0, 0.0]
    """
    check(message_of(sample), fields)


@pytest.mark.parametrize("infrared", [True, False])
def test_ranges(infrared):
    message = message_of(RangeSample(50, "sonar", infrared, 0.5, 0.25, 4.0, 1.5))
    fields = """
        header.stamp: 0.05
        header.frame_id: sonar
        field_of_view: 0.5
        min_range: 0.25
        max_range: 4.0
        range: 1.5
    """
    check(message, fields)
    assert message.radiation_type == (Range.INFRARED if infrared else Range.ULTRASOUND)


def test_inertial_units():
    turn = POSE.quaternion
    sample = ImuSample(10, "imu", turn, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.1, 0.2, 0.3)
    message = message_of(sample)
    fields = """
        header.stamp: 0.01
        header.frame_id: imu
        angular_velocity: [1.0, 2.0, 3.0]
        linear_acceleration: [4.0, 5.0, 6.0]
        orientation_covariance: [0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1]
        angular_velocity_covariance: [0.2, 0, 0, 0, 0.2, 0, 0, 0, 0.2]
        linear_acceleration_covariance: [0.3, 0, 0, 0, 0.3, 0, 0, 0, 0.3]
    """
    check(message, fields)
    assert tuple(plain(message.orientation)) == turn


def test_true_poses():
    sample = MotionSample(5, "world", "base", POSE, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.25)
    message = message_of(sample)
    fields = """
        header.stamp: 0.005
        header.frame_id: world
        child_frame_id: base
        twist.twist.linear: [1.0, 2.0, 3.0]
        twist.twist.angular: [4.0, 5.0, 6.0]
    """
    check(message, fields)
    assert plain(message.pose.pose) == [list(POSE.position), list(POSE.quaternion)]
    for matrix in (message.pose.covariance, message.twist.covariance):
        assert np.reshape(matrix, (6, 6)) == pytest.approx(0.25 * np.eye(6))


def test_contacts():
    contact = ShapeContact(
        1,
        "a::b::c",
        "d::e::f",
        ((1.0, 0.0, 2.0), (3.0, 0.0, 4.0)),
        ((0.0, 1.0, 0.0), (0.0, 2.0, 0.5)),
        ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
        ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
        (1e-3, 2e-3),
    )
    message = message_of(ContactsSample(1, "world", (contact, contact)))
    check(message, "{header.stamp: 0.001, header.frame_id: world}")
    state, other = message.states
    assert (state.wrenches, state.depths) == (other.wrenches, other.depths)
    assert other.info == "Debug:  i:(1/2)  my geom:a::b::c  other geom:d::e::f  time:0.001000000"
    fields = """
        collision1_name: a::b::c
        collision2_name: d::e::f
        wrenches: [[[1.0, 0.0, 2.0], [0.0, 1.0, 0.0]], [[3.0, 0.0, 4.0], [0.0, 2.0, 0.5]]]
        total_wrench: [[4.0, 0.0, 6.0], [0.0, 3.0, 0.5]]
        contact_positions: [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]
        contact_normals: [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
        depths: [0.001, 0.002]
    """
    check(state, fields)


def test_a_message_is_made_anew_for_each_sample():
    convert = Converter(ContactsSample).convert
    full = ContactsSample(1, "a", (ShapeContact(1, "a", "b", (), (), (), (), ()),))
    assert len(convert(full).states) == 1
    assert convert(ContactsSample(2, "b", ())).states == []
