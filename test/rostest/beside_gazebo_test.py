#!/usr/bin/env python3
"""Scenarios through ROS give the figures that they give without it."""

import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import rostest
from lab_testing import PACKAGE, PATIENCE

PROGRAM = PACKAGE / "test" / "gazebo" / "beside_gazebo.py"
# One for each thing that a stage does.
SCENARIOS = "push_1N_aside,turn_damping,pendulum_damping,set_model_state,rear_caster@45"


class BesideGazeboTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def recorded(self, name, *words):
        """Return the figures of the scenarios."""
        path = self.folder / name
        options = ("--out", str(self.folder), "--only", SCENARIOS, "--record", str(path))
        run = subprocess.run(
            [sys.executable, str(PROGRAM), *options, *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=PATIENCE,
        )
        self.assertIn(run.returncode, (0, 1), run.stdout)
        return json.loads(path.read_text())["scenarios"]

    def test_ros_changes_no_figure(self):
        direct, through_ros = self.recorded("direct.json", "--direct"), self.recorded("ros.json")
        self.assertEqual(set(SCENARIOS.split(",")), set(direct))
        self.assertEqual(direct, through_ros)


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "beside_gazebo_test", "__main__")
