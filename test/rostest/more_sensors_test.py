#!/usr/bin/env python3
"""A robot with the sensors of outdoor robots, as an unmodified client sees them."""

import math
import struct

import rospy
import rostest
from bridge_testing import BridgeCase, call, spawn, step
from bullet_lab.srv import SetBias
from geometry_msgs.msg import Vector3, Vector3Stamped
from lab_testing import wait_for
from sensor_msgs.msg import (
    CameraInfo,
    CompressedImage,
    Image,
    Imu,
    NavSatFix,
    PointCloud,
    PointCloud2,
    PointField,
)
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty as EmptyMessage
from std_srvs.srv import Empty

G = 9.8
WALL = """<sdf version="1.6"><model name="wall"><static>true</static><pose>2.1 0 1 0 0 0</pose>
  <link name="link">
    <collision name="c"><geometry><box><size>0.2 20 4</size></box></geometry></collision>
    <visual name="v"><geometry><box><size>0.2 20 4</size></box></geometry></visual>
  </link></model></sdf>"""
HEAD = """<camera name="{}"><pose>0 {} 0 0 0 0</pose><horizontal_fov>1.2</horizontal_fov>
  <image><width>80</width><height>60</height><format>{}</format></image></camera>"""
PAIR = f"{HEAD.format('left', 0.05, 'L16')}{HEAD.format('right', -0.05, 'BAYER_GRBG8')}"
FAN = """<update_rate>10</update_rate><ray><scan>
  <horizontal><samples>3</samples><min_angle>-0.5</min_angle><max_angle>0.5</max_angle></horizontal>
  <vertical><samples>2</samples><min_angle>0</min_angle><max_angle>0.2</max_angle></vertical>
  </scan><range><min>0.2</min><max>5</max></range></ray>"""


def sensor(kind, name, inner, library, tags):
    """A sensor with its plugin."""
    plugin = f'<plugin name="{name}" filename="libgazebo_ros_{library}.so">{tags}</plugin>'
    return f'<sensor type="{kind}" name="{name}">{inner}{plugin}</sensor>'


NAMED = "<topicName>{}</topicName><frameName>base</frameName>"
CRATE = f"""<robot name="crate">
  <link name="base"><inertial><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>
    <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <gazebo><plugin name="imu" filename="libhector_gazebo_ros_imu.so"><updateRate>50</updateRate>
      <topicName>imu/data</topicName><accelOffset>0.1 0.2 0.3</accelOffset>
      <rateDrift>0.1</rateDrift><rateDriftFrequency>0</rateDriftFrequency>
      <rateGaussianNoise>0 0 1e-9</rateGaussianNoise>
    </plugin>
    <plugin name="gps" filename="libhector_gazebo_ros_gps.so"><updateRate>10</updateRate>
      <referenceLatitude>45</referenceLatitude><referenceLongitude>9</referenceLongitude>
      <referenceAltitude>100</referenceAltitude><offset>0 0 5</offset><status>1</status>
      <service>3</service><frameId>earth</frameId></plugin>
    <plugin name="propeller" filename="librotors_gazebo_motor_model.so"/>
    <plugin name="wing" filename="libLiftDragPlugin.so"/>
  </gazebo>
  <gazebo reference="base">
    {sensor("ray", "block", FAN, "block_laser", NAMED.format("block"))}
    {sensor("gpu_ray", "rings", FAN, "velodyne_gpu_laser", NAMED.format("rings"))}
    {
    sensor(
        "multicamera",
        "pair",
        "<update_rate>10</update_rate>" + PAIR,
        "multicamera",
        "<cameraName>eyes</cameraName><hackBaseline>0.1</hackBaseline>",
    )
}
    {
    sensor(
        "camera",
        "eye",
        HEAD.format("c", 0, "R8G8B8"),
        "triggered_camera",
        "<cameraName>eye</cameraName>",
    )
}
    {
    sensor(
        "wideanglecamera",
        "fish",
        "<update_rate>10</update_rate>" + HEAD.format("f", 0, "R8G8B8").replace("1.2<", "3.14<"),
        "camera",
        "<cameraName>fish</cameraName>",
    )
}
  </gazebo>
</robot>"""
FOCAL = 40 / math.tan(0.6)


