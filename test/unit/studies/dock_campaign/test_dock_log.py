import pytest
from shared import cases, refuses

from bullet_lab.core.files import FileError
from bullet_lab.studies.dock_campaign.results import DockLog

PARAMETERS = {"seed": 1, "worlds": ("a", "b")}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "dockings.jsonl"


def record(index, **values):
    return {"index": index, "x": 0.1 + index, **values}


def written(path, *indices):
    log = DockLog(path, PARAMETERS)
    for index in indices:
        log.append(record(index))
    log.close()


@cases("kept: [1, -1]")
def test_a_half_written_last_line_is_cut_off(path, kept):
    written(path, 0, 1)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]) + lines[-1][:kept])
    log = DockLog(path, PARAMETERS)
    assert log.records == {0: record(0)}
    log.append(record(1))
    log.close()
    assert path.read_bytes() == b"".join(lines)


def test_a_half_written_first_line_is_a_new_campaign(path):
    path.write_bytes(b'{"camp')
    written(path, 0)
    assert len(path.read_text().splitlines()) == 2


def test_another_campaign_is_refused_with_what_differs(path):
    written(path, 0)
    before = path.read_bytes()
    with refuses(r"seed 1, not 2"):
        DockLog(path, {**PARAMETERS, "seed": 2})
    with refuses(r"worlds a b, not b"):
        DockLog(path, {**PARAMETERS, "worlds": ("b",)})
    assert path.read_bytes() == before


@cases("place: [0, 1]")
@cases(r"""
line:
  - "hello\n"
  - "[1]\n"
  - "{\"x\": 1}\n"
""")
def test_another_file_or_a_broken_line_is_refused(path, line, place):
    written(path, 0, 1)
    lines = path.read_text().splitlines(keepends=True)
    text = "".join([*lines[:place], line, *lines[place + 1 :]])
    path.write_text(text)
    with refuses(r"dockings\.jsonl is not the log of a campaign"):
        DockLog(path, PARAMETERS)
    assert path.read_text() == text


def test_a_folder_in_its_place_is_an_error_of_one_line(path):
    path.mkdir()
    with refuses("cannot write", FileError):
        DockLog(path, PARAMETERS)


def test_a_full_disk_is_an_error(path):
    log = DockLog(path, PARAMETERS)
    log.close()
    log._file = open("/dev/full", "w", buffering=1)  # noqa: SIM115
    with refuses("No space left", FileError):
        log.append(record(0))
    assert log.records == {}
    log.close()
