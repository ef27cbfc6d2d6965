#!/usr/bin/env python3
"""The sensors of Gazebo's robots as an unmodified client sees them."""

import math
import struct
import sys
import tempfile
import unittest
from pathlib import Path

import rospy
import rostest
from bullet_lab.srv import Step
from gazebo_msgs.msg import ContactsState
from geometry_msgs.msg import Twist
from lab_testing import Node, Topic, publisher, wait_for
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, Imu, LaserScan, PointCloud2, Range
from sensor_msgs.point_cloud2 import read_points

BLOCK_ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
MILLISECOND = 1_000_000

# A crate on the floor, 2 kg, with a wall 1 m ahead of its middle.
WORLD = """<sdf version="1.6"><world name="walled">
  <include><uri>model://ground_plane</uri></include>
  <model name="wall"><static>true</static><pose>1.1 0 0.5 0 0 0</pose>
    <link name="link"><collision name="bricks"><geometry><box><size>0.2 20 1</size></box>
    </geometry></collision></link></model>
</world></sdf>"""
ROBOT = """<robot name="crate">
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
    <sensor type="ray" name="sonar"><update_rate>20</update_rate>
      <ray><scan><horizontal><samples>5</samples><min_angle>-0.1</min_angle>
        <max_angle>0.1</max_angle></horizontal></scan>
        <range><min>0.05</min><max>3</max></range></ray>
      <plugin name="sonar" filename="libgazebo_ros_range.so"><topicName>sonar</topicName>
        <frameName>top</frameName><fov>0.2</fov><radiation>infrared</radiation></plugin></sensor>
    <sensor type="imu" name="imu"><plugin name="imu_b" filename="libgazebo_ros_imu_sensor.so">
      <topicName>imu_b</topicName><frameName>top</frameName><updateRateHZ>50</updateRateHZ>
      </plugin></sensor>
  </gazebo>
  <gazebo reference="base">
    <sensor type="contact" name="bumper"><update_rate>20</update_rate>
      <contact><collision>base_collision</collision></contact>
      <plugin name="bumper" filename="libgazebo_ros_bumper.so">
        <bumperTopicName>bumper</bumperTopicName><frameName>world</frameName></plugin></sensor>
  </gazebo>
  <gazebo>
    <plugin name="imu_a" filename="libgazebo_ros_imu.so"><bodyName>base</bodyName>
      <topicName>imu_a</topicName><updateRate>100</updateRate>
      <gaussianNoise>0.01</gaussianNoise></plugin>
    <plugin name="truth" filename="libgazebo_ros_p3d.so"><bodyName>top</bodyName>
      <topicName>truth</topicName><updateRate>25</updateRate>
      <gaussianNoise>0.1</gaussianNoise></plugin>
  </gazebo>
</robot>"""

WHEEL = """<link name="{0}_wheel"><inertial><mass value="0.5"/>
  <inertia ixx="2e-3" iyy="2.5e-3" izz="2e-3"/></inertial><collision>
  <origin rpy="1.5707963 0 0"/><geometry><cylinder radius="0.1" length="0.05"/></geometry>
  </collision></link><joint name="{0}_joint" type="continuous"><parent link="base"/>
  <child link="{0}_wheel"/><origin xyz="{1} {2} 0.1"/><axis xyz="0 1 0"/></joint>"""
ROVER = (
    '<robot name="rover"><link name="base"><inertial><origin xyz="0 0 0.15"/><mass value="8"/>'
    '<inertia ixx="0.1" iyy="0.15" izz="0.2"/></inertial></link>'
    + WHEEL.format("left_front", 0.2, 0.2)
    + WHEEL.format("right_front", 0.2, -0.2)
    + WHEEL.format("left_rear", -0.2, 0.2)
    + WHEEL.format("right_rear", -0.2, -0.2)
    + '<gazebo><plugin name="drive" filename="libgazebo_ros_skid_steer_drive.so">'
    "<wheelDiameter>0.2</wheelDiameter><updateRate>20</updateRate></plugin></gazebo></robot>"
)

WATCHER = """<robot name="watcher">
  <link name="base"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
  </link>
  <link name="eye"/>
  <joint name="j" type="fixed"><parent link="base"/><child link="eye"/>
    <origin xyz="0 0 0.7"/></joint>
  <gazebo reference="eye"><sensor type="depth" name="kinect"><update_rate>10</update_rate>
    <visualize>true</visualize>
    <camera><horizontal_fov>1.0</horizontal_fov><clip><near>0.05</near><far>8</far></clip>
      <image><width>64</width><height>48</height><format>R8G8B8</format></image></camera>
    <plugin name="kinect" filename="libgazebo_ros_openni_kinect.so">
      <cameraName>camera</cameraName><imageTopicName>rgb/image_raw</imageTopicName>
      <cameraInfoTopicName>rgb/camera_info</cameraInfoTopicName>
      <pointCloudTopicName>depth/points</pointCloudTopicName>
      <frameName>eye_optical</frameName><pointCloudCutoffMax>3.0</pointCloudCutoffMax>
    </plugin></sensor></gazebo>
</robot>"""
SEEN_WALL = WORLD.replace(
    "</geometry></collision></link></model>",
    """</geometry></collision><visual name="paint"><geometry><box><size>0.2 20 1</size></box>
    </geometry></visual></link></model>""",
)


