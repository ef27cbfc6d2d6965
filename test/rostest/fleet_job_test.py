#!/usr/bin/env python3
"""The job fleet leaves the paths of all robots, each driven as if it were alone."""

import tempfile
import unittest
from pathlib import Path

import numpy as np
import rostest
from lab_testing import run_job

from bullet_lab.core.trajectory import read_tum
from bullet_lab.noise.odometry_noise import derived_seed
from bullet_lab.studies.squares import SquaresSettings, run_squares

ROBOTS = 3
SEED = 5
SPACING = 2.5
# How much farther from the origin the same numbers are rounded differently.
ROUNDING = 1e-6


class FleetJobTest(unittest.TestCase):
    """The job is run once for all tests that look at what it leaves."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.plain = Path(cls.folder.name) / "plain"
        words = (f"n:={ROBOTS}", f"seed:={SEED}")
        cls.out, _ = run_job("fleet", *words, folder=cls.folder.name)
        # The first robot of the fleet starts where that of the squares does.
        run_squares(cls.plain, SquaresSettings(seed=derived_seed(SEED, 0)))

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def path(self, robot, name="odom"):
        return read_tum(self.out / f"robot{robot}" / f"{name}.tum")

    def test_first_robot_drives_as_if_it_were_alone(self):
        for name in ("odom.tum", "noisy_odom.tum", "paths.csv"):
            # Not assertEqual, which would print them.
            same = (self.plain / name).read_bytes() == (self.out / "robot1" / name).read_bytes()
            self.assertTrue(same, f"{name} differs from that of the squares")

    def test_all_drive_the_same_square_side_by_side(self):
        first = self.path(1)
        for robot, place in ((2, (SPACING, 0.0)), (3, (0.0, SPACING))):
            other = self.path(robot)
            np.testing.assert_array_equal(first.stamps, other.stamps)
            np.testing.assert_allclose(
                first.poses + (*place, 0.0), other.poses, rtol=0.0, atol=ROUNDING
            )


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "fleet_job_test", "__main__")
