#!/usr/bin/env python3
"""A relay or a multiplexer between a driver in lock step and the bridge changes nothing.

What it costs in time is measured by `scripts/bench.sh relay`.
"""

import os
import signal
import subprocess
import sys
import unittest
from pathlib import Path

import rospy
import rostest
from bridge_testing import ROBOT
from geometry_msgs.msg import Twist
from lab_testing import PATIENCE, Node, Topic
from nav_msgs.msg import Odometry

SIDES = 1
# One every 51 ms, for 12 s a side.
MESSAGES = SIDES * 12_000 // 51

RELAY = """
import rospy
from geometry_msgs.msg import Twist
rospy.init_node("relay")
onward = rospy.Publisher("cmd_vel", Twist, queue_size=10)
rospy.Subscriber("wish", Twist, onward.publish)
rospy.spin()
"""
MOVED = 0.01


def topic_tool(name):
    """The path of a program of topic_tools."""
    for root in (os.environ.get("ROS_ROOT", ""), "/usr", "/opt/ros/noetic"):
        path = Path(root) / "lib/topic_tools" / name
        if path.exists():
            return str(path)
    raise unittest.SkipTest("topic_tools is not installed")


class RelayTest(unittest.TestCase):
    """See the docstring of the module."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("relay_test")

    def program(self, *words):
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def drive(self, *detour, mode="closed_loop", meanwhile=lambda: None):
        """Drive in lock step; return the places of the robot, and the bridge."""
        bridge = Node("pybullet_bridge.py", robot=ROBOT, rtf=0, lock_step="drive_squares")
        process = self.program(*detour) if detour else None
        try:
            rospy.wait_for_service("/gazebo/reset_simulation", PATIENCE)
            odom = Topic("odom", Odometry)
            driver = Node(
                "drive_squares.py",
                lock_step=True,
                mode=mode,
                sides=SIDES,
                cmd_vel="wish" if detour else "cmd_vel",
            )
            meanwhile()
            self.assertEqual(0, driver.wait(), driver.err)
            # The world goes on when the driver has gone.
            poses = [message.pose.pose.position for message in odom.wait(MESSAGES)[:MESSAGES]]
            odom.close()
        finally:
            bridge.end()
            if process is not None:
                process.kill()
                process.wait()
        return [(pose.x, pose.y) for pose in poses], bridge

    def test_a_loop_is_closed_through_a_relay(self):
        straight, _ = self.drive()
        relayed, bridge = self.drive(sys.executable, "-c", RELAY)
        self.assertEqual(straight, relayed)
        self.assertNotIn("lost", bridge.err)

    def test_a_multiplexer_that_drops_the_commands_does_not_stall(self):
        places, _ = self.drive(topic_tool("mux"), "cmd_vel", "other", "wish", mode="open_loop")
        self.assertTrue(all(abs(x) < MOVED and abs(y) < MOVED for x, y in places))

    def test_a_relay_that_dies_does_not_hold_time(self):
        def kill():
            commands = Topic("cmd_vel", Twist)
            commands.wait(20)
            self.relay.send_signal(signal.SIGKILL)

        self.relay = self.program(topic_tool("relay"), "wish", "cmd_vel")
        self.drive("/bin/sleep", "1000", mode="open_loop", meanwhile=kill)


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "relay_test", RelayTest, sys.argv)
