#!/usr/bin/env python3
"""The goal job ends at the goal, with either robot, alone or on a map."""

import math
import unittest

from lab_testing import run_job, run_tests

from bullet_lab.core.trajectory import read_tum


class GoalJobTest(unittest.TestCase):
    """Short ways, so that it does not take long."""

    def test_the_robot_stops_at_the_goal(self):
        run = run_job("goal", "x:=0.5", "y:=-0.3", "yaw:=90")
        summary = run.summary
        self.assertTrue(summary["finished"])
        (goal,) = summary["goals"]
        self.assertTrue(goal["reached"], goal)
        self.assertLess(goal["distance_m"], 0.05)
        self.assertLess(abs(goal["yaw_error_deg"]), 3.0)
        self.assertLessEqual(summary["greatest_speed_mps"], 0.2)
        path = read_tum(run.out / "truth.tum")
        self.assertLess(math.dist(path.poses[-1][:2], (0.5, -0.3)), 0.05)
        self.assertTrue((run.out / "path.png").is_file())

    def test_the_camera_robot_by_noisy_odometry_without_heading(self):
        words = ("x:=-0.4", "y:=0.2", "robot:=camera_robot", "odom:=noisy_odom", "heading:=false")
        (goal,) = run_job("goal", *words).summary["goals"]
        self.assertTrue(goal["reached"], goal)
        # The noise is 0.1 m per metre.
        self.assertLess(goal["distance_m"], 0.2)

    def test_goals_that_are_drawn_on_the_map_of_the_house_with_a_box_in_the_way(self):
        run = run_job("goal", "world:=house", "goals:=2", "seed:=3")
        summary = run.summary
        self.assertEqual((summary["reached"], summary["contacts"]), (2, 0))
        self.assertEqual([g["box_in_the_way"] for g in summary["goals"]], [False, True])
        straight, around = (goal["over_shortest"] for goal in summary["goals"])
        self.assertTrue(0.95 < straight < 1.05 < around, (straight, around))
        self.assertTrue((run.out / "path.png").is_file())


if __name__ == "__main__":
    run_tests(node=False)
