#!/usr/bin/env python3
"""The sensors of Gazebo's robots as an unmodified client sees them."""

import math

import numpy as np
import rospy
import rostest
from bridge_testing import ROBOT as BLOCK_ROBOT
from bridge_testing import BridgeCase, spawn, step
from gazebo_msgs.msg import ContactsState
from sensor_msgs.msg import LaserScan

from bullet_lab.simulation.simulation import Simulation

MILLISECOND = 1_000_000
BEACONS = "package://bullet_lab/worlds/beacons.world"

# A crate on the floor, 2 kg, with a wall 1 m ahead of its middle.
WALL = """<sdf version="1.6"><model name="wall"><static>true</static><pose>1.1 0 0.5 0 0 0</pose>
  <link name="link">
    <collision name="bricks"><geometry><box><size>0.2 20 1</size></box></geometry></collision>
    <visual name="paint"><geometry><box><size>0.2 20 1</size></box></geometry></visual>
  </link></model></sdf>"""
CRATE = """<robot name="crate">
  <link name="base"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
    <inertia ixx="0.0133" iyy="0.0133" izz="0.0133"/></inertial>
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
  </link>
  <link name="top"/>
  <joint name="j" type="fixed"><parent link="base"/><child link="top"/>
    <origin xyz="0 0 0.1"/></joint>
  <gazebo reference="top">
    <sensor type="ray" name="laser"><update_rate>10</update_rate><visualize>true</visualize>
      <ray><scan><horizontal><samples>91</samples><min_angle>0</min_angle>
        <max_angle>1.5707963</max_angle></horizontal></scan>
        <range><min>0.2</min><max>5</max></range></ray>
      <plugin name="laser" filename="libgazebo_ros_laser.so">
        <topicName>scan</topicName><frameName>top</frameName></plugin></sensor>
  </gazebo>
  <gazebo reference="base">
    <sensor type="contact" name="bumper"><update_rate>20</update_rate>
      <contact><collision>base_collision</collision></contact>
      <plugin name="bumper" filename="libgazebo_ros_bumper.so">
        <bumperTopicName>bumper</bumperTopicName><frameName>world</frameName></plugin></sensor>
  </gazebo>
</robot>"""


class SensorsTest(BridgeCase):
    """Robots that carry sensors, before a wall."""

    def before_the_wall(self, robot):
        """Spawn the wall and a robot, whose topics have no namespace, and let it settle."""
        for name, xml in (("wall", WALL), ("robot", robot)):
            answer = spawn(name, xml, namespace="/")
            self.assertTrue(answer.success, answer.status_message)
        step(200)

    def last_of(self, name, kind, period):
        """The last message of those that 0.1 s of simulated time bring from now on."""
        topic = self.topic(name, kind)
        start = step(0)
        step(100)
        messages = topic.wait(100 // period)
        stamps = [stamp // MILLISECOND - start for stamp in topic.stamps()]
        self.assertEqual(list(range(period, 101, period)), stamps)
        return messages[-1]

    def test_laser(self):
        self.before_the_wall(CRATE)
        scan = self.last_of("scan", LaserScan, 100)
        self.assertEqual("top", scan.header.frame_id)
        self.assertEqual((91, 91), (len(scan.ranges), len(scan.intensities)))
        self.assertAlmostEqual(math.radians(1.0), scan.angle_increment, 6)
        self.assertAlmostEqual(0.2, scan.range_min, 6)
        self.assertEqual((5.0, 0.0), (scan.range_max, scan.time_increment))
        self.assertEqual(0.0, scan.scan_time)
        for degrees in (0, 30, 60):
            exact = 1.0 / math.cos(math.radians(degrees))
            self.assertAlmostEqual(exact, scan.ranges[degrees], 3)
        self.assertEqual(math.inf, scan.ranges[90])

    def test_bumper(self):
        self.before_the_wall(CRATE)
        states = self.last_of("bumper", ContactsState, 50).states
        self.assertEqual(50, len(states), "one for each step since the last message")
        state = states[-1]
        self.assertEqual("robot::base::base_collision", state.collision1_name)
        self.assertEqual("ground_plane::link::collision", state.collision2_name)
        self.assertAlmostEqual(2 * 9.8, state.total_wrench.force.z, 1)
        forces = [wrench.force.z for wrench in state.wrenches]
        self.assertAlmostEqual(state.total_wrench.force.z, sum(forces), 9)
        self.assertEqual(
            {len(forces)},
            {len(state.contact_positions), len(state.contact_normals), len(state.depths)},
        )
        for normal in state.contact_normals:
            self.assertAlmostEqual(1.0, normal.z, 6)

    def test_a_sensor_that_makes_no_sense_is_one_line_and_the_rest_works(self):
        said = "plugin 'laser': <sensor>: <samples>: -5 is not a whole number"
        self.before_the_wall(CRATE.replace("<samples>91</samples>", "<samples>-5</samples>"))
        self.last_of("bumper", ContactsState, 50)
        self.assertEqual(1, self.node.err.count(said), self.node.err)


class SeedTest(BridgeCase):
    """The noise is that of the seed."""

    parameters = {"world": BEACONS, "robot": BLOCK_ROBOT, "seed": 1}

    def test_the_block_robots_scan_and_the_seed(self):
        scans = self.topic("scan", LaserScan)
        step(200)
        first, second = scans.wait(2)
        self.assertEqual("laser_link", first.header.frame_id)
        self.assertEqual(360, len(first.ranges))
        self.assertGreater(sum(map(math.isfinite, first.ranges)), 3)
        self.assertNotEqual(first.ranges, second.ranges)
        self.assertEqual(first.ranges, simulated(1))
        self.assertNotEqual(first.ranges, simulated(2))


def simulated(seed):
    """The block robot's first scan without ROS."""
    scans = []
    with Simulation.of(BEACONS, seed) as simulation:
        simulation.spawn(BLOCK_ROBOT).listen("scan", scans.append)
        simulation.run_until(100)
    return tuple(np.float32(scans[0].ranges).tolist())


if __name__ == "__main__":
    rospy.init_node("sensors_test")
    rostest.rosrun("bullet_lab", "sensors_test", "__main__")
