"""What the grader is asked for, which marks it keeps, and submissions that hang, print or crash.

Those end, with all that they have started.
"""

import json
import os
import subprocess
import time
from contextlib import closing
from pathlib import Path

import pytest
from shared import PACKAGE, cases, refuses

from bullet_lab.ros import grade
from bullet_lab.ros.grade import (
    Grader,
    GradeSettings,
    Submission,
    SubmissionError,
    _run,
    command_of,
)

HOSTILE = PACKAGE / "test" / "submissions" / "hostile"
LARGEST_FILE = 100_000


@cases("""
given, line:
  # Settings, and the line that refuses them.
  - [{}, "^submission or class is needed, one of the two: the folder to grade$"]
  - [{submission: a, class_folder: a}, ^submission or class is needed]
  - [{submission: none}, none]
  - [{submission: file}, "^there are no submissions in 'file'$"]
  - [{class_folder: file}, "^there are no submissions in 'file'$"]
  - [{class_folder: hidden}, "^there are no submissions in 'hidden'$"]
""")
def test_what_cannot_be_graded_is_named(tmp_path, given, line):
    (tmp_path / "file").touch()
    (tmp_path / "hidden" / ".git").mkdir(parents=True)
    settings = GradeSettings(exercise="square", base=str(tmp_path), **given)
    with refuses(line):
        _run(tmp_path, settings, print)


@cases("""
kind, field:
  # Types and fields that have no number.
  - [nav_msgs/Odometry, pose.x]
  - [nav_msgs/Odometry, pose]
  - [std_msgs/Flaot64, data]
  - [Float64, data]
  - [std_msgs/String, data]
""")
def test_a_field_that_is_no_number_is_named_before_anything_runs(tmp_path, kind, field):
    file = tmp_path / "e.yaml"
    limits = f"measure: topic_mean, topic: a, type: {kind}, field: {field}, at_most: 0"
    file.write_text(f"criteria: [{{measure: contacts, at_most: 0}}, {{{limits}}}]")
    line = f"^e.yaml: criterion 2: field '{field}' of type '{kind}': there is no such number$"
    with refuses(line):
        _run(tmp_path, GradeSettings(exercise=str(file), submission="a"), print)


@pytest.fixture
def grader(tmp_path):
    """The grader of one empty submission by one criterion."""
    (tmp_path / "e.yaml").write_text("criteria: [{measure: contacts, at_most: 0}]")
    (tmp_path / "a").mkdir()
    return Grader(tmp_path / "e.yaml", [(tmp_path / "a", tmp_path / "marks")])


def test_a_mark_is_kept_until_a_file_changes(tmp_path, grader):
    main = tmp_path / "a/main.py"
    main.write_text("1")
    (tmp_path / "a/loop").symlink_to("loop")
    assert grader.kept(0) == {}
    (tmp_path / "marks").mkdir()
    mark = tmp_path / "marks" / "grade.json"
    changes = (
        lambda: main.chmod(0o755),
        lambda: main.write_text("2"),
        lambda: (tmp_path / "e.yaml").write_text("title: y"),
    )
    for change in changes:
        mark.write_text(json.dumps({"files": grader._digest(tmp_path / "a")}))
        assert grader.kept(0)
        change()
        assert grader.kept(0) == {}
    for text in ("", "[]", "{}", "5"):
        mark.write_text(text)
        assert grader.kept(0) == {}


def test_a_folder_without_a_program_is_graded_without_a_simulation(tmp_path, grader):
    mark = grader(0)
    assert (mark["points"], mark["of"]) == (0, 1)
    assert mark["why"] == ["it has no main.py, no main.sh and 0 launch files; one is needed"]
    assert json.loads((tmp_path / "marks" / "grade.json").read_text()) == mark


@pytest.fixture(autouse=True)
def lower_limits(monkeypatch):
    monkeypatch.setattr(grade, "GRACE", 0.3)
    monkeypatch.setattr(grade, "LARGEST_FILE", LARGEST_FILE)


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


@cases("""
name, reason:
  - [not_executable, ^main.py is not executable; run chmod .x main.py$]
  - [nothing, "^it has no main.py, no main.sh and 0 launch files; one is needed$"]
  - [two_launch_files, "^it has no main.py, no main.sh and 2 launch files; one is needed$"]
""")
def test_what_cannot_be_started_says_why(name, reason, tmp_path):
    with refuses(reason, SubmissionError):
        started(HOSTILE / name, tmp_path)


def test_a_pipe_says_why(tmp_path):
    os.mkfifo(written(tmp_path / "pipe", "true") / "a_pipe")
    with refuses("it cannot be started: .*a_pipe", SubmissionError):
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
