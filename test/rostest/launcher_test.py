#!/usr/bin/env python3
"""The launcher runs jobs, tells how they ended and leaves nothing behind."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
from lab_testing import NodeTest, command_of, processes_with, run_tests, wait_for

from bullet_lab.ros.launcher.output import environment_without_ros

TIMEOUT = 600
RUN = Path(__file__).resolve().parents[2] / "scripts" / "run.sh"
LAUNCHER = (sys.executable, "-m", "bullet_lab.ros.launcher")
# Environment variable with the output folder, of the launcher and all that it starts.
MARK = "LAUNCHER_TEST_OUT"


def start(folder, *words, program=LAUNCHER, **environment):
    """Start the launcher in a folder, without the master of this test."""
    out = next((word[len("out:=") :] for word in words if word.startswith("out:=")), "")
    return psutil.Popen(
        [*program, *words],
        cwd=folder,
        env={**environment_without_ros(), MARK: str(folder / out), **environment},
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
    """The processes of a run: the launcher and all that it has started."""
    return processes_with(f"{MARK}={out}")


def has_begun(command):
    """Whether `env` has become the launcher; between the two, the command line is empty."""
    return "launcher" in command and "block-signal" not in command


def is_driving(out):
    """Whether the nodes of squares have come up and record."""
    paths = out / "paths.csv"
    return paths.is_file() and len(paths.read_text().splitlines()) > 2


class LauncherTest(NodeTest):
    """Each test has a folder of its own."""

    def setUp(self):
        self.folder = self.new_folder()

    def test_two_runs_side_by_side_succeed(self):
        runs = [start(self.folder, "squares", f"out:=it's {i}", f"seed:={i}") for i in (1, 2)]
        for i, run in zip((1, 2), runs):
            status, out, err = finish(run)
            self.assertEqual(0, status, err)
            summary = json.loads((self.folder / f"it's {i}" / "summary.json").read_text())
            self.assertEqual(i, summary["seed"])
            self.assertIn(f"it's {i}/summary.json", out)
            self.assertEqual([], processes_of(self.folder / f"it's {i}"))

    def drive(self, **environment):
        """Start squares in real time and wait until it drives; return it and its folder."""
        out = self.folder / "out"
        run = start(self.folder, "squares", f"out:={out}", "rtf:=1", **environment)
        wait_for(lambda: is_driving(out), "the drive")
        return run, out

    def test_killed_it_leaves_no_node_and_all_that_was_recorded(self):
        temporary = self.folder / "tmp"
        temporary.mkdir()
        run, out = self.drive(TMPDIR=str(temporary))
        run.kill()
        finish(run)
        wait_for(lambda: not processes_of(out) and not list(temporary.iterdir()), "the end")
        self.assertFalse(json.loads((out / "summary.json").read_text())["finished"])

    def test_ctrl_c_while_it_starts_and_drives_is_no_failure(self):
        # As run.sh starts it.
        program = ("env", "--block-signal=INT", *LAUNCHER)
        for number, is_there in enumerate(
            (
                lambda run, out: has_begun(command_of(run)),
                lambda run, out: any(".py" in command_of(one) for one in processes_of(out)),
                lambda run, out: is_driving(out),
            )
        ):
            out = self.folder / f"out{number}"
            run = start(self.folder, "squares", f"out:={out}", "rtf:=1", program=program)
            wait_for(lambda now=(is_there, run, out): now[0](*now[1:]), "the moment")
            os.killpg(run.pid, signal.SIGINT)
            status, printed, err = finish(run)
            self.assertEqual(130, status, err)
            self.assertNotIn("Traceback", printed + err)
            self.assertEqual([], processes_of(out))

    def test_ctrl_c_that_comes_to_run_sh_alone_is_not_lost(self):
        # Whatever the shell does at these moments.
        for delay in (0.15, 0.3):
            run = start(self.folder, "squares", "out:=out", "rtf:=1", program=[str(RUN)])
            time.sleep(delay)
            run.send_signal(signal.SIGINT)
            # A shell calls both 130: what has died of Ctrl-C, and what says so.
            self.assertIn(finish(run)[0], (130, -signal.SIGINT), f"after {delay} s")

    def test_wrong_values_are_refused_before_anything_starts(self):
        status, out, err = finish(start(self.folder, "squares", "std:=-1"))
        self.assertEqual((2, ""), (status, out))
        self.assertEqual(1, len(err.splitlines()), err)
        self.assertTrue(err.startswith("run.sh: std is '-1': it must be a number >= 0"), err)
        self.assertEqual([], list(self.folder.iterdir()))

    def test_folder_in_use_is_refused_python_listens_on_the_loopback_and_sigterm_ends_it(self):
        first, out = self.drive()
        status, _, err = finish(start(self.folder, "squares", f"out:={out}"))
        # roscpp binds its XML-RPC server to every interface, whatever it is told.
        nodes = [one for one in processes_of(out) if ".py" in command_of(one)]
        connections = [found for one in (first, *nodes) for found in one.net_connections()]
        listening = [one.laddr.ip for one in connections if one.status == psutil.CONN_LISTEN]
        self.assertEqual(2, status)
        self.assertEqual(1, len(err.splitlines()), err)
        self.assertGreater(len(listening), 4)
        self.assertEqual({"127.0.0.1"}, set(listening))
        first.send_signal(signal.SIGTERM)
        status, _, err = finish(first)
        self.assertEqual(143, status, err)
        self.assertNotIn("Traceback", err)
        self.assertEqual([], processes_of(out))

    def test_dead_node_ends_the_run_with_its_status(self):
        run, out = self.drive()
        (victim,) = [one for one in processes_of(out) if "drive_squares.py" in command_of(one)]
        victim.kill()
        status, _, err = finish(run)
        self.assertEqual(128 + signal.SIGKILL, status)
        self.assertIn("drive_squares was killed by signal 9", err)
        self.assertEqual([], processes_of(out))


if __name__ == "__main__":
    run_tests(node=False)
