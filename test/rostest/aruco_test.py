#!/usr/bin/env python3
"""The marker detector as a node: when it works, and its diagnostics."""

import sys

import numpy as np
import rospy
from bullet_lab.msg import MarkerDetectionArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from lab_testing import PACKAGE, NodeTest, run_tests, wait_for
from sensor_msgs.msg import CameraInfo, Image

# The exact images of the unit tests.
sys.path.insert(0, str(PACKAGE / "test" / "unit"))
from marker_images import CAMERA, View, image_of, marker  # noqa: E402

from bullet_lab.ros.messages.images import image_message  # noqa: E402

IMAGE, INFO = "/mycamera/image_raw", "/mycamera/camera_info"
FRAME = "camera_optical_frame"
VIEW = View(2.0, yaw=20.0, shift=(0.1, 0.05))
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class ArucoTest(NodeTest):
    """What the node does with its defaults; this test is the camera."""

    def setUp(self):
        options = {"queue_size": 100, "tcp_nodelay": True}
        self.infos = rospy.Publisher(INFO, CameraInfo, **options)
        self.images = rospy.Publisher(IMAGE, Image, **options)
        for made in (self.infos, self.images):
            self.addCleanup(made.unregister)

    def looked_at(self):
        """Whether anybody subscribes to the images."""
        self.images.impl.check()
        return self.images.get_num_connections() > 0

    def status(self, words):
        """The status so far whose message has some words, or None."""
        found = [one for m in self.diagnostics.messages for one in m.status if words in one.message]
        return next((one for one in found if one.name.startswith("aruco:")), None)

    def test_works_only_while_somebody_listens_and_says_how_it_is(self):
        self.diagnostics = self.topic("/diagnostics", DiagnosticArray, connected=False)
        node = self.node("aruco.py")
        idle = wait_for(lambda: self.status("idle"), "the diagnostics")
        self.assertEqual((OK, False), (idle.level, self.looked_at()))
        for _ in range(2):
            topic = self.topic("/aruco/pose", PoseStamped)
            wait_for(self.looked_at, "a subscription")
            topic.close()
            wait_for(lambda: not self.looked_at(), "the subscription to end")
        detections = self.topic("/aruco/detections", MarkerDetectionArray)
        wait_for(self.looked_at, "a subscription")
        silent = wait_for(lambda: self.status("no messages"), "a status without images")
        self.assertEqual(WARN, silent.level)
        pixels = image_of([marker()], VIEW, samples=4)
        self.stamp = 0.0
        level, _ = self.send_until_said("no camera_info", pixels)
        self.assertEqual(WARN, level)
        level, values = self.send_until_said("id 0 at 2.0", pixels, CAMERA.matrix.ravel().tolist())
        self.assertEqual((OK, "1"), (level, values["detections"]))
        self.assertGreater(float(values["frame rate (Hz)"]), 0.0)
        self.assertGreater(float(values["latency median (ms)"]), 0.0)
        self.send_until_said("the image is flat", np.full((480, 640), 90, np.uint8))
        level, values = self.send_until_said("32FC1", pixels, encoding="32FC1")
        self.assertEqual((ERROR, False), (level, values["refused"] == "0"))
        wait_for(lambda: f"{IMAGE}: refused:" in node.err, "a warning")
        stamps = detections.stamps()
        self.assertEqual(sorted(set(stamps)), stamps)
        node.signal()
        self.assert_ends_well(node)

    def send_until_said(self, words, pixels, matrix=None, encoding="mono8"):
        """Go on sending an image until the diagnostics have some words; return level, values.

        A node that is behind drops images. With a matrix, each has a camera_info before it.
        """

        def said():
            self.stamp += 0.05
            if matrix is not None:
                self.infos.publish(CameraInfo(height=480, width=640, K=matrix))
            header = rospy.Header(0, rospy.Time.from_sec(self.stamp), FRAME)
            message = image_message(header, pixels, "mono8")
            message.encoding = encoding
            self.images.publish(message)
            rospy.rostime.wallsleep(0.05)
            return self.status(words)

        status = wait_for(said, f"'{words}' in the diagnostics")
        return status.level, {value.key: value.value for value in status.values}


if __name__ == "__main__":
    run_tests()
