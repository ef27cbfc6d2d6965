#!/usr/bin/env python3
"""The grade job marks right, wrong and hostile submissions."""

import csv
import os
import shutil
import subprocess
import tempfile
import unittest
from pathlib import Path

from lab_testing import PACKAGE, run_job, run_tests

SUBMISSIONS = PACKAGE / "test" / "submissions"
FOLDER = tempfile.TemporaryDirectory()
SHORT = """
title: a short one
simulated_limit: 10
processor_limit: 5
output_limit: 100
criteria:
  - {measure: path_error, places: [[1, 0]], at_most: 0.1, points: 5}
  - {measure: exit_status, at_least: 0, at_most: 0, points: 5}
"""
PLACES = "((1, 0), (1, 1), (0, 1), (0, 0))"
GAUSS = "gauss(0.0, 0.1)"
# A right and a wrong submission to each exercise: a program, a text in it, and what replaces it.
RIGHT, WRONG = "right", "wrong"
EXERCISES = {
    "square": ("places", PLACES, (PLACES, "((1, 0), (0, 1), (0, 0))")),
    "wall": ("wall", "DISTANCE = 0.51", ("DISTANCE = 0.51", "DISTANCE = -1.0")),
    "noise": ("noise", GAUSS, (GAUSS, "gauss(0.05, 0.1)")),
    "beacon": ("beacon", "EVERY = 1", ("EVERY = 1", "EVERY = 20")),
    "goal": ("places", PLACES, ("((1, -1.9), (2.6, -1.65))", "((2.6, -1.65),)")),
}
# What the line of a hostile submission says.
WHY = {
    # On a busy machine, few of its messages arrive.
    "floods": "it sent more than 200 messages a second to cmd_vel|it still ran after 10 simulated",
    "forks": "it left processes behind, which were ended",
    "ignores_sigterm": "it still ran after 10 simulated s",
    "kills_grader": "the run ended with status -9 before its end",
    "prints": "it printed more than 100 kB",
}


def marks(out):
    """Return points and reasons by the names of the submissions."""
    with (out / "grades.csv").open() as file:
        return {row["submission"]: row for row in csv.DictReader(file)}


def make_class(exercise):
    """Make a folder of a right and a wrong submission; return it."""
    program, text, texts = EXERCISES[exercise]
    group = Path(FOLDER.name) / exercise
    for name, other in zip((RIGHT, WRONG), texts):
        shutil.copytree(SUBMISSIONS / program, group / name)
        main = group / name / "main.py"
        assert text in main.read_text()
        main.write_text(main.read_text().replace(text, other))
    return group


class GradeJobTest(unittest.TestCase):
    """Each exercise with its submissions, and what goes wrong."""

    def test_right_submissions_get_all_points_and_wrong_ones_do_not(self):
        files = (PACKAGE / "config" / "exercises").glob("*.yaml")
        self.assertEqual({file.stem for file in files}, set(EXERCISES))
        for exercise in EXERCISES:
            with self.subTest(exercise):
                words = (f"exercise:={exercise}", f"class:={make_class(exercise)}")
                out, printed = run_job("grade", *words)
                found = marks(out)
                self.assertEqual("10.0", found[RIGHT]["points"], printed)
                self.assertLess(float(found[WRONG]["points"]), 9.0, printed)

    def test_hostile_submissions_are_marks_and_leave_nothing(self):
        exercise = Path(FOLDER.name) / "short.yaml"
        exercise.write_text(SHORT)
        group = Path(FOLDER.name) / "class"
        for name in WHY:
            shutil.copytree(SUBMISSIONS / "hostile" / name, group / name)
        (group / "empty").mkdir()
        words = (f"exercise:={exercise}", f"class:={group}")
        out, printed = run_job("grade", *words)
        found = marks(out)
        for name, why in WHY.items():
            self.assertRegex(found[name]["why"], f"^({why})", printed)
            self.assertEqual(5.0 * (name == "forks"), float(found[name]["points"]), name)
        self.assertIn("one is needed", found["empty"]["why"])
        names = set(os.listdir(out / "forks"))
        self.assertEqual({"grade.json", "grade.png", "grade.xml", "output.txt"}, names)
        # Nothing of them is left.
        command = ["pgrep", "-f", "sleep 9876"]
        self.assertEqual(1, subprocess.run(command, stdout=subprocess.DEVNULL).returncode)


if __name__ == "__main__":
    run_tests(node=False)
