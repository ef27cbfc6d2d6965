#!/usr/bin/env python3
"""What the dock node refuses and gives up, by name, and that the robot stands still then."""

import math
import signal
import tempfile
import time
import unittest
from pathlib import Path

import rospy
import rostest
from actionlib import GoalStatus, SimpleActionClient
from actionlib_msgs.msg import GoalStatusArray
from bullet_lab.msg import DockAction, DockGoal, DockResult, UndockAction, UndockGoal
from dock_standin import StandIn
from geometry_msgs.msg import PoseStamped, Transform, TransformStamped, Twist
from lab_testing import Node, Topic, wait_for
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from bullet_lab.docking.types import DockingState

APPROACHING = int(DockingState.APPROACHING)


class DockFailuresTest(unittest.TestCase):
    """All tests share one stand-in and one node, but those about the node's own end."""

    @classmethod
    def setUpClass(cls):
        cls.robot = StandIn()
        cls.node = Node("dock.py", patience=4.0)
        cls.dock = SimpleActionClient("dock", DockAction)
        cls.undock = SimpleActionClient("undock", UndockAction)
        cls.commands = Topic("cmd_vel", Twist)
        wait_for(cls.is_connected, "the action servers")

    @classmethod
    def tearDownClass(cls):
        cls.node.end()
        cls.robot.end()

    @classmethod
    def is_connected(cls):
        return all(
            client.action_client.pub_goal.get_num_connections()
            and client.action_client.result_sub.get_num_connections()
            for client in (cls.dock, cls.undock)
        )

    def setUp(self):
        self.states = []
        self.robot.pose = (2.6, 0.0, 0.0)
        self.robot.does = {"odom", "camera_info", "detections", "move"}
        self.robot.marker = 0
        self.robot.shift = (0.0, 0.0)

    def tearDown(self):
        # By its name: a request to cancel all could come after the next test's goal.
        for client in (self.dock, self.undock):
            if not self.is_over(client):
                client.cancel_goal()
        wait_for(lambda: self.is_over(self.dock) and self.is_over(self.undock), "the end")

    @staticmethod
    def is_over(client):
        return client.gh is None or client.get_state() not in (
            GoalStatus.PENDING,
            GoalStatus.ACTIVE,
        )

    def send(self, dock_id="dock", **values):
        goal = DockGoal(dock_id=dock_id, search=True, max_retries=-1)
        for name, value in values.items():
            setattr(goal, name, value)
        self.dock.send_goal(goal, feedback_cb=lambda said: self.states.append(said.state))

    def result(self):
        return self.result_of(self.dock)

    def result_of(self, client):
        """Wait for it: the state of a goal comes on another topic than its result."""
        wait_for(lambda: self.is_over(client) and client.get_result(), "a result")
        return client.get_result()

    def assert_failed(self, code, words, result=None):
        result = result or self.result()
        self.assertFalse(result.success)
        self.assertEqual(code, result.error_code, result.message)
        self.assertIn(words, result.message)
        self.assertNotIn("\n", result.message)
        self.assert_at_rest()

    def assert_at_rest(self):
        last = self.commands.messages[-1:]
        for command in last:
            self.assertEqual((0.0, 0.0), (command.linear.x, command.angular.z))
        before = self.robot.pose
        time.sleep(0.2)
        self.assertEqual(before, self.robot.pose)

    def wait_until_approaching(self):
        wait_for(lambda: APPROACHING in self.states, "the approach")
        wait_for(lambda: self.commands.messages[-1].linear.x > 0.05, "motion")

    def pose(self, frame, x, y, yaw=0.0):
        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x, message.pose.position.y = x, y
        message.pose.orientation.z = math.sin(0.5 * yaw)
        message.pose.orientation.w = math.cos(0.5 * yaw)
        return message

    # Invalid goals

    def test_unknown_dock(self):
        self.send("kitchen")
        self.assert_failed(DockResult.NOT_IN_DATABASE, "no dock 'kitchen'")

    def test_empty_goal(self):
        self.send("")
        self.assert_failed(DockResult.NOT_VALID, "neither dock_id nor")

    def test_pose_that_is_not_finite(self):
        self.send("", dock_pose=self.pose("odom", math.nan, 0.0))
        self.assert_failed(DockResult.NOT_VALID, "not finite")

    def test_pose_without_orientation(self):
        message = self.pose("odom", 4.0, 0.0)
        message.pose.orientation.w = 0.0
        self.send("", dock_pose=message)
        self.assert_failed(DockResult.NOT_VALID, "no unit quaternion")

    def test_pose_that_leans(self):
        message = self.pose("odom", 4.0, 0.0)
        message.pose.orientation.x = message.pose.orientation.w = math.sqrt(0.5)
        self.send("", dock_pose=message)
        self.assert_failed(DockResult.NOT_VALID, "upright")

    def test_unknown_frame(self):
        self.send("", dock_pose=self.pose("mars", 4.0, 0.0))
        self.assert_failed(DockResult.NOT_VALID, "mars")

    def test_negative_retries(self):
        self.send(max_retries=-2)
        self.assert_failed(DockResult.NOT_VALID, "max_retries")

    def test_undocking_too_far(self):
        for distance in (-1.0, 1e9, math.nan):
            self.undock.send_goal(UndockGoal(distance))
            self.assertEqual(DockResult.NOT_VALID, self.result_of(self.undock).error_code)
            self.assert_at_rest()

    # What is missing at the start

    def test_no_odometry(self):
        self.robot.does.discard("odom")
        self.send()
        self.assert_failed(DockResult.ODOMETRY_LOST, "odom: no messages")

    def test_no_camera_info(self):
        self.robot.does.discard("camera_info")
        self.send()
        self.assert_failed(DockResult.CAMERA_LOST, "camera_info: no messages")

    def test_camera_that_is_not_calibrated(self):
        matrix = self.robot.matrix
        self.addCleanup(setattr, self.robot, "matrix", matrix)
        self.robot.matrix = [0.0] * 9
        self.send()
        self.assert_failed(DockResult.CAMERA_LOST, "zero K")

    def test_no_images(self):
        self.robot.does.discard("detections")
        self.send()
        self.assert_failed(DockResult.CAMERA_LOST, "no image")

    def test_no_marker(self):
        self.robot.marker = None
        self.send(search=False)
        self.assert_failed(DockResult.NOT_DETECTED, "")

    def test_marker_with_another_id(self):
        self.robot.marker = 7
        self.send(search=False)
        self.assert_failed(DockResult.NOT_DETECTED, "")

    # Failures during the docking

    def test_camera_stops(self):
        self.send()
        self.wait_until_approaching()
        self.robot.does.discard("detections")
        self.assert_failed(DockResult.CAMERA_LOST, "image")

    def test_odometry_stops(self):
        self.send()
        self.wait_until_approaching()
        self.robot.does.discard("odom")
        self.assert_failed(DockResult.ODOMETRY_LOST, "no odometry")

    def test_odometry_jumps(self):
        self.send()
        self.wait_until_approaching()
        self.robot.shift = (0.0, 0.5)
        self.assert_failed(DockResult.ODOMETRY_LOST, "")

    def test_robot_that_cannot_move(self):
        self.send()
        self.wait_until_approaching()
        self.robot.does.discard("move")
        self.assert_failed(DockResult.BLOCKED, "")

    def test_time_set_back(self):
        self.send()
        self.wait_until_approaching()
        self.robot.time = 0.5
        self.assert_failed(DockResult.UNKNOWN, "set back")
        # A new goal is pursued as ever, and both actions say how their goals stand.
        for action in ("dock", "undock"):
            status = Topic(f"{action}/status", GoalStatusArray)
            self.addCleanup(status.close)
            status.wait(2)
        self.setUp()
        self.send()
        self.wait_until_approaching()

    def test_transforms_from_after_the_end_of_time(self):
        self.send()
        self.wait_until_approaching()
        sender = rospy.Publisher("/tf", TFMessage, queue_size=1)
        self.addCleanup(sender.unregister)
        wait_for(lambda: sender.get_num_connections() >= 1, "the node")
        late = TransformStamped(Header(0, rospy.Time(2**32 - 1), "odom"), "nobody", Transform())
        late.transform.rotation.w = 1.0
        sender.publish(TFMessage([late]))
        wait_for(lambda: "/tf: refused: a stamp at the end" in self.node.err, "a warning")
        self.assertTrue(self.result().success)

    # Whoever wants it

    def test_preempted_it_stops_at_once(self):
        self.send()
        self.wait_until_approaching()
        before = len(self.commands.messages)
        self.dock.cancel_goal()
        self.assert_failed(DockResult.PREEMPTED, "on request")
        self.assertEqual(GoalStatus.PREEMPTED, self.dock.get_state())
        moving = [m for m in self.commands.messages[before:] if m.linear.x or m.angular.z]
        # One may have been on its way.
        self.assertLessEqual(len(moving), 2)

    def test_a_second_goal_takes_the_place_of_the_first(self):
        other = SimpleActionClient("dock", DockAction)
        wait_for(lambda: other.action_client.pub_goal.get_num_connections(), "the server")
        wait_for(lambda: other.action_client.result_sub.get_num_connections(), "the server")
        self.send()
        self.wait_until_approaching()
        self.robot.pose = (2.6, 0.0, 0.0)
        other.send_goal(DockGoal(dock_id="dock", search=True, max_retries=-1))
        result = self.result()
        self.assertEqual(DockResult.PREEMPTED, result.error_code)
        self.assertIn("another goal", result.message)
        result = self.result_of(other)
        self.assertTrue(result.success, result.message)

    def test_the_two_actions_exclude_each_other(self):
        self.send()
        self.wait_until_approaching()
        self.undock.send_goal(UndockGoal(0.2))
        result = self.result()
        self.assertEqual(DockResult.PREEMPTED, result.error_code)
        self.assertEqual(GoalStatus.PREEMPTED, self.dock.get_state())
        self.assertIn("another goal", result.message)
        wait_for(lambda: self.commands.messages[-1].linear.x < -0.02, "the way back")
        self.send()
        self.assertEqual(DockResult.PREEMPTED, self.result_of(self.undock).error_code)
        self.wait_until_approaching()

    # It works as well

    def test_docks_and_undocks(self):
        self.send()
        result = self.result()
        self.assertTrue(result.success, result.message)
        self.assertEqual(DockResult.NONE, result.error_code)
        x, y, yaw = self.robot.pose
        self.assertAlmostEqual(3.44, x, delta=0.01)
        self.assertAlmostEqual(0.0, y, delta=0.01)
        self.assertAlmostEqual(0.4, result.distance, delta=0.01)
        self.undock.send_goal(UndockGoal(0.5))
        self.assertTrue(self.result_of(self.undock).success)
        self.assertAlmostEqual(x - 0.5, self.robot.pose[0], delta=0.03)
        self.assert_at_rest()

    def test_pose_on_a_map(self):
        pose = Topic("dock/dock_pose", PoseStamped)
        self.addCleanup(pose.close)
        # (4, 0, 0) of the odometry, some decimetres beside it.
        self.send("", dock_pose=self.pose("map", 0.1, 5.1, math.pi / 2))
        self.wait_until_approaching()
        found = pose.messages[-1]
        self.assertEqual("odom", found.header.frame_id)
        self.assertAlmostEqual(4.0, found.pose.position.x, delta=0.05)
        self.assertAlmostEqual(0.0, found.pose.position.y, delta=0.05)


