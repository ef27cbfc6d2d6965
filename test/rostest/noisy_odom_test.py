#!/usr/bin/env python3
"""One noisy message for each perfect one, with noise that accumulates as computed."""

import copy
import math
import sys
from dataclasses import asdict

import numpy as np
import rospy
import rostest
from bullet_lab.srv import SetNoise, SetNoiseRequest
from lab_testing import PACKAGE, NodeTest, odometry, wait_for
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32
from visualization_msgs.msg import Marker

from bullet_lab.core.se2 import SQUARE_RADIUS, quaternion_from_yaw
from bullet_lab.noise.odometry_noise import NoisyPath
from bullet_lab.noise.systematic import SystematicErrors, SystematicPath
from bullet_lab.ros.nodes.noisy_odom import NoisyOdometry, NoisyOdomParameters

sys.path.insert(0, str(PACKAGE / "test" / "unit"))
from recorded_paths import make_rule  # noqa: E402

PLANAR_AXES = (0, 1, 5)


def arc(number, period=0.05, start=0.0):
    """Messages of a robot on an arc, with covariances and a twist of their own."""
    messages = []
    for k in range(number):
        yaw = 0.05 * k
        message = odometry(start + period * (k + 1), math.sin(yaw), 1.0 - math.cos(yaw), yaw)
        message.pose.covariance = [0.5 * i for i in range(36)]
        message.twist.covariance = [0.25 * i for i in range(36)]
        message.twist.twist.linear.x = 1.0
        message.twist.twist.angular.z = 1.0
        messages.append(message)
    return messages


def pose(message):
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    return place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)


def planar_part(covariance):
    return np.array(covariance).reshape(6, 6)[np.ix_(PLANAR_AXES, PLANAR_AXES)]


class NoisyOdomTest(NodeTest):
    """Each test has its own noise, in this process."""

    def start(self, **parameters):
        self.adder = NoisyOdometry(NoisyOdomParameters(**parameters))
        self.addCleanup(self.adder._service.shutdown)
        for topic in (self.adder.sub, self.adder.pub, self.adder._ellipse):
            self.addCleanup(topic.unregister)
        self.noisy = self.topic("noisy_odom", Odometry)

    def send(self, messages, expected=None):
        """Take messages; return all noisy ones once there are so many (one for each)."""
        expected = len(self.noisy.messages) + len(messages) if expected is None else expected
        for message in messages:
            self.adder.odom_callback(message)
        return self.noisy.wait(expected)

    def assert_follows(self, path, perfect, noisy):
        """Assert that noisy messages are what a NoisyPath makes of the perfect ones."""
        for given, got in zip(perfect, noisy):
            step = path.update(*pose(given))
            np.testing.assert_allclose(step.pose[:2], pose(got)[:2], rtol=0, atol=1e-12)
            turn = got.pose.pose.orientation
            np.testing.assert_allclose(
                quaternion_from_yaw(step.pose[2]), (turn.x, turn.y, turn.z, turn.w), atol=1e-12
            )

    def test_one_message_for_each_with_the_draws_of_the_seed(self):
        perfect, alphas = arc(40), (0.01, 0.02, 0.03, 0.04)
        for model, std, given in (("rate_invariant", 0.2, ()), ("probabilistic", 0.0, alphas)):
            named = {f"alpha{i}": value for i, value in enumerate(given, 1)}
            self.start(model=model, std=std, seed=8, **named)
            noisy = self.send(perfect)
            self.assertEqual([m.header.stamp for m in perfect], [m.header.stamp for m in noisy])
            self.assertEqual({"odom"}, {m.header.frame_id for m in noisy})
            self.assertEqual({"base_footprint"}, {m.child_frame_id for m in noisy})
            self.assert_follows(NoisyPath(make_rule(model, std, given), 8), perfect, noisy)
            self.doCleanups()

    def test_noise_is_changed_while_it_runs(self):
        self.start(std=0.1, seed=4)
        perfect = arc(60)
        self.send(perfect[:20])
        self.assertTrue(self.adder.set_noise(SetNoiseRequest("rate_invariant", 0.3, [])).success)
        self.send(perfect[20:40])
        refused = self.adder.set_noise(SetNoiseRequest("", -1.0, []))
        self.assertFalse(refused.success)
        self.assertIn("std", refused.status_message)
        noisy = self.send(perfect[40:])
        path = NoisyPath(make_rule("report", 0.1), 4)
        self.assert_follows(path, perfect[:20], noisy[:20])
        path.change_rule(make_rule("rate_invariant", 0.3))
        self.assert_follows(path, perfect[20:], noisy[20:])

    def test_ellipse_is_drawn_around_the_noisy_pose(self):
        self.start(std=0.3, seed=4)
        ellipses = self.topic("noisy_odom_ellipse", Marker)
        perfect = arc(30)
        noisy = self.send(perfect)
        last = noisy[-1].header.stamp
        wait_for(
            lambda: any(m.header.stamp == last for m in ellipses.messages), "the last ellipse"
        )
        marker = next(m for m in ellipses.messages if m.header.stamp == last)
        self.assertEqual(noisy[-1].header.frame_id, marker.header.frame_id)
        self.assertEqual(noisy[-1].pose.pose.position, marker.pose.position)
        given = planar_part(perfect[-1].pose.covariance)
        covariance = (planar_part(noisy[-1].pose.covariance) - given)[:2, :2]
        points = np.array([(point.x, point.y) for point in marker.points])
        lengths = np.einsum("ni,ij,nj->n", points, np.linalg.inv(covariance), points)
        np.testing.assert_allclose(lengths, SQUARE_RADIUS, rtol=1e-6)

    def test_poses_twists_and_covariances_have_the_errors_of_their_steps(self):
        errors = SystematicErrors(0.1, -0.05, 0.02, 0.01, 0.5)
        self.start(std=0.1, seed=2, **asdict(errors))
        perfect = arc(30, period=0.2)
        noisy = self.send(perfect)
        reported, path = SystematicPath(errors), NoisyPath(make_rule("report", 0.1), 2)
        for given, got in zip(perfect, noisy):
            step = reported.update(*pose(given))
            noise = path.update(*step.pose)
            np.testing.assert_allclose(noise.pose, pose(got), rtol=0, atol=1e-12)
            added = np.array(got.pose.covariance) - np.array(given.pose.covariance)
            np.testing.assert_allclose(noise.covariance, planar_part(added), atol=1e-12)
            rest = added.reshape(6, 6).copy()
            rest[np.ix_(PLANAR_AXES, PLANAR_AXES)] = 0.0
            self.assertFalse(rest.any())
            if given is perfect[0]:
                self.assertEqual(given.twist, got.twist)
                continue
            twist = got.twist.twist
            error = (twist.linear.x - 1.0, twist.linear.y, twist.angular.z - 1.0)
            expected = (np.array(step.motion_error) + noise.motion_error) / 0.2
            np.testing.assert_allclose(expected, error, atol=1e-12)
            added = np.array(got.twist.covariance) - np.array(given.twist.covariance)
            expected = noise.motion_covariance / 0.2**2
            np.testing.assert_allclose(expected, planar_part(added), atol=1e-12)

    def test_ticks_of_both_encoders(self):
        errors = SystematicErrors(ticks_per_metre=777.7)
        self.start(std=0.0, **asdict(errors))
        sides = [self.topic(f"{side}_ticks", Int32) for side in ("left", "right")]
        perfect, path = arc(30), SystematicPath(errors)
        noisy = self.send(perfect)
        expected = []
        for given, got in zip(perfect, noisy):
            np.testing.assert_allclose(path.update(*pose(given)).pose, pose(got), atol=1e-12)
            expected.append(path.ticks)
        counted = [[message.data for message in side.wait(30)] for side in sides]
        self.assertEqual(expected, list(zip(*counted)))
        self.assertLess(counted[0][-1], counted[1][-1])

    def test_perfect_message_stays_as_it_came(self):
        self.start(std=0.5, seed=1)
        for message in arc(10):
            before = copy.deepcopy(message)
            self.adder.odom_callback(message)
            self.assertEqual(before, message)
            self.assertEqual(before, self.adder.last_odom)
            self.assertEqual(before, self.adder.msg)
        self.assertNotAlmostEqual(message.pose.pose.position.x, self.adder.pose[0])

    def test_time_set_back_starts_anew(self):
        self.start(std=0.1, seed=6)
        before, after = arc(20), arc(20)
        noisy = self.send(before + after)
        path = NoisyPath(make_rule("report", 0.1), 6)
        self.assert_follows(path, before, noisy[:20])
        path.restart()
        self.assert_follows(path, after, noisy[20:])
        self.assertLess(noisy[20].pose.covariance[0], noisy[19].pose.covariance[0])
        np.testing.assert_allclose(pose(after[0]), pose(noisy[20]), atol=1e-12)

    def test_as_published_samples_by_the_stamps(self):
        self.start(std=0.1, as_published=True)
        perfect = [odometry(0.05 * k, 0.01 * k) for k in range(1, 201)]
        noisy = self.send(perfect, 8)
        stamps = [round(m.header.stamp.to_sec(), 3) for m in noisy]
        # The first message at or after each tick of 0.9 Hz, counted from the first stamp.
        due = [0.05 + 0.05 * math.ceil(k / 0.9 / 0.05) for k in range(1, 9)]
        np.testing.assert_allclose(due, stamps, atol=1e-9)
        self.assertAlmostEqual(perfect[23].pose.pose.position.x, pose(noisy[0])[0])


