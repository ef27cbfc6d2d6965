#!/usr/bin/env python3
"""The bridge speaks as Gazebo does: topics, time, pauses, resets, lock step."""

import signal
import sys

import rospy
from bridge_testing import (
    ROBOT,
    BridgeCase,
    advance,
    call,
    milliseconds,
    step,
    twist,
)
from bullet_lab.srv import SetRtf
from lab_testing import Process, run_tests, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Empty

from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

# Joins the lock step, lets time go on to 0.1 s, and then does nothing more.
SLEEPER = """
import time
import rospy
from bullet_lab.srv import Advance
rospy.init_node("sleeper")
rospy.wait_for_service("/bullet_lab/advance")
until = rospy.Time(0.1)
rospy.ServiceProxy("/bullet_lab/advance", Advance)("/sleeper", 1, until, [], [], [])
time.sleep(1000)
"""


def clocks(topic):
    """The times on /clock so far, in ms."""
    return [milliseconds(message.clock) for message in topic.messages]


def places(messages):
    """x, y, and the orientation of odometry messages."""
    poses = [message.pose.pose for message in messages]
    return [(p.position.x, p.position.y, p.orientation.z, p.orientation.w) for p in poses]


def simulated(commands, period):
    """What the odometry says where each command acts for a period in ms, without ROS."""
    samples = []
    with Simulation.of("package://bullet_lab/worlds/empty.world") as simulation:
        robot = simulation.spawn(ROBOT)
        robot.listen("odom", samples.append)
        for vx, wz in commands:
            robot.command("cmd_vel", PlanarCommand(vx=vx, wz=wz))
            simulation.run_until(simulation.step + period)
    return [(*sample.pose.position[:2], *sample.pose.quaternion[2:]) for sample in samples]


class BridgeTest(BridgeCase):
    """Topics, commands, pauses, steps, resets and lock step."""

    parameters = {"robot": ROBOT, "lock_step": "sleeper"}

    # First, as the sleeper is missing only once.
    def test_0_time_waits_for_a_member_that_is_late_and_not_for_a_dead_one(self):
        clock = self.topic("/clock", Clock)
        call("/gazebo/unpause_physics", Empty)
        self.assert_stands(0)
        sleeper = Process(sys.executable, "-c", SLEEPER)
        self.addCleanup(sleeper.end)
        clock.wait(10)
        said = self.bridge.out.count("waits for /sleeper")
        wait_for(lambda: self.bridge.out.count("waits for /sleeper") > said, "a report")
        self.assert_stands(100)
        sleeper.signal(signal.SIGKILL)
        sleeper.wait()
        wait_for(lambda: len(clock.messages) > 100, "time to pass 0.1 s")
        self.assertIn("lock-step member /sleeper has died", self.bridge.err)

    def clock_and_odometry(self):
        return self.topic("/clock", Clock), self.topic("odom", Odometry)

    def test_reset_simulation_starts_again_at_zero(self):
        clock, odom = self.clock_and_odometry()
        commands = self.sender()
        for _ in range(2):
            commands.send(twist(vx=0.5))
            self.assertEqual(130, step(130))
            call("/gazebo/reset_simulation", Empty)
            self.assertEqual(0, step(0))
        clock.wait(26)
        odom.wait(4)
        self.assertEqual(2 * [10 * k for k in range(1, 14)], clocks(clock))
        self.assertEqual(2 * [51, 102], odom.stamps())
        self.assertEqual(places(odom.messages[:2]), places(odom.messages[2:]))

    # Lock step: time never passes what its members have granted

    def lock(self):
        """Take part in the lock step, and let time pass as far as that goes."""
        self.commands = self.sender()
        self.addCleanup(advance)
        self.epoch = self.join()
        call("/gazebo/unpause_physics", Empty)

    def join(self):
        return advance(0, self.commands.sent(), epoch=0).epoch

    def advance(self, until, more=0):
        """Advance after all that was sent, and so many messages more; return the answer."""
        return advance(until, self.commands.sent(more), epoch=self.epoch)

    def test_time_is_advanced_for_nobody_who_lives(self):
        with self.assertRaisesRegex(rospy.ServiceException, "/pybullet_bridge is alive"):
            advance(0, node="/pybullet_bridge")

    def test_commands_act_from_exactly_their_step(self):
        self.lock()
        odom = self.topic("odom", Odometry)
        expected = simulated(SQUIGGLE, 30)
        for rtf in (0, 20):
            call("/bullet_lab/set_rtf", SetRtf, rtf)
            for number, (vx, wz) in enumerate(SQUIGGLE, 1):
                self.commands.publish(twist(vx, wz=wz))
                self.advance(30 * number)
            found = odom.wait(len(expected))
            self.assertEqual(expected, places(found))
            call("/gazebo/reset_simulation", Empty)
            del odom.messages[: len(found)]
            self.epoch = self.join()

    def test_lost_command_does_not_hold_time_for_ever(self):
        self.lock()
        self.assertTrue(self.advance(100, 3).success)
        self.assertIn("commands of /bridge_test were lost", self.bridge.err)

    def test_reset_reaches_a_member_that_is_busy(self):
        self.lock()
        for reset, now in (("world", 100), ("simulation", 0)):
            self.assertTrue(self.advance(100).success)
            call(f"/gazebo/reset_{reset}", Empty)
            # It was busy, and asks for what it would have asked for without the reset.
            answer = self.advance(30_000)
            self.assertEqual((False, now), (answer.success, milliseconds(answer.now)))
            self.assertEqual(self.epoch + 1, answer.epoch)
            self.assert_stands(now)
            self.epoch = answer.epoch
            self.assertTrue(self.advance(now + 50).success)
            call("/gazebo/reset_simulation", Empty)
            self.epoch = self.join()


# Commands (m/s, rad/s) that make a path in which each of them shows.
SQUIGGLE = [(0.1 + 0.01 * k, 0.5 * (-1) ** k) for k in range(40)]


if __name__ == "__main__":
    run_tests()
