import signal

import pytest

from bullet_lab.ros.launcher.supervision import Death, Verdict, judge

NAMES = {"bridge-1": "bridge", "drive-2": "drive", "plot-3": "plot"}


def judged(*deaths, has_summary=True, stopped_by=None):
    deaths = [Death(process, status) for process, status in deaths]
    return judge(deaths, NAMES, {"bridge", "plot"}, has_summary, stopped_by)


def test_run_goes_on_until_a_required_node_ends():
    assert judged() is None
    assert judged(("drive-2", 0)) is None


def test_required_node_ends_the_run_successfully_only_with_a_summary():
    assert judged(("drive-2", 0), ("plot-3", 0)) == Verdict(0)
    assert judged(("plot-3", 0), has_summary=False) == Verdict(
        1, "plot ended before there was a summary"
    )


@pytest.mark.parametrize("status", [1, 2, 77])
def test_first_failure_gives_the_status(status):
    verdict = judged(("drive-2", status), ("bridge-1", 5), ("plot-3", 0))
    assert verdict == Verdict(status, f"drive ended with status {status}")


def test_failure_after_the_end_of_the_job_does_not_count():
    assert judged(("plot-3", 0), ("drive-2", 1)) == Verdict(0)


def test_killed_node_is_a_failure():
    assert judged(("bridge-1", -11)) == Verdict(139, "bridge was killed by signal 11")


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signal_gives_its_conventional_status(number, status):
    verdict = judged(stopped_by=number)
    assert (verdict.status, verdict.reason) == (status, f"stopped by {number.name}")


def test_failure_counts_more_than_the_signal_that_followed():
    assert judged(("drive-2", 3), stopped_by=signal.SIGINT).status == 3


def test_all_nodes_ended_without_a_required_one():
    verdict = judge([Death("drive-2", 0)], {"drive-2": "drive"}, set(), True, None)
    assert verdict.status == 1
