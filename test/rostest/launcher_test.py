#!/usr/bin/env python3
"""The launcher runs jobs, tells how they ended and leaves nothing behind."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import rostest

TIMEOUT = 600


RUN = Path(__file__).resolve().parents[2] / "scripts" / "run.sh"
LAUNCHER = (sys.executable, "-m", "bullet_lab.ros.launcher")


def start(folder, *words, program=LAUNCHER, **environment):
    """Start the launcher in a folder, without the master of this test."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("ROS_MASTER_URI", "ROS_IP")}
    return subprocess.Popen(
        [*program, *words],
        cwd=folder,
        env={**inherited, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # As in a terminal: what it starts is in its group, and this test is not.
        start_new_session=True,
    )


def finish(run):
    """The exit status, standard output and standard error of a started launcher."""
    out, err = run.communicate(timeout=TIMEOUT)
    return run.returncode, out, err


def processes_of(out):
    """Numbers of the processes that log below an output folder: launcher's children."""
    mark = f"ROS_LOG_DIR={out}/log".encode()
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if mark in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def wait_for_nodes(out, number):
    """Wait until so many nodes run, and a little longer for them to come up."""
    wait_until(lambda: len(processes_of(out)) >= number)
    time.sleep(3)


def wait_until(condition):
    """Wait for three minutes at most."""
    deadline = time.monotonic() + 180
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError("it did not come")
        time.sleep(0.1)


class LauncherTest(unittest.TestCase):
    """Each test has a folder of its own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name).resolve()

    def test_two_runs_side_by_side_succeed(self):
        runs = [start(self.folder, "squares", f"out:=it's {i}", f"seed:={i}") for i in (1, 2)]
        for i, run in zip((1, 2), runs):
            status, out, err = finish(run)
            self.assertEqual(0, status, err)
            summary = json.loads((self.folder / f"it's {i}" / "summary.json").read_text())
            self.assertEqual(i, summary["seed"])
            self.assertIn(f"it's {i}/summary.json", out)
            self.assertEqual([], processes_of(self.folder / f"it's {i}"))

    def test_results_go_below_the_current_folder_by_default(self):
        status, _, err = finish(start(self.folder, "beacons"))
        self.assertEqual(0, status, err)
        self.assertTrue((self.folder / "results" / "beacons" / "summary.json").is_file())

    def test_signals_stop_everything(self):
        for number, expected in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
            out = self.folder / f"out{expected}"
            run = start(self.folder, "squares", f"out:={out}", "rtf:=1")
            wait_for_nodes(out, 5)
            run.send_signal(number)
            status, _, err = finish(run)
            self.assertEqual(expected, status, err)
            self.assertNotIn("Traceback", err)
            self.assertEqual([], processes_of(out))

    def test_killed_it_leaves_no_node_and_all_that_was_recorded(self):
        out, temporary = self.folder / "out", self.folder / "tmp"
        temporary.mkdir()
        run = start(self.folder, "squares", f"out:={out}", "rtf:=1", TMPDIR=str(temporary))
        paths = out / "paths.csv"
        wait_until(lambda: paths.is_file() and len(paths.read_text().splitlines()) > 2)
        run.kill()
        finish(run)
        wait_until(lambda: not processes_of(out) and not list(temporary.iterdir()))
        self.assertFalse(json.loads((out / "summary.json").read_text())["finished"])

    def test_ctrl_c_while_it_starts_is_no_failure(self):
        for delay in (0.4, 0.8, 1.1, 1.3, 1.6):
            # As run.sh starts it.
            program = ("env", "--block-signal=INT", *LAUNCHER)
            run = start(self.folder, "squares", "out:=out", "rtf:=1", program=program)
            time.sleep(delay)
            os.killpg(run.pid, signal.SIGINT)
            status, out, err = finish(run)
            self.assertEqual(130, status, f"after {delay} s: {err}")
            self.assertNotIn("Traceback", out + err)
            self.assertEqual([], processes_of(self.folder / "out"))

    def test_ctrl_c_that_comes_to_run_sh_alone_is_not_lost(self):
        for delay in (0.15, 0.3):
            run = start(self.folder, "squares", "out:=out", "rtf:=1", program=[str(RUN)])
            time.sleep(delay)
            run.send_signal(signal.SIGINT)
            # A shell calls both 130: what has died of Ctrl-C, and what says so.
            self.assertIn(finish(run)[0], (130, -signal.SIGINT), f"after {delay} s")

    def test_wrong_values_are_refused_before_anything_starts(self):
        for word, line in (
            ("std:=-1", "run.sh: std is '-1': it must be a number >= 0"),
            ("model:=x", "run.sh: model is 'x': it must be one of report, rate_invariant, "),
            ("rtf:=fast", "run.sh: rtf is 'fast': it must be a number >= 0"),
        ):
            status, out, err = finish(start(self.folder, "squares", word))
            self.assertEqual((2, ""), (status, out))
            self.assertEqual(1, len(err.splitlines()), err)
            self.assertTrue(err.startswith(line), err)
        self.assertEqual([], list(self.folder.iterdir()))

    def test_folder_in_use_is_refused_and_python_listens_on_the_loopback_only(self):
        out = self.folder / "out"
        first = start(self.folder, "squares", f"out:={out}", "rtf:=1")
        wait_for_nodes(out, 5)
        status, _, err = finish(start(self.folder, "squares", f"out:={out}"))
        # roscpp binds its XML-RPC server to every interface, whatever it is told.
        nodes = [pid for pid in processes_of(out) if b".py" in command_of(pid)]
        listening = listening_addresses([first.pid, *nodes])
        first.send_signal(signal.SIGINT)
        finish(first)
        self.assertEqual(2, status)
        self.assertEqual(1, len(err.splitlines()), err)
        self.assertGreater(len(listening), 4)
        self.assertEqual({"127.0.0.1"}, {address.rpartition(":")[0] for address in listening})

    def test_dead_node_ends_the_run_with_its_status(self):
        out = self.folder / "out"
        run = start(self.folder, "squares", f"out:={out}", "rtf:=1")
        wait_for_nodes(out, 5)
        victims = [pid for pid in processes_of(out) if b"drive_squares.py" in command_of(pid)]
        os.kill(victims[0], signal.SIGKILL)
        status, _, err = finish(run)
        self.assertEqual(128 + signal.SIGKILL, status)
        self.assertIn("drive_squares was killed by signal 9", err)
        self.assertEqual([], processes_of(out))

    def test_dead_master_is_one_clear_line(self):
        run = start(self.folder, "squares", ROS_MASTER_URI="http://127.0.0.1:4")
        status, _, err = finish(run)
        self.assertEqual(1, status)
        self.assertEqual(1, len(err.splitlines()), err)
        self.assertIn("no ROS master answers at", err)


def command_of(pid):
    """The command line of a process."""
    return Path(f"/proc/{pid}/cmdline").read_bytes()


def listening_addresses(pids):
    """What these processes listen to, as address:port."""
    lines = subprocess.run(
        ["ss", "-ltnpH"], check=True, stdout=subprocess.PIPE, text=True
    ).stdout.splitlines()
    return [line.split()[3] for line in lines if any(f"pid={pid}," in line for pid in pids)]


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "launcher", LauncherTest)
