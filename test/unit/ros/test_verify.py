"""Two runs are compared by their bytes, and with references by their numbers."""

import json
import os

import numpy as np
from alike import lines_of
from PIL import Image
from shared import PACKAGE, cases, refuses

from bullet_lab.jobs.declaration import find_jobs
from bullet_lab.ros import verify
from bullet_lab.ros.verify import (
    LEFT_OUT,
    REFERENCES,
    TOLERANCES,
    UNREPEATABLE,
    FileRow,
    compared,
    fingerprint,
    read_references,
    run_job,
    table,
)

JOBS = find_jobs(PACKAGE)


def of(tmp_path, name, text, **more):
    path = tmp_path / name
    path.write_text(text)
    return fingerprint(path, **more)


ROWS = "stamp,x,word\n0.0,1.0,go\n1.0,3.0,\n2.0,inf,go\n"
RUN = {"docked": True, "run": {"sim_time_s": 2, "wall_time_s": 1.0}, "world": "w", "at": [1, 3]}
# A table and a path are their columns, any other file is the numbers in it.
FILES = {
    "a.csv": ROWS,
    "a.tum": "0 1 2 0 0 0 0 1\n1 3 2 0 0 0 0 1\n",
    "a.json": json.dumps(RUN),
    "a.world": "<pose>1 -2.5 3e-1 box2</pose>",
}


def test_each_kind_of_file_has_its_numbers(tmp_path, as_before):
    found = {name: of(tmp_path, name, text) for name, text in FILES.items()}
    pixels = np.zeros((4, 6, 3), dtype=np.uint8)
    pixels[:2, :, 0] = 200
    Image.fromarray(pixels).save(tmp_path / "a.png")
    found["a.png"] = fingerprint(tmp_path / "a.png")
    told = [line for name, one in found.items() for line in lines_of(one["numbers"], name)]
    as_before(told, "fingerprints.txt")


def test_tables_are_compared_by_their_bytes(tmp_path):
    found = of(tmp_path, "a.csv", ROWS)
    assert found == of(tmp_path, "b.csv", ROWS)
    assert found["hash"] != of(tmp_path, "c.csv", ROWS.replace("3.0,", "3.0,x"))["hash"]


def test_json_is_compared_without_keys_of_the_wall_clock(tmp_path):
    def of_run(**more):
        return of(tmp_path, "a.json", json.dumps({**RUN, "run": {"sim_time_s": 2, **more}}))

    found = of_run(wall_time_s=1.0)
    assert found == of_run(wall_time_s=2.0, real_time_factor=3.0)
    assert found != of_run(steps=1)


def test_invalid_json_is_refused(tmp_path):
    with refuses(r"cannot read .*a\.json"):
        of(tmp_path, "a.json", "{")


@cases("""
first, second, reference, tolerance, row:
  # Both runs and the reference, each with its hash and x; tolerance. Whether the runs are alike,
  # what the reference says, the difference, whether all is well.
  - [[a, 1.0], [a, 1.0], [a, 1.0], 0.0, [true, same, 0.0, true]]
  - [[a, 1.0], [b, 1.0], [a, 1.0], 0.0, [false, same, 0.0, false]]
  - [[a, 1.0], [a, 1.0], [b, 1.25], 0.3, [true, within, 0.2, true]]
  - [[a, 1.0], [a, 1.0], [b, 1.25], 0.1, [true, differs, 0.2, false]]
  - [[a, 1.0], [a, 1.0], [b, 1.0], 0.0, [true, differs, 0.0, false]]
  - [[a, 1.0], [a, 1.0], null, 0.0, [true, none, null, true]]
  - [[a, 1.0], null, [a, 1.0], 0.0, [false, same, 0.0, false]]
  - [null, null, [a, 1.0], 0.0, [false, differs, null, false]]
""")
def test_a_result_is_compared(first, second, reference, tolerance, row, monkeypatch):
    def results(of_one):
        return {"x.csv": {"hash": of_one[0], "numbers": {"x": of_one[1]}}} if of_one else {}

    monkeypatch.setattr(verify, "TOLERANCES", {"j": tolerance})
    found = list(compared("j", *map(results, (first, second, reference))))
    assert [[r.twice, r.reference, r.difference, r.good] for r in found] == [row]


TABLE = """job      file      twice    reference  largest difference
squares  odom.tum  DIFFERS  DIFFERS    5.0e-01 of x mean
dock     a         same     none"""


def test_the_table_shows_what_is_wrong():
    wrong = FileRow("squares", "odom.tum", False, "differs", 0.5, "x mean")
    assert table([wrong, FileRow("dock", "a", True)]) == TABLE.splitlines()


def test_references_that_are_none_are_refused(tmp_path):
    (tmp_path / "a.json").write_text("[]")
    with refuses(r"cannot use .*a\.json"):
        read_references(tmp_path / "a.json")


def test_a_job_that_does_not_repeat_is_refused(tmp_path):
    with refuses("^there is no job 'grade'"):
        verify._run(tmp_path, verify.VerifySettings(jobs=("squares", "grade")), print)


def test_each_exception_and_reference_has_a_job():
    others = set(JOBS) - set(UNREPEATABLE)
    assert set(read_references(PACKAGE / REFERENCES)[1]) <= others
    assert {*TOLERANCES, *LEFT_OUT} <= others
    assert set(UNREPEATABLE) <= set(JOBS)


def test_a_job_that_fails_leaves_its_status_and_its_last_line(tmp_path):
    unknown = JOBS["squares"]._replace(name="nix")
    failure = run_job(unknown, tmp_path / "nix" / "first", os.environ)
    status, _, last_line = failure.partition(": ")
    assert (status, "nix" in last_line) == ("status 2", True)
    assert (tmp_path / "nix" / "first.log").read_text().strip().endswith(last_line)
