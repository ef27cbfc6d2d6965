#!/usr/bin/env python3
"""The dock job: through ROS, the same each time, and a name for each failure."""

import functools
import json
import tempfile
import unittest

import rostest
from lab_testing import run_job

from bullet_lab.core.trajectory import read_tum

TIMEOUT = 240
FOLDER = tempfile.TemporaryDirectory()
# m, m and degrees: what section 6 of the figures allows at most.
LARGEST = {"distance_error_m": 0.02, "lateral_error_m": 0.01, "yaw_error_deg": 1.0}

# To be quick; farther starts, such as the job's own, are in test/long.
NEAR = ("x:=1.6", "y:=0.1")


@functools.lru_cache(maxsize=None)
def dock(*words, status=0):
    """Run the job in a folder of its own; return its output folder."""
    return run_job("dock", *words, folder=FOLDER.name, status=status, timeout=TIMEOUT)[0]


def summary_of(out):
    return json.loads((out / "summary.json").read_text())


class DockJobTest(unittest.TestCase):
    """Other worlds are in test/long."""

    def assert_docked(self, out):
        summary = summary_of(out)
        self.assertTrue(summary["docked"], summary["message"])
        self.assertEqual((0, "NONE"), (summary["error_code"], summary["error_name"]))
        self.assertEqual((0, {}), (summary["wall_contacts"], summary["touched"]))
        for name, most in LARGEST.items():
            self.assertLess(abs(summary[name]), most, name)
        end = read_tum(out / "truth.tum").poses[-1]
        self.assertAlmostEqual(3.44, end[0], delta=0.02)
        self.assertAlmostEqual(0.0, end[1], delta=0.01)

    def test_docks_and_says_how(self):
        out = dock(*NEAR)
        self.assert_docked(out)
        summary = summary_of(out)
        said = {"job": "dock", "seed": 1, "world": "docking", "odom": "odom", "finished": True}
        self.assertEqual(said, {key: summary[key] for key in said})
        path = read_tum(out / "truth.tum")
        self.assertAlmostEqual(path.stamps[-1] - path.stamps[0], summary["sim_time_s"])
        self.assertAlmostEqual(1.6, path.poses[0, 0], delta=0.001)
        self.assertGreater(summary["images"], 20)
        for name in ("path.png", "camera.png"):
            self.assertTrue((out / name).read_bytes().startswith(b"\x89PNG"), name)

    def test_the_same_seed_gives_the_same_path(self):
        again = dock(*NEAR, "seed:=1")
        same = (dock(*NEAR) / "truth.tum").read_bytes() == (again / "truth.tum").read_bytes()
        # Not assertEqual, which would print them.
        self.assertTrue(same, "truth.tum differs")

    def test_a_start_inside_of_a_wall(self):
        summary = summary_of(dock("x:=2.8", "y:=0.45", status=1))
        self.assertFalse(summary["docked"])
        self.assertNotIn(summary["error_name"], ("NONE", "UNKNOWN"))
        self.assertGreater(summary["error_code"], 900)
        self.assertGreater(summary["wall_contacts"], 0)


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "dock_job_test", "__main__")
