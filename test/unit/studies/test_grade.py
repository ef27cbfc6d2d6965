"""Exercises are checked, runs are measured, and marks are written."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from PIL import Image
from shared import PACKAGE, cases, refuses

from bullet_lab.studies.grade import (
    EXERCISES,
    MEASURES,
    Criterion,
    Exercise,
    Record,
    find_exercise,
    grade,
    read_exercise,
    write_grade,
)

GOOD = {"criteria": [{"measure": "contacts", "at_most": 0}]}


def square(side=1.0):
    """Return rows t, x, y along a square."""
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]) * side
    t = np.linspace(0, 4, 201)
    x, y = (np.interp(t, range(5), corners[:, k]) for k in (0, 1))
    return np.column_stack((t, x, y)).tolist()


def check_refused(folder, text, message):
    path = folder / "e.yaml"
    path.write_text(text)
    with refuses(message):
        read_exercise(path)


@pytest.mark.parametrize("path", sorted((PACKAGE / EXERCISES).glob("*.yaml")), ids=lambda p: p.stem)
def test_each_exercise_can_be_read_and_has_ten_points(path):
    exercise = read_exercise(path)
    assert sum(criterion.points for criterion in exercise.criteria) == 10
    assert exercise.title
    assert find_exercise(path.stem, Path("/")) == path


@cases(r"""
change, message:
  - [{rtf: fast}, "rtf is 'fast': it must be a number > 0 and <= 100"]
  - [{runs: 0}, "runs is 0: it must be a whole number from 1 to 100"]
  - [{wurld: a}, "there is no key 'wurld'; allowed are title, world"]
  - [{world: "package://bullet_lab/none.world"}, "world is 'package://bullet_lab/none"]
  - [{robot: none.urdf}, "robot is 'none.urdf': "]
  - [{criteria: []}, 'criteria is \[\]: it must be a list of criteria']
  - [{criteria: [x]}, "criterion 1: measure is : it must be one of end_error"]
""")
def test_a_bad_exercise_gives_a_line_with_key_value_and_what_is_allowed(tmp_path, change, message):
    check_refused(tmp_path, yaml.safe_dump({**GOOD, **change}), f"^e.yaml: {message}")


@cases(r"""
criterion, message:
  - [{measure: speed}, "measure is speed: it must be one of end_error, path_error"]
  - [{measure: [rate]}, 'measure is \[''rate''\]: it must be one of']
  - [{measure: contacts}, at_least or at_most is missing]
  - - {measure: rate, at_least: 1, places: [[0, 0]]}
    - there is no key 'places'; allowed are measure, name, points, .*, topic, type
  - - {measure: path_error, at_most: 1, places: [1, 0]}
    - 'places is \[1, 0\]: it must be a list of places \[x, y\]'
  - - {measure: topic_std, at_most: 1, truth: z}
    - "truth is 'z': it must be one of zero, x, y, distance"
""")
def test_a_bad_criterion_gives_a_line_with_its_number(tmp_path, criterion, message):
    text = yaml.safe_dump({"criteria": [*GOOD["criteria"], criterion]})
    check_refused(tmp_path, text, f"^e.yaml: criterion 2: {message}")


@cases(r"""
text:
  - ""
  - "- 1"
  - "a: ["
  - "\u0000"
  - "5"
""")
def test_what_is_no_exercise_gives_a_line(tmp_path, text):
    check_refused(tmp_path, text, "e.yaml")


@cases("""
name:
  - squares
  - ""
  - none/of/them.yaml