def step(steps):
    """Advance by so many steps."""
    rospy.wait_for_service("/bullet_lab/step", 60)
    return rospy.ServiceProxy("/bullet_lab/step", Step)(steps)


def numbers(vector):
    """The three components of a vector."""
    return (vector.x, vector.y, vector.z)


class SensorsTest(unittest.TestCase):
    """Bridges, paused and at full speed, with robots that carry sensors."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def file(self, name, text):
        path = self.folder / name
        path.write_text(text)
        return path

    def start(self, **parameters):
        bridge = Node("pybullet_bridge.py", paused=True, rtf=0, **parameters)
        self.addCleanup(bridge.end)
        wait_for(lambda: self.is_ready(bridge), "the bridge's services")
        return bridge

    def is_ready(self, bridge):
        self.assertTrue(bridge.runs(), bridge.err)
        try:
            rospy.wait_for_service("/bullet_lab/advance", 0.05)
        except rospy.ROSException:
            return False
        return True

    def crate(self, **parameters):
        """Start a bridge with the crate and let it settle."""
        bridge = self.start(
            world=self.file("walled.world", WORLD),
            robot=self.file("crate.urdf", ROBOT),
            **parameters,
        )
        step(200)
        return bridge

    def topic(self, name, kind):
        topic = Topic(name, kind)
        self.addCleanup(topic.close)
        return topic

    def last_of(self, name, kind, period):
        """The last message of those that 0.1 s of simulated time bring from now on."""
        topic = self.topic(name, kind)
        start = step(0).now.to_nsec() // MILLISECOND
        step(100)
        messages = topic.wait(100 // period)
        stamps = [stamp // MILLISECOND - start for stamp in topic.stamps()]
        self.assertEqual(list(range(period, 101, period)), stamps)
        return messages[-1]

    def test_laser(self):
        self.crate()
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

    def test_range(self):
        self.crate()
        reading = self.last_of("sonar", Range, 50)
        self.assertEqual("top", reading.header.frame_id)
        self.assertEqual(Range.INFRARED, reading.radiation_type)
        self.assertAlmostEqual(1.0, reading.range, 3)
        self.assertAlmostEqual(0.2, reading.field_of_view, 6)
        self.assertEqual((0.05, 3.0), (round(reading.min_range, 6), reading.max_range))

    def test_inertial_units(self):
        self.crate()
        exact = self.last_of("imu_b", Imu, 20)
        self.assertEqual("top", exact.header.frame_id)
        for wanted, value in zip((0, 0, 9.8), numbers(exact.linear_acceleration)):
            self.assertAlmostEqual(wanted, value, 2)
        self.assertEqual((0.0,) * 9, tuple(exact.angular_velocity_covariance))
        noisy = self.last_of("imu_a", Imu, 10)
        self.assertEqual("base", noisy.header.frame_id)
        self.assertAlmostEqual(0.0, noisy.linear_acceleration.z, delta=0.06)
        self.assertNotEqual(0.0, noisy.linear_acceleration.z)
        for matrix in (
            noisy.orientation_covariance,
            noisy.angular_velocity_covariance,
            noisy.linear_acceleration_covariance,
        ):
            for index, value in enumerate(matrix):
                self.assertAlmostEqual(1e-4 if index in (0, 4, 8) else 0.0, value, 12)

    def test_bumper(self):
        self.crate()
        (state,) = self.last_of("bumper", ContactsState, 50).states
        self.assertEqual("crate::base::base_collision", state.collision1_name)
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

    def test_depth_camera(self):
        self.start(
            world=self.file("seen.world", SEEN_WALL),
            robot=self.file("watcher.urdf", WATCHER),
        )
        offered = dict(rospy.get_published_topics("/camera"))
        self.assertEqual("sensor_msgs/PointCloud2", offered.pop("/camera/depth/points"))
        for part in ("rgb", "depth"):
            self.assertEqual("sensor_msgs/Image", offered.pop(f"/camera/{part}/image_raw"))
            self.assertEqual("sensor_msgs/CameraInfo", offered.pop(f"/camera/{part}/camera_info"))
        kind = offered.pop("/camera/rgb/image_raw/compressed")
        self.assertEqual("sensor_msgs/CompressedImage", kind)
        # What else there is belongs to dynamic_reconfigure.
        self.assertEqual([], [topic for topic in offered if "/parameter_" not in topic])
        depth = self.last_of("/camera/depth/image_raw", Image, 100)
        self.assertEqual(("32FC1", 64, 48, 256), (depth.encoding, depth.width, depth.height,
                                                  depth.step))  # fmt: skip
        values = struct.unpack(f"<{64 * 48}f", depth.data)
        self.assertAlmostEqual(1.0, values[64 * 24 + 32], 3)
        # The sky above the wall.
        self.assertTrue(math.isnan(values[32]))
        image = self.last_of("/camera/rgb/image_raw", Image, 100)
        self.assertEqual(("rgb8", 64, 48), (image.encoding, image.width, image.height))
        infos = [self.last_of(f"/camera/{part}/camera_info", CameraInfo, 100)
                 for part in ("rgb", "depth")]  # fmt: skip
        self.assertEqual(infos[0].K, infos[1].K)
        cloud = self.last_of("/camera/depth/points", PointCloud2, 100)
        self.assertEqual(["x", "y", "z", "rgb"], [field.name for field in cloud.fields])
        self.assertEqual((64, 48, False), (cloud.width, cloud.height, cloud.is_dense))
        for message in (depth, image, *infos, cloud):
            self.assertEqual("eye_optical", message.header.frame_id)
        points = list(read_points(cloud))
        self.assertEqual(64 * 48, len(points))
        x, y, z, _ = points[64 * 24 + 60]
        focal = 32 / math.tan(0.5)
        for found, exact in zip((x, y, z), ((60 - 31.5) / focal, (24 - 23.5) / focal, 1.0)):
            self.assertAlmostEqual(exact, found, 3)
        self.assertTrue(all(math.isnan(part) for part in points[32][:3]))

    def test_true_pose(self):
        self.crate(robot_pose="0 1 0 0 0 0.5")
        truth = self.truth()
        self.assertEqual(("world", "top"), (truth.header.frame_id, truth.child_frame_id))
        for wanted, value in zip((0, 1, 0.1), numbers(truth.pose.pose.position)):
            self.assertAlmostEqual(wanted, value, 3)
        self.assertAlmostEqual(math.sin(0.25), truth.pose.pose.orientation.z, 4)
        for matrix in (truth.pose.covariance, truth.twist.covariance):
            diagonal = [matrix[7 * axis] for axis in range(6)]
            self.assertAlmostEqual(0.06, sum(diagonal), 9)
            self.assertAlmostEqual(0.06, sum(matrix), 9)
        speed = math.hypot(*numbers(truth.twist.twist.linear))
        self.assertTrue(0.0 < speed < 0.7)

    def truth(self):
        topic = self.topic("truth", Odometry)
        step(200)
        messages = topic.wait(5)
        self.assertEqual([40 * k for k in range(6, 11)], [s // MILLISECOND for s in topic.stamps()])
        return messages[-1]

    def test_skid_steer(self):
        self.start(world=self.file("walled.world", WORLD), robot=self.file("r.urdf", ROVER))
        odom, commands = self.topic("odom", Odometry), publisher("cmd_vel", Twist)
        self.addCleanup(commands.unregister)
        step(100)
        command = Twist()
        command.linear.x = 0.2
        commands.publish(command)
        # The wall is at 1 m.
        wait_for(lambda: self.moves(odom), "the rover to move")
        message = odom.messages[-1]
        frames = (message.header.frame_id, message.child_frame_id)
        self.assertEqual(("odom", "base_footprint"), frames)
        self.assertEqual((1e-4, 1e-4), (message.twist.covariance[0], message.twist.covariance[7]))
        self.assertAlmostEqual(0.01, message.pose.covariance[35], 12)

    def moves(self, odom):
        step(100)
        return odom.messages[-1].pose.pose.position.x > 0.05

    def test_the_block_robots_scan_and_the_seed(self):
        scans = []
        for seed in (1, 1, 2):
            bridge = self.start(
                world="package://bullet_lab/worlds/beacons.world", robot=BLOCK_ROBOT, seed=seed
            )
            topic = Topic("scan", LaserScan)
            step(200)
            messages = topic.wait(2)
            scans.append([tuple(message.ranges) for message in messages])
            self.assertEqual("laser_link", messages[0].header.frame_id)
            self.assertEqual(360, len(messages[0].ranges))
            topic.close()
            bridge.end()
        seen = [r for r in scans[0][0] if math.isfinite(r)]
        self.assertGreater(len(seen), 3)
        self.assertEqual(scans[0], scans[1])
        self.assertNotEqual(scans[0], scans[2])
        self.assertNotEqual(scans[0][0], scans[0][1])

    def test_a_sensor_that_makes_no_sense_is_one_line_and_the_rest_works(self):
        bad = ROBOT.replace("<samples>91</samples>", "<samples>-5</samples>")
        bridge = Node(
            "pybullet_bridge.py",
            world=self.file("walled.world", WORLD),
            robot=self.file("crate.urdf", bad),
        )
        self.addCleanup(bridge.end)
        said = "plugin 'laser': <sensor>: <samples>: -5 is not a whole number"
        wait_for(lambda: said in bridge.err, "what is wrong")
        rospy.wait_for_message("imu_b", Imu, 10.0)
        self.assertEqual(1, bridge.err.count(said), bridge.err)


if __name__ == "__main__":
    rospy.init_node("sensors_test")
    rostest.rosrun("bullet_lab", "sensors_test", SensorsTest, sys.argv)