class DockNodeTest(unittest.TestCase):
    """The node's own beginning and end."""

    def start(self, name, **parameters):
        node = Node("dock.py", name, **parameters)
        self.addCleanup(node.end)
        return node

    def assert_refused(self, node, *words):
        self.assertEqual(2, node.wait(), node.err)
        (line,) = node.err.strip().splitlines()
        for word in words:
            self.assertIn(word, line)

    def test_malformed_database(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "docks.yaml"
            path.write_text("docks: {dock: {}}")
            self.assert_refused(self.start("dock_bad", docks=path), "~docks", "frame")

    def test_bad_parameters(self):
        self.assert_refused(self.start("dock_bad", dock="kitchen"), "~dock", "kitchen")

    def test_whoever_ends_the_node_the_robot_stops(self):
        robot = StandIn()
        self.addCleanup(robot.end)
        commands = Topic("cmd_vel", Twist, connected=False)
        self.addCleanup(commands.close)
        node = self.start("dock")
        client = SimpleActionClient("dock", DockAction)
        wait_for(lambda: client.action_client.pub_goal.get_num_connections(), "the server")
        client.send_goal(DockGoal(dock_id="dock", search=True, max_retries=-1))
        wait_for(lambda: any(m.linear.x > 0.05 for m in commands.messages), "motion")
        node.signal(signal.SIGINT)
        self.assertEqual(0, node.wait(), node.err)
        wait_for(lambda: not commands.messages[-1].linear.x, "the stop")
        self.assertEqual(0.0, commands.messages[-1].angular.z)


if __name__ == "__main__":
    rospy.init_node("dock_failures_test")
    rostest.rosrun("bullet_lab", "dock_failures_test", "__main__")