class MoreSensorsTest(BridgeCase):
    """The crate stands before a wall."""

    def before_the_wall(self):
        for name, xml in (("wall", WALL), ("robot", CRATE)):
            answer = spawn(name, xml, namespace="/")
            self.assertTrue(answer.success, answer.status_message)
        step(1000)

    def last_of(self, *topics):
        """The last message of each topic, of those that 0.1 s of simulated time bring."""
        heard = [self.topic(name, kind) for name, kind in topics]
        step(100)
        return [topic.wait(1)[-1] for topic in heard]

    def assert_near(self, expected, message, places=3):
        for axis, value in zip("xyz", expected):
            self.assertAlmostEqual(value, getattr(message, axis), places)

    def test_imu_and_its_services(self):
        self.before_the_wall()
        topics = ("imu/data", Imu), ("imu/data/bias", Imu)
        imu, bias = self.last_of(*topics)
        self.assertEqual("base", imu.header.frame_id)
        self.assert_near((0.1, 0.2, G + 0.3), imu.linear_acceleration, 1)
        self.assert_near((0.1, 0.2, 0.3), bias.linear_acceleration, 9)
        drift = bias.angular_velocity
        self.assertGreater(abs(drift.x) + abs(drift.y) + abs(drift.z), 0.01)
        self.assert_near((drift.x, drift.y, drift.z), imu.angular_velocity, 2)
        self.assertAlmostEqual(1e-18, imu.angular_velocity_covariance[8])
        self.assertAlmostEqual(0.2 / (2 * G), imu.orientation.x, 3)
        self.assertAlmostEqual(-0.1 / (2 * G), imu.orientation.y, 3)
        call("imu/data/calibrate", Empty)
        call("imu/data/set_accel_bias", SetBias, Vector3(1.0, 2.0, 3.0))
        imu, bias = self.last_of(*topics)
        self.assert_near((0.0, 0.0, 0.0), bias.angular_velocity, 9)
        self.assert_near((1.1, 2.2, 3.3), bias.linear_acceleration, 3)
        call("imu/data/set_rate_bias", SetBias, Vector3(0.5, 0.0, 0.0))
        call("imu/data/set_accel_bias", SetBias, Vector3(math.nan, 0.0, 0.0))
        _, bias = self.last_of(*topics)
        self.assert_near((0.5, 0.0, 0.0), bias.angular_velocity, 9)
        self.assert_near((1.1, 2.2, 3.3), bias.linear_acceleration, 3)
        wait_for(lambda: "bias is not finite" in self.node.err, "the refusal of the bias")

    def test_gps(self):
        self.before_the_wall()
        fix, velocity = self.last_of(("fix", NavSatFix), ("fix_velocity", Vector3Stamped))
        self.assertEqual(
            ("earth", 1, 3), (fix.header.frame_id, fix.status.status, fix.status.service)
        )
        self.assertAlmostEqual(45.0, fix.latitude, 6)
        self.assertAlmostEqual(9.0, fix.longitude, 6)
        self.assertAlmostEqual(105.1, fix.altitude, 2)
        self.assertEqual(NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN, fix.position_covariance_type)
        self.assert_near((0.0, 0.0, 0.0), velocity.vector, 2)
        self.assertEqual("earth", velocity.header.frame_id)

    def test_lasers_of_points(self):
        self.before_the_wall()
        block, rings = self.last_of(("block", PointCloud), ("rings", PointCloud2))
        points = [
            (2.0, 2.0 * math.tan(yaw), 2.0 * math.tan(pitch) / math.cos(yaw))
            for pitch in (0.0, 0.2)
            for yaw in (-0.5, 0.0, 0.5)
        ]
        self.assertEqual("base", block.header.frame_id)
        self.assertEqual(6, len(block.points))
        for expected, point in zip(points, block.points):
            self.assert_near(expected, point, 2)
        (channel,) = block.channels
        self.assertEqual(("", (0.0,) * 6), (channel.name, tuple(channel.values)))
        layout = [(field.name, field.offset, field.datatype) for field in rings.fields]
        kinds = 4 * [PointField.FLOAT32] + [PointField.UINT16, PointField.FLOAT32]
        names = ("x", "y", "z", "intensity", "ring", "time")
        self.assertEqual(list(zip(names, (0, 4, 8, 12, 16, 18), kinds)), layout)
        size = (rings.height, rings.width, rings.point_step, rings.row_step, rings.is_dense)
        self.assertEqual((1, 6, 22, 132, True), size)
        for number, record in enumerate(struct.iter_unpack("<4fHf", rings.data)):
            column, ring = divmod(number, 2)
            self.assert_near(points[3 * ring + column], Vector3(*record[:3]), 2)
            self.assertEqual((0.0, ring, 0.0), record[3:])

    def test_a_pair_of_cameras(self):
        self.before_the_wall()
        topics = [
            (f"eyes/{side}/{name}", kind)
            for side in ("left", "right")
            for name, kind in (("image_raw", Image), ("camera_info", CameraInfo))
        ]
        compressed = ("eyes/left/image_raw/compressed", CompressedImage)
        left, left_info, right, right_info, jpeg = self.last_of(*topics, compressed)
        self.assertEqual(
            {left.header.stamp}, {m.header.stamp for m in (left_info, right, right_info)}
        )
        self.assertEqual(("mono16", 160, 9600), (left.encoding, left.step, len(left.data)))
        self.assertEqual(("bayer_grbg8", 80, 4800), (right.encoding, right.step, len(right.data)))
        self.assertEqual(0.0, left_info.P[3])
        self.assertAlmostEqual(-FOCAL * 0.1, right_info.P[3], 3)
        self.assertAlmostEqual(FOCAL, right_info.K[0], 3)
        self.assertEqual("mono16; jpeg compressed ", jpeg.format)
        self.assertTrue(bytes(jpeg.data).startswith(b"\xff\xd8"))
        info = CameraInfo(width=1)
        call("eyes/right/set_camera_info", SetCameraInfo, info)
        (changed,) = self.last_of(topics[3])
        self.assertEqual(1, changed.width)

    def test_a_trigger_brings_a_picture(self):
        self.before_the_wall()
        pictures, infos = (
            self.topic("eye/image_raw", Image),
            self.topic("eye/camera_info", CameraInfo),
        )
        trigger = self.sender("eye/image_trigger", EmptyMessage)
        now = step(200)
        trigger.send(EmptyMessage())
        step(100)
        for topic in (pictures, infos):
            (message,) = topic.wait(1)
            self.assertEqual(now + 1, message.header.stamp.to_nsec() // 1_000_000)

    def test_a_wide_angle(self):
        self.before_the_wall()
        picture, info = self.last_of(("fish/image_raw", Image), ("fish/camera_info", CameraInfo))
        self.assertEqual(("rgb8", 80, 60), (picture.encoding, picture.width, picture.height))
        # A stereographic lens whose 180° fill the width.
        self.assertAlmostEqual(20.0, info.K[0], 1)
        self.assertFalse(any(info.D))

    def test_what_is_missing_is_one_line(self):
        self.before_the_wall()
        said = "2 plugins are not simulated and skipped (librotors_gazebo_motor_model.so, "
        said += "libLiftDragPlugin.so); missing: thrust of propellers, lift and drag in air, "
        said += "and no other plugin moves the model"
        wait_for(lambda: said in self.node.err, "the line about missing physics")


if __name__ == "__main__":
    rospy.init_node("more_sensors_test")
    rostest.rosrun("bullet_lab", "more_sensors_test", "__main__")
