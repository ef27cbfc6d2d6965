#!/usr/bin/env python3
"""A relay or a multiplexer between a driver in lock step and the bridge changes nothing."""

import math
import os
import subprocess
import sys
import unittest
from pathlib import Path

from bridge_testing import ROBOT
from geometry_msgs.msg import Twist
from lab_testing import NodeTest, offered, run_tests, wait_for
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


class RelayTest(NodeTest):
    """See the docstring of the module."""

    def program(self, *words):
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def bridge(self):
        """A bridge whose time waits for the driver."""
        bridge = self.node("pybullet_bridge.py", robot=ROBOT, rtf=0, lock_step="drive_squares")
        wait_for(lambda: offered("/gazebo/reset_simulation") or not bridge.runs(), "the bridge")
        self.odom = self.topic("odom", Odometry)
        return bridge

    def driver(self, mode, cmd_vel="wish"):
        return self.node(
            "drive_squares.py", lock_step=True, mode=mode, sides=SIDES, cmd_vel=cmd_vel
        )

    def places(self, *driver):
        """Drive; return the places of the robot."""
        before, driver = len(self.odom.messages), self.driver(*driver)
        self.assert_ends_well(driver)
        # The world goes on when the driver has gone.
        messages = self.odom.wait(before + MESSAGES)[before : before + MESSAGES]
        poses = [message.pose.pose.position for message in messages]
        return [(pose.x, pose.y) for pose in poses]

    def test_a_loop_is_closed_through_a_relay(self):
        bridge = self.bridge()
        straight = self.places("closed_loop", "cmd_vel")
        bridge.end()
        self.program(sys.executable, "-c", RELAY)
        bridge = self.bridge()
        self.assertEqual(straight, self.places("closed_loop"))
        self.assertNotIn("lost", bridge.err)

    def test_what_loses_the_commands_does_not_hold_time(self):
        self.bridge()
        multiplexer = self.program(topic_tool("mux"), "cmd_vel", "other", "wish")
        for place in self.places("open_loop"):
            self.assertLess(math.hypot(*place), MOVED)
        multiplexer.kill()
        multiplexer.wait()
        # One that dies on the way.
        relay = self.program(topic_tool("relay"), "wish", "cmd_vel")
        driver = self.driver("open_loop")
        self.topic("cmd_vel", Twist).wait(20)
        relay.kill()
        self.assert_ends_well(driver)


if __name__ == "__main__":
    run_tests()
