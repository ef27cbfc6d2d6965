"""Ctrl-C while a program imports its modules, whatever these make of it."""

import subprocess
import sys

import pytest

INTERRUPT = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
SWALLOWED = f"try:\n    exec({INTERRUPT!r})\nexcept KeyboardInterrupt:\n    pass\n"
MAIN = "def main():\n    print('started')\n"


@pytest.mark.parametrize("imported", [INTERRUPT, SWALLOWED, f"exec({INTERRUPT!r})\n"])
def test_an_interrupted_import_ends_it_with_130(tmp_path, imported):
    (tmp_path / "slow.py").write_text(imported + MAIN)
    (tmp_path / "program.py").write_text("from bullet_lab.entry import run\nrun('slow')\n")
    run = subprocess.run(
        [sys.executable, "-m", "program"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "")


def test_main_gets_the_interrupt_again(tmp_path):
    (tmp_path / "job.py").write_text(
        f"def main():\n    try:\n        exec({INTERRUPT!r})\n"
        "    except KeyboardInterrupt:\n        print('in order')\n"
    )
    (tmp_path / "program.py").write_text("from bullet_lab.entry import run\nrun('job')\n")
    run = subprocess.run(
        [sys.executable, "-m", "program"], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.stdout == "in order\n", run.stderr
