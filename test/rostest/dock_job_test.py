#!/usr/bin/env python3
"""The dock job: through ROS, the same each time, and a name for each failure."""

import math
import unittest

from lab_testing import run_job, run_tests

from bullet_lab.core.trajectory import read_tum
from bullet_lab.docking.database import DockUncertainty, drawn_error

# To be quick; farther starts, such as the job's own, are in test/long.
NEAR = ("x:=1.6", "y:=0.1")


class DockJobTest(unittest.TestCase):
    """Other worlds and robots are in test/long."""

    def test_docks_says_how_and_does_the_same_again(self):
        run = run_job("dock", *NEAR)
        out, summary = run.out, run.summary
        self.assertTrue(summary["docked"], summary["message"])
        self.assertEqual((0, "NONE"), (summary["error_code"], summary["error_name"]))
        self.assertEqual((0, {}), (summary["wall_contacts"], summary["touched"]))
        for name, most in summary["tolerances"].items():
            self.assertLess(abs(summary[name]), most, name)
        path = read_tum(out / "truth.tum")
        self.assertAlmostEqual(3.44, path.poses[-1, 0], delta=0.005)
        self.assertAlmostEqual(0.0, path.poses[-1, 1], delta=0.003)
        said = {"job": "dock", "seed": 1, "world": "docking", "odom": "odom", "finished": True}
        self.assertEqual(said, {key: summary[key] for key in said})
        # The robot was told a wrong pose, by what the seed says.
        error = drawn_error(DockUncertainty(0.3, math.radians(10.0)), 1.0, 1)
        names = ("database_error_x_m", "database_error_y_m", "database_error_yaw_deg")
        self.assertEqual([*error[:2], math.degrees(error[2])], [summary[name] for name in names])
        self.assertAlmostEqual(path.stamps[-1] - path.stamps[0], summary["sim_time_s"])
        self.assertAlmostEqual(1.6, path.poses[0, 0], delta=0.001)
        self.assertGreater(summary["images"], 20)
        for name in ("path.png", "camera.png"):
            self.assertTrue((out / name).read_bytes().startswith(b"\x89PNG"), name)
        again = run_job("dock", *NEAR, "seed:=1")
        same = (out / "truth.tum").read_bytes() == (again.out / "truth.tum").read_bytes()
        # Not assertEqual, which would print them.
        self.assertTrue(same, "truth.tum differs")

    def test_a_start_inside_of_a_wall(self):
        # It comes out of the wall, and docks, but not without a contact.
        summary = run_job("dock", "x:=2.8", "y:=0.45", status=1).summary
        self.assertFalse(summary["docked"])
        self.assertEqual("NONE", summary["error_name"])
        self.assertGreater(summary["wall_contacts"], 0)


if __name__ == "__main__":
    run_tests(node=False)
