"""The command line of the launcher."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from bullet_lab.entry import end_at_once_when_interrupted, quick_imports
from bullet_lab.errors import LabError
from bullet_lab.jobs.command import (
    STATUS_BAD_VALUE,
    STATUS_FAILED,
    OutputFolder,
    print_end,
    read_command,
    shown,
    status_of,
)
from bullet_lab.jobs.declaration import FILE, Job, find_jobs
from bullet_lab.ros.launcher.node_server import NodeServer
from bullet_lab.ros.launcher.output import VirtualScreen, temporary_folder, words_to
from bullet_lab.simulation.world.resources import package_share, ros_package_folder
from bullet_lab.simulation.world.xml import parse_text, read_text

_POLL_PERIOD = 0.02


class StopSignals:
    """Remembers the first signal that asks to stop; no signal interrupts this process any more.

    So the launcher stops its nodes even if the signal comes while it starts them, and a second
    Ctrl-C does not cut off its last lines.
    """

    NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self):
        self.received: int | None = None
        for number in self.NUMBERS:
            signal.signal(number, self._remember)

    def _remember(self, number: int, _frame) -> None:
        if self.received is None:
            self.received = number


def main(server: NodeServer) -> None:
    """Run the command line, with a server of nodes, and exit.

    The exit status is 0 for success, 2 for a wrong command line, 128 + n after a signal n, and
    otherwise that of the first node that failed, or 1.
    """
    # Until a job's `StopSignals` replace this handler.
    end_at_once_when_interrupted()
    # ROS would read them as its own.
    words, sys.argv[1:] = sys.argv[1:], []
    status = status_of("run.sh", functools.partial(_dispatch, server), words)
    # Python removes its handlers before it has ended: a signal after that would kill it.
    for number in StopSignals.NUMBERS:
        signal.signal(number, signal.SIG_IGN)
    sys.exit(status)


def _dispatch(server: NodeServer, words: list[str]) -> int:
    package = package_share()
    found = read_command("scripts/run.sh", find_jobs(package), words, _defaults)
    if found is None:
        return 0
    job, values = found
    for name, value in values.items():
        if job.arguments[name].bracket == FILE and value:
            make_package_known(Path(value))
    return _run(job, values, package, StopSignals(), server)


def _defaults(job: Job) -> dict[str, str]:
    from bullet_lab.ros.launcher.supervision import resolved_defaults

    return resolved_defaults(job.path)


def make_package_known(file: Path) -> None:
    """Add the folder that holds a file's package to ROS_PACKAGE_PATH, if ROS does not find it."""
    package = next((one for one in file.parents if (one / "package.xml").is_file()), None)
    if package is None or ros_package_folder(_package_name(package)) is not None:
        return
    known = os.environ.get("ROS_PACKAGE_PATH", "")
    os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join(filter(None, (known, str(package.parent))))


def _package_name(folder: Path) -> str:
    """Return the name in a package.xml; that of the folder if it has none."""
    try:
        manifest = folder / "package.xml"
        name = parse_text(read_text(manifest), str(manifest)).findtext("name")
    except LabError:
        name = None
    return (name or folder.name).strip()


def _run(
    job: Job, values: dict[str, str], package: Path, signals: StopSignals, server: NodeServer
) -> int:
    """Run a job, print its results, and return the exit status."""
    started = time.monotonic()
    with OutputFolder(Path(values["out"])) as out:
        rviz = job.arguments.get("rviz")
        with_rviz = rviz is not None and values.get("rviz", rviz.default) == "true"
        if with_rviz and not _set_up_rviz(package / "scripts" / "setup.sh", signals):
            return 128 + signals.received if signals.received else STATUS_FAILED
        with contextlib.ExitStack() as stack:
            # Nodes run in this folder, so that their leftovers are removed with it.
            os.environ["ROS_HOME"] = stack.enter_context(temporary_folder())
            os.environ["ROS_LOG_DIR"] = str(out.log)
            # Qt needs it, and it is missing if nobody has logged in.
            os.environ.setdefault("XDG_RUNTIME_DIR", os.environ["ROS_HOME"])
            screen = None
            if with_rviz and not os.environ.get("DISPLAY"):
                screen = VirtualScreen(out.log / "xvfb.log", out.path / "rviz.png")
                stack.enter_context(screen)
            verdict = _launch(job, values, out, signals, screen, server)
        # A node that refuses a value prints why: that line shall stand alone.
        if verdict.status == STATUS_BAD_VALUE:
            return verdict.status
        if verdict.status:
            print(f"{job.name}: {verdict.reason}, see {shown(out.log)}", file=sys.stderr)
        stopped = signals.received and verdict.status == 128 + signals.received
        how = "stopped" if stopped else "failed" if verdict.status else "done"
        print_end(job.name, how, started, out)
    return verdict.status


def _set_up_rviz(setup: Path, signals: StopSignals) -> bool:
    """Install RViz if it is missing; an installed package has no setup.sh and needs none."""
    if not setup.is_file():
        return True
    process = subprocess.Popen([str(setup), "--with", "rviz"])
    while process.poll() is None and not signals.received:
        time.sleep(0.02)
    if signals.received:
        process.terminate()
    return process.wait() == 0 and not signals.received


def _launch(job, values, out: OutputFolder, signals, screen, server):
    """Run the nodes and return the verdict; roslaunch prints to a log, nodes to the terminal."""
    terminal = sys.stdout
    with words_to(out.log / "roslaunch.log"):
        # Imported late: these set up logging when they are imported, and read the environment.
        with quick_imports():
            from bullet_lab.ros.launcher.supervision import Launch, Verdict, prepare_master

        master = prepare_master()
        whose = "its own master" if master.own else "the master"
        print(f"{job.name}: running on {whose} {master.uri}", file=terminal, flush=True)
        # The page in a browser stays after the job has finished.
        stays = values.get("view") == "browser"
        announced = False
        with Launch(job, values, master, server) as launch:
            while True:
                verdict = launch.verdict(out.has_summary, signals.received)
                if verdict is not None:
                    break
                if screen:
                    screen.picture_now_and_then()
                # The last picture of the screen is of all nodes.
                if not stays and not screen and out.is_finished():
                    launch.end_others()
                if stays and not announced and out.is_finished():
                    announced = True
                    where = f"{job.name}: the results are in {shown(out.path)}"
                    print(f"{where}; the page stays until Ctrl-C", file=terminal, flush=True)
                time.sleep(_POLL_PERIOD)
            if screen:
                screen.picture()
        # Then Ctrl-C is its normal end.
        well = stays and verdict.status == 128 + (signals.received or 0) and out.is_finished()
        return Verdict(0) if well else verdict
