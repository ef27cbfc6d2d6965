#!/usr/bin/env python3
"""The marker detector as a node: when it works, its diagnostics, its transforms."""

import dataclasses
import sys

import numpy as np
import rospy
import rostest
from bullet_lab.msg import MarkerDetectionArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from lab_testing import PACKAGE, NodeTest, wait_for
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

# The exact images of the unit tests.
sys.path.insert(0, str(PACKAGE / "test" / "unit"))
from marker_images import CAMERA, View, image_of, marker  # noqa: E402

from bullet_lab.ros.messages.images import image_message  # noqa: E402

IMAGE, INFO = "/mycamera/image_raw", "/mycamera/camera_info"
FRAME = "camera_optical_frame"
CLOSE = View(1.0, yaw=25.0, shift=(0.35, 0.2))
BENT = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.001, 0.0))
VIEW = View(2.0, yaw=20.0, shift=(0.1, 0.05))
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def info(seconds, camera=CAMERA):
    """The camera_info of a camera."""
    message = CameraInfo(height=camera.height, width=camera.width, distortion_model="plumb_bob")
    message.header.stamp = rospy.Time.from_sec(seconds)
    message.header.frame_id = FRAME
    message.D = list(camera.distortion)
    message.K = camera.matrix.ravel().tolist()
    message.P = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


class FakeCamera:
    """Publishes images and their camera_info."""

    def __init__(self):
        options = {"queue_size": 100, "tcp_nodelay": True}
        self._infos = rospy.Publisher(INFO, CameraInfo, **options)
        self._images = rospy.Publisher(IMAGE, Image, **options)

    def connect(self):
        """Wait until somebody looks."""
        for made in (self._images, self._infos):
            wait_for(lambda made=made: made.get_num_connections() > 0, f"a look at {made.name}")

    def looked_at(self):
        """Whether anybody subscribes to the images."""
        self._images.impl.check()
        return self._images.get_num_connections() > 0

    def send(self, seconds, pixels, about=None, encoding=""):
        """Publish an image, after its camera_info if there is one."""
        if about is not None:
            self._infos.publish(about)
        message = image_message(rospy.Header(frame_id=FRAME), pixels, "mono8")
        message.header.stamp = rospy.Time.from_sec(seconds)
        message.encoding = encoding or message.encoding
        self._images.publish(message)

    def end(self):
        """Stop publishing."""
        self._images.unregister()
        self._infos.unregister()


class ArucoTest(NodeTest):
    """What the node does with its defaults, and one with other parameters."""

    def setUp(self):
        self.camera = FakeCamera()
        self.addCleanup(self.camera.end)

    def status(self, words):
        """The status so far whose message has some words, or None."""
        found = [one for m in self.diagnostics.messages for one in m.status if words in one.message]
        return next((one for one in found if one.name.startswith("aruco:")), None)

    def test_works_only_while_somebody_listens_and_says_how_it_is(self):
        self.diagnostics = self.topic("/diagnostics", DiagnosticArray, connected=False)
        node = self.node("aruco.py")
        idle = wait_for(lambda: self.status("idle"), "the diagnostics")
        self.assertEqual((OK, False), (idle.level, self.camera.looked_at()))
        for _ in range(2):
            topic = self.topic("/aruco/pose", PoseStamped)
            wait_for(self.camera.looked_at, "a subscription")
            topic.close()
            wait_for(lambda: not self.camera.looked_at(), "the subscription to end")
        detections = self.topic("/aruco/detections", MarkerDetectionArray)
        self.camera.connect()
        silent = wait_for(lambda: self.status("no messages"), "a status without images")
        self.assertEqual(WARN, silent.level)
        pixels = image_of([marker()], VIEW, samples=4)
        self.stamp = 0.0
        level, _ = self.send_until_said("no camera_info", pixels)
        self.assertEqual(WARN, level)
        level, values = self.send_until_said("id 0 at 2.0", pixels, info(0.0))
        self.assertEqual((OK, "1"), (level, values["detections"]))
        self.assertGreater(float(values["frame rate (Hz)"]), 0.0)
        self.assertGreater(float(values["latency median (ms)"]), 0.0)
        self.send_until_said("the image is flat", np.full((480, 640), 90, np.uint8))
        level, values = self.send_until_said("32FC1", pixels, encoding="32FC1")
        self.assertEqual((ERROR, False), (level, values["refused"] == "0"))
        wait_for(lambda: f"{IMAGE}: refused:" in node.err, "a warning")
        self.assertTrue(node.runs())
        self.assertNotIn("Traceback", node.err)
        stamps = detections.stamps()
        self.assertEqual(sorted(set(stamps)), stamps)

    def send_until_said(self, words, pixels, *about, **options):
        """Go on sending an image until the diagnostics have some words; return level, values.

        A node that is behind drops images.
        """

        def said():
            self.stamp += 0.05
            self.camera.send(self.stamp, pixels, *about, **options)
            rospy.rostime.wallsleep(0.05)
            return self.status(words)

        status = wait_for(said, f"'{words}' in the diagnostics")
        return status.level, {value.key: value.value for value in status.values}

    def test_transforms_in_lock_step_of_chosen_markers_in_rectified_images_until_ctrl_c(self):
        # Nobody offers the lock step here: the node waits for it, and works all the same.
        choice = {"tags": "4x4_50", "ids": "3 7", "sizes": "7=0.4", "rectified": True}
        panel = "[{name: panel, layout: [{id: 7, size: 0.4, x: 0.1}, {id: 3, size: 0.2}]}]"
        node = self.node("aruco.py", **choice, tag_bundles=panel, publish_tf=True, lock_step=True)
        transforms = self.topic("/tf", TFMessage)
        self.camera.connect()
        pixels = image_of([marker(7, size=0.4, tags="4x4_50")], CLOSE, samples=4)
        self.camera.send(1.0, pixels, info(1.0, BENT))
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
            self.camera.send(stamp, pixels, info(stamp, BENT))
        messages = detections.wait(30)
        np.testing.assert_allclose(stamps, [m.header.stamp.to_sec() for m in messages], atol=1e-9)
        (found,) = messages[-1].detections
        self.assertEqual((7, "DICT_4X4_50", 0.4), (found.id, found.dictionary, found.size))
        place = found.pose.pose.position
        np.testing.assert_allclose([place.x, place.y, place.z], CLOSE.translation, atol=0.005)
        (bundle,) = messages[-1].bundles
        self.assertEqual(("panel", (7,)), (bundle.name, bundle.ids))
        self.camera.send(3.0, image_of([marker(9, tags="4x4_50")], VIEW, samples=4), info(3.0))
        self.assertEqual([], detections.wait(31)[-1].detections)
        node.signal()
        self.assertEqual(0, node.wait(), node.err)
        self.assertNotIn("Traceback", node.err)


if __name__ == "__main__":
    rospy.init_node("aruco_test")
    rostest.rosrun("bullet_lab", "aruco_test", "__main__")
