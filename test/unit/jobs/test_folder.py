import os

import pytest
from shared import refuses

from bullet_lab.jobs.command import OutputFolder, shown
from bullet_lab.jobs.declaration import UsageError


def test_second_run_on_the_same_folder_is_refused_until_the_first_ends(tmp_path):
    folder = tmp_path / "a" / "b"
    with OutputFolder(folder) as out:
        (folder / "summary.json").write_text("{}")
        with refuses("another run is writing", UsageError):
            OutputFolder(folder).__enter__()
        # It leaves the summary of the first alone.
        assert out.has_summary()
    with OutputFolder(folder) as out:
        # That of an earlier run does not count.
        assert not out.has_summary()
        (folder / "summary.json").write_text("{}")
        assert out.has_summary()


def test_a_run_has_finished_unless_its_summary_denies_it(tmp_path):
    with OutputFolder(tmp_path) as out:
        assert not out.is_finished()
        for text, finished in (('{"a', False), ('{"finished": false}', False), ("{}", True)):
            (tmp_path / "summary.json").write_text(text)
            assert out.is_finished() is finished


def test_only_files_of_this_run_are_listed(tmp_path):
    for name in ("old.png", "again.csv"):
        (tmp_path / name).write_text("before")
        os.utime(tmp_path / name, (1, 1))
    with OutputFolder(tmp_path) as out:
        (tmp_path / "again.csv").write_text("now")
        (tmp_path / "new.png").write_text("now")
        (out.log / "a.log").write_text("now")
        assert [path.name for path in out.written()] == ["again.csv", "new.png"]


def test_partial_files_of_a_killed_program_are_deleted(tmp_path):
    with OutputFolder(tmp_path / "out") as out:
        (out.path / ".part_1" / "deeper").mkdir(parents=True)
        (out.log / ".part_2.png").write_text("")
        with pytest.raises(UsageError):
            OutputFolder(out.path).__enter__()
        # The partial file of another run, which writes to a subfolder.
        (out.path / "other").mkdir()
        (out.path / "other" / ".part_3").write_text("")
        assert len(list(out.path.rglob(".part_*"))) == 3
    assert [path.name for path in out.path.rglob(".part_*")] == [".part_3"]


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "deeper"):
        with refuses(f"cannot make the folder {path}", UsageError):
            OutputFolder(path).__enter__()


def test_paths_are_shown_relative_to_the_current_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shown(tmp_path / "a" / "b") == "a/b"
    assert shown(tmp_path.parent) == str(tmp_path.parent)


def test_only_logs_of_a_run_keep_their_folder(tmp_path):
    with OutputFolder(tmp_path) as out:
        assert out.log.is_dir()
    assert not out.log.exists()
    with OutputFolder(tmp_path) as out:
        (out.log / "node.log").write_text("started")
    assert out.log.is_dir()
