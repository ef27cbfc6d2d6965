#!/usr/bin/env python3
"""The main job gives, through ROS, the same files as plain Python, and the published figures."""

import csv
import functools
import json
import tempfile
import unittest
from pathlib import Path

import rostest
from lab_testing import run_job

from bullet_lab.studies.squares import SquaresSettings, run_squares

FOLDER = tempfile.TemporaryDirectory()
STD = 0.1
SEED = 1
CLOSED_LOOP = ("mode:=closed_loop", "as_published:=true", "rtf:=20")


@functools.lru_cache(maxsize=None)
def run(job, *words, out="out"):
    """Run a job once; return its output folder."""
    return run_job(job, *words, folder=FOLDER.name, out=out)[0]


def squares(*words):
    return run("squares", f"std:={STD}", f"seed:={SEED}", *words)


def summary_of(out):
    return json.loads((out / "summary.json").read_text())


class SquaresJobTest(unittest.TestCase):
    """Jobs are run once for all tests that look at what they leave."""

    def assert_same_files(self, out, **settings):
        plain = Path(tempfile.mkdtemp(dir=FOLDER.name))
        figures = run_squares(plain, SquaresSettings(std=STD, seed=SEED, **settings))
        for name in ("odom.tum", "noisy_odom.tum", "paths.csv", "paths.png"):
            # Not assertEqual, which would print them.
            same = (plain / name).read_bytes() == (out / name).read_bytes()
            self.assertTrue(same, f"{name} differs from that of the plain run")
        self.assertEqual(figures["side_lengths_m"], summary_of(out)["side_lengths_m"])

    def test_open_loop_is_the_same_as_without_ros(self):
        self.assert_same_files(squares())

    def test_closed_loop_as_published_at_another_speed_is_the_same_as_without_ros(self):
        settings = {"mode": "closed_loop", "as_published": True}
        self.assert_same_files(squares(*CLOSED_LOOP), **settings)

    def test_beacons_are_measured_as_they_stand(self):
        out = run("beacons", out="")
        summary = summary_of(out)
        self.assertTrue(summary["finished"])
        self.assertEqual(["beacon_0", "beacon_1", "beacon_2"], summary["beacons"])
        for closest, error in zip(summary["closest_m"], summary["largest_error_m"]):
            self.assertAlmostEqual(1.0, closest, delta=0.005)
            self.assertLess(error, 1e-5)
        with (out / "distances.csv").open() as file:
            stamps = [round(1000 * float(row["stamp"])) for row in csv.DictReader(file)]
        self.assertEqual(summary["rows"], len(stamps))
        self.assertEqual([stamps[0] + 51 * k for k in range(len(stamps))], stamps)
        self.assertTrue((out / "distances.png").is_file())


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "squares_job_test", "__main__")
