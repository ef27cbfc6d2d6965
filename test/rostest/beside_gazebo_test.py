#!/usr/bin/env python3
"""Scenarios through ROS give the figures that they give without it."""

import json
import sys

from lab_testing import PACKAGE, NodeTest, Process, run_tests

PROGRAM = PACKAGE / "test" / "gazebo" / "beside_gazebo.py"
# One for each thing that a stage does.
SCENARIOS = "push_1N_aside,turn_damping,pendulum_damping,set_model_state,rear_caster@45"


class BesideGazeboTest(NodeTest):
    def recorded(self, *words):
        """Return the figures of the scenarios."""
        path = self.new_folder() / "figures.json"
        options = ("--out", str(path.parent), "--only", SCENARIOS, "--record", str(path))
        run = Process(sys.executable, str(PROGRAM), *options, *words)
        self.assertIn(run.wait(), (0, 1), run.said)
        return json.loads(path.read_text())["scenarios"]

    def test_ros_changes_no_figure(self):
        direct, through_ros = self.recorded("--direct"), self.recorded()
        self.assertEqual(set(SCENARIOS.split(",")), set(direct))
        self.assertEqual(direct, through_ros)


if __name__ == "__main__":
    run_tests(node=False)
