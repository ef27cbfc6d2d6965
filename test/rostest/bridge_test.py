#!/usr/bin/env python3
"""The bridge speaks as Gazebo does: topics, time, pauses, resets, lock step."""

import math
import signal
import subprocess
import sys
import threading

import rospy
import rostest
from bridge_testing import (
    MILLISECOND,
    ROBOT,
    BridgeCase,
    advance,
    call,
    milliseconds,
    step,
    twist,
    world,
)
from bullet_lab.srv import SetRtf
from lab_testing import PATIENCE, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

ARM_ROBOT = """<robot name="arm_robot">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="continuous">
    <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
  <gazebo><plugin name="states" filename="libgazebo_ros_joint_state_publisher.so">
    <updateRate>50</updateRate></plugin></gazebo>
</robot>"""

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
    """Topics, commands, pauses, steps and resets."""

    parameters = {"robot": ROBOT}

    def clock_and_odometry(self):
        return self.topic("/clock", Clock), self.topic("odom", Odometry)

    def test_rates_stamps_and_frames(self):
        clock, odom = self.clock_and_odometry()
        tf = self.topic("/tf", TFMessage)
        reached = [step(steps) for steps in (1, 36, 0, 963, 1000, 509)]
        self.assertEqual([1, 37, 37, 1000, 2000, 2509], reached)
        for topic, number in ((clock, 250), (odom, 49), (tf, 49)):
            topic.wait(number)
        self.assertEqual([10 * k for k in range(1, 251)], clocks(clock))
        # More than a period of 20 Hz.
        due = [51 * k * MILLISECOND for k in range(1, 50)]
        self.assertEqual(due, odom.stamps())
        transforms = [transform for message in tf.messages for transform in message.transforms]
        self.assertEqual(due, [t.header.stamp.to_nsec() for t in transforms])
        self.assertEqual({"odom"}, {t.header.frame_id for t in transforms})
        self.assertEqual({"base_footprint"}, {t.child_frame_id for t in transforms})

    def test_commands_that_are_not_finite_are_refused(self):
        odom, commands = self.topic("odom", Odometry), self.sender()
        bad = (math.nan, math.inf, -math.inf)
        refused = [twist(**{name: value}) for name in ("vx", "vy", "wz") for value in bad]
        commands.send(twist(vx=0.2), *refused)
        step(1000)
        x = [message.pose.pose.position.x for message in odom.wait(19)]
        # The command before them stays in force.
        self.assertAlmostEqual(x[17] + 0.0097, x[18], 3)
        wait_for(lambda: "is not finite" in self.node.err, "a warning")
        commands.send(twist())
        step(1000)
        poses = places(odom.wait(39))
        self.assertLess(math.dist(poses[20][:2], poses[38][:2]), 1e-6)

    def test_pause_stops_the_clock_and_nothing_else(self):
        clock = self.topic("/clock", Clock)
        call("/gazebo/unpause_physics", Empty)
        clock.wait(5)
        call("/gazebo/pause_physics", Empty)
        paused_at = step(0)
        self.assert_stands(paused_at)
        self.assertEqual(paused_at + 25, step(25))
        call("/gazebo/unpause_physics", Empty)
        clock.wait(paused_at // 10 + 10)
        ticks = clocks(clock)
        self.assertEqual([10 * k for k in range(1, len(ticks) + 1)], ticks)

    def test_reset_world_puts_the_robot_back_and_keeps_time(self):
        clock, odom = self.clock_and_odometry()
        commands = self.sender()
        step(51)
        commands.send(twist(vx=0.5, wz=1.0))
        step(969)
        call("/gazebo/reset_world", Empty)
        self.assertEqual(1071, step(51))
        clock.wait(107)
        poses = places(odom.wait(21))
        self.assertGreater(math.dist(poses[0], poses[19]), 0.2)
        # Not to the last bit: a block on a floor settles by nanometres.
        for first, again in zip(poses[0], poses[20]):
            self.assertAlmostEqual(first, again, 9)
        self.assertEqual([10 * k for k in range(1, 108)], clocks(clock))

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
        self.assertEqual(2 * [51 * MILLISECOND, 102 * MILLISECOND], odom.stamps())
        self.assertEqual(places(odom.messages[:2]), places(odom.messages[2:]))


class ParametersTest(BridgeCase):
    """Another world, another place and another rate than by default."""

    parameters = {
        "robot": ROBOT,
        "robot_pose": f"1 2 0 0 0 {math.pi / 2}",
        "world": "package://bullet_lab/worlds/beacons.world",
        "clock_rate": 30,
    }

    def test_clock_rate_that_does_not_divide_the_steps(self):
        clock = self.topic("/clock", Clock)
        step(1000)
        clock.wait(30)
        self.assertEqual([math.ceil(1000 * k / 30) for k in range(1, 31)], clocks(clock))

    def test_robot_pose(self):
        odom = self.topic("odom", Odometry)
        step(51)
        for wanted, found in zip((1.0, 2.0, math.sqrt(0.5)), places(odom.wait(1))[0]):
            self.assertAlmostEqual(wanted, found, 6)

    def test_world_is_latched(self):
        step(100)
        found = self.topic("/bullet_lab/world", MarkerArray).wait(1)[0]
        beacons = {
            marker.ns: (marker.pose.position.x, marker.pose.position.y)
            for marker in found.markers
            if marker.type == Marker.MESH_RESOURCE
        }
        self.assertEqual(
            {"beacon_0": (1.0, 1.0), "beacon_1": (5.0, 1.0), "beacon_2": (-5.0, 1.0)}, beacons
        )
        self.assertEqual({*beacons, "ground_plane"}, {marker.ns for marker in found.markers})
        self.assertEqual({"world"}, {marker.header.frame_id for marker in found.markers})


class DescriptionTest(BridgeCase):
    """The robot of the parameter server, in a namespace."""

    parameters = {"robot_namespace": "left"}

    def setUp(self):
        rospy.set_param("robot_description", ARM_ROBOT)
        self.addCleanup(rospy.delete_param, "robot_description")
        super().setUp()

    def test_joint_states_name_the_joints(self):
        joints = self.topic("/left/joint_states", JointState)
        step(100)
        messages = joints.wait(5)
        self.assertEqual([20 * k * MILLISECOND for k in range(1, 6)], joints.stamps())
        for message in messages:
            lengths = (len(message.position), len(message.velocity), len(message.effort))
            self.assertEqual((["elbow"], (1, 1, 0)), (message.name, lengths))


class LockStepTest(BridgeCase):
    """Time never passes what its members have granted."""

    parameters = {"robot": ROBOT, "lock_step": "/bridge_test"}

    def setUp(self):
        super().setUp()
        self.commands = self.sender()
        self.epoch = self.join()
        call("/gazebo/unpause_physics", Empty)

    def join(self):
        return advance(0, self.commands.sent(), epoch=0).epoch

    def advance(self, until, more=0, node=""):
        """Advance after all that was sent, and so many messages more; return the answer."""
        sent = {} if node else self.commands.sent(more)
        return advance(until, sent, node, self.epoch)

    def going(self, *words):
        """A thread that advances."""
        thread = threading.Thread(target=self.advance, args=words, daemon=True)
        thread.start()
        return thread

    def test_time_never_passes_a_grant(self):
        clock = self.topic("/clock", Clock)
        for until in range(0, 401, 100):
            answer = self.advance(until)
            self.assertEqual((True, until), (answer.success, milliseconds(answer.now)))
            self.assert_stands(until)
        advance()
        clock.wait(400)
        ticks = clocks(clock)
        self.assertEqual([10 * k for k in range(1, len(ticks) + 1)], ticks)

    def test_slowest_member_counts(self):
        self.addCleanup(advance, node="/other")
        self.advance(0, 0, "/other")
        ahead = self.going(500)
        self.advance(200, 0, "/other")
        self.assert_stands(200)
        self.assertTrue(ahead.is_alive())
        self.advance(500, 0, "/other")
        ahead.join(PATIENCE)
        self.assertFalse(ahead.is_alive())
        # Time is advanced for a node that does not exist, but not for one that lives.
        with self.assertRaisesRegex(rospy.ServiceException, "/pybullet_bridge is alive"):
            self.advance(0, 0, "/pybullet_bridge")

    def test_commands_act_from_exactly_their_step(self):
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

    def test_announced_command_is_awaited(self):
        odom = self.topic("odom", Odometry)
        self.advance(100)
        going = self.going(200, 1)
        # No longer: the bridge waits for 2 s of wall time.
        self.assertEqual(0.1, world().sim_time)
        self.commands.publish(twist(vx=1.0))
        going.join(PATIENCE)
        expected = simulated([(0.0, 0.0), (1.0, 0.0)], 100)
        self.assertEqual(expected, places(odom.wait(len(expected))))

    def test_lost_command_does_not_hold_time_for_ever(self):
        self.assertTrue(self.advance(100, 3).success)
        self.assertIn("commands of /bridge_test were lost", self.node.err)

    def test_reset_reaches_a_member_that_is_busy(self):
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


class DeadMemberTest(BridgeCase):
    """Time waits for a member that is late, and not for one that is dead."""

    parameters = {"paused": False, "lock_step": "sleeper"}

    def test_dead_members_do_not_hold_time(self):
        clock = self.topic("/clock", Clock)
        self.assert_stands(0)
        sleeper = subprocess.Popen([sys.executable, "-c", SLEEPER])
        self.addCleanup(sleeper.wait)
        self.addCleanup(sleeper.kill)
        clock.wait(10)
        said = self.node.out.count("waits for /sleeper")
        wait_for(lambda: self.node.out.count("waits for /sleeper") > said, "a report")
        self.assert_stands(100)
        sleeper.send_signal(signal.SIGKILL)
        sleeper.wait()
        wait_for(lambda: len(clock.messages) > 100, "time to pass 0.1 s")
        self.assertIn("lock-step member /sleeper has died", self.node.err)


# Commands (m/s, rad/s) that make a path in which each of them shows.
SQUIGGLE = [(0.1 + 0.01 * k, 0.5 * (-1) ** k) for k in range(40)]


def setUpModule():
    rospy.init_node("bridge_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "bridge_test", "__main__")
