"""The command line of the launcher."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TextIO

import rospkg

from bullet_lab.errors import LabError
from bullet_lab.ros.launcher.jobs import (
    Job,
    choose_job,
    find_jobs,
    help_on,
    list_of_jobs,
    read_assignments,
)
from bullet_lab.ros.launcher.output import OutputFolder, shown
from bullet_lab.ros.launcher.values import UsageError

_WATCHED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Remembers the first signal that asks to stop, instead of being interrupted by it.

    What was started half is stopped the more surely for it.
    """

    def __init__(self):
        self.received: int | None = None

    def __enter__(self) -> StopSignals:
        """Take the signals over for good: the process ends soon after."""
        for number in _WATCHED:
            signal.signal(number, self._remember)
        return self

    def __exit__(self, *_) -> None:
        """Keep watching: a second Ctrl-C may not interrupt the last lines."""

    def _remember(self, number: int, _frame) -> None:
        if self.received is None:
            self.received = number


_HELP = ("-h", "--help")
STATUS_BAD_VALUE = 2
_GRAB_PERIOD = 3.0


def main(words: list[str]) -> int:
    """Do what the command line asks for; the exit status is returned.

    0 is success; 2 a wrong command line; 128 + n a signal n; otherwise the status of the
    first node that failed, or 1.
    """
    try:
        return _dispatch(words)
    except UsageError as error:
        return _complain(error, 2)
    except LabError as error:
        return _complain(error, 1)


def _complain(error: LabError, status: int) -> int:
    print(f"run.sh: {error}", file=sys.stderr)
    return status


def _dispatch(words: list[str]) -> int:
    package = Path(rospkg.RosPack().get_path("bullet_lab"))
    jobs = find_jobs(package / "launch")
    if not words or words[0] in _HELP:
        print(list_of_jobs(jobs))
        return 0
    job = choose_job(jobs, words[0])
    if any(word in _HELP for word in words[1:]):
        print(help_on(job, _defaults(job)))
        return 0
    values = read_assignments(job, words[1:])
    out = Path.cwd() / values.get("out", f"results/{job.name}")
    values["out"] = os.path.normpath(out)
    with StopSignals() as signals:
        return _run(job, values, package, signals)


def _defaults(job: Job) -> dict[str, str]:
    """The defaults as they would be from here; a run's results go below this folder."""
    from bullet_lab.ros.launcher.supervision import resolved_defaults

    return {**resolved_defaults(job.path), "out": f"results/{job.name}"}


def _run(job: Job, values: dict[str, str], package: Path, signals: StopSignals) -> int:
    started = time.monotonic()
    with OutputFolder(Path(values["out"])) as out:
        with_rviz = values.get("rviz", job.default_of("rviz")) == "true"
        if with_rviz and not _set_up_rviz(package / "scripts" / "setup.sh", signals):
            return 128 + signals.received if signals.received else 1
        status = _supervise(job, values, with_rviz, out, signals)
        _report(job, status, out, time.monotonic() - started)
    return status


def _set_up_rviz(setup: Path, signals: StopSignals) -> bool:
    """Install RViz where that is missing; an installed package has no setup.sh and needs none."""
    if not setup.is_file():
        return True
    process = subprocess.Popen([str(setup), "--with", "rviz"])
    while process.poll() is None and not signals.received:
        time.sleep(0.02)
    if signals.received:
        process.terminate()
    return process.wait() == 0 and not signals.received


def _supervise(
    job: Job, values: dict[str, str], with_rviz: bool, out: OutputFolder, signals: StopSignals
) -> int:
    with contextlib.ExitStack() as stack:
        # Also the folder that nodes run in: what they drop there belongs to nobody.
        os.environ["ROS_HOME"] = stack.enter_context(tempfile.TemporaryDirectory(prefix="lab-"))
        os.environ["ROS_LOG_DIR"] = str(out.log)
        # Qt asks for it, and has none where nobody has logged in.
        os.environ.setdefault("XDG_RUNTIME_DIR", os.environ["ROS_HOME"])
        meanwhile = _Screenshots.none
        if with_rviz and not os.environ.get("DISPLAY"):
            meanwhile = stack.enter_context(_screenshots(out)).take
        verdict = _launch(job, values, out, signals, meanwhile)
    if verdict.status not in (0, STATUS_BAD_VALUE):
        print(f"{job.name}: {verdict.reason}, see {shown(out.log)}", file=sys.stderr)
    return verdict.status


def _launch(job, values, out: OutputFolder, signals: StopSignals, meanwhile):
    """Run the nodes with roslaunch's own words in a log; theirs go to the terminal."""
    terminal = sys.stdout
    with (out.log / "roslaunch.log").open("w", buffering=1) as log, _words_to(log):
        # Not before now: these set up logging on import and look at the environment.
        from bullet_lab.ros.launcher.master import prepare_master
        from bullet_lab.ros.launcher.supervision import Launch

        master = prepare_master()
        whose = "its own master" if master.own else "the master"
        print(f"{job.name}: running on {whose} {master.uri}", file=terminal, flush=True)
        with Launch(job, values, master) as launch:
            verdict = launch.wait(out.has_summary, lambda: signals.received, meanwhile)
            meanwhile(last=True)
            return verdict


class _PlainText:
    """A text file that gets no terminal colours."""

    def __init__(self, file: TextIO):
        self._file = file

    def write(self, text: str) -> int:
        return self._file.write(re.sub(r"\x1b(\[[\d;]*m|\][^\x07]*\x07)", "", text))

    def flush(self) -> None:
        self._file.flush()


@contextlib.contextmanager
def _words_to(log: TextIO):
    """Send what this process (not its nodes) prints and logs to the file."""
    # At the level of INFO, roslaunch would write the user's whole environment to it.
    logging.basicConfig(stream=log, level=logging.WARNING, force=True)
    # The master complains at length about each node that leaves before it is told of others.
    logging.getLogger("rosmaster.threadpool").setLevel(logging.CRITICAL)
    plain = _PlainText(log)
    with contextlib.redirect_stdout(plain), contextlib.redirect_stderr(plain):
        yield


class _Screenshots:
    """Takes a picture of RViz now and then, so that there is one however the run ends."""

    def __init__(self, screen, path: Path):
        self._screen = screen
        self._path = path
        self._next = time.monotonic() + _GRAB_PERIOD

    def take(self, last: bool = False) -> None:
        """Take a picture if it is time for one, or the last one."""
        if last or time.monotonic() >= self._next:
            self._screen.grab(self._path)
            self._next = time.monotonic() + _GRAB_PERIOD

    @staticmethod
    def none(last: bool = False) -> None:
        """Take no picture: there is a display, or no RViz."""


@contextlib.contextmanager
def _screenshots(out: OutputFolder):
    from bullet_lab.ros.launcher.screen import VirtualScreen

    with VirtualScreen(out.log / "xvfb.log") as screen:
        yield _Screenshots(screen, out.path / "rviz.png")


def _report(job: Job, status: int, out: OutputFolder, seconds: float) -> None:
    """Say how long it took and which files there are."""
    if status == STATUS_BAD_VALUE:
        # A node refused a value, and has said why: that line shall stand alone.
        return
    print(f"{job.name}: {'failed' if status else 'done'} after {seconds:.1f} s")
    for path in out.written():
        print(f"  {shown(path)}")
