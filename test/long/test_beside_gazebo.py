"""All scenarios beside Gazebo's figures, through ROS: what agrees goes on to do so."""

import csv

from beside_gazebo import DEVIATE, names
from beside_table import FAILED
from programs import printed


def test_what_agrees_with_gazebo_through_ros(tmp_path):
    printed("scripts/beside_gazebo.sh", "--out", tmp_path, statuses=(0, 1))
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["scenario"] for row in rows} == set(names())
    failed = [row for row in rows if row["verdict"] == FAILED]
    assert [row for row in failed if not row["scenario"].startswith(DEVIATE)] == []
    assert (tmp_path / "cam.png").stat().st_size
