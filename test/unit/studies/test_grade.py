"""Exercises are checked, runs are measured, and marks are written."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from PIL import Image

from bullet_lab.errors import LabError
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

ROOT = Path(__file__).parents[3]
GOOD = {"criteria": [{"measure": "contacts", "at_most": 0}]}


def square(side=1.0, steps=50):
    """Return rows t, x, y along a square."""
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]) * side
    t = np.linspace(0, 4, 4 * steps + 1)
    x, y = (np.interp(t, range(5), corners[:, k]) for k in (0, 1))
    return np.column_stack((t, x, y)).tolist()


def value(record, measure, **arguments):
    return Criterion(measure=measure, **arguments).value(record)


@pytest.mark.parametrize("path", sorted((ROOT / EXERCISES).glob("*.yaml")), ids=lambda p: p.stem)
def test_each_exercise_can_be_read_and_has_ten_points(path):
    exercise = read_exercise(path)
    assert sum(criterion.points for criterion in exercise.criteria) == 10
    assert exercise.title
    assert find_exercise(path.stem, Path("/")) == path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rtf": "fast"}, "e.yaml: rtf is 'fast': it must be a number > 0 and <= 100"),
        ({"runs": 0}, "e.yaml: runs is 0: it must be a whole number from 1 to 100"),
        ({"start": "1 2"}, "e.yaml: start is '1 2': it must be 3 finite numbers"),
        ({"wurld": "a"}, "e.yaml: there is no key 'wurld'; allowed are title, world"),
        ({"world": "package://bullet_lab/none.world"}, "^e.yaml: world is 'package://bullet_lab/none"),
        ({"robot": "none.urdf"}, "^e.yaml: robot is 'none.urdf': "),
        ({"criteria": []}, r"e.yaml: criteria is \[\]: it must be a list of criteria"),
        ({"criteria": 5}, "e.yaml: criteria is 5: it must be a list of criteria"),
        ({"criteria": ["x"]}, "e.yaml: criterion 1: measure is : it must be one of end_error"),
        (
            {"criteria": [{"measure": "speed", "at_most": 1}]},
            "e.yaml: criterion 1: measure is speed: it must be one of end_error, path_error",
        ),
        (
            {"criteria": [{"measure": ["rate"], "at_most": 1}]},
            r"e.yaml: criterion 1: measure is \['rate'\]: it must be one of",
        ),
        (
            {"criteria": [*GOOD["criteria"], {"measure": "contacts"}]},
            "e.yaml: criterion 2: at_least or at_most is missing",
        ),
        (
            {"criteria": [{"measure": "rate", "at_least": "a few"}]},
            "e.yaml: criterion 1: at_least is 'a few': it must be a number",
        ),
        (
            {"criteria": [{"measure": "rate", "at_least": 1, "places": [[0, 0]]}]},
            "there is no key 'places'; allowed are measure, name, points, .*, topic, type",
        ),
        (
            {"criteria": [{"measure": "path_error", "at_most": 1, "places": [1, 0]}]},
            r"places is \[1, 0\]: it must be a list of places \[x, y\]",
        ),
        (
            {"criteria": [{"measure": "topic_std", "at_most": 1, "truth": "z"}]},
            "truth is 'z': it must be one of zero, x, y, distance",
        ),
    ],
)
def test_a_bad_exercise_gives_a_line_with_key_value_and_what_is_allowed(tmp_path, change, message):
    path = tmp_path / "e.yaml"
    path.write_text(yaml.safe_dump({**GOOD, **change}))
    with pytest.raises(LabError, match=message) as refusal:
        read_exercise(path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("text", ["", "- 1", "a: [", "\x00", "5"])
def test_what_is_no_exercise_gives_a_line(tmp_path, text):
    path = tmp_path / "e.yaml"
    path.write_text(text)
    with pytest.raises(LabError, match="e.yaml") as refusal:
        read_exercise(path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["squares", "", "none/of/them.yaml"])
def test_an_unknown_exercise_names_those_that_are_known(tmp_path, name):
    with pytest.raises(LabError, match=f"^exercise is '{name}': .*goal, noise, square"):
        find_exercise(name, tmp_path)


def test_errors_of_a_path():
    record = Record(path=square(0.9))
    corners = ((1, 0), (1, 1), (0, 1))
    assert value(record, "path_error", places=corners) == pytest.approx(0.1 * 2**0.5)
    assert value(record, "end_error", places=((0.3, 0.4),)) == pytest.approx(0.5)


def test_places_have_to_be_passed_in_their_order():
    record = Record(path=square())
    assert value(record, "path_error", places=((1, 0), (1, 1), (0, 1))) == pytest.approx(0)
    # The other way around: the path is at the second corner in time, but not at the third.
    assert value(record, "path_error", places=((0, 1), (1, 1), (1, 0))) == pytest.approx(1)


def test_clearance_is_that_of_the_nearest_box():
    boxes = {"far": [9, 9, 10, 10], "near": [1.3, 1.4, 2, 2]}
    record = Record(path=square(), boxes=boxes)
    assert value(record, "clearance") == pytest.approx(0.5)
    assert value(Record(path=square(), boxes={"over": [0.9, 0.9, 2, 2]}), "clearance") == 0
    assert value(Record(path=square()), "clearance") is None


def test_contacts_are_counted():
    assert value(Record(path=square(), touched=["wall", "crate"]), "contacts") == 2
    assert value(Record(path=square()), "contacts") == 0


@pytest.mark.parametrize("measure", ["contacts", "clearance", "end_error", "path_error"])
def test_who_does_not_move_has_no_value(measure):
    standing = Record(path=[[t, 0.001 * t, 0] for t in range(5)], boxes={"a": [1, 1, 2, 2]})
    assert value(standing, measure) is None
    assert not Criterion(measure=measure, at_most=9).holds(None)


@pytest.mark.parametrize("measure", MEASURES)
def test_an_empty_record_has_no_value(measure):
    assert value(Record(), measure) is None


def test_exit_status_is_missing_of_what_did_not_end():
    assert value(Record(path=square(), status=3), "exit_status") == 3
    assert value(Record(path=square()), "exit_status") is None


@pytest.mark.parametrize(
    ("content", "error"),
    [("2.5", 0), ("least: 2.75 m", 0.25), ("1 2 -.5e0\n", 3), ("none", None), ("1e999", None)],
)
def test_the_last_number_of_a_file_counts(content, error):
    record = Record(path=square(), files={"a.txt": content})
    assert value(record, "file_error", file="a.txt", number=2.5) == error
    assert value(record, "file_error", file="b.txt", number=2.5) is None


def test_rate_is_that_of_simulated_time():
    rows = [[0.1 * k, 0] for k in range(31)]
    record = Record(path=square(), messages={"a ": rows, "b ": rows[:1], "c ": [[1, 0], [1, 0]]})
    assert value(record, "rate", topic="a") == pytest.approx(10)
    assert value(record, "rate", topic="b") is None
    assert value(record, "rate", topic="c") is None


@pytest.mark.parametrize("sign", [1, -1])
def test_errors_of_a_topic(sign):
    rng = np.random.default_rng(1)
    path = square()
    truth = [np.hypot(x - 1, y - 1) for _, x, y in path]
    noise = sign * (0.5 + 0.1 * rng.standard_normal(len(path)))
    rows = [[t, true + error] for (t, _, _), true, error in zip(path, truth, noise)]
    record = Record(path=path, messages={"d data": rows})
    how = {"topic": "d", "truth": "distance", "places": ((1, 1),)}
    assert value(record, "topic_std", **how) == pytest.approx(0.1, rel=0.15)
    # Also a mean below the truth is an error.
    assert value(record, "topic_mean", **how) == pytest.approx(0.5, rel=0.05)
    assert value(record, "topic_error", **how) == pytest.approx(0.66, rel=0.05)


def test_a_few_messages_are_not_enough():
    record = Record(path=square(), messages={"d data": [[k, 0] for k in range(9)]})
    assert value(record, "topic_mean", topic="d") is None


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
