from pathlib import Path

import pytest

from bullet_lab.ros.launcher.jobs import (
    choose_job,
    find_jobs,
    help_on,
    list_of_jobs,
    read_assignments,
    read_job,
)
from bullet_lab.ros.launcher.values import UsageError

LAUNCH = Path(__file__).parents[4] / "launch"

TEXT = """<?xml version="1.0"?>
<!-- Does one
     thing well. And more is said
     here. -->
<launch>
  <arg name="std" default="0.1" doc="Noise
    per metre [number >= 0]"/>
  <arg name="empty" default=""/>
  <arg name="fixed" value="1"/>
  <group><arg name="inner" default="1"/></group>
</launch>
"""


@pytest.fixture
def job(tmp_path):
    path = tmp_path / "thing.launch"
    path.write_text(TEXT)
    return read_job(path)


def test_job_says_what_its_file_says(job):
    assert (job.name, job.summary) == ("thing", "Does one thing well.")
    assert [(a.name, a.default, a.doc) for a in job.arguments] == [
        ("std", "0.1", "Noise per metre [number >= 0]"),
        ("empty", "", ""),
    ]


def test_comment_inside_the_root_is_the_summary_too(tmp_path):
    path = tmp_path / "a.launch"
    path.write_text("<launch><!-- Runs at 0.5 m/s past it --></launch>")
    assert read_job(path).summary == "Runs at 0.5 m/s past it"


def test_assignments_are_checked_and_the_last_counts(job):
    assert read_assignments(job, ["std:=1", "empty:=a:=b", "std:=2"]) == {
        "std": "2",
        "empty": "a:=b",
    }


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("std=1", "'std=1' is not of the form name:=value"),
        ("--std", "not of the form"),
        ("stf:=1", "no argument 'stf' .did you mean 'std'"),
        ("fixed:=2", "no argument 'fixed'"),
        ("inner:=2", "no argument 'inner'"),
        ("std:=-1", "std:=-1 is refused"),
    ],
)
def test_wrong_words_are_refused_in_one_line(job, word, message):
    with pytest.raises(UsageError, match=message) as refusal:
        read_assignments(job, [word])
    assert "\n" not in str(refusal.value)


def test_argument_without_default_is_demanded(tmp_path):
    path = tmp_path / "a.launch"
    path.write_text('<launch><arg name="world"/></launch>')
    with pytest.raises(UsageError, match="needs a value for world"):
        read_assignments(read_job(path), [])


@pytest.mark.parametrize(
    "text",
    [
        "<launch>",
        "",
        '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><launch>&b;</launch>',
        '<launch><arg name="a" doc="x [numbre]"/></launch>',
    ],
)
def test_broken_launch_file_is_a_clear_error(tmp_path, text):
    path = tmp_path / "a.launch"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"a\.launch: "):
        read_job(path)


def test_unknown_job_is_refused_with_a_hint(job):
    with pytest.raises(UsageError, match="no job 'thign' .did you mean 'thing'.*jobs: thing"):
        choose_job({"thing": job}, "thign")


def test_help_lists_resolved_defaults(job):
    lines = help_on(job, {"std": "0.5"}).splitlines()
    assert lines[0] == "thing: Does one thing well."
    assert lines[3:] == ["  std:=0.5  Noise per metre [number >= 0]", "  empty:="]


def test_list_has_a_line_for_each_job(job):
    assert "  thing  Does one thing well." in list_of_jobs({"thing": job}).splitlines()


def test_every_shipped_job_has_the_common_arguments_and_sound_defaults():
    jobs = find_jobs(LAUNCH)
    assert {"squares", "beacons"} <= set(jobs)
    for job in jobs.values():
        assert job.summary.endswith(".")
        assert {"out", "rtf", "seed", "rviz"} <= {a.name for a in job.arguments}
        for argument in job.arguments:
            assert argument.doc, argument.name
            if "$(" not in argument.default:
                argument.values.check(argument.name, argument.default)
