#!/usr/bin/env python3
"""The bridge answers whatever goes wrong with one clear line and the right exit status."""

import signal
import sys
import unittest

from lab_testing import Master, Node, Process, run_tests, wait_for

ROBOT = "package://bullet_lab/urdf/block_robot.urdf"

LOGGING = """
import rospy
from bullet_lab.ros.node.node import run_node

def body():
    rospy.loginfo("a word")
    print("ready", flush=True)
    rospy.spin()

run_node("logging", body)
"""
# Calls a service that does not come back, and says when time goes on for it.
CALLER = """
import threading
import rospy
from bullet_lab.srv import Advance, Step
from rosgraph_msgs.msg import Clock

rospy.init_node("waiting", disable_signals=True)
going = threading.Event()
rospy.Subscriber("/clock", Clock, lambda _: going.set())
rospy.wait_for_service("/bullet_lab/advance")
call = threading.Thread(target=lambda: {call}, daemon=True)
call.start()
going.wait()
print("waiting", flush=True)
call.join()
"""
# Joins the lock step and waits for a time that does not come.
ADVANCE = (
    'rospy.ServiceProxy("/bullet_lab/advance", Advance)'
    '("/waiting", 1, rospy.Time(10**9), [], [], [])'
)
# Asks for more steps than anybody can wait for.
STEP = 'rospy.ServiceProxy("/bullet_lab/step", Step)(2**32 - 1)'


class FailuresTest(unittest.TestCase):
    """All nodes have one master, but for the test that ends it."""

    @classmethod
    def setUpClass(cls):
        cls.master = Master()

    @classmethod
    def tearDownClass(cls):
        cls.master.end()

    def bridge(self, master=None, **parameters):
        uri = (master or self.master).uri
        bridge = Node("pybullet_bridge.py", master=uri, rtf=0, **parameters)
        self.addCleanup(bridge.end)
        return bridge

    def running_bridge(self, master=None, **parameters):
        master, service = master or self.master, "/bullet_lab/advance"
        # That of a bridge that was killed.
        before = master.offers(service)
        bridge = self.bridge(master, **parameters)
        wait_for(
            lambda: not bridge.runs() or master.offers(service) not in ("", before), "the bridge"
        )
        self.assertTrue(bridge.runs(), bridge.err)
        return bridge

    def helper(self, program):
        """Start a little program and wait for its first line."""
        process = Process(sys.executable, "-c", program, ROS_MASTER_URI=self.master.uri)
        self.addCleanup(process.end)
        wait_for(lambda: "\n" in process.out, "the program")
        return process

    def assert_ends(self, bridge, status, *words):
        """Assert that it ends with a status and one line on standard error with these words."""
        self.assertEqual(status, bridge.wait(), bridge.err)
        self.assertEqual(1, len(bridge.err.splitlines()), bridge.err)
        self.assertNotIn("Traceback", bridge.out)
        for word in words:
            self.assertIn(word, bridge.err)

    # How worlds, robots and parameters are refused is in the unit tests; that the bridge then ends
    # is here.

    def test_malformed_robot_description(self):
        self.master.set_parameter("/robot_description", {"a": "b"})
        self.addCleanup(self.master.set_parameter, "/robot_description", "")
        self.assert_ends(self.bridge(), 1, "robot_description")
        self.assertFalse(self.master.knows("/pybullet_bridge"))

    def test_misspelt_parameter(self):
        self.assert_ends(self.bridge(reality=1), 2, "~reality", "~rtf")

    def test_second_bridge_and_ctrl_c_while_a_member_waits(self):
        first = self.running_bridge()
        self.assert_ends(self.bridge(), 1, "/pybullet_bridge", "/clock")
        self.assertTrue(first.runs())
        self.assertTrue(self.master.knows("/pybullet_bridge"))
        # One that was killed is in nobody's way.
        first.signal(signal.SIGKILL)
        first.wait()
        self.assert_ctrl_c_ends_it(ADVANCE, lock_step="waiting")

    def test_ctrl_c_while_it_steps(self):
        self.assert_ctrl_c_ends_it(STEP, paused=True)

    def assert_ctrl_c_ends_it(self, call, **parameters):
        bridge = self.running_bridge(robot=ROBOT, **parameters)
        self.helper(CALLER.format(call=call))
        bridge.signal()
        self.assertEqual(0, bridge.wait(), bridge.err)
        self.assertEqual("", bridge.err)
        self.assertNotIn("Traceback", bridge.out)
        self.assertFalse(self.master.knows("/pybullet_bridge"))

    def test_master_that_goes_away(self):
        master = Master()
        self.addCleanup(master.end)
        bridge = self.running_bridge(master, robot=ROBOT)
        master.end()
        self.assert_ends(bridge, 1, "the ROS master is gone")

    def test_a_master_forgets_a_node_that_has_logged(self):
        node = self.helper(LOGGING)
        self.assertTrue(self.master.knows("/logging"))
        node.signal()
        self.assertEqual(0, node.wait())
        self.assertFalse(self.master.knows("/logging"))


if __name__ == "__main__":
    run_tests(node=False)
