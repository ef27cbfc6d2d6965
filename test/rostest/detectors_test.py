#!/usr/bin/env python3
"""The nodes that see edges and corners: their answers, encodings and parameters."""


import cv2
import numpy as np
import rospy
import rostest
from bullet_lab.msg import ImagePoints
from image_testing import FRAME, ImageNodeTest, image
from lab_testing import Node, wait_for
from sensor_msgs.msg import CameraInfo, Image

from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.nodes.features import (
    CannyEdges,
    CannyParameters,
    GoodFeatures,
    GoodFeaturesParameters,
    HarrisCorners,
    HarrisParameters,
)
from bullet_lab.ros.nodes.image_node import CameraImage

CORNERS = ((200, 150), (400, 150), (400, 350), (200, 350))
NODES = {
    "view_camera": {"image_annotated": Image, "camera_info": CameraInfo},
    "canny_edges": {"edges": Image, "image_annotated": Image},
    "good_features": {"points": ImagePoints, "image_annotated": Image},
    "harris_corners": {"points": ImagePoints, "image_annotated": Image},
}
BLUE = (255, 0, 0)


def square():
    """A white square on dark ground, with its corners at CORNERS."""
    pixels = np.full((480, 640), 60, np.uint8)
    pixels[150:351, 200:401] = 220
    return pixels


def near(points, places=CORNERS, within=3.0):
    """Which of some places have a point near them."""
    found = np.array([[p.x, p.y] for p in points]).reshape(-1, 1, 2)
    distance = np.linalg.norm(found - np.array(places, dtype=float), axis=2)
    return (distance < within).any(axis=0)


class DetectorsTest(ImageNodeTest):
    """All tests share a node of each kind, which works while it is listened to."""

    @classmethod
    def setUpClass(cls):
        cls.nodes = {name: Node(f"{name}.py") for name in NODES}

    @classmethod
    def tearDownClass(cls):
        for node in cls.nodes.values():
            node.end()

    def look(self, name):
        """Return a camera at which a node looks, and the topics of its results."""
        camera = self.camera()
        topics = [self.topic(f"/{name}/{topic}", kind) for topic, kind in NODES[name].items()]
        camera.connect()
        return (camera, *topics)

    def results(self, name):
        """Return a node's results of the square."""
        camera, *topics = self.look(name)
        camera.send(1.5, square())
        messages = [topic.wait(1)[0] for topic in topics]
        for message in messages:
            self.assertEqual(rospy.Time.from_sec(1.5), message.header.stamp)
            self.assertEqual(FRAME, message.header.frame_id)
        return messages

    def test_edges_are_where_the_square_ends_and_blue(self):
        answer, drawn = self.results("canny_edges")
        self.assertEqual("mono8", answer.encoding)
        seen = pixels_of(answer, "mono8")
        self.assertEqual({0, 255}, set(np.unique(seen)))
        row, column = np.nonzero(seen)
        found = (column.min(), column.max(), row.min(), row.max())
        np.testing.assert_allclose(found, (199, 401, 149, 351), atol=1)
        self.assertEqual(0, np.count_nonzero(seen[160:340, 210:390]))
        pixels = pixels_of(drawn, "bgr8")
        self.assertTrue((pixels[140:160, 300] == BLUE).all(axis=1).any())
        self.assertEqual([60, 60, 60], pixels[20, 20].tolist())

    def test_corners_are_those_of_the_square_and_blue(self):
        for name in ("good_features", "harris_corners"):
            with self.subTest(name=name):
                answer, drawn = self.results(name)
                self.assertEqual((640, 480), (answer.width, answer.height))
                self.assertTrue(near(answer.points).all())
                strengths = [p.z for p in answer.points]
                self.assertEqual(sorted(strengths, reverse=True), strengths)
                pixels = pixels_of(drawn, "bgr8")
                for u, v in CORNERS:
                    patch = pixels[v - 2 : v + 3, u - 2 : u + 3]
                    self.assertTrue((patch == BLUE).all(axis=2).any(), (u, v))
                self.doCleanups()

    def test_parameters_count(self):
        seen = CameraImage(image(1.0, square()), None)
        canny = CannyEdges(CannyParameters(low=2000.0, high=2000.0))
        self.assertEqual({"edge pixels": 0}, canny.process(seen))
        good = GoodFeatures(GoodFeaturesParameters(max_corners=2))
        self.assertEqual({"features": 2}, good.process(seen))
        harris = HarrisCorners(HarrisParameters(threshold=1.0))
        self.assertEqual([0], list(harris.process(seen).values()))

    def test_encodings_that_cameras_have(self):
        camera, view, _ = self.look("view_camera")
        colours = np.zeros((480, 640, 3), np.uint8)
        colours[:] = (10, 120, 230)
        cases = {
            "bgr8": colours,
            "rgb8": colours[:, :, ::-1],
            "bgra8": cv2.cvtColor(colours, cv2.COLOR_BGR2BGRA),
            "rgba8": cv2.cvtColor(colours, cv2.COLOR_BGR2RGBA),
        }
        for number, (encoding, pixels) in enumerate(cases.items(), 1):
            camera.send(float(number), pixels, encoding)
            seen = pixels_of(view.wait(number)[-1], "bgr8")
            self.assertEqual([10, 120, 230], seen[300, 300].tolist(), encoding)

    def test_images_that_are_none_are_refused(self):
        camera, points, _ = self.look("good_features")
        bad = image(1.0, square())
        bad.encoding = "no such"
        camera.images.publish(bad)
        node = self.nodes["good_features"]
        wait_for(lambda: "refused:" in node.err, "a warning")
        camera.send(3.0, square())
        self.assertEqual([rospy.Time(3)], [m.header.stamp for m in points.wait(1)])
        self.assertNotIn("Traceback", node.err)


def setUpModule():
    rospy.init_node("detectors_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "detectors_test", "__main__")
