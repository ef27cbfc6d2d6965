"""Files of results, series of rows, and names within a folder."""

import json
import math
import os
import stat

import pytest

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


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    parts = []

    def write(part):
        parts.append(part)
        part.write_text("new")
        assert path.read_text() == "old"

    with path.open() as reader:
        replace_file(path, write)
        # Who reads the old file meanwhile reads all of it.
        assert reader.read() == "old"
    assert path.read_text() == "new"
    assert parts[0].suffix == ".txt"
    assert list(tmp_path.iterdir()) == [path]


def test_the_old_file_stays_when_writing_fails(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail(error):
        def write(part):
            part.write_text("half of it")
            raise error

        return write

    with pytest.raises(RuntimeError):
        replace_file(path, fail(RuntimeError()))
    with pytest.raises(FileError, match=f"^cannot write {path}: No space left on device$"):
        replace_file(path, fail(OSError(28, os.strerror(28))))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_results_are_readable_as_the_umask_says(tmp_path):
    old = os.umask(0o027)
    try:
        replace_file(tmp_path / "a", lambda part: part.write_text("x"))
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_json_keeps_the_order(tmp_path):
    write_json(tmp_path / "a.json", {"b": 1, "a": [None, 0.5]})
    text = (tmp_path / "a.json").read_text()
    assert list(json.loads(text).items()) == [("b", 1), ("a", [None, 0.5])]
    assert text.endswith("}\n")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), object()])
def test_json_refuses_what_it_has_no_word_for(tmp_path, value):
    path = tmp_path / "a.json"
    path.write_text("old")
    with pytest.raises(FileError, match=f"^cannot write {path}: "):
        write_json(path, {"a": value})
    assert path.read_text() == "old"


def test_folders_are_made(tmp_path):
    assert make_folder(tmp_path / "a" / "b").is_dir()
    assert make_folder(tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    for bad in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(FileError, match=f"^cannot make the folder {bad}: "):
            make_folder(bad)


STEP = 50_000_000


def test_poses_are_in_the_file_at_once_and_those_after_the_end_are_left_out(tmp_path):
    path = tmp_path / "new" / "a.tum"
    series = PathSeries(path)
    for number in (1, 2, 3):
        series.add(STEP * number, (0.1 * number, 0.01 * number, 0.5))
    found = read_tum(path)
    assert found.stamps.tolist() == [0.05, 0.1, 0.15]
    assert found.poses[2, 1] == 0.01 * 3
    assert series.path().poses[:, :2].tolist() == found.poses[:, :2].tolist()
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


@pytest.mark.parametrize("stamp", [0, STEP])
def test_time_does_not_go_back(tmp_path, stamp):
    series = PathSeries(tmp_path / "a")
    series.add(STEP, (0.0, 0.0, 0.0))
    with pytest.raises(LabError, match=r"^time goes back from 0\.050000000 s to "):
        series.add(stamp, (0.0, 0.0, 0.0))
    assert len(series) == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_poses_are_finite(tmp_path, bad):
    series = PathSeries(tmp_path / "a")
    with pytest.raises(LabError, match="^the pose is not finite"):
        series.add(STEP, (0.0, bad, 0.0))
    assert series.last is None
    assert (tmp_path / "a").read_text() == ""


def test_rows_in_any_order_are_put_in_order_at_the_end(tmp_path):
    series = Series(tmp_path / "a", ["x"], in_order=False)
    for stamp, value in ((2 * STEP, 1), (STEP, 2), (2 * STEP, 3)):
        series.add(stamp, [value])
    assert series.last == 2 * STEP
    series.finish()
    assert (tmp_path / "a").read_text() == "stamp,x\n0.050000000,2.0\n0.100000000,3.0\n"


@pytest.mark.parametrize("values", [(1.0,), (math.nan, 1.0)])
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
    join = Join(("a", "b"), lambda stamp, values: whole.append((stamp, values)))
    join.add("a", STEP, [1.0])
    join.add("b", STEP + 1, [2.0])
    join.add("b", STEP, [3.0])
    join.add("a", STEP + 1, [4.0])
    assert whole == [(STEP, {"a": [1.0], "b": [3.0]}), (STEP + 1, {"a": [4.0], "b": [2.0]})]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "own" / "inner").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    return (tmp_path / "own").resolve()


def all_files(path):
    return sorted(str(one.relative_to(path)) for one in path.rglob("*") if one.is_file())


def write(folder, name, text="text"):
    replace_file(place_within(folder, name), lambda part: part.write_text(text, encoding="utf-8"))


def test_writes_into_the_folder_and_below(folder, tmp_path):
    for name in ("a", "inner/b", f"{folder}/c", "inner/../d", "a"):
        write(folder, name, name)
    assert all_files(tmp_path) == ["own/a", "own/c", "own/d", "own/inner/b"]
    assert (folder / "d").read_text() == "inner/../d"


def test_a_file_is_for_whoever_may_read_the_folder(folder):
    write(folder, "a")
    umask = os.umask(0)
    os.umask(umask)
    assert (folder / "a").stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("name", ["../a", "/a", "out/a", "file_out", "inner/../../a", ".", "inner"])
def test_refuses_what_is_elsewhere_or_a_folder(folder, tmp_path, name):
    (folder / "out").symlink_to(tmp_path / "elsewhere")
    (folder / "file_out").symlink_to(tmp_path / "elsewhere" / "a")
    with pytest.raises(FileError, match="is not in|is a folder"):
        write(folder, name)
    assert all_files(tmp_path) == []


def test_a_link_within_the_folder_may_be_followed(folder):
    (folder / "link").symlink_to("inner")
    write(folder, "link/a")
    assert (folder / "inner" / "a").read_text() == "text"


def test_a_link_in_the_place_of_the_file_is_replaced(folder, tmp_path):
    place = place_within(folder, "a")
    place.symlink_to(tmp_path / "elsewhere" / "a")
    replace_file(place, lambda part: part.write_text("text"))
    assert not place.is_symlink()
    assert all_files(tmp_path) == ["own/a"]


def test_what_cannot_be_written_leaves_nothing(folder):
    with pytest.raises(UnicodeError):
        write(folder, "a", "\ud800")
    assert all_files(folder) == []


def test_the_folder_is_the_one_that_it_was_at_first(folder, tmp_path):
    (folder / "inner").rmdir()
    folder.rmdir()
    folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileError):
        write(folder, "a")
    assert all_files(tmp_path) == []
