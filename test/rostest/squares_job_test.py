#!/usr/bin/env python3
"""The main job gives, through ROS, the same files as plain Python, and the published figures."""

import csv
import unittest

from lab_testing import run_job, run_tests

from bullet_lab.studies.squares import SquaresSettings, run_squares

STD = 0.1
SEED = 1
CLOSED_LOOP = ("mode:=closed_loop", "as_published:=true", "rtf:=20")


def squares(*words):
    return run_job("squares", f"std:={STD}", f"seed:={SEED}", *words)


class SquaresJobTest(unittest.TestCase):
    """A run for each test."""

    def assert_same_files(self, run, **settings):
        plain = run.out.parent / "plain"
        figures = run_squares(plain, SquaresSettings(std=STD, seed=SEED, **settings))
        for name in ("odom.tum", "noisy_odom.tum", "paths.csv", "paths.png"):
            # Not assertEqual, which would print them.
            same = (plain / name).read_bytes() == (run.out / name).read_bytes()
            self.assertTrue(same, f"{name} differs from that of the plain run")
        self.assertEqual(figures["side_lengths_m"], run.summary["side_lengths_m"])

    def test_open_loop_is_the_same_as_without_ros(self):
        self.assert_same_files(squares())

    def test_closed_loop_as_published_at_another_speed_is_the_same_as_without_ros(self):
        settings = {"mode": "closed_loop", "as_published": True}
        self.assert_same_files(squares(*CLOSED_LOOP), **settings)

    def test_beacons_are_measured_as_they_stand(self):
        run = run_job("beacons", out="")
        summary = run.summary
        self.assertTrue(summary["finished"])
        self.assertEqual(["beacon_0", "beacon_1", "beacon_2"], summary["beacons"])
        for closest, error in zip(summary["closest_m"], summary["largest_error_m"]):
            self.assertAlmostEqual(1.0, closest, delta=0.005)
            self.assertLess(error, 1e-5)
        with (run.out / "distances.csv").open() as file:
            stamps = [round(1000 * float(row["stamp"])) for row in csv.DictReader(file)]
        self.assertEqual(summary["rows"], len(stamps))
        self.assertEqual([stamps[0] + 51 * k for k in range(len(stamps))], stamps)
        self.assertTrue((run.out / "distances.png").is_file())


if __name__ == "__main__":
    run_tests(node=False)
