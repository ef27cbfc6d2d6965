#!/usr/bin/env python3
"""The sensors of Gazebo's robots as an unmodified client sees them."""

import math
import os
import tempfile
import unittest.mock
from pathlib import Path

import cv2
import numpy as np
from bridge_testing import BridgeCase, call, spawn, step
from bullet_lab.srv import SetBias, SetRtf
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from lab_testing import run_tests, wait_for
from nav_msgs.msg import Odometry
from sensor_msgs.msg import (
    CameraInfo,
    CompressedImage,
    Image,
    Imu,
)
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty as EmptyMessage
from std_srvs.srv import Empty

from bullet_lab.ros.messages.images import pixels_of

CRATE = """<robot name="crate">
  <link name="base"><inertial><mass value="2"/>
    <inertia ixx="0.0133" iyy="0.0133" izz="0.0133"/></inertial>
    <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <gazebo><plugin name="imu" filename="libhector_gazebo_ros_imu.so"><updateRate>50</updateRate>
      <topicName>imu/data</topicName><accelOffset>0.1 0.2 0.3</accelOffset>
      <rateDrift>0.1</rateDrift><rateDriftFrequency>0</rateDriftFrequency>
      <rateGaussianNoise>0 0 1e-9</rateGaussianNoise>
    </plugin>
  </gazebo>
  <gazebo reference="base">
    <sensor type="multicamera" name="pair"><update_rate>10</update_rate>
      <camera name="left"><pose>0 0.05 0 0 0 0</pose><horizontal_fov>1.2</horizontal_fov>
        <image><width>80</width><height>60</height><format>L16</format></image></camera>
      <camera name="right"><pose>0 -0.05 0 0 0 0</pose><horizontal_fov>1.2</horizontal_fov>
        <image><width>80</width><height>60</height><format>BAYER_GRBG8</format></image></camera>
      <plugin name="pair" filename="libgazebo_ros_multicamera.so">
        <cameraName>eyes</cameraName><hackBaseline>0.1</hackBaseline></plugin></sensor>
    <sensor type="camera" name="eye"><update_rate>10</update_rate>
      <camera name="c"><horizontal_fov>1.2</horizontal_fov>
        <image><width>80</width><height>60</height><format>R8G8B8</format></image></camera>
      <plugin name="eye" filename="libgazebo_ros_triggered_camera.so">
        <cameraName>eye</cameraName></plugin></sensor>
  </gazebo>
</robot>"""
FOCAL = 40 / math.tan(0.6)
IMAGE, INFO = "/mycamera/image_raw", "/mycamera/camera_info"
# The camera robot before the dock.
DOCK = {
    "world": "package://bullet_lab/worlds/docking.world",
    "robot": "package://bullet_lab/urdf/camera_robot.urdf",
}


class SensorsTest(BridgeCase):
    """A crate carries sensors; all tests share it."""

    def empty(self):
        """Leave the crate where it is."""

    def start(self, **parameters):
        super().start(**parameters)
        upright = Pose(Point(0.0, 0.0, 0.1), Quaternion(0.0, 0.0, 0.0, 1.0))
        answer = spawn("robot", CRATE, upright, namespace="/")
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
        topics = ("imu/data", Imu), ("imu/data/bias", Imu)
        imu, bias = self.last_of(*topics)
        drift = bias.angular_velocity
        self.assertGreater(abs(drift.x), 0.0)
        self.assert_near((drift.x, drift.y, drift.z), imu.angular_velocity, 2)
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
        wait_for(lambda: "bias is not finite" in self.bridge.err, "the refusal of the bias")

    def test_a_pair_of_cameras(self):
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
        self.assertEqual(("mono16", "bayer_grbg8"), (left.encoding, right.encoding))
        self.assertAlmostEqual(-FOCAL * 0.1, right_info.P[3], 3)
        self.assertEqual("mono16; jpeg compressed ", jpeg.format)
        call("eyes/right/set_camera_info", SetCameraInfo, CameraInfo(width=1))
        (changed,) = self.last_of(topics[3])
        self.assertEqual(1, changed.width)

    def test_a_trigger_brings_a_picture(self):
        pictures, infos = (
            self.topic("eye/image_raw", Image),
            self.topic("eye/camera_info", CameraInfo),
        )
        trigger = self.sender("eye/image_trigger", EmptyMessage)
        now = step(200)
        trigger.send(EmptyMessage())
        step(100)
        for topic in (pictures, infos):
            topic.wait(1)
            self.assertEqual([now + 1], topic.stamps())


