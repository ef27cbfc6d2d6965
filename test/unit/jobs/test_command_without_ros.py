"""The command without ROS runs jobs by the names and arguments of scripts/run.sh."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from shared import PACKAGE, cases, python
from study_runs import summary_of

from bullet_lab.jobs import command
from bullet_lab.jobs.declaration import find_jobs, read_job
from bullet_lab.studies.squares import SquaresSettings, run_squares

JOBS = {name: job for name, job in find_jobs(PACKAGE).items() if job.program}
STUDIES = sorted(JOBS.keys() - {"squares"})
# A value for an argument, with what a shell would split.
VALUES = {"out": "/some where/it's", "seed": "7", "path": "my run.tum"}


def run(monkeypatch, *words):
    """Run the command in this process; return its exit status."""
    monkeypatch.setattr("sys.argv", ["bullet_lab", *words])
    with pytest.raises(SystemExit) as end:
        command.main()
    return end.value.code


def test_jobs_without_ros_are_listed(monkeypatch, capsys):
    assert run(monkeypatch) == 0
    listed = capsys.readouterr().out
    assert "usage: bullet_lab <job>" in listed
    assert {"noise_study", "umbmark"} < set(STUDIES)
    assert all(f"  {name} " in listed for name in JOBS)
    assert "  dock " not in listed


@cases("""
words, said:
  dock: "bullet_lab: dock needs ROS: clone bullet_lab, run scripts/run.sh dock"
  square: "bullet_lab: there is no job 'square' (did you mean 'squares'?)"
  "squares rtf:=1": "bullet_lab: squares has no argument 'rtf'"
  "squares std:=-1": "bullet_lab: std is '-1': it must be a number >= 0"
  "squares mode:=fast": "bullet_lab: mode is 'fast': it must be one of open_loop"
""")
def test_a_wrong_command_line_is_one_line(words, said, monkeypatch, capsys):
    assert run(monkeypatch, *words.split()) == command.STATUS_BAD_VALUE
    printed = capsys.readouterr()
    assert printed.err.startswith(said)
    assert printed.err.count("\n") == 1
    assert not printed.out


def test_a_reader_that_has_gone_leaves_no_traceback():
    code = "from bullet_lab.entry import command; command()"
    words = [sys.executable, "-c", code, "squares", "--help"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        program.stdout.close()
        assert program.stderr.read() == b""
    assert program.returncode == command.STATUS_UNREAD


def test_squares_leaves_the_files_of_the_library(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = ("std:=0.05", "model:=probabilistic", "alpha1:=0.02", "base_error:=-0.01", "seed:=4")
    assert run(monkeypatch, "squares", *words) == 0
    printed = capsys.readouterr().out
    settings = SquaresSettings(
        std=0.05, model="probabilistic", alpha1=0.02, base_error=-0.01, seed=4
    )
    run_squares(tmp_path / "plain", settings)
    ours, theirs = (
        {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
        for folder in ("results/squares", "plain")
    )
    assert ours == theirs
    assert sorted(ours) == ["noisy_odom.tum", "odom.tum", "paths.csv", "paths.png", "summary.json"]
    assert all(f"\n  results/squares/{name}\n" in printed for name in ours)
    summary = summary_of(tmp_path / "plain")
    assert (summary["seed"], summary["alpha1"], summary["finished"]) == (4, 0.02, True)


def test_a_study_that_refuses_its_input_says_so_alone(monkeypatch, capsys, tmp_path):
    words = (f"out:={tmp_path}", "path:=/no/such.tum")
    assert run(monkeypatch, "noise_study", *words) == command.STATUS_BAD_VALUE
    printed = capsys.readouterr()
    assert "cannot read /no/such.tum" in printed.err
    assert not printed.out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_has_the_command_line_and_the_help_of_roslaunch(name):
    supervision = pytest.importorskip("bullet_lab.ros.launcher.supervision")
    rospkg = pytest.importorskip("rospkg")
    package = Path(rospkg.RosPack().get_path("bullet_lab"))
    job = read_job(package / "launch" / f"{name}.launch", package)
    values = {key: value for key, value in VALUES.items() if key in job.arguments}
    # A shell quotes this for roslaunch, which splits the resolved text.
    shown = {key: value.replace("'", "'\"'\"'") for key, value in values.items()}
    [node] = supervision._load(job.path, shown).nodes
    assert job.words(values) == shlex.split(node.args)
    alone = job.without_ros()
    assert command._defaults(alone) == supervision.resolved_defaults(job.path)
    assert list(alone.arguments) == list(job.arguments)


def test_listing_jobs_imports_no_study():
    code = (
        "import sys; sys.argv[1:] = ['--help']; from bullet_lab.entry import command\n"
        "try:\n    command()\nexcept SystemExit:\n"
        "    sys.exit('rospy' in sys.modules or 'matplotlib' in sys.modules)"
    )
    path = [entry for entry in sys.path if entry]
    assert python(f"import sys; sys.path[:] = {path}; {code}")[0] == 0
