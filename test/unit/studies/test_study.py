import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Tuple

import pytest

from bullet_lab.core.files import FileError
from bullet_lab.core.parameters import boolean, check_parameters, integer, numbers, text
from bullet_lab.studies.study import progress, run_from, write_table
from bullet_lab.studies.workers import TaskLostError, WorkersError

PACKAGE = Path(__file__).parents[3]
ENDING = """
import os, signal, sys
from bullet_lab.errors import LabError
from bullet_lab.studies.study import run_from

class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

last = Last()
def run(folder, tell):
    if folder.name == "bad":
        raise LabError("bad")
run_from("ending", "", (), run, sys.argv[1:])
"""
CODE = """
import os, signal, time
from bullet_lab.studies.study import interrupt_once
interrupt_once()
try:
    print("ready", flush=True)
    time.sleep(60.0)
except KeyboardInterrupt:
    for number in (signal.SIGTERM, signal.SIGINT):
        os.kill(os.getpid(), number)
        time.sleep(0.01)
    print("cleared away", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_second_signal_does_not_interrupt_what_the_first_one_has_begun(number):
    process = subprocess.Popen([sys.executable, "-c", CODE], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    os.kill(process.pid, number)
    rest, _ = process.communicate(timeout=30.0)
    assert rest == "cleared away\n"
    assert process.returncode == 0


@dataclass(frozen=True)
class Settings:
    levels: Tuple[float, ...] = numbers((0.1, 0.2), "of noise", minimum=0.0)
    paths: int = integer(3, "how many", 1)
    all_of_it: bool = boolean(False, "or some")

    def __post_init__(self):
        check_parameters(self)


@dataclass(frozen=True)
class Place:
    world: str = text("", "where")


def ended(words, run=lambda *_: None, **options):
    """The status that a study ends with, and what it was run with."""
    found = []

    def body(*given):
        found.extend(given)
        run(*given)

    with pytest.raises(SystemExit) as end:
        run_from("a_study", "Studies.\nMore.", (Settings, Place), body, words, **options)
    return end.value.code, found


@pytest.fixture(autouse=True)
def results_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True)
def signals():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_settings_make_the_command_line(capsys):
    words = ["out", "--levels", "0", "0.5", "--all-of-it", "--world", "moon", "-p", "7"]
    status, found = ended([*words, "__name:=a", "__log:=/a b.log"], short=[("-p", "paths")])
    folder, settings, place, tell = found
    assert status == 0
    assert (folder, settings) == (Path("out"), Settings((0.0, 0.5), 7, True))
    assert place == Place("moon")
    tell("so far")
    assert capsys.readouterr().out == "a_study: so far\n"


def test_without_words_there_are_the_defaults():
    status, (_, settings, place, _) = ended(["out"])
    assert (status, settings, place) == (0, Settings(), Place())


def test_launch_files_may_leave_values_empty():
    _, (_, settings, place, _) = ended(["out", "--levels", "--paths", "", "--world", ""])
    assert (settings, place) == (Settings(), Place())


def test_help_names_every_setting(capsys):
    assert ended(["--help"])[0] == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("Studies.", "--levels", "--all-of-it", "of noise", "0.1"))


def failing(error):
    def run(*_):
        raise error

    return run


@pytest.mark.parametrize(
    ("words", "error", "status", "said"),
    [
        ([], None, 2, "the following arguments are required: out"),
        (["out", "--paths", "0"], None, 2, "--paths is '0': it must be a whole number from 1"),
        (["out", "--nix"], None, 2, "unrecognized arguments: --nix"),
        (["out"], FileError("cannot write"), 2, "cannot write"),
        (["out"], WorkersError("nobody\nworks"), 1, "nobody works"),
        (["out"], TaskLostError("lost"), 1, "lost"),
        (["out"], KeyboardInterrupt(), 130, ""),
    ],
)
def test_how_it_ends(words, error, status, said, capsys):
    code, _ = ended(words, *([failing(error)] if error else []))
    assert code == status
    err = capsys.readouterr().err
    assert (err == "") if not said else err.startswith("a_study: ") and err.count("\n") == 1
    assert said in err


@pytest.mark.parametrize(("total", "before"), [(30, 0), (7, 3), (1, 0), (100, 95)])
def test_without_a_terminal_some_lines_tell_of_the_progress(total, before):
    lines = []
    with progress(
        "work", total, lines.append, before, things=" cells", counts=lambda: "3 bad"
    ) as note:
        for _ in range(total - before):
            note()
    assert 1 <= len(lines) <= 10
    assert lines[-1] == f"{total} of {total} cells done, 3 bad"


def test_a_table_leaves_empty_what_is_not_known(tmp_path):
    write_table(tmp_path / "a.csv", [("a", "b,c"), (None, 0.1 + 0.2)])
    assert (tmp_path / "a.csv").read_text() == 'a,"b,c"\n,0.30000000000000004\n'


@pytest.mark.parametrize(
    "name", ["noise_study", "published_noise", "detection_range", "dock_campaign"]
)
def test_each_study_is_a_program(name, tmp_path):
    program = PACKAGE / "scripts" / f"{name}.py"
    done = subprocess.run(
        [sys.executable, program, tmp_path / "out", "--seed", "-1"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"{name}: --seed is '-1': it must be a whole number from 0")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("folder, status", [("good", 0), ("bad", 2)])
def test_ctrl_c_while_python_ends_changes_no_status(folder, status):
    assert subprocess.run([sys.executable, "-c", ENDING, folder], timeout=60).returncode == status
