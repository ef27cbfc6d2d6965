#!/usr/bin/env python3
"""The marker detector: its results, when it works, what it refuses, and its diagnostics."""

import dataclasses
import math
import unittest

import numpy as np
import rospy
import rostest
from bullet_lab.msg import MarkerDetectionArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from image_testing import CAMERA, FRAME, Diagnosis, FakeCamera, View, image, info, picture
from lab_testing import Node, Topic, wait_for
from marker_images import image_of, marker, true_corners
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

VIEW = View(2.0, yaw=20.0, shift=(0.1, 0.05))
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
RESULTS = {
    "detections": MarkerDetectionArray,
    "pose": PoseStamped,
    "pose_with_covariance": PoseWithCovarianceStamped,
    "image_annotated": Image,
    "camera_info": CameraInfo,
}


class ArucoTest(unittest.TestCase):
    """Each test has a node and a camera of its own."""

    def start(self, *results, with_info=True, **parameters):
        self.node = Node("aruco.py", **parameters)
        self.addCleanup(self.node.end)
        self.camera = FakeCamera(with_info)
        self.addCleanup(self.camera.end)
        self.topics = {name: self.topic(f"/aruco/{name}", RESULTS[name]) for name in results}
        if results:
            self.camera.connect()

    def topic(self, name, kind, connected=True):
        topic = Topic(name, kind, connected)
        self.addCleanup(topic.close)
        return topic

    def diagnosis(self):
        diagnosis = Diagnosis("aruco")
        self.addCleanup(diagnosis.close)
        return diagnosis

    def send_until(self, condition, pixels, **options):
        """Go on sending an image until something holds."""
        stamps = iter(range(1, 10**6))

        def send():
            self.camera.send(0.05 * next(stamps), pixels, **options)
            rospy.rostime.wallsleep(0.05)
            return condition()

        return wait_for(send, "an effect of images")

    # Answers

    def test_every_result_has_the_stamp_and_the_frame_of_the_image(self):
        self.start(*RESULTS)
        self.camera.send(1.25, picture(VIEW))
        for name, topic in self.topics.items():
            header = topic.wait(1)[0].header
            self.assertEqual(
                (rospy.Time.from_sec(1.25), FRAME), (header.stamp, header.frame_id), name
            )

    def test_a_marker_where_it_is(self):
        self.start("detections", "pose", "pose_with_covariance")
        self.camera.send(1.0, picture(VIEW))
        (found,) = self.topics["detections"].wait(1)[0].detections
        self.assertEqual((0, "DICT_APRILTAG_36h10", 0.2), (found.id, found.dictionary, found.size))
        corners = np.reshape(found.corners, (4, 2))
        self.assertLess(np.abs(corners - true_corners(VIEW)).max(), 0.1)
        place = found.pose.pose.position
        np.testing.assert_allclose([place.x, place.y, place.z], VIEW.translation, atol=0.01)
        self.assertGreater(found.pose.covariance[0], 0.0)
        self.assertLess(found.reprojection_error, found.alternative_reprojection_error)
        self.assertFalse(found.ambiguous)
        self.assertEqual(found.pose.pose, self.topics["pose"].wait(1)[0].pose)
        self.assertEqual(found.pose, self.topics["pose_with_covariance"].wait(1)[0].pose)

    def test_every_image_is_answered_also_without_a_marker(self):
        self.start("detections", lock_step=False)
        empty = np.full((480, 640), 128, np.uint8)
        for number, pixels in enumerate((picture(VIEW), empty, picture(VIEW)), 1):
            self.camera.send(float(number), pixels)
            answer = self.topics["detections"].wait(number)[-1]
            self.assertEqual(rospy.Time(number), answer.header.stamp)
        counts = [len(m.detections) for m in self.topics["detections"].messages]
        self.assertEqual([1, 0, 1], counts)

    def test_sizes_by_id_and_ids_that_were_not_asked_for(self):
        self.start("detections", ids="0 7", sizes="7=0.4", width=0.2)
        diagnosis = self.diagnosis()
        self.camera.send(1.0, image_of([marker(7)], VIEW, samples=4))
        (found,) = self.topics["detections"].wait(1)[0].detections
        self.assertEqual((7, 0.4), (found.id, found.size))
        self.assertAlmostEqual(4.0, found.pose.pose.position.z, delta=0.02)
        other = image_of([marker(9)], VIEW, samples=4)
        self.send_until(lambda: any("marker 9 seen" in said for said in diagnosis.said()), other)
        self.assertEqual([], self.topics["detections"].messages[-1].detections)

    def test_dictionary_of_another_name(self):
        self.start("detections", tags="4x4_50")
        self.camera.send(1.0, image_of([marker(3, tags="4x4_50")], VIEW, samples=4))
        (found,) = self.topics["detections"].wait(1)[0].detections
        self.assertEqual((3, "DICT_4X4_50"), (found.id, found.dictionary))

    def test_transforms_are_sent_on_demand_without_another_listener(self):
        self.start(publish_tf=True)
        transforms = self.topic("/tf", TFMessage)
        self.camera.connect()
        self.camera.send(1.0, picture(VIEW))
        (transform,) = transforms.wait(1)[0].transforms
        self.assertEqual(
            ("fiducial_0", FRAME), (transform.child_frame_id, transform.header.frame_id)
        )
        self.assertAlmostEqual(2.0, transform.transform.translation.z, delta=0.01)
        turn = transform.transform.rotation
        self.assertAlmostEqual(1.0, turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2, 9)

    def test_in_lock_step_nothing_is_lost(self):
        # Nobody offers the lock step here: the node waits for it, and answers all the same.
        self.start("detections", lock_step=True)
        pixels = picture(VIEW)
        for number in range(1, 61):
            self.camera.send(0.01 * number, pixels)
        stamps = [m.header.stamp.to_sec() for m in self.topics["detections"].wait(60)]
        np.testing.assert_allclose(stamps, 0.01 * np.arange(1, 61), atol=1e-9)

    # When it works

    def test_works_only_while_somebody_listens(self):
        self.start()
        diagnosis = self.diagnosis()
        diagnosis.wait(OK, "idle")
        self.assertFalse(self.camera.looked_at())
        for _ in range(2):
            topic = self.topic("/aruco/pose", PoseStamped)
            wait_for(self.camera.looked_at, "a subscription")
            topic.close()
            wait_for(lambda: not self.camera.looked_at(), "the subscription to end")

    def test_camera_info_is_waited_for_by_the_first_image(self):
        self.start("detections")
        self.camera.images.publish(image(1.0, picture(VIEW)))
        rospy.rostime.wallsleep(0.3)
        self.assertEqual([], self.topics["detections"].messages)
        self.camera.infos.publish(info(1.0))
        self.assertEqual(0.2, self.topics["detections"].wait(1)[0].detections[0].size)

    # What it refuses

    def test_images_that_are_none(self):
        self.start("detections")
        bad = image(1.0, picture(VIEW))
        bad.encoding = "32FC1"
        short = image(2.0, picture(VIEW))
        short.data = short.data[:-1]
        tiny = image(3.0, np.zeros((4, 4), np.uint8))
        for message in (bad, short, tiny):
            self.camera.infos.publish(info(message.header.stamp.to_sec()))
            self.camera.images.publish(message)
            self.topics["detections"].wait(int(message.header.stamp.to_sec()))
        self.camera.send(4.0, picture(VIEW))
        counts = [len(m.detections) for m in self.topics["detections"].wait(4)]
        self.assertEqual([0, 0, 0, 1], counts)
        wait_for(lambda: "refused:" in self.node.err, "a warning")
        self.assertTrue(self.node.runs())
        self.assertNotIn("Traceback", self.node.err)

    def test_a_stamp_that_comes_twice_is_refused_and_time_may_be_set_back(self):
        self.start("detections")
        for number, stamp in enumerate((5.0, 6.0, 1.0), 1):
            self.camera.send(stamp, picture(VIEW))
            self.topics["detections"].wait(number)
            self.camera.send(stamp, picture(VIEW))
        stamps = [m.header.stamp.to_sec() for m in self.topics["detections"].wait(3)]
        self.assertEqual([5.0, 6.0, 1.0], stamps)
        wait_for(lambda: "duplicate image with stamp" in self.node.err, "a warning")

    def test_cameras_that_are_none(self):
        zero, other, nan = info(0.0), info(0.0), info(0.0)
        zero.K = [0.0] * 9
        other.width = 320
        nan.K = [math.nan, *nan.K[1:]]
        for about, words in ((zero, "zero K"), (other, "not 640 x 480"), (nan, "not finite")):
            with self.subTest(words=words):
                self.start("detections")
                diagnosis = self.diagnosis()
                self.camera.send(1.0, picture(VIEW), about=about)
                (found,) = self.topics["detections"].wait(1)[0].detections
                self.assertEqual(0.0, found.size)
                wait_for(lambda words=words: words in self.node.err, words)
                said = lambda d=diagnosis, w=words: any(w in line for line in d.said())  # noqa: E731
                self.send_until(said, picture(VIEW), about=about)
                diagnosis.wait(ERROR, words)
                self.doCleanups()

    def test_parameters_that_are_not_allowed(self):
        node = Node("aruco.py", tags="apriltag_37h10")
        self.addCleanup(node.end)
        self.assertEqual(2, node.wait(), node.err)
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("~tags", node.err)

    def test_an_id_that_the_dictionary_does_not_have(self):
        node = Node("aruco.py", tags="4x4_50", ids="50")
        self.addCleanup(node.end)
        self.assertEqual(2, node.wait(), node.err)
        self.assertIn("no marker 50", node.err)

    # Diagnostics

    def test_diagnostics_of_each_kind(self):
        self.start("detections", with_info=False)
        diagnosis = self.diagnosis()
        diagnosis.wait(WARN, "no messages")
        said = lambda words: lambda: any(words in line for line in diagnosis.said())  # noqa: E731
        self.send_until(said("no camera_info"), picture(VIEW))
        diagnosis.wait(WARN, "no camera_info")

    def test_diagnostics_with_a_marker_and_without(self):
        self.start("detections")
        diagnosis = self.diagnosis()
        said = lambda words: lambda: any(words in line for line in diagnosis.said())  # noqa: E731
        self.send_until(said("id 0 at"), picture(VIEW))
        values = {v.key: v.value for v in diagnosis.wait(OK, "id 0 at 2.0").values}
        self.assertEqual("1", values["detections"])
        self.assertGreater(float(values["frame rate (Hz)"]), 0.0)
        self.assertGreater(float(values["latency median (ms)"]), 0.0)
        flat = np.full((480, 640), 90, np.uint8)
        self.send_until(said("the image is flat"), flat)
        grey = picture(VIEW)
        grey[230:250] = 128
        self.send_until(said("no marker:"), grey)

    def test_lens_of_a_raw_image_and_none_of_a_rectified_one(self):
        bent = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.001, 0.0))
        self.start("detections")
        view = View(1.0, yaw=25.0, shift=(0.35, 0.2))
        raw = image_of([marker()], view, camera=bent, samples=4)
        self.camera.send(1.0, raw, about=info(1.0, bent))
        (found,) = self.topics["detections"].wait(1)[0].detections
        place = found.pose.pose.position
        np.testing.assert_allclose([place.x, place.y, place.z], view.translation, atol=0.005)
        self.doCleanups()
        self.start("detections", rectified=True)
        flat = image_of([marker()], view, samples=4)
        self.camera.send(1.0, flat, about=info(1.0, bent))
        (found,) = self.topics["detections"].wait(1)[0].detections
        place = found.pose.pose.position
        np.testing.assert_allclose([place.x, place.y, place.z], view.translation, atol=0.005)


def setUpModule():
    rospy.init_node("aruco_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "aruco_test", "__main__")
