#!/usr/bin/env python3
"""The main job gives, through ROS, the same files as plain Python, and the published figures."""

import csv
import functools
import json
import math
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rostest
from scipy import stats

from bullet_lab.noise.odometry_noise import ReportRule
from bullet_lab.studies.squares import SquaresSettings, run_squares

sys.path.append(str(Path(__file__).resolve().parents[1] / "unit"))
from recorded_paths import read_paths_csv, recover_noise  # noqa: E402

TIMEOUT = 200
FOLDER = tempfile.TemporaryDirectory()
STD = 0.1
SEED = 1
# Of a statistic that is beyond a two-sided bound at 99.9 %.
TAIL = 0.0005
# Seconds at which an open-loop side begins: after the rest, sides of 10 s and turns of 3.4 s.
SIDE_STARTS = [0.5 + 13.4 * side for side in range(4)]


@functools.lru_cache(maxsize=None)
def run_job(*words):
    """Run a job in a folder of its own; return its output folder."""
    folder = Path(tempfile.mkdtemp(dir=FOLDER.name))
    environment = {k: v for k, v in os.environ.items() if k not in ("ROS_MASTER_URI", "ROS_IP")}
    run = subprocess.run(
        [sys.executable, "-m", "bullet_lab.ros.launcher", *words, "out:=out"],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIMEOUT,
    )
    if run.returncode:
        raise AssertionError(f"{words} ended with status {run.returncode}:\n{run.stdout}")
    return folder / "out"


def squares(*words):
    return run_job("squares", f"std:={STD}", f"seed:={SEED}", *words)


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

    def assert_square(self, out, side, side_within, turn, turn_within):
        summary = summary_of(out)
        self.assertEqual((4, 4), (len(summary["side_lengths_m"]), len(summary["turns_deg"])))
        for length in summary["side_lengths_m"]:
            self.assertAlmostEqual(side, length, delta=side_within)
        for angle in summary["turns_deg"]:
            self.assertAlmostEqual(turn, angle, delta=turn_within)

    def test_open_loop_is_the_same_as_without_ros(self):
        self.assert_same_files(squares())

    def test_closed_loop_is_the_same_as_without_ros(self):
        self.assert_same_files(squares("mode:=closed_loop"), mode="closed_loop")

    def test_as_published_is_the_same_as_without_ros(self):
        self.assert_same_files(squares("as_published:=true"), as_published=True)

    def test_slower_run_is_the_same_too(self):
        self.assert_same_files(squares("rtf:=20"))

    def test_open_loop_drives_the_published_square(self):
        self.assert_square(squares(), 1.90, 0.01, 90.4, 0.5)

    def test_closed_loop_drives_a_true_square(self):
        out = squares("mode:=closed_loop")
        self.assert_square(out, 2.00, 0.01, 90.0, 0.3)
        self.assertLess(summary_of(out)["closure_error_m"], 0.02)

    def test_summary_says_what_was_run_and_how_it_went(self):
        summary = summary_of(squares())
        said = {
            "std": STD,
            "seed": SEED,
            "model": "report",
            "mode": "open_loop",
            "as_published": False,
            "finished": True,
            "refused_messages": 0,
        }
        self.assertEqual(said, {key: summary[key] for key in said})
        self.assertAlmostEqual(4 * 13.4 + 2 * 0.5, summary["sim_time_s"], delta=0.1)
        factor = summary["sim_time_s"] / summary["wall_time_s"]
        self.assertAlmostEqual(factor, summary["real_time_factor"], delta=1e-6 * factor)
        for name in ("final_error_m", "final_heading_error_deg", "ape_rmse_m"):
            self.assertGreater(abs(summary[name]), 0.0)

    def test_odometry_is_whole(self):
        with (squares() / "paths.csv").open() as file:
            stamps = [round(1000 * float(row["stamp"])) for row in csv.DictReader(file)]
        self.assertEqual([stamps[0] + 50 * k for k in range(len(stamps))], stamps)

    def test_residuals_are_standard_normal(self):
        true, noisy = read_paths_csv(squares() / "paths.csv")
        found = recover_noise(true.poses, noisy.poses).standardised(ReportRule(STD)).ravel()
        draws = found[~np.isnan(found)]
        count = len(draws)
        self.assertGreater(count, 1000)
        self.assertLess(abs(draws.mean()), stats.norm.isf(TAIL) / math.sqrt(count))
        squares_sum = float(np.sum(draws**2))
        self.assertLess(stats.chi2.ppf(TAIL, count), squares_sum)
        self.assertLess(squares_sum, stats.chi2.isf(TAIL, count))
        self.assertGreater(stats.kstest(draws, "norm").pvalue, 2 * TAIL)

    def test_noisy_path_leaves_the_true_one_for_good(self):
        true, noisy = read_paths_csv(squares() / "paths.csv")
        apart = np.hypot(*(true.poses - noisy.poses)[:, :2].T)
        self.assertEqual(0.0, apart[0])
        self.assertGreater(apart[-1], 0.05)
        self.assertGreater(apart[len(apart) // 2 :].min(), 0.02)

    def test_as_published_zigzags_on_the_third_side_only(self):
        true, noisy = read_paths_csv(squares("as_published:=true") / "paths.csv")
        errors = (noisy.poses - true.poses)[:, :2]
        across = []
        for side, start in enumerate(SIDE_STARTS):
            # Well within the side, where no corner is cut.
            chosen = (true.stamps > start + 1.5) & (true.stamps < start + 9.5)
            self.assertGreater(chosen.sum(), 5)
            across.append(math.sqrt(np.mean(errors[chosen, 1 - side % 2] ** 2)))
        self.assertGreater(across[2], 0.03)
        self.assertLess(max(across[0], across[1], across[3]), 0.003)
        # It comes back: the published noise does not accumulate.
        self.assertLess(summary_of(squares("as_published:=true"))["final_error_m"], 0.01)

    def test_beacons_are_measured_as_they_stand(self):
        out = run_job("beacons")
        summary = summary_of(out)
        self.assertTrue(summary["finished"])
        self.assertEqual(["beacon_0", "beacon_1", "beacon_2"], summary["beacons"])
        for closest, error in zip(summary["closest_m"], summary["largest_error_m"]):
            self.assertAlmostEqual(1.0, closest, delta=0.005)
            self.assertLess(error, 1e-5)
        with (out / "distances.csv").open() as file:
            stamps = [round(1000 * float(row["stamp"])) for row in csv.DictReader(file)]
        self.assertEqual(summary["rows"], len(stamps))
        self.assertEqual([stamps[0] + 50 * k for k in range(len(stamps))], stamps)
        self.assertTrue((out / "distances.png").is_file())


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "squares_job_test", "__main__")
