"""The program around a study: command line, exit status, progress and complete results."""

import importlib
import os
import runpy
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Tuple

import pytest

from bullet_lab.core.files import FileError
from bullet_lab.core.parameters import ParameterError, boolean, integer, numbers, text
from bullet_lab.studies.study import (
    Settings,
    UnfinishedError,
    interrupt_once,
    progress,
    run_from,
    whole_results,
    write_table,
)
from bullet_lab.studies.workers import TaskLostError

PACKAGE = Path(__file__).parents[3]
SIGNALS = (signal.SIGINT, signal.SIGTERM)
STUDIES = (
    *("calibrate", "detection_range", "dock_campaign"),
    *("noise_study", "published_noise", "umbmark"),
)
# What a study refuses besides what all of them do.
REFUSED = [
    ("calibrate", "--models nix", "--models is 'nix': it must be different words of"),
    ("calibrate", "--truth a.tum", "truth and odometry are one recording: both files are needed"),
    ("calibrate", "--data nix", "nix: there is no such file or folder"),
    ("calibrate", "--max-gap 1", "--max-gap is '1': it must be a number > 1"),
    ("detection_range", "--worlds moon", "it must be different words of marker_panel"),
    ("detection_range", "--lights dark dark", "--lights is 'dark dark'"),
    ("detection_range", "--distances 0", "it must be different numbers >= 0.1 and <= 50"),
    ("detection_range", "--bearings 90", "it must be different numbers >= 0 and <= 85"),
    ("detection_range", "--frames 0", "it must be a whole number from 1 to 100000"),
    ("detection_range", "--dots -1", "it must be a whole number from 0 to 100000"),
    ("detection_range", "--workers -1", "--workers is '-1'"),
    ("dock_campaign", "--dockings 0", "it must be a whole number from 1 to 1000000"),
    ("dock_campaign", "--worlds kitchen", "--worlds is 'kitchen'"),
    ("dock_campaign", "--lights candle", "--lights is 'candle'"),
    ("dock_campaign", "--odometry gps", "--odometry is 'gps'"),
    ("dock_campaign", "--scheduler somewhere", "tcp://host:8786"),
    ("noise_study", "--levels -0.1", "it must be different numbers >= 0 and <= 10"),
    ("noise_study", "--rates 0", "--rates is '0': it must be different numbers > 0"),
    ("noise_study", "--models magic", "it must be different words of report"),
    ("noise_study", "--paths 1", "it must be a whole number from 2 to 10000000"),
    ("noise_study", "--delta 0", "--delta is '0': it must be a number > 0"),
    ("noise_study", "--delta 50", "no two poses are 50 m apart"),
    ("noise_study", "--laps 0", "--laps is '0'"),
    ("noise_study", "--path nix.tum", "cannot read nix.tum: No such file"),
    ("published_noise", "--std -0.1", "--std is '-0.1': it must be a number >= 0 and <= 1"),
    ("published_noise", "--seeds 3", "it must be a whole number from 20 to 20000"),
    ("published_noise", "--reading -1", "--reading is '-1'"),
    ("umbmark", "--robots -1", "--robots is '-1': it must be a whole number from 0"),
]
ENDING = """
import os, signal
from bullet_lab.errors import LabError
from bullet_lab.studies.study import run_from

class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

last = Last()
def run(folder, tell):
    raise LabError("bad")
run_from("ending", "", (), run, ["bad"])
"""


@dataclass(frozen=True)
class Noise(Settings):
    levels: Tuple[float, ...] = numbers((0.1, 0.2), "of noise", minimum=0.0)
    paths: int = integer(3, "how many", 1)
    all_of_it: bool = boolean(False, "or some")


@dataclass(frozen=True)
class Place:
    world: str = text("", "where")


def ended(words, run=lambda *_: None):
    """The status that a study ends with, and what it was run with."""
    found = []

    def body(*given):
        found.extend(given)
        run(*given)

    with pytest.raises(SystemExit) as end:
        run_from("a_study", "Studies.\nMore.", (Noise, Place), body, words)
    return end.value.code, found


def assert_one_line(name, said, printed):
    assert printed.out == ""
    assert printed.err.startswith(f"{name}: ")
    assert said in printed.err
    assert printed.err.count("\n") == 1


@pytest.fixture(autouse=True)
def results_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True)
def signals():
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("first", SIGNALS)
def test_the_second_signal_does_not_interrupt_what_the_first_one_has_begun(first):
    interrupt_once()
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), first)
        pytest.fail("not interrupted")
    for number in SIGNALS:
        os.kill(os.getpid(), number)


