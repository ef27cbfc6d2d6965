import shlex
from pathlib import Path

import pytest
import yaml
from shared import PACKAGE, cases, refuses

from bullet_lab.core.parameters import ParameterError
from bullet_lab.jobs.declaration import (
    Target,
    UsageError,
    choose_job,
    find_jobs,
    help_on,
    list_of_jobs,
    read_assignments,
    read_job,
)

TEXT = """<?xml version="1.0"?>
<!-- Does one
     thing well. And more is said
     here. -->
<launch>
  <arg name="std" default="0.1" doc="Noise
    per metre [number]"/>
  <arg name="empty" default=""/>
  <arg name="fixed" value="1"/>
  <arg name="smallest" value="std:=0 empty:='a b'"/>
  <group><arg name="inner" default="1"/></group>
</launch>
"""


def read(name, text, folder):
    """Read a job from the text of a launch file."""
    path = folder / f"{name}.launch"
    path.write_text(text)
    return read_job(path, PACKAGE)


@pytest.fixture
def job(tmp_path):
    return read("thing", TEXT, tmp_path)


def of_argument(words, folder):
    """Read a job with one argument, which sets no parameter."""
    words = words.replace(">", "&gt;").replace("<", "&lt;")
    return read("a", f'<launch><arg name="std" {words}/></launch>', folder)


def test_job_is_read_from_its_launch_file(job):
    assert (job.name, job.summary) == ("thing", "Does one thing well.")
    assert [(a.name, a.default, a.doc, a.bracket) for a in job.arguments.values()] == [
        ("std", "0.1", "Noise per metre", "number"),
        ("empty", "", "", ""),
    ]
    assert job.smallest == "std:=0 empty:='a b'"


def test_comment_inside_the_root_is_the_summary_too(tmp_path):
    job = read("a", "<launch><!-- Runs at 0.5 m/s past it --></launch>", tmp_path)
    assert job.summary == "Runs at 0.5 m/s past it"


def test_assignments_are_checked_and_the_last_counts(job):
    assert read_assignments(job, ["std:=1", "empty:=a:=b", "std:=2"]) == {
        "std": "2",
        "empty": "a:=b",
    }


def test_argument_without_default_is_required(tmp_path):
    with refuses("needs a value for std", UsageError):
        read_assignments(of_argument("", tmp_path), [])


@cases("""
doc, good, bad:
  - ["Seed [integer]", ["0", "42"], ["1.0", "1e3", "٣"]]
  - ["Any [number]", ["-1e300", "1e-3", ".5"], ["1e999", "1_000", "0x10", " 1", nan, x, ""]]
  - ["Show [true|false]", ["true", "false"], ["True", "1", "yes", ""]]
  - ["Rule [report|rate_invariant]", [rate_invariant], [report|rate_invariant, rep]]
  - ["Where [folder]", [a/b c, /tmp], [""]]
  - ["Which [file]", ["", /etc/passwd, "package://bullet_lab/x"], [nothing.urdf, /tmp]]
  - ["What [text]", ["", anything], []]
  - ["no bracket", ["", anything], []]
  - ["Bracket [number] in the middle.", [anything], []]
""")
def test_values_that_a_bracket_allows(tmp_path, doc, good, bad):
    checked = of_argument(f'default="" doc="{doc}"', tmp_path).arguments["std"]
    for value in good:
        checked.check(value)
    for value in bad:
        with refuses(f"^std is '{value}': it must be ", ParameterError):
            checked.check(value)


def test_a_file_is_passed_as_an_absolute_path(tmp_path, monkeypatch):
    (tmp_path / "a.urdf").touch()
    monkeypatch.chdir(tmp_path)
    job = of_argument('default="" doc="x [file]"', tmp_path)
    assert read_assignments(job, ["std:=a.urdf"]) == {"std": str(tmp_path / "a.urdf")}
    found = read_assignments(job, ["std:=package://bullet_lab/package.xml"])["std"]
    assert Path(found) == PACKAGE / "package.xml"


@pytest.mark.parametrize("name", ["a" * 300 + ".urdf", "package://bullet_lab/" + "a" * 300])
def test_a_name_that_is_too_long_is_refused(tmp_path, name):
    job = of_argument('default="" doc="x [file]"', tmp_path)
    with refuses("File name too long|a file that exists"):
        read_assignments(job, [f"std:={name}"])


@cases("""
doc:
  - "x [nubmer]"
  - "x [number >= 0]"
  - "x [only]"
  - "x [a||b]"
  - "x [ ]"
""")
def test_bracket_outside_the_grammar_is_an_error(tmp_path, doc):
    with refuses(r"the doc of std ends with \[.*\]; a bracket is text, ", UsageError):
        of_argument(f'default="1" doc="{doc}"', tmp_path)


@cases("""
text:
  - <launch>
  - ""
  - '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><launch>&b;</launch>'
  - '<launch><arg name="a" doc="x [numbre]"/></launch>'
""")
def test_broken_launch_file_is_a_clear_error(tmp_path, text):
    with refuses(r"a\.launch: ", UsageError):
        read("a", text, tmp_path)


