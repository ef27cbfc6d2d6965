#!/usr/bin/env python3
"""The save_world job leaves a world that loads again as it was."""

import json
import math
import tempfile
import unittest

import rostest
from lab_testing import run_job

from bullet_lab.simulation.simulation import Simulation

FOLDER = tempfile.TemporaryDirectory()


class SaveWorldJobTest(unittest.TestCase):
    """A circle of beacons."""

    def run_job(self, *words):
        out, printed = run_job("save_world", *words, folder=FOLDER.name)
        return out / "saved.world", json.loads((out / "summary.json").read_text()), printed

    def test_a_circle_of_beacons_at_full_speed(self):
        world, summary, printed = self.run_job("count:=7", "rtf:=0")
        # The robot and the floor besides.
        self.assertEqual(9, summary["models"])
        self.assertEqual(str(world), summary["path"])
        self.assertEqual(world.stat().st_size, summary["file_bytes"])
        self.assertGreater(summary["simulated_s"], 0.0)
        self.assertIn("9 models at", printed)
        with Simulation.of(str(world)) as simulation:
            places = {
                name: instance.pose().position
                for name, instance in simulation.models.items()
                if name.startswith("beacon")
            }
        self.assertEqual({f"beacon_{k}" for k in range(7)}, set(places))
        for x, y, z in places.values():
            self.assertAlmostEqual(3.0, math.hypot(x, y), 9)
            self.assertEqual(0.0, z)

    def test_a_model_that_is_not_there_is_the_end_of_it(self):
        _, printed = run_job("save_world", "model:=model://nothing", folder=FOLDER.name, status=1)
        self.assertIn("nothing", printed)


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "save_world_job_test", "__main__")
