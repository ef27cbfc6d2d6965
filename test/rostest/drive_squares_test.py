#!/usr/bin/env python3
"""The robot is driven as in the report, and stands still whatever ends the drive."""

import contextlib
import http.client
import math
import signal
import threading
import time
import unittest
import xmlrpc.client

import rosgraph
import rospy
import rostest
from geometry_msgs.msg import Twist
from lab_testing import Node, Topic, odometry, wait_for
from nav_msgs.msg import Odometry
from std_msgs.msg import Time

ROBOT = "package://bullet_lab/urdf/block_robot.urdf"


def velocities(topic):
    """The commands so far as (m/s, rad/s)."""
    return [(message.linear.x, message.angular.z) for message in topic.messages]


def advertised(topic):
    """Whether the master knows a publisher of a topic."""
    publishers, _, _ = rosgraph.Master("/test").getSystemState()
    return topic in dict(publishers)


class FakeRobot:
    """Follows the commands, and publishes its pose 50 times a second of wall time."""

    def __init__(self):
        self.x = self.y = self.yaw = 0.0
        self.speaks = True
        self._command = (0.0, 0.0)
        self._over = False
        self._publisher = rospy.Publisher("odom", Odometry, queue_size=10, tcp_nodelay=True)
        self._subscriber = rospy.Subscriber("cmd_vel", Twist, self._take)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self):
        self._over = True
        self._thread.join()
        self._publisher.unregister()
        self._subscriber.unregister()

    def _take(self, message):
        self._command = (message.linear.x, message.angular.z)

    def _run(self):
        last = time.monotonic()
        while not self._over:
            time.sleep(0.02)
            now = time.monotonic()
            ahead, turn = self._command
            self.x += (now - last) * ahead * math.cos(self.yaw)
            self.y += (now - last) * ahead * math.sin(self.yaw)
            self.yaw += (now - last) * turn
            last = now
            if self.speaks:
                self._publisher.publish(odometry(rospy.get_time(), self.x, self.y, self.yaw))


