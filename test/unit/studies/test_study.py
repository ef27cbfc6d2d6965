"""The program around a study: command line, exit status, progress and complete results."""

import importlib
import os
import runpy
import shlex
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Tuple

import pytest
from shared import PACKAGE, cases, python, refuses
from study_runs import names_in, run_main

from bullet_lab.core.files import FileError
from bullet_lab.core.parameters import ParameterError, boolean, integer, numbers, text
from bullet_lab.studies.study import (
    Settings,
    TaskLostError,
    UnfinishedError,
    interrupt_once,
    progress,
    run_from,
    whole_results,
    write_table,
)

SIGNALS = (signal.SIGINT, signal.SIGTERM)
STUDIES = (
    *("calibrate", "detection_range", "dock_campaign"),
    *("noise_study", "published_noise", "umbmark"),
)
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


def ended(words, error=None):
    """What a study ends with: its status, what it was run with, and what it printed."""
    found = []

    def body(*given):
        found.extend(given)
        given[-1]("so far")
        if error:
            raise error

    def main(words):
        run_from("a_study", "Studies.\nMore.", (Noise, Place), body, words)

    status, *printed = run_main(main, *words)
    return status, found, printed


def assert_one_line(name, said, printed):
    out, error = printed
    assert out == ""
    assert error.startswith(f"{name}: ") and said in error
    assert error.count("\n") == 1


@pytest.fixture(autouse=True)
def results_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("first", SIGNALS)
def test_the_second_signal_does_not_interrupt_what_the_first_one_has_begun(first):
    interrupt_once()
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), first)
        pytest.fail("not interrupted")
    for number in SIGNALS:
        os.kill(os.getpid(), number)


@cases("""
words, noise, place:
  - - --levels 0 0.5 --all-of-it --world moon --paths 7
    - {levels: [0.0, 0.5], paths: 7, all_of_it: true}
    - {world: moon}
  - ["'__name:=a' '__log:=/a b.log'", {}, {}]
  # Without values, as from launch files.
  - [--levels --paths '' --world '', {}, {}]
""")
def test_settings_make_the_command_line(words, noise, place):
    status, (folder, *found, _), printed = ended(["out", *shlex.split(words)])
    assert (status, printed) == (0, ["a_study: so far\n", ""])
    noise = {name: tuple(v) if name == "levels" else v for name, v in noise.items()}
    assert (folder, *found) == (Path("out"), Noise(**noise), Place(**place))


def test_settings_are_checked_in_python_as_well():
    with refuses("paths is 0", ParameterError):
        Noise(paths=0)


def test_help_names_every_setting():
    status, _, (said, _) = ended(["--help"])
    assert status == 0
    assert all(word in said for word in ("Studies.", "--levels", "--all-of-it", "of noise", "0.1"))


