from alike import lines_of, lines_of_figure

from bullet_lab.reports import Reading
from bullet_lab.reports.goal import GoalAnswer, GoalReport

MS = 1_000_000


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
        report.take("odom", Reading(50 * k * MS, (0.005 * k, 0.001 * k, 0.002 * k)))
        if k == 40:
            answer(report, "a", "the end", reached=reached, over=True)
            finished(report, 2000)


def reports(folder):
    """Yield reports and what they were told: goals that are reached or not, and refused ones."""

    def made(name, stay):
        beacons = [("a", 1.0, 1.0), ("far", 90.0, 0.0)]
        return name, GoalReport(folder / name, 0.05, stay, lambda: beacons)

    for name in ("reached", "missed", "reached, stays", "missed, stays"):
        told = made(name, name.endswith("stays"))
        drive(told[1], name.startswith("reached"))
        yield told
    # One more goal, which is not reached yet, far from where the robot turns.
    told = made("two", False)
    drive(told[1], True)
    goal(told[1], 2100, 2.0, 1.0, 1.0)
    answer(told[1], "b", "driving")
    yield told
    # One that waits is refused in the end, and was never driven to.
    told = made("taken up", True)
    for name, text, rejected in (("a", "pending", False), ("a", "no way", True), ("b", "", False)):
        answer(told[1], name, text, rejected)
    goal(told[1], 1000, 1.0, 0.0, 0.0)
    finished(told[1], 2000)
    answer(told[1], "b", "there", reached=True)
    yield told
    told = made("refused", False)
    answer(told[1], "a", "refused", rejected=True)
    yield told


def test_reports_of_goals_are_as_before(tmp_path, as_before):
    told = []
    for name, report in reports(tmp_path):
        told += lines_of([report.is_answered(), report.is_complete()], f"{name}: answered, whole")
        report.finish(report.until)
        summary = report.summary(True, {})
        failed = report.has_failed(summary)
        told += lines_of([report.line(summary), failed], f"{name}: line, failed")
        told += lines_of({**summary, "goals": dict(enumerate(summary["goals"]))}, name)
        figure = report.figures(summary)["path.png"]
        told += lines_of_figure(figure)
        # What is far is left out.
        told += lines_of(figure.axes[0].get_xlim(), "x")
    as_before(told, "goals.txt")


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
