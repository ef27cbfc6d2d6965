"""A running submission: a process group with limits, in a working folder of its own."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

from bullet_lab.errors import LabError
from bullet_lab.ros.launcher.output import tied

# Wall seconds between SIGTERM and SIGKILL.
GRACE = 2.0
# Bytes of each file that a submission writes.
LARGEST_FILE = 20_000_000
LIMITS = {
    -signal.SIGXCPU: "used too much processor time",
    -signal.SIGKILL: "used too much processor time",
    -signal.SIGXFSZ: "wrote a file of more than 20 MB",
}
"""What the limits of a process end it for, by its status."""

# Characters of the last printed line, and of a file that is left.
LONGEST_LINE = 200
LONGEST_FILE = 10_000
_PR_SET_CHILD_SUBREAPER = 36


class SubmissionError(LabError):
    """A submission cannot be started."""


def command_of(folder: Path) -> list[str]:
    """Return the command that starts a submission; raise SubmissionError."""
    for name in ("main.py", "main.sh"):
        if (folder / name).is_file() and not os.access(folder / name, os.X_OK):
            raise SubmissionError(f"{name} is not executable; run chmod +x {name}")
        if (folder / name).is_file():
            return [f"./{name}"]
    launch = sorted(folder.glob("*.launch"))
    if len(launch) != 1:
        count = f"{len(launch)} launch files"
        raise SubmissionError(f"it has no main.py, no main.sh and {count}; one is needed")
    return ["roslaunch", launch[0].name]


class Submission:
    """A submission that runs in a copy of its folder, `work`, until it is closed."""

    def __init__(self, folder: Path, work: Path, output: Path, seconds: int):
        self.output, self._work = output, work
        self._others = adopt_orphans()
        limits = [f"--cpu={seconds}:{seconds + 1}", f"--fsize={LARGEST_FILE}", "--core=0"]
        try:
            shutil.copytree(folder, work, symlinks=True)
            with output.open("wb") as file:
                self._process = subprocess.Popen(
                    tied("prlimit", *limits, *command_of(folder)),
                    cwd=work,
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
        except (OSError, shutil.Error) as error:
            raise SubmissionError(f"it cannot be started: {str(error)[:LONGEST_LINE]}") from error

    def close(self) -> None:
        """End the process group: SIGTERM, then SIGKILL; then all that has left the group."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE)
        end_children(self._others)

    def status(self) -> int | None:
        """Return the exit status; None while it runs."""
        return self._process.poll()

    def why_ended(self) -> list[str]:
        """Return lines that say what was wrong with its end; none while it runs."""
        status, lines = self.status(), []
        if status in LIMITS:
            lines = [f"it was ended, since it {LIMITS[status]}"]
        elif status:
            how = f"ended with status {status}" if status > 0 else f"was ended by signal {-status}"
            tail = self.output.read_bytes()[-10 * LONGEST_LINE :].decode(errors="replace")
            printed = [line.strip() for line in tail.split("\n") if line.strip()]
            lines = [f"it {how}: {(printed or ['it printed nothing'])[-1][:LONGEST_LINE]}"]
        if status is not None and _children() - self._others:
            lines.append("it left processes behind, which were ended")
        return lines

    def file(self, name: str) -> str:
        """Return the beginning of a file in the working folder; empty if there is none."""
        path = (self._work / name).resolve()
        # A pipe would never end.
        if not path.is_file() or self._work.resolve() not in path.parents:
            return ""
        with path.open("rb") as file:
            return file.read(LONGEST_FILE).decode(errors="replace")


def adopt_orphans() -> set[int]:
    """Make orphans below this process its children, and return those that it has now."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    return _children()


def end_children(others: set[int]) -> None:
    """Kill all children of this process but some others, and those that become orphans by that."""
    until = time.monotonic() + GRACE
    while _children() - others and time.monotonic() < until:
        for process in _children() - others:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
                os.waitpid(process, 0)


def _children() -> set[int]:
    texts = [path.read_text() for path in Path("/proc/self/task").glob("*/children")]
    return {int(word) for text in texts for word in text.split()}
