"""What the shell scripts have in common."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_lab_is_found_through_a_link_to_its_scripts(tmp_path):
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    command = f"source {tmp_path}/scripts/environment.sh && echo $LAB_ROOT"
    run = subprocess.run(
        ["bash", "-c", command], stdout=subprocess.PIPE, text=True, check=True
    )
    assert run.stdout.strip() == str(ROOT)
