"""Files of results, series of rows, and names within a folder."""

import json
import math
import os
import stat

import pytest
from shared import cases

from bullet_lab.core.files import (
    FileError,
    Join,
    PathSeries,
    Series,
    make_folder,
    place_within,
    replace_file,
    write_json,
)
from bullet_lab.core.trajectory import read_tum
from bullet_lab.errors import LabError


@pytest.fixture
def old(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    return path


def test_a_file_is_replaced_and_nothing_else_is_left(old, tmp_path):
    def write(part):
        assert part.suffix == ".txt"
        part.write_text("new")
        assert old.read_text() == "old"

    with old.open() as reader:
        replace_file(old, write)
        # Who reads the old file meanwhile reads all of it.
        assert reader.read() == "old"
    assert old.read_text() == "new"
    assert list(tmp_path.iterdir()) == [old]


@pytest.mark.parametrize(
    "error, message",
    [(RuntimeError("why"), "^why$"), (OSError(28, "full"), "^cannot write .*a.txt: full$")],
)
def test_the_old_file_stays_when_writing_fails(old, tmp_path, error, message):
    def write(part):
        part.write_text("half of it")
        raise error

    with pytest.raises((RuntimeError, FileError), match=message):
        replace_file(old, write)
    assert old.read_text() == "old"
    assert list(tmp_path.iterdir()) == [old]


def test_results_are_readable_as_the_umask_says(tmp_path):
    before = os.umask(0o027)
    try:
        write(tmp_path, "a")
    finally:
        assert os.umask(before) == 0o027
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_json_keeps_the_order(tmp_path):
    write_json(tmp_path / "a.json", {"b": 1, "a": [None, 0.5]})
    text = (tmp_path / "a.json").read_text()
    assert list(json.loads(text).items()) == [("b", 1), ("a", [None, 0.5])]
    assert text.endswith("}\n")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), object()])
def test_json_refuses_what_it_has_no_word_for(old, value):
    with pytest.raises(FileError, match=f"^cannot write {old}: "):
        write_json(old, {"a": value})
    assert old.read_text() == "old"


def test_folders_are_made(tmp_path):
    for _ in range(2):
        assert make_folder(tmp_path / "a" / "b").is_dir()
    write(tmp_path, "file")
    for bad in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(FileError, match=f"^cannot make the folder {bad}: "):
            make_folder(bad)


STEP = 50_000_000


def test_poses_are_in_the_file_at_once_and_those_after_the_end_are_left_out(tmp_path):
    path = tmp_path / "new" / "a.tum"
    series = PathSeries(path)
    for number in (1, 2, 3):
        series.add(STEP * number, (0.1 * number, 0.01 * number, 0.5))
    found, held = read_tum(path), series.path()
    assert found.stamps.tolist() == [0.05, 0.1, 0.15]
    assert found.poses[2, 1] == 0.01 * 3
    assert held.poses[:, :2].tolist() == found.poses[:, :2].tolist()
    assert series.last == 3 * STEP
    series.finish(2 * STEP)
    assert len(read_tum(path)) == len(series) == len(series.path()) == 2
    series.finish(0)
    assert series.path() is None


def test_rows_are_in_the_file_at_once_and_may_be_infinite(tmp_path):
    series = Series(tmp_path / "a.csv", ("x", "y"))
    assert series.last is None
    assert series.table()[1].shape == (0, 2)
    series.add(STEP, (1, math.inf))
    assert (tmp_path / "a.csv").read_text() == "stamp,x,y\n0.050000000,1.0,inf\n"
    stamps, rows = series.table()
    assert (stamps.tolist(), rows.tolist()) == ([0.05], [[1.0, math.inf]])


@cases(r"""
step, x, message:
  - [0, 0.0, '^time goes back from 0\.050000000 s to ']
  - [1, 0.0, '^time goes back from 0\.050000000 s to ']
  - [2, .nan, ^the pose is not finite]
  - [2, .inf, ^the pose is not finite]
""")
def test_a_path_refuses_times_that_go_back_and_poses_that_are_not_finite(
    tmp_path, step, x, message
):
    series = PathSeries(tmp_path / "a")
    series.add(STEP, (0.0, 0.0, 0.0))
    before = (tmp_path / "a").read_text()
    with pytest.raises(LabError, match=message):
        series.add(step * STEP, (0.0, x, 0.0))
    assert (series.last, len(series)) == (STEP, 1)
    assert (tmp_path / "a").read_text() == before


def test_rows_in_any_order_are_put_in_order_at_the_end(tmp_path):
    series = Series(tmp_path / "a", ["x"], in_order=False)
    for stamp, value in ((2 * STEP, 1), (STEP, 2), (2 * STEP, 3)):
        series.add(stamp, [value])
    assert series.last == 2 * STEP
    series.finish()
    assert (tmp_path / "a").read_text() == "stamp,x\n0.050000000,2.0\n0.100000000,3.0\n"


@cases("values: [[1.0], [.nan, 1.0]]")
def test_rows_that_are_refused(tmp_path, values):
    series = Series(tmp_path / "a.csv", ("x", "y"))
    with pytest.raises(LabError):
        series.add(STEP, values)
    assert len(series) == 0


def test_a_full_disk_is_one_line(tmp_path):
    (tmp_path / "rows.csv").symlink_to("/dev/full")
    with pytest.raises(FileError, match="No space left"):
        Series(tmp_path / "rows.csv", "ab").add(0, (1.0, 2.0))


def test_rows_are_joined_by_the_nanosecond_whatever_comes_first():
    whole = []
    join = Join(("a", "b"), lambda *both: whole.append(both))
    for source, stamp, value in (("a", 1, 1.0), ("b", 2, 2.0), ("b", 1, 3.0), ("a", 2, 4.0)):
        join.add(source, STEP + stamp, [value])
    assert whole == [(STEP + 1, {"a": [1.0], "b": [3.0]}), (STEP + 2, {"a": [4.0], "b": [2.0]})]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "own" / "inner").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    return (tmp_path / "own").resolve()


def all_files(path):
    return sorted(str(one.relative_to(path)) for one in path.rglob("*") if one.is_file())


def write(folder, name, text="text"):
    replace_file(place_within(folder, name), lambda part: part.write_text(text))


def test_writes_into_the_folder_and_below(folder, tmp_path):
    (folder / "link").symlink_to("inner")
    for name in ("a", "link/b", f"{folder}/c", "inner/../d", "a"):
        write(folder, name, name)
    assert all_files(tmp_path) == ["own/a", "own/c", "own/d", "own/inner/b"]
    assert (folder / "d").read_text() == "inner/../d"


@cases("name: [../a, /a, out/a, file_out, inner/../../a, ., inner, missing/a]")
def test_refuses_what_is_elsewhere_or_a_folder(folder, tmp_path, name):
    (folder / "out").symlink_to(tmp_path / "elsewhere")
    (folder / "file_out").symlink_to(tmp_path / "elsewhere" / "a")
    with pytest.raises(FileError, match="is not in|is a folder|is no folder"):
        write(folder, name)
    assert all_files(tmp_path) == []


def test_a_link_in_the_place_of_the_file_is_replaced(folder, tmp_path):
    place = place_within(folder, "a")
    place.symlink_to(tmp_path / "elsewhere" / "a")
    replace_file(place, lambda part: part.write_text("text"))
    assert not place.is_symlink()
    assert all_files(tmp_path) == ["own/a"]


def test_the_folder_is_the_one_that_it_was_at_first(folder, tmp_path):
    (folder / "inner").rmdir()
    folder.rmdir()
    folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileError):
        write(folder, "a")
    assert all_files(tmp_path) == []
