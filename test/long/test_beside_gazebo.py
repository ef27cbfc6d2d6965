"""All scenarios beside Gazebo's figures, through ROS: what agrees goes on to do so."""

import csv
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "test" / "gazebo"))
from beside_gazebo import HOLDS, names  # noqa: E402
from beside_table import FAILED  # noqa: E402

SECONDS = 900


def test_what_agrees_with_gazebo_through_ros(tmp_path):
    command = [str(ROOT / "scripts" / "beside_gazebo.sh"), "--out", str(tmp_path)]
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=SECONDS
    )
    assert done.returncode in (0, 1), done.stdout
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["scenario"] for row in rows} == set(names())
    failed = [row for row in rows if row["verdict"] == FAILED and row["scenario"] in HOLDS]
    assert failed == []
    assert (tmp_path / "cam.png").stat().st_size
