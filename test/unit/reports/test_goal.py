import math

import numpy as np
import pytest
from shared import cases

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports import Reading
from bullet_lab.reports.goal import (
    GoalAnswer,
    GoalRecord,
    GoalReport,
    goal_figures,
    title_of,
)

MS = 1_000_000
STAMPS = np.arange(0.0, 5.0, 0.5)
# 0.2 m/s along x up to 0.6 m.
PATH = Trajectory(STAMPS, [[min(0.2 * t, 0.6), 0.0, 0.1] for t in STAMPS])


def test_figures_are_those_of_the_robot_at_rest():
    figures = goal_figures(GoalRecord((0.64, 0.03, 0.0), 1.0, 3.0, True, "there"), PATH)
    assert (figures["reached"], figures["message"]) == (True, "there")
    names = ("distance_m", "yaw_error_deg", "seconds", "driven_m")
    expected = (0.05, math.degrees(0.1), 2.0, 0.4)
    assert [figures[name] for name in names] == pytest.approx(expected)
    assert "at the goal after 2.0 s and 0.40 m: 5.0 cm" in title_of([figures])
    driving = goal_figures(GoalRecord((5.0, 0.0, 0.0), 1.0), PATH)
    assert (driving["reached"], driving["seconds"]) == (False, None)
    assert title_of([driving]) == "the goal was not reached: not finished"
    assert title_of([figures, driving]) == "1 of 2 goals reached"


def test_the_picture_leaves_out_what_is_far(tmp_path):
    report = GoalReport(tmp_path, 0.05, False, lambda: [("a", 1.0, 1.0), ("far", 90.0, 0.0)])
    report.figures(report.summary(False, {}))
    drive(report, True)
    goal(report, 2100, 2.0, 1.0, 1.0)
    answer(report, "b", "driving")
    plan = report.figures(report.summary(True, {}))["path.png"].axes[0]
    assert plan.get_xlim()[1] < 5.0
    assert len(plan.patches) == 4


def answer(report, *words, **more):
    report.take("drive_to_goal/status", Reading(0, (), GoalAnswer(*words, **more)))


def goal(report, ms, *pose):
    report.take("drive_to_goal/current_goal", Reading(ms * MS, pose))


def finished(report, ms):
    report.take("drive_to_goal/finished", Reading(ms * MS))


def drive(report, reached):
    """Send what comes of a goal at 0.7 s that is given up or reached at 2 s."""
    goal(report, 700, 0.3, 0.0, 0.0)
    answer(report, "a", "driving")
    for k in range(100):
        report.take("odom", Reading(50 * k * MS, (0.005 * k, 0.0, 0.0)))
        if k == 40:
            answer(report, "a", "the end", reached=reached, over=True)
            finished(report, 2000)


@cases("reached: [true, false]")
@cases("stay: [true, false]")
def test_a_goal_is_recorded_until_the_robot_stands(tmp_path, reached, stay):
    report = GoalReport(tmp_path, 0.05, stay, lambda: [("beacon_0", 1.0, 1.0)])
    drive(report, reached)
    assert report.is_answered()
    assert report.is_complete() != stay
    report.finish(report.until)
    summary = report.summary(True, {})
    (found,) = summary["goals"]
    assert (found["reached"], found["seconds"]) == (reached, 1.3)
    assert summary["greatest_speed_mps"] == pytest.approx(0.1)
    assert report.has_failed(summary) == (not stay and not reached)
    rows = (tmp_path / "truth.tum").read_text().splitlines()
    assert rows[0].startswith("0.500000000 ")
    assert rows[-1].startswith("4.950000000 " if stay else "3.000000000 ")


def test_how_it_ended_may_come_after_all_else(tmp_path):
    report = GoalReport(tmp_path, 0.05, False, list)
    answer(report, "a", "driving")
    finished(report, 1000)
    for k in range(50):
        report.take("odom", Reading(50 * k * MS, (0.0, 0.0, 0.0)))
    assert not report.is_complete()
    answer(report, "a", "there", reached=True, over=True)
    assert not report.is_complete()
    goal(report, 500, 0.0, 0.0, 0.0)
    assert report.is_complete()
    assert not report.has_failed(report.summary(True, {}))


def test_a_goal_that_was_taken_up_but_never_driven_to_is_no_drive(tmp_path):
    report = GoalReport(tmp_path, 0.05, True, list)
    for name, text, rejected in (("a", "pending", False), ("a", "no way", True), ("b", "", False)):
        answer(report, name, text, rejected)
    goal(report, 1000, 1.0, 0.0, 0.0)
    finished(report, 2000)
    answer(report, "b", "there", reached=True)
    summary = report.summary(True, {})
    assert summary["refused_goals"] == ["no way"]
    assert [found["reached"] for found in summary["goals"]] == [True]


def test_a_goal_that_is_refused_is_the_end(tmp_path):
    report = GoalReport(tmp_path, 0.05, False, list)
    answer(report, "a", "refused", rejected=True)
    assert report.is_complete()
    summary = report.summary(True, {})
    assert (report.line(summary), report.has_failed(summary)) == ("refused", True)
    assert summary["finished"] is False