class NoisyOdomNodeTest(NodeTest):
    """The node as a process."""

    def test_what_cannot_be_used_is_refused_until_ctrl_c(self):
        node = self.node("noisy_odom.py", std=0.1, seed=4)
        noisy, sender = self.topic("noisy_odom", Odometry), self.publisher("odom", Odometry)
        perfect = arc(10)
        bad = [odometry(0.26) for _ in range(6)]
        bad[0].pose.pose.position.x = math.nan
        bad[1].header.frame_id = "map"
        bad[2].header.stamp = perfect[4].header.stamp
        bad[3].twist.twist.linear.y = math.nan
        bad[4].pose.covariance[7] = math.inf
        bad[5].pose.pose.position.z = -math.inf
        for message in perfect[:5] + bad + perfect[5:]:
            sender.publish(message)
        stamps = [message.header.stamp for message in noisy.wait(10)]
        self.assertEqual([message.header.stamp for message in perfect], stamps)
        # Nothing of the refused ones is in the path.
        path = NoisyPath(make_rule("report", 0.1), 4)
        expected = [path.update(*pose(message)).pose for message in perfect]
        np.testing.assert_allclose(expected, list(map(pose, noisy.messages)), atol=1e-12)
        change = rospy.ServiceProxy("noisy_odom_node/set_noise", SetNoise)
        self.assertTrue(change("rate_invariant", 0.3, []).success)
        wait_for(lambda: "odom: refused:" in node.err, "a warning")
        node.signal()
        self.assertEqual(0, node.wait(), node.err)
        self.assertNotIn("Traceback", node.err)

    def test_bad_parameters(self):
        self.assert_bad_parameter(self.node("noisy_odom.py", alpha1=".nan"), "~alpha1")


def setUpModule():
    rospy.init_node("noisy_odom_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "noisy_odom_test", "__main__")
