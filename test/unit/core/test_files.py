import json
import os
import stat

import pytest

from bullet_lab.core.files import FileError, make_folder, replace_file, write_json


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


def test_a_missing_folder_is_one_line(tmp_path):
    with pytest.raises(FileError, match="^cannot write .*: No such file or directory$"):
        replace_file(tmp_path / "nix" / "a", lambda part: None)


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
