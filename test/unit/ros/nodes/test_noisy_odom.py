"""One noisy message for each perfect one, with noise that accumulates as computed."""

import copy
import math
from dataclasses import asdict

import numpy as np
import pytest
import rospy
from bullet_lab.srv import SetNoiseRequest
from nav_msgs.msg import Odometry
from recorded_paths import make_rule

from bullet_lab.core.se2 import SQUARE_RADIUS, quaternion_from_yaw
from bullet_lab.noise.odometry_noise import NoisyPath
from bullet_lab.noise.systematic import SystematicErrors, SystematicPath
from bullet_lab.ros.messages.poses import stamped_pose
from bullet_lab.ros.nodes import noisy_odom
from bullet_lab.ros.nodes.noisy_odom import NoisyOdometry, NoisyOdomParameters

NODE = noisy_odom
PLANAR = np.ix_((0, 1, 5), (0, 1, 5))


def odometry(seconds, x=0.0, y=0.0, yaw=0.0):
    """A message of odometry."""
    message = Odometry(child_frame_id="base_footprint")
    stamped = stamped_pose(rospy.Time.from_sec(seconds), "odom", (x, y, yaw))
    message.header, message.pose.pose = stamped.header, stamped.pose
    return message


def arc(number, period=0.05):
    """Messages of a robot on an arc, with covariances and a twist of their own."""
    messages = []
    for k in range(number):
        yaw = 0.05 * k
        message = odometry(period * (k + 1), math.sin(yaw), 1.0 - math.cos(yaw), yaw)
        message.pose.covariance = [0.5 * i for i in range(36)]
        message.twist.covariance = [0.25 * i for i in range(36)]
        message.twist.twist.linear.x = 1.0
        message.twist.twist.angular.z = 1.0
        messages.append(message)
    return messages


def pose(message):
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    return place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)


def added(noisy, given):
    """What was added to a covariance, as a matrix."""
    return np.reshape(np.subtract(noisy.covariance, given.covariance), (6, 6))


@pytest.fixture
def adder(published):
    """Make a node; `send` gives it messages and returns all noisy ones so far."""

    def make(**parameters):
        made = NoisyOdometry(NoisyOdomParameters(**parameters))

        def send(messages):
            for message in messages:
                made.odom_callback(message)
            return published["noisy_odom"]

        made.send = send
        return made

    return make


def assert_follows(path, perfect, noisy):
    """Assert that noisy messages are what a NoisyPath makes of the perfect ones."""
    for given, got in zip(perfect, noisy):
        step = path.update(*pose(given))
        np.testing.assert_allclose(step.pose[:2], pose(got)[:2], rtol=0, atol=1e-12)
        turn = got.pose.pose.orientation
        np.testing.assert_allclose(
            quaternion_from_yaw(step.pose[2]), (turn.x, turn.y, turn.z, turn.w), atol=1e-12
        )


@pytest.mark.parametrize(
    ("model", "std", "alphas"),
    [("rate_invariant", 0.2, ()), ("probabilistic", 0.0, (0.01, 0.02, 0.03, 0.04))],
)
def test_one_message_for_each_with_the_draws_of_the_seed(adder, model, std, alphas):
    perfect = arc(40)
    named = {f"alpha{i}": value for i, value in enumerate(alphas, 1)}
    noisy = adder(model=model, std=std, seed=8, **named).send(perfect)
    assert [m.header.stamp for m in noisy] == [m.header.stamp for m in perfect]
    assert {(m.header.frame_id, m.child_frame_id) for m in noisy} == {("odom", "base_footprint")}
    assert_follows(NoisyPath(make_rule(model, std, alphas), 8), perfect, noisy)


def test_noise_is_changed_while_it_runs(adder):
    node, perfect = adder(std=0.1, seed=4), arc(60)
    node.send(perfect[:20])
    assert node.set_noise(SetNoiseRequest("rate_invariant", 0.3, [])).success
    node.send(perfect[20:40])
    refused = node.set_noise(SetNoiseRequest("", -1.0, []))
    assert not refused.success
    assert "std" in refused.status_message
    noisy = node.send(perfect[40:])
    path = NoisyPath(make_rule("report", 0.1), 4)
    assert_follows(path, perfect[:20], noisy[:20])
    path.change_rule(make_rule("rate_invariant", 0.3))
    assert_follows(path, perfect[20:], noisy[20:])


