#!/usr/bin/env python3
"""The bridge speaks as Gazebo does: topics, time, pauses, resets, lock step."""

import math
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

import rospy
import rostest
from bullet_lab.srv import Advance, Step
from geometry_msgs.msg import Twist
from lab_testing import Node, Topic, publisher, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
WORLD = "package://bullet_lab/worlds/empty.world"
MILLISECOND = 1_000_000
END_OF_TIME = rospy.Time(2**31 - 1)

ARM_ROBOT = """<robot name="arm_robot">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="continuous">
    <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
  <gazebo><plugin name="states" filename="libgazebo_ros_joint_state_publisher.so">
    <updateRate>50</updateRate></plugin></gazebo>
  <gazebo><plugin name="move" filename="libgazebo_ros_planar_move.so">
    <cmdTimeout>0.5</cmdTimeout></plugin></gazebo>
</robot>"""

# Joins the lock step, lets time go on to so many seconds, and then does nothing more.
SLEEPER = """
import sys, time
import rospy
from bullet_lab.srv import Advance
rospy.init_node("sleeper")
rospy.wait_for_service("/bullet_lab/advance")
until = rospy.Time(float(sys.argv[1]))
rospy.ServiceProxy("/bullet_lab/advance", Advance)("/sleeper", 1, until, [], [], [])
print("joined", flush=True)
time.sleep(1000)
"""


def call(service, kind, *arguments):
    """Call a service once it is there."""
    rospy.wait_for_service(service, 60)
    return rospy.ServiceProxy(service, kind)(*arguments)


def step(steps):
    """Advance by so many steps; return the time reached in ms."""
    answer = call("/bullet_lab/step", Step, steps)
    if not answer.success:
        raise AssertionError(answer.status_message)
    return milliseconds(answer.now)


def advance(until, commands=0, node=None, epoch=1):
    """Let time go on to so many ms, for all that this test cares; return the answer."""
    stamp = rospy.Time(*divmod(until * MILLISECOND, 10**9))
    return advance_to(stamp, commands, node or rospy.get_name(), epoch)


def advance_to(stamp, commands, node, epoch):
    sent = (["/cmd_vel"], ["/pybullet_bridge"], [commands])
    return call("/bullet_lab/advance", Advance, node, epoch, stamp, *sent)


def leave(commands=0):
    """Let time go on for ever, as soon as so many commands have arrived."""
    advance_to(END_OF_TIME, commands, rospy.get_name(), 0)


def milliseconds(stamp):
    return stamp.to_nsec() / MILLISECOND


def clocks(topic):
    """The times on /clock so far, in ms."""
    return [milliseconds(message.clock) for message in topic.messages]


def twist(vx=0.0, vy=0.0, wz=0.0):
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = vx, vy, wz
    return message


def places(messages):
    """x, y, and the orientation of odometry messages, to the last bit."""
    poses = [message.pose.pose for message in messages]
    return [(p.position.x, p.position.y, p.orientation.z, p.orientation.w) for p in poses]


def simulated(commands, period):
    """What the odometry says where each command acts for a period in ms, without ROS."""
    samples = []
    with Simulation.of(WORLD) as simulation:
        robot = simulation.spawn(ROBOT)
        robot.listen("odom", samples.append)
        for vx, wz in commands:
            robot.command("cmd_vel", PlanarCommand(vx=vx, wz=wz))
            simulation.run_until(simulation.step + period)
    return [(*sample.pose.position[:2], *sample.pose.quaternion[2:]) for sample in samples]


