#!/usr/bin/env python3
"""The umbmark job finds what is wrong about the wheels of the camera robot, and mends it."""

import json
import tempfile
import unittest

import rostest
import yaml
from lab_testing import run_job

FOLDER = tempfile.TemporaryDirectory()


class UmbmarkJobTest(unittest.TestCase):
    """One run of small squares."""

    def test_injected_errors_are_recovered_and_mended(self):
        words = ("diameter_error:=0.005", "base_error:=-1e-2", "side:=0.5", "runs:=1", "std:=0")
        out, printed = run_job("umbmark", *words, folder=FOLDER.name)
        summary = json.loads((out / "summary.json").read_text())
        self.assertTrue(summary["finished"])
        recovered = summary["recovered"]
        self.assertAlmostEqual(0.005, recovered["diameter_error"], delta=0.05 * 0.005)
        self.assertAlmostEqual(-0.01, recovered["base_error"], delta=0.05 * 0.01)
        self.assertGreater(summary["falls_by"], 10.0)
        # No way was driven twice.
        self.assertIsNone(recovered["intervals_95"])
        self.assertIn("E_max,syst", printed)
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


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "umbmark_job_test", "__main__")