@cases("""
words, said:
  - [[], "the following arguments are required: out"]
  - [[out, --paths, "0"], "--paths is '0': it must be a whole number from 1"]
  - [[out, --nix], "unrecognized arguments: --nix"]
  - [[/proc/nowhere], cannot make the folder]
""")
def test_bad_words(words, said):
    status, _, printed = ended(words)
    assert status == 2
    assert_one_line("a_study", said, printed)


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (FileError("cannot write"), 2, "a_study: cannot write\n"),
        (UnfinishedError("nobody\nworks"), 1, "a_study: nobody works\n"),
        (TaskLostError("lost"), 1, "a_study: lost\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_how_it_fails(error, status, said):
    found, _, (_, errors) = ended(["out"], error)
    assert (found, errors) == (status, said)


def test_ctrl_c_while_python_ends_changes_no_status():
    assert python(ENDING)[0] == 2


@pytest.mark.parametrize("name", STUDIES)
def test_each_study_is_a_program(name, monkeypatch, capsys):
    program = str(PACKAGE / "scripts" / f"{name}.py")
    monkeypatch.setattr("sys.argv", [program, "out", "--seed", "-1"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(program, run_name="__main__")
    assert end.value.code == 2
    said = "--seed is '-1': it must be a whole number from 0 to 9223372036854775807"
    assert_one_line(name, said, capsys.readouterr())


@cases("""
name, words, said:
  # What a study refuses besides what all of them do.
  - [calibrate, --models nix, "--models is 'nix': it must be different words of"]
  - [calibrate, --truth a.tum, "truth and odometry are one recording: both files are needed"]
  - [calibrate, --data nix, "nix: there is no such file or folder"]
  - [calibrate, --max-gap 1, "--max-gap is '1': it must be a number > 1"]
  - [detection_range, --worlds moon, it must be different words of marker_panel]
  - [detection_range, --lights dark dark, "--lights is 'dark dark'"]
  - [detection_range, --distances 0, it must be different numbers >= 0.1 and <= 50]
  - [detection_range, --bearings 90, it must be different numbers >= 0 and <= 85]
  - [detection_range, --frames 0, it must be a whole number from 1 to 100000]
  - [detection_range, --dots -1, it must be a whole number from 0 to 100000]
  - [detection_range, --workers -1, "--workers is '-1'"]
  - - detection_range
    - --worlds docking --lights default --distances 1 --bearings 30
    - no cell of the grid has room for the camera
  - [dock_campaign, --dockings 0, it must be a whole number from 1 to 1000000]
  - [dock_campaign, --worlds kitchen, "--worlds is 'kitchen'"]
  - [dock_campaign, --lights candle, "--lights is 'candle'"]
  - [dock_campaign, --odometry gps, "--odometry is 'gps'"]
  - [noise_study, --levels -0.1, it must be different numbers >= 0 and <= 10]
  - [noise_study, --rates 0, "--rates is '0': it must be different numbers > 0"]
  - [noise_study, --models magic, it must be different words of report]
  - [noise_study, --paths 1, it must be a whole number from 2 to 10000000]
  - [noise_study, --delta 0, "--delta is '0': it must be a number > 0"]
  - [noise_study, --delta 50, no two poses are 50 m apart]
  - [noise_study, --laps 0, "--laps is '0'"]
  - [noise_study, --path nix.tum, "cannot read nix.tum: No such file"]
  - [published_noise, --std -0.1, "--std is '-0.1': it must be a number >= 0 and <= 1"]
  - [published_noise, --seeds 3, it must be a whole number from 20 to 20000]
  - [published_noise, --reading -1, "--reading is '-1'"]
  - [umbmark, --robots -1, "--robots is '-1': it must be a whole number from 0"]
""")
def test_bad_words_end_a_study_with_one_line_and_nothing_written(name, words, said):
    study = importlib.import_module(f"bullet_lab.studies.{name}.study")
    status, *printed = run_main(study.main, "out", *words.split())
    assert status == 2
    assert_one_line(name, said, printed)
    assert not list(Path().glob("out/*"))


@cases("total, before: [[30, 0], [7, 3]]")
def test_without_a_terminal_some_lines_tell_of_the_progress(total, before):
    lines = []
    work = range(before, total)
    assert list(progress(work, "cells", total, lines.append, before, lambda: "3 bad")) == list(work)
    assert len(lines) == min(10, total - before)
    assert lines[-1] == f"{total} of {total} cells done, 3 bad"


def test_a_table_leaves_empty_what_is_not_known():
    write_table(Path("a.csv"), [{"a": None, "b,c": 0.1 + 0.2}, {"a": True, "b,c": 1}])
    assert Path("a.csv").read_text() == 'a,"b,c"\n,0.30000000000000004\ntrue,1\n'


def test_results_are_put_in_place_when_whole_with_the_summary_last(tmp_path):
    (tmp_path / "a").write_text("old")
    with whole_results(tmp_path) as part:
        (part / "a").write_text("new")
        (part / "below").mkdir()
        (part / "below" / "b").write_text("b")
        assert (tmp_path / "a").read_text() == "old"
    assert (tmp_path / "a").read_text() == "new"
    assert (tmp_path / "below" / "b").exists()
    assert names_in(tmp_path) == {"a", "below"}
    (tmp_path / "z" / "in the way").mkdir(parents=True)
    with pytest.raises(FileError), whole_results(tmp_path) as part:
        (part / "summary.json").write_text("{}")
        (part / "z").write_text("z")
    assert not (tmp_path / "summary.json").exists()


def test_results_that_cannot_be_written_leave_the_old_ones(tmp_path):
    (tmp_path / "a").write_text("old")
    with refuses("^cannot write to ", FileError), whole_results(tmp_path) as part:
        (part / "a").write_text("new")
        (part / "nix" / "b").write_text("b")
    assert (tmp_path / "a").read_text() == "old"
    assert names_in(tmp_path) == {"a"}