class BridgeCase(unittest.TestCase):
    """Starts bridges, with the block robot, at full speed and paused if not said otherwise."""

    def start(self, paused=True, rtf=0, robot=ROBOT, **parameters):
        bridge = Node("pybullet_bridge.py", paused=paused, rtf=rtf, robot=robot, **parameters)
        self.addCleanup(bridge.end)
        wait_for(lambda: self.is_ready(bridge), "the bridge's services")
        return bridge

    def is_ready(self, bridge):
        self.assertTrue(bridge.runs(), bridge.err)
        try:
            # The last thing that it offers.
            rospy.wait_for_service("/bullet_lab/advance", 0.05)
        except rospy.ROSException:
            return False
        return True

    def topic(self, name, kind):
        topic = Topic(name, kind)
        self.addCleanup(topic.close)
        return topic

    def commands(self):
        made = publisher("cmd_vel", Twist)
        self.addCleanup(made.unregister)
        return made

    def arm_robot(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        path = Path(folder.name) / "arm_robot.urdf"
        path.write_text(ARM_ROBOT)
        return path


class TopicsTest(BridgeCase):
    """What the topics say."""

    def test_rates_stamps_and_frames(self):
        self.start()
        clock, odom = self.topic("/clock", Clock), self.topic("odom", Odometry)
        tf = self.topic("/tf", TFMessage)
        for steps in (1, 36, 963, 1000, 509):
            step(steps)
        for topic, number in ((clock, 250), (odom, 50), (tf, 50)):
            topic.wait(number)
        self.assertEqual([10 * k for k in range(1, 251)], clocks(clock))
        due = [50 * k * MILLISECOND for k in range(1, 51)]
        self.assertEqual(due, odom.stamps())
        transforms = [transform for message in tf.messages for transform in message.transforms]
        self.assertEqual(due, [t.header.stamp.to_nsec() for t in transforms])
        self.assertEqual({"odom"}, {t.header.frame_id for t in transforms})
        self.assertEqual({"base_footprint"}, {t.child_frame_id for t in transforms})

    def test_clock_rate_that_does_not_divide_the_steps(self):
        self.start(clock_rate=30)
        clock = self.topic("/clock", Clock)
        step(1000)
        clock.wait(30)
        self.assertEqual([math.ceil(1000 * k / 30) for k in range(1, 31)], clocks(clock))

    def test_odometry_is_planar_with_gazebos_covariance(self):
        self.start(robot_pose="1 2 0 0 0 0.5")
        odom, tf = self.topic("odom", Odometry), self.topic("/tf", TFMessage)
        step(100)
        message = odom.wait(2)[-1]
        self.assertEqual("odom", message.header.frame_id)
        self.assertEqual("base_footprint", message.child_frame_id)
        place = message.pose.pose.position
        self.assertAlmostEqual(1.0, place.x, 6)
        self.assertAlmostEqual(2.0, place.y, 6)
        self.assertEqual(0.0, place.z)
        self.assertAlmostEqual(math.sin(0.25), message.pose.pose.orientation.z, 6)
        diagonal = [message.pose.covariance[7 * axis] for axis in range(6)]
        self.assertEqual([1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3], diagonal)
        self.assertEqual(sum(diagonal), sum(message.pose.covariance))
        moved = tf.wait(2)[-1].transforms[0].transform.translation
        self.assertEqual((place.x, place.y), (moved.x, moved.y))

    def test_twist_is_in_the_childs_frame(self):
        self.start(robot_pose=f"0 0 0 0 0 {math.pi / 2}")
        odom, commands = self.topic("odom", Odometry), self.commands()
        commands.publish(twist(vx=0.2))
        leave(1)
        step(2000)
        before, last = odom.wait(40)[38:]
        moved = last.pose.pose.position.y - before.pose.pose.position.y
        self.assertGreater(moved, 0.009)
        self.assertAlmostEqual(0.0, last.pose.pose.position.x, 5)
        self.assertAlmostEqual(moved / 0.05, last.twist.twist.linear.x, 6)
        self.assertAlmostEqual(0.0, last.twist.twist.linear.y, 5)

    def test_joint_states_name_the_joints(self):
        self.start(robot=self.arm_robot())
        joints = self.topic("joint_states", JointState)
        step(100)
        messages = joints.wait(5)
        self.assertEqual([20 * k * MILLISECOND for k in range(1, 6)], joints.stamps())
        for message in messages:
            lengths = (len(message.position), len(message.velocity), len(message.effort))
            self.assertEqual((["elbow"], (1, 1, 0)), (message.name, lengths))

    def test_world_is_latched(self):
        self.start(world="package://bullet_lab/worlds/beacons.world")
        step(100)
        world = self.topic("/bullet_lab/world", MarkerArray).wait(1)[0]
        beacons = {
            marker.ns: (marker.pose.position.x, marker.pose.position.y)
            for marker in world.markers
            if marker.type == Marker.MESH_RESOURCE
        }
        self.assertEqual(
            {"beacon_0": (1.0, 1.0), "beacon_1": (5.0, 1.0), "beacon_2": (-5.0, 1.0)}, beacons
        )
        self.assertEqual({*beacons, "ground_plane"}, {marker.ns for marker in world.markers})
        self.assertEqual({"world"}, {marker.header.frame_id for marker in world.markers})

    def test_robot_of_the_parameter_server_in_a_namespace(self):
        rospy.set_param("robot_description", self.arm_robot().read_text())
        self.addCleanup(rospy.delete_param, "robot_description")
        self.start(robot="", robot_namespace="left")
        odom = self.topic("/left/odom", Odometry)
        step(50)
        odom.wait(1)


class CommandsTest(BridgeCase):
    """What the robot does with commands."""

    def test_command_is_latched(self):
        self.start()
        odom, commands = self.topic("odom", Odometry), self.commands()
        commands.publish(twist(vx=0.2))
        leave(1)
        step(10000)
        # 0.2 m/s less the friction between two steps, as in figure 1a.
        self.assertAlmostEqual(1.902, odom.wait(200)[-1].pose.pose.position.x, 2)

    def test_command_ends_with_its_timeout(self):
        self.start(robot=self.arm_robot())
        odom, commands = self.topic("odom", Odometry), self.commands()
        commands.publish(twist(vx=1.0))
        leave(1)
        step(2000)
        x = [message.pose.pose.position.x for message in odom.wait(40)]
        self.assertLess(x[8], x[9] - 0.04)
        self.assertEqual(x[9], x[-1])

    def test_commands_that_are_not_finite_are_refused(self):
        bridge = self.start()
        odom, commands = self.topic("odom", Odometry), self.commands()
        bad = (math.nan, math.inf, -math.inf)
        commands.publish(twist(vx=0.2))
        for value in bad:
            commands.publish(twist(vx=value))
            commands.publish(twist(vy=value))
            commands.publish(twist(wz=value))
        leave(10)
        step(1000)
        x = [message.pose.pose.position.x for message in odom.wait(20)]
        # The command before them stays in force.
        self.assertAlmostEqual(x[18] + 0.0095, x[19], 3)
        wait_for(lambda: "is not finite" in bridge.err, "a warning")
        commands.publish(twist())
        leave(11)
        step(1000)
        poses = places(odom.wait(40))
        self.assertLess(math.dist(poses[20][:2], poses[39][:2]), 1e-6)


class TimeTest(BridgeCase):
    """Pause, step, reset."""

    def test_pause_stops_the_clock_and_nothing_else(self):
        self.start(paused=False, rtf=1)
        clock = self.topic("/clock", Clock)
        clock.wait(5)
        call("/gazebo/pause_physics", Empty)
        paused_at = step(0)
        time.sleep(0.3)
        before = len(clock.messages)
        time.sleep(0.7)
        self.assertEqual(before, len(clock.messages))
        self.assertEqual(paused_at, step(0))
        self.assertEqual(paused_at + 25, step(25))
        call("/gazebo/unpause_physics", Empty)
        clock.wait(before + 10)
        ticks = clocks(clock)
        self.assertEqual([ticks[0] + 10 * k for k in range(len(ticks))], ticks)

    def test_step_advances_exactly_and_publishes_what_is_due(self):
        self.start()
        clock, odom = self.topic("/clock", Clock), self.topic("odom", Odometry)
        reached = [step(n) for n in (7, 0, 92, 1)]
        self.assertEqual([7, 7, 99, 100], reached)
        clock.wait(10)
        odom.wait(2)
        time.sleep(0.3)
        self.assertEqual((10, 2), (len(clock.messages), len(odom.messages)))

    def test_reset_world_puts_the_robot_back_and_keeps_time(self):
        self.start(robot_pose="1 0 0 0 0 1")
        clock, odom = self.topic("/clock", Clock), self.topic("odom", Odometry)
        commands = self.commands()
        step(50)
        commands.publish(twist(vx=0.5, wz=1.0))
        leave(1)
        step(1000)
        call("/gazebo/reset_world", Empty)
        self.assertEqual(1100, step(50))
        clock.wait(110)
        poses = places(odom.wait(22))
        self.assertGreater(math.dist(poses[0], poses[20]), 0.2)
        # Not to the last bit: a block on a floor settles by nanometres.
        for first, again in zip(poses[0], poses[21]):
            self.assertAlmostEqual(first, again, 9)
        self.assertEqual([10 * k for k in range(1, 111)], clocks(clock))

    def test_reset_simulation_starts_again_at_zero(self):
        self.start()
        clock, odom = self.topic("/clock", Clock), self.topic("odom", Odometry)
        commands = self.commands()
        for sent in (1, 3):
            commands.publish(twist(vx=0.5))
            leave(sent)
            self.assertEqual(130, step(130))
            call("/gazebo/reset_simulation", Empty)
            commands.publish(twist())
            leave(sent + 1)
            self.assertEqual(0, step(0))
        clock.wait(26)
        odom.wait(4)
        self.assertEqual(2 * [10 * k for k in range(1, 14)], clocks(clock))
        self.assertEqual(2 * [50 * MILLISECOND, 100 * MILLISECOND], odom.stamps())
        self.assertEqual(places(odom.messages[:2]), places(odom.messages[2:]))


class LockStepTest(BridgeCase):
    """Time never passes what its members have granted."""

    def test_time_never_passes_a_grant(self):
        self.start(paused=False, lock_step=rospy.get_name())
        clock = self.topic("/clock", Clock)
        time.sleep(0.5)
        self.assertEqual([], clocks(clock))
        for until in range(0, 1001, 100):
            answer = advance(until)
            self.assertTrue(answer.success)
            self.assertEqual(until, milliseconds(answer.now))
            clock.wait(until // 10)
            time.sleep(0.03)
            self.assertEqual(until, clocks(clock)[-1] if until else 0)
        leave()
        clock.wait(1000)

    def test_slowest_member_counts(self):
        self.start(paused=False, lock_step=f"{rospy.get_name()} other")
        clock = self.topic("/clock", Clock)
        advance(0)
        advance(0, node="/other")
        ahead = threading.Thread(target=advance, args=(500,), daemon=True)
        ahead.start()
        advance(200, node="/other")
        time.sleep(0.2)
        self.assertTrue(ahead.is_alive())
        self.assertEqual(200, clocks(clock)[-1])
        advance(500, node="/other")
        ahead.join(60)
        self.assertFalse(ahead.is_alive())
        # Time is advanced for a node that does not exist, but not for one that lives.
        with self.assertRaisesRegex(rospy.ServiceException, "/pybullet_bridge is alive"):
            advance(0, node="/pybullet_bridge")

    def test_commands_act_from_exactly_their_step(self):
        expected = simulated(SQUIGGLE, 30)
        for rtf in (0, 20):
            bridge = self.start(paused=False, rtf=rtf, lock_step=rospy.get_name())
            odom, commands = self.topic("odom", Odometry), self.commands()
            advance(0)
            for number, (vx, wz) in enumerate(SQUIGGLE, 1):
                commands.publish(twist(vx, wz=wz))
                advance(30 * number, number)
            self.assertEqual(expected, places(odom.wait(len(expected))), f"rtf {rtf}")
            odom.close()
            commands.unregister()
            bridge.end()

    def test_announced_command_is_awaited(self):
        self.start(paused=False, lock_step=rospy.get_name())
        odom, clock = self.topic("odom", Odometry), self.topic("/clock", Clock)
        commands = self.commands()
        advance(0)
        advance(100)
        going = threading.Thread(target=advance, args=(200, 1), daemon=True)
        going.start()
        time.sleep(0.5)
        self.assertEqual(100, clocks(clock)[-1])
        commands.publish(twist(vx=1.0))
        going.join(60)
        expected = simulated([(0.0, 0.0), (1.0, 0.0)], 100)
        self.assertEqual(expected, places(odom.wait(4)))

    def test_commands_of_a_node_that_was_started_again_are_awaited(self):
        self.start(paused=False, lock_step=rospy.get_name())
        clock, commands = self.topic("/clock", Clock), self.commands()
        for _ in range(5):
            commands.publish(twist())
        leave(5)
        # Another life of the same name counts from 0.
        now = int(milliseconds(advance(0, epoch=0).now))
        going = threading.Thread(target=advance, args=(now + 1000, 1), daemon=True)
        going.start()
        time.sleep(0.5)
        self.assertLessEqual(clocks(clock)[-1], now)
        commands.publish(twist())
        going.join(60)
        self.assertFalse(going.is_alive())

    def test_lost_command_does_not_hold_time_for_ever(self):
        bridge = self.start(paused=False, lock_step=rospy.get_name())
        advance(0)
        self.assertTrue(advance(100, 3).success)
        self.assertIn(f"commands of {rospy.get_name()} were lost", bridge.err)

    def test_dead_members_do_not_hold_time(self):
        for granted in ("0", "0.1"):
            bridge = self.start(paused=False, lock_step="sleeper")
            clock = self.topic("/clock", Clock)
            sleeper = subprocess.Popen(
                [sys.executable, "-c", SLEEPER, granted], stdout=subprocess.PIPE, text=True
            )
            self.addCleanup(sleeper.kill)
            self.assertEqual("joined\n", sleeper.stdout.readline())
            time.sleep(0.3)
            self.assertEqual(round(100 * float(granted)), len(clock.messages))
            sleeper.send_signal(signal.SIGKILL)
            sleeper.wait()
            sleeper.stdout.close()
            wait_for(lambda topic=clock: len(topic.messages) > 100, f"time to pass {granted} s")
            self.assertIn("lock-step member /sleeper has died", bridge.err)
            clock.close()
            bridge.end()

    def test_slow_members_are_waited_for(self):
        bridge = self.start(paused=False, lock_step=rospy.get_name())
        clock = self.topic("/clock", Clock)
        advance(100)
        wait_for(lambda: f"simulated time waits for {rospy.get_name()}" in bridge.out, "a report")
        self.assertEqual(100, clocks(clock)[-1])

    def test_reset_simulation_releases_who_waits(self):
        self.start(paused=False, lock_step=f"{rospy.get_name()} other")
        advance(0, node="/other")
        advance(0)
        answers = []
        waiting = threading.Thread(target=lambda: answers.append(advance(500)), daemon=True)
        waiting.start()
        advance(200, node="/other")
        call("/gazebo/reset_simulation", Empty)
        waiting.join(60)
        self.assertFalse(answers[0].success)
        self.assertEqual(0, milliseconds(answers[0].now))

    def test_reset_reaches_a_member_that_is_busy(self):
        self.start(paused=False, lock_step=rospy.get_name())
        clock = self.topic("/clock", Clock)
        for reset, now in (("world", 100), ("simulation", 0)):
            epoch = advance(0, epoch=0).epoch
            self.assertTrue(advance(100, epoch=epoch).success)
            call(f"/gazebo/reset_{reset}", Empty)
            # It was busy, and asks for what it would have asked for without the reset.
            answer = advance(30_000, epoch=epoch)
            self.assertFalse(answer.success)
            self.assertEqual(now, milliseconds(answer.now))
            self.assertEqual(epoch + 1, answer.epoch)
            time.sleep(0.3)
            self.assertEqual(100, clocks(clock)[-1])
            self.assertTrue(advance(now + 50, epoch=answer.epoch).success)
            clock.wait(15)
            del clock.messages[-5:]


# Commands (m/s, rad/s) that make a path in which each of them shows.
SQUIGGLE = [(0.1 + 0.01 * k, 0.5 * (-1) ** k) for k in range(40)]


def setUpModule():
    rospy.init_node("bridge_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "bridge_test", "__main__")
