#!/usr/bin/env python3
"""The vision job leaves a picture for each detector, and the marker is where it hangs."""

import json
import math
import tempfile
import unittest

import cv2
import numpy as np
import rostest
from lab_testing import run_job

from bullet_lab.core.pose import Pose

FOLDER = tempfile.TemporaryDirectory()
PICTURES = {"view_camera", "canny_edges", "good_features", "harris_corners", "aruco"}
# Where the robot's camera is, in its base, and the marker in the world; m.
CAMERA = (0.16, 0.0, 0.44)
MARKER = (4.0, 0.0, 0.5)


def marker_from(x, y, yaw_deg):
    """The marker in the optical frame of a robot at a pose, m."""
    camera = Pose.on_floor(x, y, math.radians(yaw_deg)) * Pose(CAMERA)
    ahead, left, up = (camera.inverse() * Pose(MARKER)).position
    return [-left, -up, ahead]


class VisionJobTest(unittest.TestCase):
    """One run, as in figure 7."""

    @classmethod
    def setUpClass(cls):
        cls.out, cls.printed = run_job("vision", folder=FOLDER.name)
        cls.summary = json.loads((cls.out / "summary.json").read_text())

    def test_a_picture_and_a_line_for_each_detector(self):
        self.assertEqual(PICTURES, set(self.summary["found"]) - {"marker"})
        for name in PICTURES:
            picture = cv2.imread(str(self.out / f"{name}.png"))
            self.assertEqual((480, 640, 3), picture.shape, name)
            self.assertGreater(picture.std(), 5.0, name)
            self.assertIn(f"{name}: {self.summary['found'][name]}", self.printed)
        self.assertGreater(cv2.imread(str(self.out / "side_by_side.png")).shape[1], 1000)

    def test_the_marker_is_where_it_hangs(self):
        (found,) = self.summary["markers"]
        self.assertEqual((0, "DICT_APRILTAG_36h10"), (found["id"], found["dictionary"]))
        robot = (self.summary[name] for name in ("x", "y", "yaw_deg"))
        np.testing.assert_allclose(found["position_m"], marker_from(*robot), atol=0.03)

    def test_the_marker_has_its_contrast_where_figure_7_shows_a_white_square(self):
        corners = np.array(self.summary["markers"][0]["corners_px"])
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
        picture = cv2.imread(str(self.out / "view_camera.png"), cv2.IMREAD_GRAYSCALE)
        marker = picture[int(top) : int(bottom) + 2, int(left) : int(right) + 2]
        self.assertGreater(int(marker.max()) - int(marker.min()), 120)
        self.assertLess(marker.max(), 255)


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "vision_job_test", "__main__")