class DriveSquaresTest(unittest.TestCase):
    """Each test has a node of its own."""

    def setUp(self):
        self.commands = self.topic("cmd_vel", Twist)

    def topic(self, name, kind):
        topic = Topic(name, kind, connected=False)
        self.addCleanup(topic.close)
        return topic

    def start(self, name="", **parameters):
        node = Node("drive_squares.py", name, **parameters)
        self.addCleanup(node.end)
        return node

    def robot(self):
        robot = FakeRobot()
        self.addCleanup(robot.end)
        return robot

    def wait_until_driving(self, node, number=3):
        def is_driving():
            return sum(1 for v in velocities(self.commands) if any(v)) >= number

        def what():
            said = velocities(self.commands)[-5:]
            links = (self.commands.is_connected(), rosgraph.Master("/test").getSystemState()[:2])
            return f"commands; have {said}, {links}; the node has written {node.out}{node.err}"

        wait_for(lambda: is_driving() or not node.runs(), what)
        self.assertTrue(node.runs(), node.err)

    def assert_stopped(self):
        """Assert that the last thing that was said is to stand still; the node has ended."""
        wait_for(lambda: velocities(self.commands)[-1] == (0.0, 0.0), "a stop")
        time.sleep(0.3)
        last = self.commands.messages[-1]
        self.assertEqual(Twist(), last)
        self.assertTrue(any(any(v) for v in velocities(self.commands)))

    def test_open_loop_sends_the_commands_of_the_report(self):
        finished = self.topic("drive_squares/finished", Time)
        node = self.start(sides=2, side=0.06, speed=0.2, turn_speed=-0.5, turn_commands=2)
        self.assertEqual(0, node.wait(), node.err)
        side = 3 * [(0.2, 0.0)] + 2 * [(0.0, -0.5)]
        self.assert_stopped()
        sent = velocities(self.commands)
        self.assertEqual(2 * side, sent[: 2 * len(side)])
        self.assertEqual({(0.0, 0.0)}, set(sent[2 * len(side) :]))
        self.assertEqual("", node.err)
        for number in (1, 2):
            self.assertIn(f"side {number} of 2", node.out)
        (message,) = finished.wait(1)
        self.assertEqual("1", message._connection_header["latching"])
        self.assertLess(abs(message.data.to_sec() - rospy.get_time()), 60.0)

    def test_defaults_are_those_of_listing_9(self):
        node = self.start()
        self.wait_until_driving(node, 2)
        node.signal()
        node.wait()
        self.assertIn((0.2, 0.0), velocities(self.commands))

    def test_other_topic(self):
        elsewhere = self.topic("robot/cmd_vel", Twist)
        node = self.start(cmd_vel="robot/cmd_vel", sides=1, side=0.02, turn_commands=1)
        self.assertEqual(0, node.wait(), node.err)
        time.sleep(0.3)
        self.assertEqual([(0.2, 0.0), (0.0, -0.5236)], velocities(elsewhere)[:2])
        self.assertEqual([], self.commands.messages)

    def test_signals_stop_the_robot(self):
        for number in (signal.SIGINT, signal.SIGTERM):
            self.commands = self.topic("cmd_vel", Twist)
            node = self.start()
            self.wait_until_driving(node)
            node.signal(number)
            self.assertEqual((0, ""), (node.wait(), node.err))
            # Long before the end of the square.
            self.assertNotIn("side 2", node.out)
            self.assert_stopped()

    def test_ctrl_c_in_closed_loop_stops_the_robot(self):
        self.robot()
        node = self.start(mode="closed_loop")
        self.wait_until_driving(node)
        node.signal()
        self.assertEqual((0, ""), (node.wait(), node.err))
        self.assert_stopped()

    def test_ctrl_c_while_nobody_listens(self):
        self.commands.close()
        node = self.start()
        wait_for(lambda: advertised("/cmd_vel") or not node.runs(), "the publisher of cmd_vel")
        node.signal()
        self.assertEqual((0, ""), (node.wait(), node.err))

    def test_closed_loop_drives_and_turns_until_the_odometry_says_so(self):
        robot = self.robot()
        node = self.start(mode="closed_loop", sides=1, side=0.1, turn_speed=-1.0)
        self.assertEqual((0, ""), (node.wait(), node.err))
        self.assertAlmostEqual(0.1, robot.x, delta=0.02)
        self.assertAlmostEqual(0.0, robot.y, delta=0.02)
        self.assertAlmostEqual(-90.0, math.degrees(robot.yaw), delta=3.0)
        self.assert_stopped()

    def test_odometry_that_ends_stops_the_robot(self):
        robot = self.robot()
        node = self.start(mode="closed_loop")
        self.wait_until_driving(node)
        robot.speaks = False
        wait_for(lambda: velocities(self.commands)[-1] == (0.0, 0.0), "a stop")
        # At once, not when it gives up.
        self.assertTrue(node.runs())
        self.assertEqual(1, node.wait())
        self.assertEqual("drive_squares: no odometry on odom for 5 s\n", node.err)
        self.assert_stopped()

    def test_odometry_that_pauses_only_delays_the_robot(self):
        robot = self.robot()
        node = self.start(mode="closed_loop", sides=1, side=0.3, turn_speed=-2.0)
        self.wait_until_driving(node)
        robot.speaks = False
        wait_for(lambda: velocities(self.commands)[-1] == (0.0, 0.0), "a stop")
        robot.speaks = True
        self.assertEqual((0, ""), (node.wait(), node.err))
        self.assertAlmostEqual(0.3, robot.x, delta=0.03)

    def test_closed_loop_without_odometry(self):
        node = self.start(mode="closed_loop", odom="nowhere")
        self.assertEqual(1, node.wait())
        self.assertEqual("drive_squares: no odometry on nowhere for 5 s\n", node.err)

    def test_shutdown_by_another_node_at_full_speed(self):
        bridge = Node("pybullet_bridge.py", robot=ROBOT, rtf=0, lock_step="driver_0")
        self.addCleanup(bridge.end)
        for name in ("driver_0", "driver_1"):
            self.commands = self.topic("cmd_vel", Twist)
            node = self.start(name, lock_step=True, sides=1000)
            self.wait_until_driving(node, 500)
            uri = rosgraph.Master("/test").lookupNode(f"/{name}")
            # It may be gone before it has answered.
            with contextlib.suppress(OSError, http.client.HTTPException):
                xmlrpc.client.ServerProxy(uri).shutdown("/test", "because of a test")
            self.assertEqual(0, node.wait())
            # rospy itself may say that it waits for the bridge.
            self.assertNotIn("Traceback", node.err)
            self.assert_stopped()

    def test_bridge_that_dies_in_lock_step(self):
        bridge = Node("pybullet_bridge.py", robot=ROBOT, rtf=1, lock_step="drive_squares")
        self.addCleanup(bridge.end)
        node = self.start(lock_step=True)
        self.wait_until_driving(node)
        bridge.signal(signal.SIGKILL)
        self.assertEqual(1, node.wait())
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("/bullet_lab/advance", node.err)
        self.assert_stopped()

    def test_bad_parameters(self):
        node = self.start(sides="2.5")
        self.assertEqual(2, node.wait(), node.err)
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("~sides", node.err)
        self.assertEqual([], self.commands.messages)


def setUpModule():
    rospy.init_node("drive_squares_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "drive_squares_test", "__main__")
