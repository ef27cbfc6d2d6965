"""Submissions that hang, print, fork or crash end, with all that they have started."""

import os
import subprocess
import time
from contextlib import closing
from pathlib import Path

import pytest

from bullet_lab.ros.grade import trial as submission
from bullet_lab.ros.grade.trial import Submission, SubmissionError, command_of

HOSTILE = Path(__file__).parents[3] / "submissions" / "hostile"
LARGEST_FILE = 100_000


@pytest.fixture(autouse=True)
def lower_limits(monkeypatch):
    monkeypatch.setattr(submission, "GRACE", 0.3)
    monkeypatch.setattr(submission, "LARGEST_FILE", LARGEST_FILE)


def started(folder, tmp_path, seconds=30):
    return closing(Submission(folder, tmp_path / "work", tmp_path / "output.txt", seconds))


def ended(one):
    """Wait until a submission has ended by itself, and return its status."""
    while one.status() is None:
        time.sleep(0.01)
    return one.status()


def process_of(one):
    """Wait for the number of a process that a submission writes, and return it."""
    while not one.file("pid").strip():
        time.sleep(0.01)
    return int(one.file("pid"))


def written(folder, text, name="main.sh"):
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text if text.startswith("#!") else f"#!/bin/bash\n{text}\n")
    (folder / name).chmod(0o755)
    return folder


def is_running(process):
    """Return whether a process runs; one that has ended may not have been waited for."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


UNSTARTED = {
    "not_executable": "^main.py is not executable; run chmod .x main.py$",
    "nothing": "^it has no main.py, no main.sh and 0 launch files; one is needed$",
    "two_launch_files": "^it has no main.py, no main.sh and 2 launch files; one is needed$",
}


@pytest.mark.parametrize("name, reason", UNSTARTED.items())
def test_what_cannot_be_started_says_why(name, reason, tmp_path):
    with pytest.raises(SubmissionError, match=reason):
        started(HOSTILE / name, tmp_path)


def test_a_pipe_says_why(tmp_path):
    os.mkfifo(written(tmp_path / "pipe", "true") / "a_pipe")
    with pytest.raises(SubmissionError, match="it cannot be started: .*a_pipe"):
        started(tmp_path / "pipe", tmp_path)


def test_a_launch_file_is_started_by_roslaunch(tmp_path):
    (tmp_path / "drive.launch").write_text("<launch/>")
    assert command_of(tmp_path) == ["roslaunch", "drive.launch"]


def hostile(name):
    return (HOSTILE / name).read_text()


@pytest.mark.parametrize(
    "name, text, reason",
    [
        ("main.sh", "exit 3", "it ended with status 3: it printed nothing"),
        ("main.py", "#!/no/such/python\n", "No such file"),
        (
            "main.py",
            hostile("crashes/main.py"),
            "it ended with status 1: ZeroDivisionError: division by zero",
        ),
        (
            "main.sh",
            "while :; do :; done",
            "it was ended, since it used too much processor time",
        ),
        (
            "main.sh",
            hostile("writes_much/main.sh"),
            "it was ended, since it wrote a file of more than 20 MB",
        ),
    ],
)
def test_why_it_ended(tmp_path, name, text, reason):
    with started(written(tmp_path / "a", text, name), tmp_path, seconds=1) as one:
        assert ended(one)
        (why,) = one.why_ended()
        assert reason in why
    sizes = [path.stat().st_size for path in (tmp_path / "work").rglob("*")]
    assert max(sizes) <= LARGEST_FILE


def test_it_runs_in_a_copy_and_what_it_leaves_is_read(tmp_path):
    text = "echo 4.5 > found.txt; ln -s /etc/passwd outside.txt; mkfifo pipe; mkdir d"
    folder = written(tmp_path / "a", text)
    with started(folder, tmp_path) as one:
        assert ended(one) == 0
        assert one.why_ended() == []
        assert one.file("found.txt") == "4.5\n"
        # A pipe would never end, and other files are nobody's answer.
        for name in ("outside.txt", "pipe", "d", "missing", "../output.txt", "/etc/passwd"):
            assert one.file(name) == ""
    assert [path.name for path in folder.iterdir()] == ["main.sh"]


def test_what_ignores_signals_is_killed(tmp_path):
    folder = written(tmp_path / "a", "trap '' TERM INT HUP; echo $$ > pid; while :; do :; done")
    with started(folder, tmp_path) as one:
        process = process_of(one)
        assert one.why_ended() == []
    assert not is_running(process)


def test_processes_that_leave_the_group_are_named_and_ended(tmp_path):
    text = "setsid bash -c 'trap \"\" TERM; echo $$ > pid; while :; do sleep 0.1; done' & exit 0"
    with started(written(tmp_path / "a", text), tmp_path) as one:
        assert ended(one) == 0
        process = process_of(one)
        assert one.why_ended() == ["it left processes behind, which were ended"]
        assert is_running(process)
    assert not is_running(process)


def test_other_children_of_the_process_are_left_alone(tmp_path):
    with subprocess.Popen(["sleep", "1000"]) as other:
        with started(written(tmp_path / "a", "exit 0"), tmp_path) as one:
            ended(one)
        assert other.poll() is None
        other.kill()