""")
def test_an_unknown_exercise_names_those_that_are_known(tmp_path, name):
    with refuses(f"^exercise is '{name}': .*goal, noise, square"):
        find_exercise(name, tmp_path)


@cases("""
side, seen, measure, arguments, expected:
  # The side of the square, what else was seen, the measure and its arguments, and the value.
  - [0.9, {}, path_error, {places: [[1, 0], [1, 1], [0, 1]]}, 0.14142136]
  - [0.9, {}, end_error, {places: [[0.3, 0.4]]}, 0.5]
  - [1.0, {}, path_error, {places: [[1, 0], [1, 1], [0, 1]]}, 0.0]
  # The other way around: the path is at the second corner in time, but not at the third.
  - [1.0, {}, path_error, {places: [[0, 1], [1, 1], [1, 0]]}, 1.0]
  - [1.0, {boxes: {far: [9, 9, 10, 10], near: [1.3, 1.4, 2, 2]}}, clearance, {}, 0.5]
  - [1.0, {boxes: {over: [0.9, 0.9, 2, 2]}}, clearance, {}, 0.0]
  - [1.0, {}, clearance, {}, null]
  - [1.0, {touched: [wall, crate]}, contacts, {}, 2]
  - [1.0, {}, contacts, {}, 0]
  - [1.0, {status: 3}, exit_status, {}, 3]
  - [1.0, {}, exit_status, {}, null]
  - [1.0, {messages: {"a ": [[0.0, 0], [0.1, 0], [0.15, 0], [0.4, 0]]}}, rate, {}, 7.5]
  - [1.0, {messages: {"a ": [[1, 0]]}}, rate, {}, null]
  - [1.0, {messages: {"a ": [[1, 0], [1, 0]]}}, rate, {}, null]
  # A few messages are not enough.
  - - 1.0
    - messages: {a data: [[0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [5, 0], [6, 0], [7, 0], [8, 0]]}
    - topic_mean
    - {}
    - null
""")
def test_what_is_measured_of_a_square(side, seen, measure, arguments, expected):
    found = Criterion(measure=measure, topic="a", **arguments).value(
        Record(path=square(side), **seen)
    )
    assert found == (expected if expected is None else pytest.approx(expected))


@cases("measure: [contacts, clearance, end_error, path_error]")
def test_who_does_not_move_has_no_value(measure):
    standing = Record(path=[[t, 0.001 * t, 0] for t in range(5)], boxes={"a": [1, 1, 2, 2]})
    criterion = Criterion(measure=measure, at_most=9)
    assert criterion.value(standing) is None
    assert not criterion.holds(None)


@pytest.mark.parametrize("measure", MEASURES)
def test_an_empty_record_has_no_value(measure):
    assert Criterion(measure=measure).value(Record()) is None


@cases(r"""
content, error:
  - ["2.5", 0]
  - ["least: 2.75 m", 0.25]
  - ["1 2 -.5e0\n", 3]
  - [none, null]
  - [1e999, null]
""")
def test_the_last_number_of_a_file_counts(content, error):
    record = Record(path=square(), files={"a.txt": content})
    for file, expected in (("a.txt", error), ("b.txt", None)):
        assert Criterion(measure="file_error", file=file, number=2.5).value(record) == expected


@cases("sign: [1, -1]")
def test_errors_of_a_topic(sign):
    rng = np.random.default_rng(1)
    path = square()
    noise = sign * (0.5 + 0.1 * rng.standard_normal(len(path)))
    rows = [[t, np.hypot(x - 1, y - 1) + error] for (t, x, y), error in zip(path, noise)]
    record = Record(path=path, messages={"d data": rows})
    how = {"topic": "d", "truth": "distance", "places": ((1, 1),)}
    # Also a mean below the truth is an error.
    for name, expected, rel in (("std", 0.1, 0.15), ("mean", 0.5, 0.05), ("error", 0.66, 0.05)):
        found = Criterion(measure=f"topic_{name}", **how).value(record)
        assert found == pytest.approx(expected, rel=rel)


EXERCISE = Exercise(
    title="Drive",
    criteria=(
        Criterion(measure="end_error", name="ends at home", at_most=0.2, points=3),
        Criterion(measure="contacts", name="touches <nothing> & $no", at_most=0, points=2),
    ),
)


def test_points_are_those_of_criteria_that_hold_in_all_runs():
    good, bad = Record(path=square()), Record(path=square(), touched=["a"], notes=["x", "x"])
    assert grade("s", EXERCISE, [good])["points"] == 5
    mark = grade("s", EXERCISE, [good, bad])
    assert (mark["points"], mark["of"], mark["why"]) == (3, 5, ["x"])
    row = mark["criteria"][1]
    assert (row["passed"], row["points"], row["measured"]) == (False, 0, 1)
    assert row["wanted"] == "<= 0 models"


@pytest.mark.parametrize("record", [Record(), Record(path=square(), boxes={"a": [0, 0, 1, 1]})])
def test_a_mark_is_written_as_json_junit_and_picture(tmp_path, record):
    record.notes.append("it printed \x1b[31m red \ud800")
    mark = grade("näme \x00 \ud800 $x", EXERCISE, [record])
    write_grade(tmp_path, mark, EXERCISE, [record])
    assert json.loads((tmp_path / "grade.json").read_text()) == mark
    suite = ElementTree.parse(tmp_path / "grade.xml").getroot()
    failed = [case.get("name") for case in suite.iter("testcase") if case.findall("failure")]
    assert failed == [row["criterion"] for row in mark["criteria"] if not row["passed"]]
    assert suite.findtext("system-out") == "it printed ?[31m red ?"
    with Image.open(tmp_path / "grade.png") as picture:
        assert picture.width > 800


def test_limits_in_words():
    assert Criterion(measure="rate", at_least=5, at_most=6).wanted() == ">= 5 and <= 6 Hz"
    assert Criterion(measure="exit_status", at_least=0, at_most=0).wanted() == "0"
