#!/usr/bin/env python3
"""The camera speaks as Gazebo's does, and never loses a frame."""

import os
import unittest.mock
from pathlib import Path

import cv2
import numpy as np
import rospy
import rostest
from bridge_testing import BridgeCase, call, step
from bullet_lab.srv import SetRtf
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Empty

IMAGE, INFO = "/mycamera/image_raw", "/mycamera/camera_info"
# The camera robot before the dock.
PARAMETERS = {
    "world": "package://bullet_lab/worlds/docking.world",
    "robot": "package://bullet_lab/urdf/camera_robot.urdf",
}


def milliseconds(topic):
    return [stamp // 1_000_000 for stamp in topic.stamps()]


def pixels(message):
    channels = message.step // message.width
    return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, channels)


class CameraTest(BridgeCase):
    """What the camera says."""

    parameters = PARAMETERS

    def images(self):
        return self.topic(IMAGE, Image)

    def infos(self):
        return self.topic(INFO, CameraInfo)

    def test_image_and_camera_info(self):
        image, info = self.images(), self.infos()
        step(100)
        picture, geometry = image.wait(3)[0], info.wait(3)[0]
        self.assertEqual(milliseconds(image)[:3], milliseconds(info)[:3])
        self.assertEqual(picture.header.frame_id, "camera_optical_frame")
        self.assertEqual(geometry.header.frame_id, "camera_optical_frame")
        self.assertEqual((picture.width, picture.height, picture.encoding), (640, 480, "rgb8"))
        self.assertEqual((geometry.width, geometry.height), (640, 480))
        # Numbers of a URDF's <sensor> have six digits in Gazebo.
        focal = 320 / np.tan(round(np.radians(65), 5) / 2)
        wanted = [focal, 0, 319.5, 0, focal, 239.5, 0, 0, 1]
        np.testing.assert_allclose(geometry.K, wanted, atol=1e-3)
        self.assertEqual(list(geometry.D), [0.0] * 5)
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h10)
        (corners,), ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(pixels(picture))
        self.assertEqual(ids.ravel().tolist(), [0])
        # The marker stands 3.84 m before the camera and 0.06 m above it.
        middle = corners[0].mean(axis=0)
        np.testing.assert_allclose(middle, (319.5, 239.5 - focal * 0.06 / 3.84), atol=1.0)

    def test_compressed_pictures(self):
        image, compressed = self.images(), self.topic(f"{IMAGE}/compressed", CompressedImage)
        step(100)
        (raw, *_), (small, *_) = image.wait(3), compressed.wait(3)
        self.assertEqual(raw.header.stamp, small.header.stamp)
        self.assertEqual(raw.header.frame_id, small.header.frame_id)
        self.assertEqual("rgb8; jpeg compressed bgr8", small.format)
        self.assertLess(len(small.data), 0.2 * len(raw.data))
        self.assert_like(raw, small, 8.0)
        client = self.reconfigured("mycamera/image_raw/compressed")
        self.assertEqual(80, client.get_configuration()["jpeg_quality"])
        self.addCleanup(client.update_configuration, {"format": "jpeg"})
        client.update_configuration({"format": "png"})
        step(100)
        raw, png = image.wait(6)[-1], compressed.wait(6)[-1]
        self.assertEqual("rgb8; png compressed bgr8", png.format)
        self.assert_like(raw, png, 0.0)

    def assert_like(self, raw, compressed, tolerance):
        decoded = cv2.imdecode(np.frombuffer(compressed.data, np.uint8), cv2.IMREAD_COLOR)
        difference = np.abs(decoded[..., ::-1].astype(float) - pixels(raw))
        self.assertLessEqual(difference.mean(), tolerance)

    def test_the_rate_can_be_changed(self):
        info = self.infos()
        client = self.reconfigured("mycamera")
        self.assertEqual(30.0, client.get_configuration()["imager_rate"])
        self.addCleanup(client.update_configuration, {"imager_rate": 30.0})
        client.update_configuration({"imager_rate": 10.0})
        step(500)
        info.wait(5)
        self.assertEqual([100, 200, 300, 400, 500], milliseconds(info)[:5])

    def test_the_calibration_can_be_set(self):
        info = self.infos()
        step(100)
        before = info.wait(3)[-1]
        self.addCleanup(call, "mycamera/set_camera_info", SetCameraInfo, before)
        told = CameraInfo(width=640, height=480, distortion_model="plumb_bob", D=[0.1] * 5)
        told.K[0] = 500.0
        answer = call("mycamera/set_camera_info", SetCameraInfo, told)
        self.assertTrue(answer.success, answer.status_message)
        step(100)
        found = info.wait(6)[-1]
        self.assertEqual((500.0, [0.1] * 5), (found.K[0], list(found.D)))
        self.assertEqual("camera_optical_frame", found.header.frame_id)

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
                    self.assertEqual(due, milliseconds(topic)[: len(due)])
                    topic.close()

    def test_time_starts_again_with_a_reset(self):
        image = self.images()
        step(70)
        image.wait(2)
        call("/gazebo/reset_simulation", Empty)
        step(70)
        image.wait(4)
        self.assertEqual(milliseconds(image), [34, 67, 34, 67])


class SurroundingsTest(BridgeCase):
    """Bridges of their own: what the camera needs and what it leaves."""

    def setUp(self):
        """Start no bridge yet."""

    def test_nothing_is_drawn_without_a_subscriber_or_left_after_the_end(self):
        folder = self.folder()
        with unittest.mock.patch.dict(os.environ, TMPDIR=str(folder)):
            self.start(**PARAMETERS)
        maps = Path(f"/proc/{self.node.process.pid}/maps")
        info = self.topic(INFO, CameraInfo)
        step(100)
        info.wait(3)
        self.assertNotIn("libpanda.so", maps.read_text())
        image = self.topic(IMAGE, Image)
        step(100)
        image.wait(3)
        self.assertIn("libpanda.so", maps.read_text())
        self.node.process.kill()
        self.node.wait()
        self.assertEqual([], list(folder.iterdir()))

    def test_without_a_driver_the_camera_says_so_once_and_the_rest_goes_on(self):
        hidden = {"__EGL_VENDOR_LIBRARY_FILENAMES": os.devnull, "LIBGL_DRIVERS_PATH": os.devnull}
        with unittest.mock.patch.dict(os.environ, hidden):
            self.start(**PARAMETERS)
        images, odometry = self.topic(IMAGE, Image), self.topic("odom", Odometry)
        step(1000)
        odometry.wait(20)
        self.assertEqual([], images.messages)
        said = self.node.out + self.node.err
        line = "pictures need EGL and a driver: on Debian, install libegl1 and libgl1-mesa-dri"
        self.assertEqual(said.count(line), 1, said)
        self.assertTrue(self.node.runs())


if __name__ == "__main__":
    rospy.init_node("camera_test")
    rostest.rosrun("bullet_lab", "camera_test", "__main__")
