"""The ROS master that a run joins, and how the run ends."""

import os
import signal
from types import SimpleNamespace
from unittest import mock

from shared import cases, refuses

from bullet_lab.ros.launcher import supervision
from bullet_lab.ros.launcher.supervision import STOCK_URI, Verdict, judge, others_than_writers


def judged(deaths, has_summary=True, stopped_by=None):
    return judge(deaths, 3, {"bridge", "plot"}, has_summary, stopped_by)


@cases("""
deaths, summary, signal_name, status, reason:
  # Nodes that ended with their statuses, whether there is a summary, the signal that came, and the
  # exit status of the run with its reason. The bridge and the plot are required.
  - [{drive: 0, plot: 0}, true, null, 0, ""]
  - [{plot: 0}, false, null, 1, plot ended before there was a summary]
  # The first failure gives the status.
  - [{drive: 1, bridge: 5, plot: 0}, true, null, 1, drive ended with status 1]
  - [{drive: 77, bridge: 5, plot: 0}, true, null, 77, drive ended with status 77]
  # After the end of the job, it does not count.
  - [{plot: 0, drive: 1}, true, null, 0, ""]
  - [{bridge: -11}, true, null, 139, bridge was killed by signal 11]
  - [{}, true, SIGINT, 130, stopped by SIGINT]
  - [{}, true, SIGTERM, 143, stopped by SIGTERM]
  # It counts more than the signal that followed.
  - [{drive: 3}, true, SIGINT, 3, drive ended with status 3]
""")
def test_how_a_run_ends(deaths, summary, signal_name, status, reason):
    stopped_by = signal_name and signal.Signals[signal_name]
    assert judged(deaths, summary, stopped_by) == Verdict(status, reason)


def test_run_goes_on_until_a_required_node_ends():
    assert judged({}) is None
    assert judged({"drive": 0}) is None


def test_nodes_that_do_not_write_the_results_end_when_these_are_complete():
    nodes = [
        SimpleNamespace(namespace="/", name=name, required=required, respawn=respawn)
        for name, required, respawn in (
            ("plot", True, False),
            ("bridge", True, False),
            ("record", False, False),
            ("rviz", False, True),
        )
    ]
    told = SimpleNamespace(nodes=nodes, params={"/plot/out": "", "/record/out": ""})
    assert others_than_writers(told) == {"/bridge", "/record"}
    # Nobody would be left whose end is the end of the job.
    assert others_than_writers(SimpleNamespace(nodes=nodes, params={})) == set()


def test_all_nodes_ended_without_a_required_one():
    verdict = judge({"/drive": 0}, 1, set(), True, None)
    assert verdict.status == 1


@cases("user, joins: [[0, true], [1, false]]")
@cases(f"uri: ['{STOCK_URI}', '{STOCK_URI}/']")
def test_the_stock_master_of_another_user_is_not_joined(monkeypatch, user, joins, uri):
    running, own, mine = mock.Mock(), mock.Mock(uri="http://127.0.0.1:1/"), os.getuid()
    running.get.return_value = running
    running.getPid.return_value = (1, "", os.getpid())
    running.getParam.return_value = (1, "", "run")
    monkeypatch.setattr(supervision, "Master", lambda uri: running)
    monkeypatch.setattr(supervision, "_answers", lambda uri: True)
    monkeypatch.setattr(supervision.rosmaster.master, "Master", lambda port: own)
    monkeypatch.setattr(supervision.os, "getuid", lambda: mine + user)
    monkeypatch.setattr(supervision.os, "environ", {"ROS_MASTER_URI": uri})
    assert supervision.prepare_master().own is not joins


def test_a_master_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:4")
    with refuses("^no ROS master answers at ROS_MASTER_URI=http"):
        supervision.prepare_master()
