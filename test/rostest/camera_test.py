#!/usr/bin/env python3
"""The camera speaks as Gazebo's does, and never loses a frame."""

import contextlib
import importlib
import os
import tempfile
import unittest
import unittest.mock
from pathlib import Path

import cv2
import numpy as np
import rospy
import rostest
from bullet_lab.srv import Step
from lab_testing import Node, Topic, wait_for
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Empty

ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
WORLD = "package://bullet_lab/worlds/docking.world"
IMAGE, INFO = "/mycamera/image_raw", "/mycamera/camera_info"
# Of 30 Hz, in ms: the first step at or after k/30 s.
PERIODS = {33, 34}


@contextlib.contextmanager
def bridge(**parameters):
    """A bridge with the camera robot before the dock."""
    node = Node("pybullet_bridge.py", **{"world": WORLD, "robot": ROBOT, **parameters})
    try:
        wait_for(lambda: "/bullet_lab/step" in services(), "the bridge")
        yield node
    finally:
        node.end()


def services():
    _, _, state = rospy.get_master().getSystemState()
    return [name for name, _ in state[2]]


def advance(steps):
    rospy.wait_for_service("/bullet_lab/step", 30.0)
    rospy.ServiceProxy("/bullet_lab/step", Step)(steps)


def milliseconds(topic):
    return [stamp // 1_000_000 for stamp in topic.stamps()]


def pixels(message):
    channels = message.step // message.width
    return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, channels)