def test_settings_make_the_command_line(capsys):
    words = ["out", "--levels", "0", "0.5", "--all-of-it", "--world", "moon", "--paths", "7"]
    status, found = ended([*words, "__name:=a", "__log:=/a b.log"])
    folder, settings, place, tell = found
    assert status == 0
    assert (folder, settings) == (Path("out"), Noise((0.0, 0.5), 7, True))
    assert place == Place("moon")
    tell("so far")
    assert capsys.readouterr().out == "a_study: so far\n"


def test_settings_are_checked_in_python_as_well():
    with pytest.raises(ParameterError, match="paths is 0"):
        Noise(paths=0)


@pytest.mark.parametrize("words", [[], ["--levels", "--paths", "", "--world", ""]])
def test_without_values_as_from_launch_files_there_are_the_defaults(words):
    _, (_, settings, place, _) = ended(["out", *words])
    assert (settings, place) == (Noise(), Place())


def test_help_names_every_setting(capsys):
    assert ended(["--help"])[0] == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("Studies.", "--levels", "--all-of-it", "of noise", "0.1"))


@pytest.mark.parametrize(
    ("words", "error", "status", "said"),
    [
        ([], None, 2, "the following arguments are required: out"),
        (["out", "--paths", "0"], None, 2, "--paths is '0': it must be a whole number from 1"),
        (["out", "--nix"], None, 2, "unrecognized arguments: --nix"),
        (["/proc/nowhere"], None, 2, "cannot make the folder"),
        (["out"], FileError("cannot write"), 2, "cannot write"),
        (["out"], UnfinishedError("nobody\nworks"), 1, "nobody works"),
        (["out"], TaskLostError("lost"), 1, "lost"),
    ],
)
def test_how_it_fails(words, error, status, said, capsys):
    def run(*_):
        raise error

    assert ended(words, run)[0] == status
    assert_one_line("a_study", said, capsys.readouterr())


def test_an_interrupt_ends_it_without_a_word(capsys):
    def run(*_):
        raise KeyboardInterrupt

    assert ended(["out"], run)[0] == 130
    assert capsys.readouterr() == ("", "")


def test_ctrl_c_while_python_ends_changes_no_status():
    assert subprocess.run([sys.executable, "-c", ENDING]).returncode == 2


@pytest.mark.parametrize("name", STUDIES)
def test_each_study_is_a_program(name, monkeypatch, capsys):
    program = PACKAGE / "scripts" / f"{name}.py"
    monkeypatch.setattr("sys.argv", [str(program), "out", "--seed", "-1"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(program), run_name="__main__")
    assert end.value.code == 2
    said = "--seed is '-1': it must be a whole number from 0 to 9223372036854775807"
    assert_one_line(name, said, capsys.readouterr())


@pytest.mark.parametrize(("name", "words", "said"), REFUSED)
def test_bad_words_end_a_study_with_one_line_and_nothing_written(name, words, said, capsys):
    study = importlib.import_module(f"bullet_lab.studies.{name}.study")
    with pytest.raises(SystemExit) as end:
        study.main(["out", *words.split()])
    assert end.value.code == 2
    assert_one_line(name, said, capsys.readouterr())
    assert not list(Path().glob("out/*"))


@pytest.mark.parametrize(("total", "before"), [(30, 0), (7, 3)])
def test_without_a_terminal_some_lines_tell_of_the_progress(total, before):
    lines = []
    work = range(before, total)
    assert list(progress(work, "cells", total, lines.append, before, lambda: "3 bad")) == list(work)
    assert len(lines) == min(10, total - before)
    assert lines[-1] == f"{total} of {total} cells done, 3 bad"


def test_a_table_leaves_empty_what_is_not_known():
    write_table(Path("a.csv"), [{"a": None, "b,c": 0.1 + 0.2}, {"a": True, "b,c": 1}])
    assert Path("a.csv").read_text() == 'a,"b,c"\n,0.30000000000000004\ntrue,1\n'


def test_results_are_put_in_place_when_whole(tmp_path):
    (tmp_path / "a").write_text("old")
    with whole_results(tmp_path) as part:
        (part / "a").write_text("new")
        (part / "below").mkdir()
        (part / "below" / "b").write_text("b")
        assert (tmp_path / "a").read_text() == "old"
    assert (tmp_path / "a").read_text() == "new"
    assert (tmp_path / "below" / "b").exists()
    assert {path.name for path in tmp_path.iterdir()} == {"a", "below"}


def test_results_that_cannot_be_written_leave_the_old_ones(tmp_path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(FileError, match="^cannot write to "), whole_results(tmp_path) as part:
        (part / "a").write_text("new")
        (part / "nix" / "b").write_text("b")
    assert (tmp_path / "a").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_the_summary_comes_last(tmp_path):
    (tmp_path / "z" / "in the way").mkdir(parents=True)
    with pytest.raises(FileError), whole_results(tmp_path) as part:
        (part / "summary.json").write_text("{}")
        (part / "z").write_text("z")
    assert not (tmp_path / "summary.json").exists()
