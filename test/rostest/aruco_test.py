#!/usr/bin/env python3
"""The marker detector: its results, when it works, what it refuses, and its diagnostics."""

import dataclasses
import threading
from unittest import mock

import numpy as np
import rospy
import rostest
from bullet_lab.msg import MarkerDetectionArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from image_testing import CAMERA, FRAME, ImageNodeTest, View, image, info, picture
from lab_testing import PATIENCE, Node, wait_for
from marker_images import image_of, marker, true_corners
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from bullet_lab.core.parameters import ParameterError
from bullet_lab.ros.nodes import image_node
from bullet_lab.ros.nodes.aruco import Aruco, ArucoParameters

CLOSE = View(1.0, yaw=25.0, shift=(0.35, 0.2))
BENT = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.001, 0.0))
VIEW = View(2.0, yaw=20.0, shift=(0.1, 0.05))
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
RESULTS = {
    "detections": MarkerDetectionArray,
    "pose": PoseStamped,
    "pose_with_covariance": PoseWithCovarianceStamped,
    "image_annotated": Image,
    "camera_info": CameraInfo,
}


class ArucoTest(ImageNodeTest):
    """All tests share a node."""

    @classmethod
    def setUpClass(cls):
        cls.shared = Node("aruco.py")

    @classmethod
    def tearDownClass(cls):
        cls.shared.end()

    def look(self, *results, with_info=True):
        """Have the node look at a camera, for some results."""
        self.seen = self.camera(with_info)
        self.topics = {name: self.topic(f"/aruco/{name}", RESULTS[name]) for name in results}
        self.seen.connect()

    def detections(self, number):
        """The answers to so many images."""
        return self.topics["detections"].wait(number)

    def send_until_said(self, words, pixels, **options):
        """Go on sending an image until the diagnostics have some words; return the status.

        It returns after the answer to the last image, which the next test shall not receive. A
        node that is behind drops images, so another one is sent until one is answered.
        """
        diagnosis, answers = self.diagnosis("aruco"), self.topics["detections"]
        stamp = rospy.Time(0)

        def send():
            nonlocal stamp
            stamp += rospy.Duration(0, 50_000_000)
            self.seen.send(stamp.to_sec(), pixels, **options)
            rospy.rostime.wallsleep(0.05)
            return diagnosis.found(words)

        status = wait_for(send, lambda: f"'{words}'; had {diagnosis.said()}")

        def answered():
            if stamp.to_nsec() in answers.stamps():
                return True
            send()
            rospy.rostime.wallsleep(1.0)
            return stamp.to_nsec() in answers.stamps()

        wait_for(answered, "the answer to the last image")
        return status

    # Answers

    def test_a_marker_where_it_is_with_the_stamp_and_the_frame_of_the_image(self):
        self.look(*RESULTS)
        self.seen.send(1.25, picture(VIEW))
        answers = {name: topic.wait(1)[0] for name, topic in self.topics.items()}
        for name, answer in answers.items():
            header = answer.header
            self.assertEqual((rospy.Time(1.25), FRAME), (header.stamp, header.frame_id), name)
        (found,) = answers["detections"].detections
        self.assertEqual((0, "DICT_APRILTAG_36h10", 0.2), (found.id, found.dictionary, found.size))
        corners = np.reshape(found.corners, (4, 2))
        self.assertLess(np.abs(corners - true_corners(VIEW)).max(), 0.1)
        place = found.pose.pose.position
        np.testing.assert_allclose([place.x, place.y, place.z], VIEW.translation, atol=0.01)
        self.assertGreater(found.pose.covariance[0], 0.0)
        self.assertLess(found.reprojection_error, found.alternative_reprojection_error)
        self.assertFalse(found.ambiguous)
        self.assertEqual(found.pose.pose, answers["pose"].pose)
        self.assertEqual(found.pose, answers["pose_with_covariance"].pose)

    def test_every_image_is_answered_also_without_a_marker(self):
        self.look("detections")
        empty = np.full((480, 640), 128, np.uint8)
        for number, pixels in enumerate((picture(VIEW), empty, picture(VIEW)), 1):
            self.seen.send(float(number), pixels)
            self.assertEqual(rospy.Time(number), self.detections(number)[-1].header.stamp)
        self.assertEqual([1, 0, 1], [len(m.detections) for m in self.detections(3)])

    def test_the_lens_of_a_raw_image(self):
        self.look("detections")
        self.seen.send(1.0, image_of([marker()], CLOSE, BENT, samples=4), about=info(1.0, BENT))
        (found,) = self.detections(1)[0].detections
        assert_place(found, CLOSE)

    # When it works

    def test_works_only_while_somebody_listens(self):
        self.seen = self.camera()
        self.diagnosis("aruco").wait(OK, "idle")
        self.assertFalse(self.seen.looked_at())
        for _ in range(2):
            topic = self.topic("/aruco/pose", PoseStamped)
            wait_for(self.seen.looked_at, "a subscription")
            topic.close()
            wait_for(lambda: not self.seen.looked_at(), "the subscription to end")

    def test_camera_info_is_waited_for_by_the_first_image(self):
        node, seen = Aruco(ArucoParameters()), []
        node.process = lambda image: seen.append(image.info) or {}
        looking = threading.Thread(target=node._receive_image, args=[image(1.0, picture(VIEW))])
        with mock.patch.object(image_node, "_INFO_PATIENCE", PATIENCE):
            looking.start()
            wait_for(lambda: node._lock._waiters or seen, "the image")
            node._receive_info(info(1.0))
            looking.join()
        self.assertEqual([info(1.0)], seen)

    # What it refuses

    def test_images_that_are_none(self):
        self.look("detections")
        bad = image(1.0, picture(VIEW))
        bad.encoding = "32FC1"
        short = image(2.0, picture(VIEW))
        short.data = short.data[:-1]
        tiny = image(3.0, np.zeros((4, 4), np.uint8))
        for message in (bad, short, tiny):
            self.seen.infos.publish(info(message.header.stamp.to_sec()))
            self.seen.images.publish(message)
            self.detections(int(message.header.stamp.to_sec()))
        self.seen.send(4.0, picture(VIEW))
        counts = [len(m.detections) for m in self.detections(4)]
        self.assertEqual([0, 0, 0, 1], counts)
        wait_for(lambda: "refused:" in self.shared.err, "a warning")
        self.assertTrue(self.shared.runs())
        self.assertNotIn("Traceback", self.shared.err)

    def test_a_stamp_that_comes_twice_is_refused_and_time_may_be_set_back(self):
        self.look("detections")
        for number, stamp in enumerate((5.0, 6.0, 1.0), 1):
            self.seen.send(stamp, picture(VIEW))
            self.detections(number)
            self.seen.send(stamp, picture(VIEW))
        stamps = [m.header.stamp.to_sec() for m in self.detections(3)]
        self.assertEqual([5.0, 6.0, 1.0], stamps)

        def warned():
            # The node may just have warned of something else, and is silent for a second then.
            self.seen.send(1.0, picture(VIEW))
            return "duplicate image with stamp" in self.shared.err

        wait_for(warned, "a warning")

    def test_a_camera_that_is_none(self):
        zero = info(0.0)
        zero.K = [0.0] * 9
        self.look("detections")
        self.seen.send(1.0, picture(VIEW), about=zero)
        (found,) = self.detections(1)[0].detections
        self.assertEqual(0.0, found.size)
        self.assertEqual(ERROR, self.send_until_said("zero K", picture(VIEW), about=zero).level)

    # Diagnostics

    def test_diagnostics_without_camera_info(self):
        self.look("detections", with_info=False)
        self.diagnosis("aruco").wait(WARN, "no messages")
        self.assertEqual(WARN, self.send_until_said("no camera_info", picture(VIEW)).level)

    def test_diagnostics_with_a_marker_and_without(self):
        self.look("detections")
        status = self.send_until_said("id 0 at 2.0", picture(VIEW))
        values = {v.key: v.value for v in status.values}
        self.assertEqual((OK, "1"), (status.level, values["detections"]))
        self.assertGreater(float(values["frame rate (Hz)"]), 0.0)
        self.assertGreater(float(values["latency median (ms)"]), 0.0)
        self.send_until_said("the image is flat", np.full((480, 640), 90, np.uint8))


