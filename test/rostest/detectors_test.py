#!/usr/bin/env python3
"""The nodes that see edges and corners: answers, laziness, encodings, refusals."""

import unittest

import cv2
import numpy as np
import rospy
import rostest
from bullet_lab.msg import ImagePoints
from diagnostic_msgs.msg import DiagnosticStatus
from image_testing import FRAME, Diagnosis, FakeCamera, image
from lab_testing import Node, Topic, wait_for
from sensor_msgs.msg import CameraInfo, Image

from bullet_lab.ros.messages.images import pixels_of

CORNERS = ((200, 150), (400, 150), (400, 350), (200, 350))
NODES = {
    "view_camera": ("image_annotated", Image),
    "canny_edges": ("edges", Image),
    "good_features": ("points", ImagePoints),
    "harris_corners": ("points", ImagePoints),
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


class DetectorsTest(unittest.TestCase):
    """Each test has nodes and a camera of its own."""

    def start(self, name, *results, **parameters):
        self.node = Node(f"{name}.py", **parameters)
        self.addCleanup(self.node.end)
        self.camera = FakeCamera()
        self.addCleanup(self.camera.end)
        topics = [self.topic(f"/{name}/{topic}", kind) for topic, kind in results]
        if results:
            self.camera.connect()
        return topics

    def topic(self, name, kind):
        topic = Topic(name, kind)
        self.addCleanup(topic.close)
        return topic

    def test_every_result_has_the_stamp_and_the_frame_of_the_image(self):
        for name, result in NODES.items():
            with self.subTest(name=name):
                results = [result, ("image_annotated", Image), ("camera_info", CameraInfo)]
                topics = self.start(name, *results)
                self.camera.send(1.5, square())
                for topic in topics:
                    header = topic.wait(1)[0].header
                    self.assertEqual(rospy.Time.from_sec(1.5), header.stamp)
                    self.assertEqual(FRAME, header.frame_id)
                self.doCleanups()

    def test_works_only_while_somebody_listens(self):
        for name, (topic, kind) in NODES.items():
            with self.subTest(name=name):
                self.start(name)
                diagnosis = Diagnosis(name)
                self.addCleanup(diagnosis.close)
                diagnosis.wait(DiagnosticStatus.OK, "idle")
                self.assertFalse(self.camera.looked_at())
                listener = self.topic(f"/{name}/{topic}", kind)
                wait_for(self.camera.looked_at, "a subscription")
                listener.close()
                wait_for(lambda: not self.camera.looked_at(), "the subscription to end")
                self.doCleanups()

    def test_edges_are_where_the_square_ends(self):
        (edges,) = self.start("canny_edges", ("edges", Image))
        self.camera.send(1.0, square())
        answer = edges.wait(1)[0]
        self.assertEqual("mono8", answer.encoding)
        seen = pixels_of(answer, "mono8")
        self.assertEqual({0, 255}, set(np.unique(seen)))
        row, column = np.nonzero(seen)
        self.assertEqual(((199, 401), (149, 351)), _extent(column, row, 1))
        self.assertEqual(0, np.count_nonzero(seen[160:340, 210:390]))

    def test_edges_are_drawn_blue(self):
        (drawn,) = self.start("canny_edges", ("image_annotated", Image))
        self.camera.send(1.0, square())
        pixels = pixels_of(drawn.wait(1)[0], "bgr8")
        self.assertTrue((pixels[140:160, 300] == BLUE).all(axis=1).any())
        self.assertEqual([60, 60, 60], pixels[20, 20].tolist())

    def test_corners_are_those_of_the_square(self):
        for name in ("good_features", "harris_corners"):
            with self.subTest(name=name):
                points, drawn = self.start(
                    name, ("points", ImagePoints), ("image_annotated", Image)
                )
                self.camera.send(1.0, square())
                answer = points.wait(1)[0]
                self.assertEqual((640, 480), (answer.width, answer.height))
                self.assertTrue(near(answer.points).all())
                strengths = [p.z for p in answer.points]
                self.assertEqual(sorted(strengths, reverse=True), strengths)
                pixels = pixels_of(drawn.wait(1)[0], "bgr8")
                for u, v in CORNERS:
                    patch = pixels[v - 2 : v + 3, u - 2 : u + 3]
                    self.assertTrue((patch == BLUE).all(axis=2).any(), (u, v))
                self.doCleanups()

    def test_nothing_in_an_even_image(self):
        for name in ("good_features", "harris_corners"):
            with self.subTest(name=name):
                (points,) = self.start(name, ("points", ImagePoints))
                self.camera.send(1.0, np.full((480, 640), 100, np.uint8))
                self.assertEqual([], points.wait(1)[0].points)
                self.doCleanups()

    def test_parameters_count(self):
        cases = (
            ("good_features", "points", {"max_corners": 2}, lambda m: len(m.points) == 2),
            ("harris_corners", "points", {"threshold": 1.0}, lambda m: len(m.points) == 0),
        )
        for name, topic, parameters, holds in cases:
            with self.subTest(name=name):
                (points,) = self.start(name, (topic, ImagePoints), **parameters)
                self.camera.send(1.0, square())
                self.assertTrue(holds(points.wait(1)[0]))
                self.doCleanups()
        (edges,) = self.start("canny_edges", ("edges", Image), low=2000, high=2000)
        self.camera.send(1.0, square())
        self.assertEqual(0, np.count_nonzero(pixels_of(edges.wait(1)[0], "mono8")))

    def test_encodings_that_cameras_have(self):
        (view,) = self.start("view_camera", ("image_annotated", Image))
        colours = np.zeros((480, 640, 3), np.uint8)
        colours[:] = (10, 120, 230)
        cases = {
            "bgr8": colours,
            "rgb8": colours[:, :, ::-1],
            "bgra8": cv2.cvtColor(colours, cv2.COLOR_BGR2BGRA),
            "rgba8": cv2.cvtColor(colours, cv2.COLOR_BGR2RGBA),
        }
        for number, (encoding, pixels) in enumerate(cases.items(), 1):
            self.camera.send(float(number), pixels, encoding)
            seen = pixels_of(view.wait(number)[-1], "bgr8")
            self.assertEqual([10, 120, 230], seen[300, 300].tolist(), encoding)

    def test_images_that_are_none_are_refused(self):
        (points,) = self.start("good_features", ("points", ImagePoints))
        bad = image(1.0, square())
        bad.encoding = "no such"
        short = image(2.0, square())
        short.step = 10
        for message in (bad, short):
            self.camera.images.publish(message)
        rospy.rostime.wallsleep(0.5)
        self.camera.send(3.0, square())
        wait_for(lambda: 3.0 in [m.header.stamp.to_sec() for m in points.messages], "an answer")
        self.assertEqual(1, len(points.messages))
        wait_for(lambda: "refused:" in self.node.err, "a warning")
        self.assertNotIn("Traceback", self.node.err)
        self.node.signal()
        self.assertEqual(0, self.node.wait())

    def test_parameters_that_are_not_allowed(self):
        node = Node("canny_edges.py", low=-1)
        self.addCleanup(node.end)
        self.assertEqual(2, node.wait(), node.err)
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("~low", node.err)


def _extent(column, row, slack):
    """The least and largest column and row, moved to the expected ones if within some pixels."""
    found = ((column.min(), column.max()), (row.min(), row.max()))
    expected = ((199, 401), (149, 351))
    return expected if np.abs(np.subtract(found, expected)).max() <= slack else found


def setUpModule():
    rospy.init_node("detectors_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "detectors_test", "__main__")
