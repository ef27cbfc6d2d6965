#!/usr/bin/env python3
"""What the dock node refuses and gives up, by name, and that the robot stands still then."""

import math
import signal

import rospy
from actionlib import GoalStatus, SimpleActionClient
from actionlib_msgs.msg import GoalStatusArray
from bullet_lab.msg import DockAction, DockGoal, DockResult, UndockAction, UndockGoal
from geometry_msgs.msg import PoseStamped, Twist
from lab_testing import Node, NodeTest, Topic, run_tests, transform, wait_for
from standin import DockStandIn
from tf2_msgs.msg import TFMessage

from bullet_lab.docking.types import DockingState
from bullet_lab.ros.messages.poses import stamped_pose

APPROACHING = int(DockingState.APPROACHING)


class DockFailuresTest(NodeTest):
    """All tests share one stand-in and one node."""

    @classmethod
    def setUpClass(cls):
        cls.robot = DockStandIn().start()
        # A node that is starved finds its messages late.
        cls.shared = Node("dock.py", patience=30.0)
        cls.dock = SimpleActionClient("dock", DockAction)
        cls.undock = SimpleActionClient("undock", UndockAction)
        cls.commands = Topic("cmd_vel", Twist)
        wait_for(cls.is_connected, "the action servers")

    @classmethod
    def tearDownClass(cls):
        cls.shared.end()
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
        with self.robot.lock:
            self.robot.pose = (2.6, 0.0, 0.0)
        self.robot.does = {"odom", "camera_info", "detections", "move"}

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

    def assert_failed(self, code, words):
        result = self.result()
        self.assertFalse(result.success)
        self.assertEqual(code, result.error_code, result.message)
        self.assertIn(words, result.message)
        self.assertNotIn("\n", result.message)
        self.robot.assert_stands()

    def approach(self):
        """Send a goal, and wait until the robot drives to the dock."""
        self.send()
        self.wait_until_approaching()

    def wait_until_approaching(self):
        wait_for(lambda: APPROACHING in self.states, "the approach")
        wait_for(lambda: self.commands.messages[-1].linear.x > 0.05, "motion")

    # Invalid goals

    def test_unknown_dock(self):
        self.send("kitchen")
        self.assert_failed(DockResult.NOT_IN_DATABASE, "no dock 'kitchen'")

    # What is missing at the start

    def test_no_odometry(self):
        self.robot.does.discard("odom")
        self.send()
        self.assert_failed(DockResult.ODOMETRY_LOST, "odom: no messages")

    # Failures during the docking

    def test_time_set_back(self):
        self.approach()
        self.robot.set_time(rospy.Time(0, 500_000_000))
        self.assert_failed(DockResult.UNKNOWN, "set back")
        # A new goal is pursued as ever, and both actions say how their goals stand.
        for action in ("dock", "undock"):
            self.topic(f"{action}/status", GoalStatusArray).wait(2)
        self.setUp()
        self.approach()

    def test_transforms_from_after_the_end_of_time(self):
        self.approach()
        sender = rospy.Publisher("/tf", TFMessage, queue_size=1)
        self.addCleanup(sender.unregister)
        wait_for(lambda: sender.get_num_connections() >= 1, "the node")
        late = transform("odom", "nobody")
        late.header.stamp = rospy.Time(2**32 - 1)
        sender.publish(TFMessage([late]))
        wait_for(lambda: "/tf: refused: a stamp at the end" in self.shared.err, "a warning")
        self.assertTrue(self.result().success)

    # Whoever wants it

    def test_preempted_it_stops_at_once(self):
        self.approach()
        before = len(self.commands.messages)
        self.dock.cancel_goal()
        self.assert_failed(DockResult.PREEMPTED, "on request")
        self.assertEqual(GoalStatus.PREEMPTED, self.dock.get_state())
        moves = [bool(m.linear.x or m.angular.z) for m in self.commands.messages[before:]]
        # Nothing that was computed before comes after the stop.
        self.assertFalse(any(moves[moves.index(False) :]))

    def test_the_two_actions_exclude_each_other(self):
        self.approach()
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
        self.robot.assert_stands()
        x, y, _ = self.robot.pose
        self.assertAlmostEqual(3.44, x, delta=0.01)
        self.assertAlmostEqual(0.0, y, delta=0.01)
        self.assertAlmostEqual(0.4, result.distance, delta=0.01)
        self.undock.send_goal(UndockGoal(0.5))
        result = self.result_of(self.undock)
        self.assertTrue(result.success, result.message)
        self.robot.assert_stands()
        self.assertAlmostEqual(x - 0.5, self.robot.pose[0], delta=0.03)

    def test_pose_on_a_map(self):
        pose = self.topic("dock/dock_pose", PoseStamped)
        # (4, 0, 0) of the odometry, some decimetres beside it.
        dock = stamped_pose(rospy.Time(0), "map", (0.1, 5.1, math.pi / 2))
        self.send("", dock_pose=dock)
        self.wait_until_approaching()
        found = pose.messages[-1]
        self.assertEqual("odom", found.header.frame_id)
        self.assertAlmostEqual(4.0, found.pose.position.x, delta=0.05)
        self.assertAlmostEqual(0.0, found.pose.position.y, delta=0.05)

    # Last, as the node ends.
    def test_z_whoever_ends_the_node_the_robot_stops(self):
        self.approach()
        self.shared.signal(signal.SIGINT)
        self.assert_ends_well(self.shared)
        wait_for(lambda: not self.commands.messages[-1].linear.x, "the stop")
        self.assertEqual(0.0, self.commands.messages[-1].angular.z)
        self.dock.stop_tracking_goal()


if __name__ == "__main__":
    run_tests()