def test_unknown_job_is_refused_with_a_hint(job):
    with refuses("no job 'thign' .did you mean 'thing'.*jobs: thing", UsageError):
        choose_job({"thing": job}, "thign")


def test_help_lists_resolved_defaults(job):
    lines = help_on(job, {"std": "0.5"}).splitlines()
    assert lines[0] == "thing: Does one thing well."
    assert lines[3:] == ["  std:=0.5  Noise per metre [number]", "  empty:="]


def test_list_has_a_line_for_each_job(job):
    assert "  thing  Does one thing well." in list_of_jobs({"thing": job}).splitlines()


NODES = """
<launch>
  <arg name="noise" default=""/>
  <arg name="seed" default="1" doc="Of all"/>
  <arg name="speed" default="0.5" doc="How fast [number]"/>
  <arg name="many" default=""/>
  <arg name="count" default=""/>
  <group if="true">
    <node name="a" pkg="bullet_lab" type="noisy_odom.py">
      <param name="std" value="$(arg noise)"/>
      <param name="seed" value="$(arg seed)"/>
    </node>
  </group>
  <node name="b" pkg="bullet_lab" type="drive_squares.py">
    <param name="speed" value="$(arg speed)"/>
    <param name="sides" value="$(eval arg('count') + 1)"/>
  </node>
  <node name="c" pkg="other" type="drive_squares.py">
    <param name="side" value="$(arg count)"/>
  </node>
  <node name="d" pkg="bullet_lab" type="published_noise.py" args="'x' --seeds '$(arg many)'"/>
  <include file="$(find bullet_lab)/launch/include/bridge.launch.xml">
    <arg name="seed" value="$(arg seed)"/>
  </include>
</launch>
"""


def test_arguments_are_described_by_the_parameters_that_they_set(tmp_path):
    job = read("a", NODES, tmp_path)
    targets = {
        name: [f"{target.main} {target.parameter}" for target in argument.targets]
        for name, argument in job.arguments.items()
    }
    assert targets == yaml.safe_load(
        """
        noise: ["bullet_lab.ros.nodes.noisy_odom:noisy_odom_node std"]
        seed:
          - bullet_lab.ros.nodes.noisy_odom:noisy_odom_node seed
          - bullet_lab.ros.nodes.bridge seed
        speed: ["bullet_lab.ros.nodes.drive_squares:drive_squares speed"]
        many: [bullet_lab.studies.published_noise.study seeds]
        count: []
        """
    )
    text = help_on(job, {})
    assert "  noise:=0.1  Standard deviation per metre" in text
    assert "[a number >= 0 and <= 1e+06]" in text
    assert "  seed:=1     Of all [a whole number from 0 to 2147483647]" in text
    assert "  speed:=0.5  How fast [number]" in text


@cases(r"""
nodes, word, message:
  # Which of the launch files, a word, and what is said of it.
  - [false, std=1, "'std=1' is not of the form name:=value"]
  - [false, --std, not of the form]
  - [false, "stf:=1", no argument 'stf' .did you mean 'std']
  - [false, "fixed:=2", no argument 'fixed']
  - [false, "inner:=2", no argument 'inner']
  - [false, "std:=x", "^std is 'x': it must be a number$"]
  # Those that a node would refuse.
  - [true, "noise:=-1", '^noise is ''-1'': it must be a number >= 0 and <= 1e\+06$']
  - [true, "seed:=0.5", "^seed is '0.5': it must be a whole number from 0 to 2147483647$"]
  - [true, "speed:=x", "^speed is 'x': it must be a number$"]
""")
def test_wrong_words_are_refused_in_one_line(tmp_path, nodes, word, message):
    with refuses(message, (UsageError, ParameterError)):
        read_assignments(read("a", NODES if nodes else TEXT, tmp_path), [word])


def test_empty_value_stands_for_the_default_of_the_node(tmp_path):
    assert read_assignments(read("a", NODES, tmp_path), ["noise:="]) == {"noise": ""}


def test_node_that_cannot_be_imported_declares_nothing():
    assert Target("bullet_lab.no_such_module", "std").declarations() == []
    assert Target("bullet_lab.ros.nodes.noisy_odom", "no_such_parameter").declarations() == []


def test_every_shipped_job_has_the_common_arguments_and_sound_defaults():
    jobs = find_jobs(PACKAGE)
    assert {"squares", "beacons"} <= set(jobs)
    for job in jobs.values():
        assert job.summary.endswith(".")
        assert "out" in job.arguments
        for argument in job.arguments.values():
            if argument.default == "":
                assert argument.declarations(), f"{job.name}: nobody declares {argument.name}"
            elif "$(" not in argument.default:
                argument.check(argument.default)
            _, sentence = argument.help("")
            assert sentence, f"{job.name}: {argument.name} has no sentence"
        read_assignments(job, shlex.split(job.smallest))
    # This executable runs another function than the module's main.
    of_fleet = Target("bullet_lab.ros.nodes.drive_squares:fleet", "robots")
    assert of_fleet in jobs["fleet"].arguments["n"].targets
