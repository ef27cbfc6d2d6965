import threading
from types import SimpleNamespace

import pytest
import rospy
from message_fields import message
from nav_msgs.msg import Odometry
from shared import refuses
from study_runs import summary_of

from bullet_lab.core.figures import new_figure
from bullet_lab.core.files import FileError, PathSeries
from bullet_lab.reports import Report
from bullet_lab.ros.node.lock_step import END_OF_TIME
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record import recorder
from bullet_lab.ros.record.plots import PlotParameters, plot
from bullet_lab.ros.record.recorder import GoalRequest, Recorder, TimedParameters


class PathReport(Report):
    """The smallest report: one path."""

    failed = False

    def __init__(self, folder):
        super().__init__(folder)
        self.topics = {"odom": "nav_msgs/Odometry"}
        self.series = {"odom": PathSeries(folder / "path.tum")}

    def summary(self, finished, run):
        return {"finished": finished, "rows": len(self.series["odom"]), **run}

    def figures(self, summary):
        return {"path.png": new_figure(1.0, 1.0)}

    def line(self, summary):
        return f"{summary['rows']} rows"

    def has_failed(self, summary):
        return self.failed


@pytest.fixture
def receive(monkeypatch):
    """What the subscribers would call, by topic."""
    receivers = {}

    def subscriber(topic, kind, receive, *args):
        receivers[topic] = receive
        return SimpleNamespace(get_num_connections=lambda: 1, unregister=lambda: None)

    monkeypatch.setattr(recorder, "subscriber", subscriber)
    monkeypatch.setattr(recorder.rospy, "Subscriber", subscriber)
    return receivers


@pytest.fixture
def report(tmp_path):
    return PathReport(tmp_path)


@pytest.fixture
def record(tmp_path, report, receive):
    """A function that returns a recording until an announced end, with one message."""

    def record(request=None, **more):
        parameters = TimedParameters(
            out=str(tmp_path), about={"job": "test"}, until="" if request else "over", **more
        )
        made = Recorder(report, parameters, request=request)
        receive["odom"](odometry(1))
        return made

    return record


def odometry(number, x=0.0, frame="odom"):
    text = f"""
        header: {{stamp: {{nsecs: {50_000_000 * number}}}, frame_id: {frame}}}
        pose: {{pose: {{position: {{x: {x}}}, orientation: {{w: 1.0}}}}}}
    """
    return message(Odometry, text)


def left(folder):
    """Return the summary that is left, and the rows of the path."""
    return summary_of(folder), len((folder / "path.tum").read_text().splitlines())


def end_at(number):
    return SimpleNamespace(data=rospy.Time(0, 50_000_000 * number))


def test_what_cannot_be_used_is_counted_and_the_end_is_where_it_was_announced(
    tmp_path, receive, record
):
    recording = record()
    for bad in (odometry(2, ".nan"), odometry(2, frame="map"), odometry(1)):
        receive["odom"](bad)
    for number in (2, 3, 4):
        receive["odom"](odometry(number))
    assert len((tmp_path / "path.tum").read_text().splitlines()) == 4
    receive["over"](end_at(3))
    recording.run()
    # A late message.
    receive["odom"](odometry(5))
    summary, rows = left(tmp_path)
    assert list(summary)[:2] == ["job", "finished"]
    assert (summary["finished"], summary["rows"], summary["refused_messages"]) == (True, 3, 3)
    assert summary["sim_time_s"] == pytest.approx(0.1)
    assert rows == 3
    assert (tmp_path / "path.png").is_file()


def test_time_stands_still_while_the_figures_are_drawn(tmp_path, receive, record, monkeypatch):
    def grant(until):
        granted.append((until, (tmp_path / "summary.json").exists()))

    granted = []
    monkeypatch.setattr(recorder, "grant", grant)
    recording = record()
    receive["over"](end_at(1))
    recording.run()
    assert granted == [(rospy.Time(0), False), (END_OF_TIME, True)]


def test_an_end_that_nothing_comes_up_to_is_one_all_the_same(
    tmp_path, receive, record, monkeypatch
):
    monkeypatch.setattr(recorder, "PATIENCE", 0.05)
    recording = record()
    receive["over"](end_at(3))
    recording.run()
    assert left(tmp_path)[1] == 1


def test_nothing_is_cut_off_where_it_is_broken_off(tmp_path, record, monkeypatch):
    recording = record()
    monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
    recording.run()
    summary, rows = left(tmp_path)
    assert (summary["finished"], rows) == (False, 1)


def test_pictures_are_renewed_before_the_summary(tmp_path, receive, record):
    recording = record(plot_period=0.01)
    seen = []

    def watch():
        while not (tmp_path / "summary.json").exists():
            pass
        seen.append((tmp_path / "path.png").exists())
        receive["over"](end_at(1))

    watcher = threading.Thread(target=watch)
    watcher.start()
    recording.run()
    watcher.join()
    assert seen == [True]


def test_a_goal_that_is_not_reached_leaves_everything_and_one_line(tmp_path, record, report):
    report.failed, report.until = True, 50_000_000
    sent = []
    recording = record(GoalRequest("server", lambda: True, lambda: sent.append(1), lambda: sent))
    with refuses("^1 rows$", NodeError):
        recording.run()
    assert sent == [1]
    assert left(tmp_path)[0]["finished"] is True


def test_a_goal_that_is_not_accepted(tmp_path, record, monkeypatch):
    monkeypatch.setattr(recorder, "ACCEPTANCE", 0.05)
    recording = record(GoalRequest("server", lambda: True, list, lambda: False))
    with refuses(r"^server has not accepted the goal within 0\.05 s$", NodeError):
        recording.run()
    assert left(tmp_path)[1] == 1


def test_a_full_disk(tmp_path, receive):
    (tmp_path / "path.tum").symlink_to("/dev/full")
    recording = Recorder(PathReport(tmp_path), recorder.RecordParameters(out=str(tmp_path)))
    receive["odom"](odometry(1))
    with refuses(r"path\.tum", FileError):
        recording.run()


def test_plot_runs_the_report_that_is_named(tmp_path, receive, monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
    plot.__wrapped__(PlotParameters(out=str(tmp_path), report=f"{__name__}:PathReport"))
    assert left(tmp_path)[1] == 0
    missing = "bullet_lab.reports.nothing:Report"
    with refuses(f"~report is '{missing}'", NodeError):
        plot.__wrapped__(PlotParameters(out=str(tmp_path), report=missing))
