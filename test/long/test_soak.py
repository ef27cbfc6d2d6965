"""A soak of a minute, in two halves: nothing ends, and it goes on where it was."""

import csv
import json

from programs import printed


def soak(folder, hours):
    printed("scripts/soak.sh", "--hours", hours, "--out", folder)
    return json.loads((folder / "summary.json").read_text())


def test_a_soak_of_a_minute(tmp_path):
    soak(tmp_path, 0.5 / 60)
    summary = soak(tmp_path, 1 / 60)
    assert summary["segments"] == 2
    assert summary["hours"] >= 0.98 / 60
    assert summary["done"]
    with (tmp_path / "samples.csv").open() as file:
        assert {float(row["segment"]) for row in csv.DictReader(file)} == {1.0, 2.0}
    assert (tmp_path / "soak.png").stat().st_size
