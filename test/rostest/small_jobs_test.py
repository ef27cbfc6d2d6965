#!/usr/bin/env python3
"""Short jobs leave what they promise: fleet, save_world, umbmark and vision."""

import math
import unittest

import cv2
import numpy as np
import yaml
from lab_testing import run_job, run_tests

from bullet_lab.core.pose import Pose
from bullet_lab.core.trajectory import read_tum
from bullet_lab.noise.odometry_noise import derived_seed
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.studies.squares import SquaresSettings, run_squares

# Of robots of a fleet, and how much farther from the origin the same numbers are rounded otherwise.
SPACING, ROUNDING = 2.5, 1e-6
PICTURES = {"view_camera", "canny_edges", "good_features", "harris_corners", "aruco"}
# Where the robot's camera is, in its base, and the marker in the world; m.
CAMERA = (0.16, 0.0, 0.44)
MARKER = (4.0, 0.0, 0.5)


def marker_from(x, y, yaw_deg):
    """The marker in the optical frame of a robot at a pose, m."""
    camera = Pose.on_floor(x, y, math.radians(yaw_deg)) * Pose(CAMERA)
    ahead, left, up = (camera.inverse() * Pose(MARKER)).position
    return [-left, -up, ahead]


class JobsTest(unittest.TestCase):
    def test_robots_of_a_fleet_drive_as_if_each_were_alone(self):
        out, _ = run_job("fleet", "n:=3", "seed:=5")
        # The first robot of the fleet starts where that of the squares does.
        plain = out.parent / "plain"
        run_squares(plain, SquaresSettings(seed=derived_seed(5, 0)))
        for name in ("odom.tum", "noisy_odom.tum", "paths.csv"):
            # Not assertEqual, which would print them.
            same = (plain / name).read_bytes() == (out / "robot1" / name).read_bytes()
            self.assertTrue(same, f"{name} differs from that of the squares")
        first = read_tum(plain / "odom.tum")
        for robot, place in (("robot2", (SPACING, 0.0, 0.0)), ("robot3", (0.0, SPACING, 0.0))):
            other = read_tum(out / robot / "odom.tum")
            np.testing.assert_array_equal(first.stamps, other.stamps)
            np.testing.assert_allclose(first.poses + place, other.poses, rtol=0.0, atol=ROUNDING)

    def test_a_circle_of_beacons_is_saved_at_full_speed(self):
        run = run_job("save_world", "count:=7", "rtf:=0")
        world, summary = run.out / "saved.world", run.summary
        # The robot and the floor besides.
        self.assertEqual(9, summary["models"])
        self.assertEqual(str(world), summary["path"])
        self.assertEqual(world.stat().st_size, summary["file_bytes"])
        self.assertGreater(summary["simulated_s"], 0.0)
        self.assertIn("9 models at", run.printed)
        with Simulation.of(str(world)) as simulation:
            places = {name: one.pose().position for name, one in simulation.models.items()}
        for number in range(7):
            x, y, z = places[f"beacon_{number}"]
            self.assertAlmostEqual(3.0, math.hypot(x, y), 9)
            self.assertEqual(0.0, z)

    def test_a_model_that_is_not_there_is_the_end_of_it(self):
        self.assertIn("nothing", run_job("save_world", "model:=model://nothing", status=1).printed)

    def test_wheels_that_are_wrong_are_recovered_and_mended(self):
        words = ("diameter_error:=0.005", "base_error:=-1e-2", "side:=0.5", "runs:=1", "std:=0")
        run = run_job("umbmark", *words)
        out, summary = run.out, run.summary
        self.assertTrue(summary["finished"])
        recovered = summary["recovered"]
        self.assertAlmostEqual(0.005, recovered["diameter_error"], delta=0.05 * 0.005)
        self.assertAlmostEqual(-0.01, recovered["base_error"], delta=0.05 * 0.01)
        self.assertGreater(summary["falls_by"], 10.0)
        # No way was driven twice.
        self.assertIsNone(recovered["intervals_95"])
        self.assertIn("E_max,syst", run.printed)
        corrected = yaml.safe_load((out / "corrected.yaml").read_text())
        left, right = (corrected[f"{side}_wheel_radius_multiplier"] for side in ("left", "right"))
        effective = summary["effective"]
        self.assertAlmostEqual(1.0 + effective["diameter_error"], right / left)
        base = corrected["wheel_separation_multiplier"]
        self.assertAlmostEqual(1.0 + effective["base_error"], base)
        for name, error in summary["floor"].items():
            self.assertLess(abs(error), 1e-3, name)
        self.assertTrue((out / "clusters.png").is_file())
        self.assertTrue((out / "returns.csv").is_file())

    def test_a_picture_and_a_line_for_each_detector_and_the_marker_where_it_hangs(self):
        run = run_job("vision")
        out, summary = run.out, run.summary
        self.assertEqual(PICTURES, set(summary["found"]) - {"marker"})
        for name in PICTURES:
            picture = cv2.imread(str(out / f"{name}.png"))
            self.assertEqual((480, 640, 3), picture.shape, name)
            self.assertGreater(picture.std(), 5.0, name)
            self.assertIn(f"{name}: {summary['found'][name]}", run.printed)
        self.assertGreater(cv2.imread(str(out / "side_by_side.png")).shape[1], 1000)
        (found,) = summary["markers"]
        self.assertEqual((0, "DICT_APRILTAG_36h10"), (found["id"], found["dictionary"]))
        robot = (summary[name] for name in ("x", "y", "yaw_deg"))
        np.testing.assert_allclose(found["position_m"], marker_from(*robot), atol=0.03)
        # It has its contrast where figure 7 shows a white square.
        corners = np.array(found["corners_px"])
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
        picture = cv2.imread(str(out / "view_camera.png"), cv2.IMREAD_GRAYSCALE)
        marker = picture[int(top) : int(bottom) + 2, int(left) : int(right) + 2]
        self.assertGreater(int(marker.max()) - int(marker.min()), 120)
        self.assertLess(marker.max(), 255)


if __name__ == "__main__":
    run_tests(node=False)