class ArucoParametersTest(ImageNodeTest):
    """Nodes with other parameters."""

    def test_transforms_in_lock_step_of_chosen_markers_in_rectified_images_until_ctrl_c(self):
        # Nobody offers the lock step here: the node waits for it, and works all the same.
        choice = {"tags": "4x4_50", "ids": "3 7", "sizes": "7=0.4", "rectified": True}
        panel = "[{name: panel, layout: [{id: 7, size: 0.4, x: 0.1}, {id: 3, size: 0.2}]}]"
        node = self.node("aruco.py", **choice, tag_bundles=panel, publish_tf=True, lock_step=True)
        transforms = self.topic("/tf", TFMessage)
        camera = self.camera()
        self.addCleanup(node.end)
        camera.connect()
        pixels = image_of([marker(7, size=0.4, tags="4x4_50")], CLOSE, samples=4)
        camera.send(1.0, pixels, about=info(1.0, BENT))
        transform, of_panel = transforms.wait(1)[0].transforms
        self.assertEqual(
            ("fiducial_7", FRAME), (transform.child_frame_id, transform.header.frame_id)
        )
        self.assertEqual("panel", of_panel.child_frame_id)
        ends = (one.transform.translation for one in (transform, of_panel))
        arm = [getattr(one, axis) for one in ends for axis in "xyz"]
        self.assertAlmostEqual(0.1, float(np.linalg.norm(np.subtract(arm[:3], arm[3:]))), 6)
        turn = transform.transform.rotation
        self.assertAlmostEqual(1.0, turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2, 9)
        detections = self.topic("/aruco/detections", MarkerDetectionArray)
        stamps = 2.0 + 0.01 * np.arange(30)
        for stamp in stamps:
            camera.send(stamp, pixels, about=info(stamp, BENT))
        messages = detections.wait(30)
        np.testing.assert_allclose(stamps, [m.header.stamp.to_sec() for m in messages], atol=1e-9)
        (found,) = messages[-1].detections
        self.assertEqual((7, "DICT_4X4_50", 0.4), (found.id, found.dictionary, found.size))
        assert_place(found, CLOSE)
        (bundle,) = messages[-1].bundles
        self.assertEqual(("panel", (7,)), (bundle.name, bundle.ids))
        camera.send(3.0, image_of([marker(9, tags="4x4_50")], VIEW, samples=4))
        self.assertEqual([], detections.wait(31)[-1].detections)
        node.signal()
        self.assertEqual(0, node.wait(), node.err)
        self.assertNotIn("Traceback", node.err)

    def test_parameters_that_are_not_allowed(self):
        node = self.node("aruco.py", tags="apriltag_37h10")
        self.assert_bad_parameter(node, "~tags")
        with self.assertRaisesRegex(ParameterError, "no marker 50"):
            ArucoParameters(tags="DICT_4X4_50", ids=(50,))


def assert_place(found, view):
    """Assert that a marker is where a view has it."""
    place = found.pose.pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], view.translation, atol=0.005)


def setUpModule():
    rospy.init_node("aruco_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "aruco_test", "__main__")
