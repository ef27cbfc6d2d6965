"""What the grader is asked for, and which marks it keeps."""

import json

import pytest
import yaml

from bullet_lab.errors import LabError
from bullet_lab.ros.grade.grade import Grader, GradeSettings, _run

# Settings, and the line that refuses them.
REFUSED = """
- [{}, "^submission or class is needed, one of the two: the folder to grade$"]
- [{submission: a, class_folder: a}, ^submission or class is needed]
- [{submission: none}, none]
- [{submission: file}, "^there are no submissions in 'file'$"]
- [{class_folder: file}, "^there are no submissions in 'file'$"]
- [{class_folder: hidden}, "^there are no submissions in 'hidden'$"]
"""


@pytest.mark.parametrize("given, line", yaml.safe_load(REFUSED))
def test_what_cannot_be_graded_is_named(tmp_path, given, line):
    (tmp_path / "file").touch()
    (tmp_path / "hidden" / ".git").mkdir(parents=True)
    settings = GradeSettings(exercise="square", base=str(tmp_path), **given)
    with pytest.raises(LabError, match=line):
        _run(tmp_path, settings, print)


# Types and fields that have no number.
FIELDS = """
- [nav_msgs/Odometry, pose.x]
- [nav_msgs/Odometry, pose]
- [std_msgs/Flaot64, data]
- [Float64, data]
- [std_msgs/String, data]
"""


@pytest.mark.parametrize("kind, field", yaml.safe_load(FIELDS))
def test_a_field_that_is_no_number_is_named_before_anything_runs(tmp_path, kind, field):
    file = tmp_path / "e.yaml"
    limits = f"measure: topic_mean, topic: a, type: {kind}, field: {field}, at_most: 0"
    file.write_text(f"criteria: [{{measure: contacts, at_most: 0}}, {{{limits}}}]")
    line = f"^e.yaml: criterion 2: field '{field}' of type '{kind}': there is no such number$"
    with pytest.raises(LabError, match=line):
        _run(tmp_path, GradeSettings(exercise=str(file), submission="a"), print)


@pytest.fixture
def grader(tmp_path):
    """The grader of one empty submission by one criterion."""
    (tmp_path / "e.yaml").write_text("criteria: [{measure: contacts, at_most: 0}]")
    (tmp_path / "a").mkdir()
    return Grader(tmp_path / "e.yaml", [tmp_path / "a"], [tmp_path / "marks"])


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
        mark.write_text(json.dumps({"files": grader._digest(0)}))
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