class CameraTest(unittest.TestCase):
    def images(self):
        return self.topic(IMAGE, Image)

    def infos(self):
        return self.topic(INFO, CameraInfo)

    def topic(self, name, kind):
        topic = Topic(name, kind)
        self.addCleanup(topic.close)
        return topic

    def test_image_and_camera_info(self):
        with bridge(paused=True):
            image, info = self.images(), self.infos()
            advance(100)
            picture, geometry = image.wait(3)[0], info.wait(3)[0]
            self.assertEqual(milliseconds(image)[:3], milliseconds(info)[:3])
        self.assertEqual(picture.header.frame_id, "camera_optical_frame")
        self.assertEqual(geometry.header.frame_id, "camera_optical_frame")
        self.assertEqual((picture.width, picture.height, picture.encoding), (640, 480, "rgb8"))
        self.assertEqual((geometry.width, geometry.height), (640, 480))
        focal = 320 / np.tan(np.radians(65) / 2)
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
        with bridge(paused=True):
            image, compressed = self.images(), self.topic(f"{IMAGE}/compressed", CompressedImage)
            advance(100)
            (raw, *_), (small, *_) = image.wait(3), compressed.wait(3)
            self.assertEqual(raw.header.stamp, small.header.stamp)
            self.assertEqual(raw.header.frame_id, small.header.frame_id)
            self.assertEqual("rgb8; jpeg compressed bgr8", small.format)
            self.assertLess(len(small.data), 0.2 * len(raw.data))
            self.assert_like(raw, small, 8.0)
            client = self.reconfigured("mycamera/image_raw/compressed")
            self.assertEqual(80, client.get_configuration()["jpeg_quality"])
            client.update_configuration({"format": "png"})
            advance(100)
            raw, png = image.wait(6)[-1], compressed.wait(6)[-1]
            self.assertEqual("rgb8; png compressed bgr8", png.format)
            self.assert_like(raw, png, 0.0)

    def assert_like(self, raw, compressed, tolerance):
        decoded = cv2.imdecode(np.frombuffer(compressed.data, np.uint8), cv2.IMREAD_COLOR)
        difference = np.abs(decoded[..., ::-1].astype(float) - pixels(raw))
        self.assertLessEqual(difference.mean(), tolerance)

    def reconfigured(self, name):
        try:
            client = importlib.import_module("dynamic_reconfigure.client")
        except ImportError:
            self.skipTest("dynamic_reconfigure is not installed")
        return client.Client(name, timeout=30.0)

    def test_the_rate_can_be_changed(self):
        with bridge(paused=True):
            info = self.infos()
            client = self.reconfigured("mycamera")
            self.assertEqual(30.0, client.get_configuration()["imager_rate"])
            client.update_configuration({"imager_rate": 10.0})
            advance(500)
            info.wait(5)
            self.assertEqual([100, 200, 300, 400, 500], milliseconds(info)[:5])

    def test_the_calibration_can_be_set(self):
        with bridge(paused=True):
            info = self.infos()
            rospy.wait_for_service("mycamera/set_camera_info", 30.0)
            told = CameraInfo(width=640, height=480, distortion_model="plumb_bob", D=[0.1] * 5)
            told.K[0] = 500.0
            answer = rospy.ServiceProxy("mycamera/set_camera_info", SetCameraInfo)(told)
            self.assertTrue(answer.success, answer.status_message)
            advance(100)
            found = info.wait(3)[-1]
            self.assertEqual((500.0, [0.1] * 5), (found.K[0], list(found.D)))
            self.assertEqual("camera_optical_frame", found.header.frame_id)

    def count_frames(self, rtf, count):
        with bridge(rtf=rtf):
            image, info = self.images(), self.infos()
            image.wait(count)
            info.wait(count)
            stamps, others = milliseconds(image), milliseconds(info)
        steps = set(np.diff(stamps).tolist())
        self.assertTrue(steps <= PERIODS, f"gaps of {sorted(steps)} ms")
        grid = [-(-1000 * k // 30) for k in range(1, 100_000)]
        self.assertIn(stamps[0], grid)
        first = grid.index(stamps[0])
        self.assertEqual(stamps, grid[first : first + len(stamps)])
        # The two topics are subscribed to one after the other.
        shared = max(stamps[0], others[0])
        pairs = zip((s for s in stamps if s >= shared), (s for s in others if s >= shared))
        self.assertTrue(all(one == other for one, other in pairs))

    def test_no_frame_is_lost_at_full_speed(self):
        self.count_frames(0.0, 60)

    def test_no_frame_is_lost_in_real_time(self):
        self.count_frames(1.0, 45)

    def test_nothing_is_drawn_without_a_subscriber(self):
        with bridge(rtf=1.0) as node:
            maps = Path(f"/proc/{node.process.pid}/maps")
            self.infos().wait(10)
            self.assertNotIn("libpanda.so", maps.read_text())
            self.images().wait(2)
            self.assertIn("libpanda.so", maps.read_text())

    def test_nothing_is_left_in_the_temporary_directory(self):
        with tempfile.TemporaryDirectory() as folder:
            with unittest.mock.patch.dict(os.environ, TMPDIR=folder), bridge(rtf=1.0) as node:
                self.images().wait(2)
                node.process.kill()
                node.process.wait(10)
            self.assertEqual(os.listdir(folder), [])

    def test_without_a_driver_the_camera_says_so_once_and_the_rest_goes_on(self):
        hidden = {"__EGL_VENDOR_LIBRARY_FILENAMES": os.devnull, "LIBGL_DRIVERS_PATH": os.devnull}
        with unittest.mock.patch.dict(os.environ, hidden), bridge(rtf=0.0) as node:
            images = self.images()
            odometry = self.topic("/odom", Odometry)
            odometry.wait(100)
            self.assertEqual(len(images.messages), 0)
            said = node.out + node.err
            line = "pictures need EGL and a driver: on Debian, install libegl1 and libgl1-mesa-dri"
            self.assertEqual(said.count(line), 1, said)
            self.assertTrue(node.runs())

    def test_pictures_follow_from_the_seed(self):
        pictures = [self.picture_at_a_second(seed) for seed in (1, 1, 2)]
        self.assertEqual(pictures[0], pictures[1])
        self.assertNotEqual(pictures[0], pictures[2])

    def picture_at_a_second(self, seed):
        with bridge(paused=True, seed=seed):
            # Whether one has looked before makes no difference.
            advance(900 if seed == 1 else 1)
            image = self.images()
            advance(100 if seed == 1 else 999)
            wait_for(lambda: 1000 in milliseconds(image), "the picture at 1 s")
            return image.messages[milliseconds(image).index(1000)].data

    def test_time_starts_again_with_a_reset(self):
        with bridge(paused=True):
            image = self.images()
            advance(70)
            image.wait(2)
            rospy.ServiceProxy("/gazebo/reset_simulation", Empty)()
            advance(70)
            image.wait(4)
            self.assertEqual(milliseconds(image), [34, 67, 34, 67])


if __name__ == "__main__":
    rospy.set_param("/use_sim_time", True)
    rospy.init_node("camera_test")
    rostest.rosrun("bullet_lab", "camera_test", CameraTest)
