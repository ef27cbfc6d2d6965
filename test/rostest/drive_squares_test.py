#!/usr/bin/env python3
"""The robot is driven as in the report, and stands still whatever ends the drive."""

import contextlib
import http.client
import signal
import xmlrpc.client

import rosgraph
from geometry_msgs.msg import Twist
from lab_testing import NodeTest, advertised, run_tests, wait_for
from standin import RobotStandIn

ROBOT = "package://bullet_lab/urdf/block_robot.urdf"


def velocities(topic):
    """The commands so far as (m/s, rad/s)."""
    return [(message.linear.x, message.angular.z) for message in topic.messages]


class DriveSquaresTest(NodeTest):
    """Each test has a node of its own."""

    def setUp(self):
        self.commands = self.topic("cmd_vel", Twist, False)

    def start(self, name="", **parameters):
        return self.node("drive_squares.py", name, **parameters)

    def robot(self, tick):
        robot = RobotStandIn(tick).start()
        self.addCleanup(robot.end)
        return robot

    def wait_until_driving(self, node, number=3):
        def is_driving():
            return sum(1 for v in velocities(self.commands) if any(v)) >= number

        wait_for(lambda: is_driving() or not node.runs(), lambda: f"commands; {node.err}")
        self.assertTrue(node.runs(), node.err)

    def end(self, node, number=signal.SIGINT):
        """Send a node a signal, of which it ends without a word."""
        node.signal(number)
        self.assertEqual((0, ""), (node.wait(), node.err))

    def is_stopped(self):
        return velocities(self.commands)[-1] == (0.0, 0.0)

    def assert_stopped(self):
        """Assert that the last thing that was said is to stand still; the node has ended."""
        wait_for(lambda: not self.commands.is_connected(), "the end of the connection")
        self.assertEqual(Twist(), self.commands.messages[-1])
        self.assertTrue(any(any(v) for v in velocities(self.commands)))

    def test_ctrl_c_while_it_drives_the_square_of_listing_9_on_another_topic(self):
        elsewhere, self.commands = self.commands, self.topic("robot/cmd_vel", Twist, False)
        self.robot(0.1)
        node = self.start(cmd_vel="robot/cmd_vel")
        self.wait_until_driving(node)
        self.end(node)
        self.assert_stopped()
        self.assertEqual((0.2, 0.0), velocities(self.commands)[0])
        self.assertEqual([], elsewhere.messages)

    def test_sigterm_in_closed_loop_stops_the_robot(self):
        self.robot(0.05)
        node = self.start(mode="closed_loop")
        self.wait_until_driving(node)
        self.end(node, signal.SIGTERM)
        # Long before the end of the square.
        self.assertNotIn("side 2", node.out)
        self.assert_stopped()

    def test_ctrl_c_while_nobody_listens(self):
        self.commands.close()
        node = self.start()
        wait_for(lambda: advertised("/cmd_vel") or not node.runs(), "the publisher of cmd_vel")
        self.end(node)

    def test_odometry_that_pauses_delays_the_robot_and_its_end_is_an_error(self):
        robot = self.robot(0.05)
        node = self.start(mode="closed_loop", sides=2, side=0.3, turn_speed=-2.0)
        self.wait_until_driving(node)
        robot.does.discard("odom")
        wait_for(self.is_stopped, "a stop")
        self.assertLess(robot.pose[0], 0.25)
        robot.does.add("odom")
        wait_for(lambda: "side 2" in node.out, "the second side")
        self.assertAlmostEqual(0.3, robot.pose[0], delta=0.03)
        self.wait_until_driving(node, len(self.commands.messages))
        robot.does.discard("odom")
        wait_for(self.is_stopped, "a stop")
        # At once, not when it gives up.
        self.assertTrue(node.runs())
        self.assertEqual(1, node.wait())
        self.assertEqual("drive_squares: no odometry on odom for 5 s\n", node.err)
        self.assert_stopped()

    def test_shutdown_by_another_node_and_a_bridge_that_dies_in_lock_step(self):
        bridge = self.node("pybullet_bridge.py", robot=ROBOT, rtf=0, lock_step="driver_0")
        node = self.start("driver_0", lock_step=True, sides=1000)
        self.wait_until_driving(node, 500)
        uri = rosgraph.Master("/test").lookupNode("/driver_0")
        # It may be gone before it has answered.
        with contextlib.suppress(OSError, http.client.HTTPException):
            xmlrpc.client.ServerProxy(uri).shutdown("/test", "because of a test")
        # rospy itself may say that it waits for the bridge.
        self.assert_ends_well(node)
        self.assert_stopped()
        node = self.start(lock_step=True, sides=1000)
        self.wait_until_driving(node, len(self.commands.messages))
        bridge.signal(signal.SIGKILL)
        self.assertEqual(1, node.wait())
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("/bullet_lab/advance", node.err)
        self.assert_stopped()


if __name__ == "__main__":
    run_tests()
