"""Every job at its full length, and every job interrupted: a new launch file is covered here."""

import json
import os
import shlex
import signal
import subprocess
import time
import zlib

import numpy as np
import pytest
from programs import LONGEST, PACKAGE

from bullet_lab.jobs.declaration import find_jobs

JOBS = find_jobs(PACKAGE)
assert "squares" in JOBS
# Without a submission there is nothing to grade.
NEEDED = {"grade": shlex.split(JOBS["grade"].smallest)}
KOBUKI = PACKAGE / "urdf" / "kobuki_robot.urdf"
# Other ways that jobs go than by default, on top of those that rostests take.
WAYS = [
    "dock world:=docking_dots odom:=noisy_odom x:=1.2 y:=0.3 yaw:=-30",
    "dock world:=docking_nested x:=1.0 y:=-0.3 yaw:=20",
    "dock world:=docking_decoy x:=1.5 y:=0.4 yaw:=10",
    f"dock robot:={KOBUKI} cmd_vel:=mobile_base/commands/velocity",
    # It fails unless all goals are reached without a contact.
    "goal world:=house goals:=20 seed:=1",
]
INTERRUPTED = 130
# Wall seconds: while roslaunch starts, or while the job is at work.
LATEST_SIGNAL = 8.0


def start(job, folder, *words):
    """Start a job in a process group of its own, as a terminal does."""
    return subprocess.Popen(
        [str(PACKAGE / "scripts" / "run.sh"), job, f"out:={folder}", *NEEDED.get(job, ()), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def processes_of(session):
    """Return the command lines of what still runs in a session."""
    done = subprocess.run(["ps", "-o", "args=", "-s", str(session)], capture_output=True, text=True)
    return [line for line in done.stdout.splitlines() if line]


@pytest.mark.parametrize("way", [*JOBS, *WAYS])
def test_a_job_runs_and_leaves_its_results(way, tmp_path):
    job, *words = way.split()
    process = start(job, tmp_path, *words)
    printed, _ = process.communicate(timeout=LONGEST)
    assert process.returncode == 0, printed
    assert isinstance(json.loads((tmp_path / "summary.json").read_text()), dict)
    assert "Traceback" not in printed
    assert not processes_of(process.pid)


@pytest.mark.parametrize("job", JOBS)
def test_an_interrupted_job_says_so_and_leaves_nothing_running(job, tmp_path):
    process = start(job, tmp_path)
    time.sleep(np.random.default_rng(zlib.crc32(job.encode())).uniform(0.5, LATEST_SIGNAL))
    if process.poll() is not None:
        pytest.skip("it was done before")
    os.killpg(process.pid, signal.SIGINT)
    printed, _ = process.communicate(timeout=120)
    # The signal may have come when all was done.
    done = process.returncode == 0 and f"{job}: done" in printed
    assert done or process.returncode == INTERRUPTED, printed
    assert "Traceback" not in printed
    assert not processes_of(process.pid)