class CameraTest(BridgeCase):
    """What the camera says, and what it leaves."""

    parameters = DOCK
    temporary = tempfile.TemporaryDirectory()

    def start(self, **parameters):
        with unittest.mock.patch.dict(os.environ, TMPDIR=self.temporary.name):
            super().start(**parameters)

    def images(self):
        return self.topic(IMAGE, Image)

    def infos(self):
        return self.topic(INFO, CameraInfo)

    # First, as what was drawn with stays loaded.
    def test_0_nothing_is_drawn_without_a_subscriber(self):
        maps = Path(f"/proc/{self.bridge.process.pid}/maps")
        info = self.infos()
        step(100)
        info.wait(3)
        self.assertNotIn("libpanda.so", maps.read_text())
        image = self.images()
        step(100)
        image.wait(3)
        self.assertIn("libpanda.so", maps.read_text())

    def test_compressed_pictures(self):
        image, compressed = self.images(), self.topic(f"{IMAGE}/compressed", CompressedImage)
        step(100)
        (raw, *_), (small, *_) = image.wait(3), compressed.wait(3)
        self.assertEqual(raw.header.stamp, small.header.stamp)
        self.assertEqual("rgb8; jpeg compressed bgr8", small.format)
        client = self.reconfigured("mycamera/image_raw/compressed")
        self.assertEqual(80, client.get_configuration()["jpeg_quality"])
        self.addCleanup(client.update_configuration, {"format": "jpeg"})
        client.update_configuration({"format": "png"})
        step(100)
        raw, png = image.wait(6)[-1], compressed.wait(6)[-1]
        self.assertEqual("rgb8; png compressed bgr8", png.format)
        decoded = cv2.imdecode(np.frombuffer(png.data, np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(decoded[..., ::-1], pixels_of(raw, "rgb8"))

    def test_the_rate_can_be_changed(self):
        info = self.infos()
        client = self.reconfigured("mycamera")
        self.assertEqual(30.0, client.get_configuration()["imager_rate"])
        self.addCleanup(client.update_configuration, {"imager_rate": 30.0})
        client.update_configuration({"imager_rate": 10.0})
        step(500)
        info.wait(5)
        self.assertEqual([100, 200, 300, 400, 500], info.stamps()[:5])

    def test_no_frame_is_lost_at_full_speed_or_in_real_time(self):
        for rtf in (0.0, 1.0):
            with self.subTest(rtf=rtf):
                self.empty()
                call("/bullet_lab/set_rtf", SetRtf, rtf)
                image, info = self.images(), self.infos()
                call("/gazebo/unpause_physics", Empty)
                # 30 Hz: the first step at or after k/30 s.
                due = [-(-1000 * k // 30) for k in range(1, 16)]
                for topic in (image, info):
                    topic.wait(len(due))
                    self.assertEqual(due, topic.stamps()[: len(due)])
                    topic.close()

    # Last, as it is the end of the bridge.
    def test_z_nothing_is_left_by_a_bridge_that_is_killed(self):
        image = self.images()
        step(100)
        image.wait(3)
        self.bridge.process.kill()
        self.bridge.wait()
        self.assertEqual([], os.listdir(self.temporary.name))


class WithoutDriverTest(BridgeCase):
    """Nothing can be drawn."""

    parameters = DOCK

    def test_the_camera_says_so_once_and_the_rest_goes_on(self):
        images, odometry = self.topic(IMAGE, Image), self.topic("odom", Odometry)
        step(1000)
        odometry.wait(20)
        self.assertEqual([], images.messages)
        said = self.bridge.out + self.bridge.err
        line = "pictures need EGL and a driver: on Debian, install libegl1 and libgl1-mesa-dri"
        self.assertEqual(said.count(line), 1, said)
        self.assertTrue(self.bridge.runs())

    def start(self, **parameters):
        hidden = {"__EGL_VENDOR_LIBRARY_FILENAMES": os.devnull, "LIBGL_DRIVERS_PATH": os.devnull}
        with unittest.mock.patch.dict(os.environ, hidden):
            super().start(**parameters)


if __name__ == "__main__":
    run_tests()