def test_what_cannot_be_used_is_refused_and_not_in_the_path(adder):
    perfect = arc(10)
    bad = [odometry(0.26) for _ in range(6)]
    bad[0].pose.pose.position.x = math.nan
    bad[1].header.frame_id = "map"
    bad[2].header.stamp = perfect[4].header.stamp
    bad[3].twist.twist.linear.y = math.nan
    bad[4].pose.covariance[7] = math.inf
    bad[5].pose.pose.position.z = -math.inf
    noisy = adder(std=0.1, seed=4).send(perfect[:5] + bad + perfect[5:])
    assert len(noisy) == 10
    assert_follows(NoisyPath(make_rule("report", 0.1), 4), perfect, noisy)


def test_ellipse_is_drawn_around_the_noisy_pose(adder, published):
    perfect = arc(30)
    noisy = adder(std=0.3, seed=4).send(perfect)[-1]
    marker = published["noisy_odom_ellipse"][-1]
    assert marker.header == noisy.header
    assert marker.pose.position == noisy.pose.pose.position
    covariance = added(noisy.pose, perfect[-1].pose)[:2, :2]
    points = np.array([(point.x, point.y) for point in marker.points])
    lengths = np.einsum("ni,ij,nj->n", points, np.linalg.inv(covariance), points)
    np.testing.assert_allclose(lengths, SQUARE_RADIUS, rtol=1e-6)


def test_poses_twists_and_covariances_have_the_errors_of_their_steps(adder):
    errors = SystematicErrors(0.1, -0.05, 0.02, 0.01, 0.5)
    perfect = arc(30, period=0.2)
    noisy = adder(std=0.1, seed=2, **asdict(errors)).send(perfect)
    reported, path = SystematicPath(errors), NoisyPath(make_rule("report", 0.1), 2)
    for given, got in zip(perfect, noisy):
        step = reported.update(*pose(given))
        noise = path.update(*step.pose)
        np.testing.assert_allclose(noise.pose, pose(got), rtol=0, atol=1e-12)
        more = added(got.pose, given.pose)
        np.testing.assert_allclose(noise.covariance, more[PLANAR], atol=1e-12)
        more[PLANAR] = 0.0
        assert not more.any()
        if given is perfect[0]:
            assert got.twist == given.twist
            continue
        twist = got.twist.twist
        error = (twist.linear.x - 1.0, twist.linear.y, twist.angular.z - 1.0)
        expected = (np.array(step.motion_error) + noise.motion_error) / 0.2
        np.testing.assert_allclose(expected, error, atol=1e-12)
        more = added(got.twist, given.twist)[PLANAR]
        np.testing.assert_allclose(noise.motion_covariance / 0.2**2, more, atol=1e-12)


def test_ticks_of_both_encoders(adder, published):
    errors = SystematicErrors(ticks_per_metre=777.7)
    perfect, path, expected = arc(30), SystematicPath(errors), []
    noisy = adder(std=0.0, **asdict(errors)).send(perfect)
    for given, got in zip(perfect, noisy):
        np.testing.assert_allclose(path.update(*pose(given)).pose, pose(got), atol=1e-12)
        expected.append(path.ticks)
    left, right = ([m.data for m in published[f"{side}_ticks"]] for side in ("left", "right"))
    assert list(zip(left, right)) == expected
    assert left[-1] < right[-1]


def test_perfect_message_stays_as_it_came(adder):
    node = adder(std=0.5, seed=1)
    for message in arc(10):
        before = copy.deepcopy(message)
        node.odom_callback(message)
        assert message == node.last_odom == node.msg == before
    assert message.pose.pose.position.x != pytest.approx(node.pose[0], abs=1e-7)


def test_time_set_back_starts_anew(adder):
    before, after = arc(20), arc(20)
    noisy = adder(std=0.1, seed=6).send(before + after)
    path = NoisyPath(make_rule("report", 0.1), 6)
    assert_follows(path, before, noisy[:20])
    path.restart()
    assert_follows(path, after, noisy[20:])
    assert noisy[20].pose.covariance[0] < noisy[19].pose.covariance[0]
    np.testing.assert_allclose(pose(after[0]), pose(noisy[20]), atol=1e-12)


def test_as_published_samples_by_the_stamps(adder):
    perfect = [odometry(0.05 * k, 0.01 * k) for k in range(1, 201)]
    noisy = adder(std=0.1, as_published=True).send(perfect)
    # The first message at or after each tick of 0.9 Hz, counted from the first stamp.
    due = [0.05 + 0.05 * math.ceil(k / 0.9 / 0.05) for k in range(1, 9)]
    np.testing.assert_allclose([m.header.stamp.to_sec() for m in noisy], due, atol=1e-9)
    assert pose(noisy[0])[0] == pytest.approx(perfect[23].pose.pose.position.x, abs=1e-7)
