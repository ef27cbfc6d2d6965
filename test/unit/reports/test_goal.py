import math

import numpy as np
import pytest

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports.goal import GoalRecord, goal_figure, goal_figures, greatest_speed, title_of

STAMPS = np.arange(0.0, 5.0, 0.5)
# 0.2 m/s along x up to 0.6 m.
PATH = Trajectory(STAMPS, [[min(0.2 * t, 0.6), 0.0, 0.1] for t in STAMPS])


def test_figures_are_those_of_the_robot_at_rest():
    figures = goal_figures(GoalRecord((0.64, 0.03, 0.0), 1.0, 3.0, True, "there"), PATH)
    assert figures["reached"]
    assert figures["distance_m"] == pytest.approx(0.05)
    assert figures["yaw_error_deg"] == pytest.approx(math.degrees(0.1))
    assert (figures["seconds"], figures["message"]) == (2.0, "there")
    assert figures["driven_m"] == pytest.approx(0.4)
    assert "at the goal after 2.0 s and 0.40 m: 5.0 cm" in title_of([figures])


def test_a_goal_that_is_still_driven_to():
    figures = goal_figures(GoalRecord((5.0, 0.0, 0.0), 1.0), PATH)
    assert (figures["reached"], figures["seconds"]) == (False, None)
    assert title_of([figures]) == "the goal was not reached: not finished"
    assert goal_figures(GoalRecord((5.0, 0.0, 0.0), 1.0, 2.0), None)["distance_m"] is None


def test_titles():
    done, lost = {"reached": True}, {"reached": False}
    assert title_of([]) == "no goal was given"
    assert title_of([done, lost, done]) == "2 of 3 goals reached"


def test_speed():
    assert greatest_speed(PATH) == pytest.approx(0.2)
    assert greatest_speed(Trajectory([0.0], [[0.0, 0.0, 0.0]])) == 0.0


def test_the_picture_draws_anything():
    goals = [GoalRecord((0.6, 0.0, 0.0), 0.0, 3.0, True), GoalRecord((2.0, 1.0, 1.0), 3.0)]
    figure = goal_figure(PATH, goals, [("beacon_0", 1.0, 1.0), ("far", 90.0, 0.0)], 0.05, "t")
    way = figure.axes[0]
    assert way.get_xlim()[1] < 5.0
    assert len(way.patches) == 4
    goal_figure(None, [], [], 0.05, "nothing")
