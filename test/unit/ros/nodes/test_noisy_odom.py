"""One noisy message for each perfect one, with noise that accumulates as computed."""

import copy
import math
from dataclasses import asdict

import numpy as np
import pytest
import rospy
from alike import lines_of
from bullet_lab.srv import SetNoiseRequest
from nav_msgs.msg import Odometry
from recorded_paths import make_rule
from shared import cases

from bullet_lab.core.se2 import quaternion_from_yaw
from bullet_lab.noise.odometry_noise import NoisyPath
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.ros.messages.poses import stamped_pose
from bullet_lab.ros.nodes import noisy_odom
from bullet_lab.ros.nodes.noisy_odom import NoisyOdometry, NoisyOdomParameters

NODE = noisy_odom


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
        message.pose.covariance = [5e-5 * i for i in range(36)]
        message.twist.covariance = [2e-5 * i for i in range(36)]
        message.twist.twist.linear.x = 1.0
        message.twist.twist.angular.z = 1.0
        messages.append(message)
    return messages


def pose(message):
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    return place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)


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


@cases("""
model, std, alphas:
  - [rate_invariant, 0.2, []]
  - [probabilistic, 0.0, [0.01, 0.02, 0.03, 0.04]]
""")
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


@cases("""
model, std, alphas, said:
  - [report, -1.0, [], "std is -1.0: it must be"]
  # Also for a model without it.
  - [probabilistic, -1.0, [], "std is -1.0: it must be"]
  - [probabilistic, 0.1, [0, 0, -1, 0], "alpha3 is -1: it must be"]
  - [nix, 0.1, [], unknown noise model 'nix']
""")
def test_a_request_that_is_invalid_changes_nothing(adder, model, std, alphas, said):
    node = adder(std=0.3)
    refused = node.set_noise(SetNoiseRequest(model, std, alphas))
    assert not refused.success and said in refused.status_message
    assert node.std == 0.3
    assert node.set_noise(SetNoiseRequest("", 0.2, [])).success
    assert node.std == 0.2


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


def test_poses_twists_covariances_ticks_and_the_ellipse_are_as_before(adder, published, as_before):
    errors = SystematicErrors(0.1, -0.05, 0.02, 0.01, 0.5, ticks_per_metre=777.7)
    spread = {"scale_error_std": 0.1, "base_error_std": 0.05}
    noisy = adder(std=0.9, seed=2, **spread, **asdict(errors)).send(arc(12, period=0.2))
    told = []
    for number, message in enumerate(noisy):
        told += lines_of([*pose(message), *message.pose.covariance], f"{number} pose")
        ahead, turn = message.twist.twist.linear, message.twist.twist.angular.z
        told += lines_of([ahead.x, ahead.y, turn, *message.twist.covariance], f"{number} twist")
    told += lines_of([m.data for m in published["left_ticks"]], "left")
    told += lines_of([m.data for m in published["right_ticks"]], "right")
    marker = published["noisy_odom_ellipse"][-1]
    assert (marker.header, marker.pose.position) == (noisy[-1].header, noisy[-1].pose.pose.position)
    told += lines_of([(point.x, point.y) for point in marker.points], "ellipse")
    as_before(told, "noisy_odom.txt")


def test_perfect_message_stays_as_it_came(adder):
    node = adder(std=0.5, seed=1)
    for message in arc(10):
        before = copy.deepcopy(message)
        noisy = node.send([message])
        assert message == node.msg == before
    assert message.pose.pose.position.x != pytest.approx(pose(noisy[-1])[0], abs=1e-7)


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
