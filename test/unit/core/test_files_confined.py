import os

import pytest

from bullet_lab.core.files import ConfinedFolder, FileError


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "own" / "inner").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    return ConfinedFolder(tmp_path / "own")


def all_files(path):
    return sorted(str(one.relative_to(path)) for one in path.rglob("*") if one.is_file())


def write(folder, name, text="text"):
    folder.write(folder.place(name), text)


def test_writes_into_the_folder_and_below(folder, tmp_path):
    for name in ("a", "inner/b", f"{folder.path}/c", "inner/../d", "a"):
        write(folder, name, name)
    assert all_files(tmp_path) == ["own/a", "own/c", "own/d", "own/inner/b"]
    assert (folder.path / "d").read_text() == "inner/../d"


def test_a_file_is_for_whoever_may_read_the_folder(folder):
    write(folder, "a")
    umask = os.umask(0)
    os.umask(umask)
    assert (folder.path / "a").stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("name", ["../a", "/a", "out/a", "file_out", "inner/../../a", ".", "inner"])
def test_refuses_what_is_elsewhere_or_a_folder(folder, tmp_path, name):
    (folder.path / "out").symlink_to(tmp_path / "elsewhere")
    (folder.path / "file_out").symlink_to(tmp_path / "elsewhere" / "a")
    with pytest.raises(FileError, match="is not in|is a folder"):
        write(folder, name)
    assert all_files(tmp_path) == []


def test_a_link_within_the_folder_may_be_followed(folder):
    (folder.path / "link").symlink_to("inner")
    write(folder, "link/a")
    assert (folder.path / "inner" / "a").read_text() == "text"


def test_a_link_that_comes_into_the_way_is_not_followed(folder, tmp_path):
    place = folder.place("inner/a")
    (folder.path / "inner").rmdir()
    (folder.path / "inner").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileError, match="cannot write"):
        folder.write(place, "text")
    assert all_files(tmp_path) == []


def test_a_link_in_the_place_of_the_file_is_replaced(folder, tmp_path):
    place = folder.place("a")
    place.symlink_to(tmp_path / "elsewhere" / "a")
    folder.write(place, "text")
    assert not place.is_symlink()
    assert all_files(tmp_path) == ["own/a"]


def test_a_hard_link_to_another_file_is_replaced(folder, tmp_path):
    precious = tmp_path / "elsewhere" / "precious"
    precious.write_text("as it was")
    os.link(precious, folder.path / "a")
    write(folder, "a")
    assert precious.read_text() == "as it was"


def test_what_cannot_be_written_leaves_nothing(folder):
    with pytest.raises(UnicodeError):
        write(folder, "a", "\ud800")
    assert all_files(folder.path) == []


def test_the_folder_is_the_one_that_it_was_at_first(folder, tmp_path):
    (folder.path / "inner").rmdir()
    folder.path.rmdir()
    folder.path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileError):
        write(folder, "a")
    assert all_files(tmp_path) == []
