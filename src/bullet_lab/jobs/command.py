"""The command `bullet_lab` of an installation by pip: it runs jobs without ROS.

The launcher of scripts/run.sh shares the command line, the folder for the results and the last
lines with it.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib
import json
import os
import shutil
import sys
import time
from pathlib import Path
from typing import Callable

from bullet_lab.core.files import PART, FileError, make_folder
from bullet_lab.core.parameters import ParameterError
from bullet_lab.entry import STATUS_INTERRUPTED, end_at_once_when_interrupted
from bullet_lab.errors import LabError
from bullet_lab.jobs.declaration import (
    Job,
    UsageError,
    choose_job,
    find_jobs,
    help_on,
    list_of_jobs,
    read_assignments,
)
from bullet_lab.simulation.world.resources import package_share

PROGRAM = "bullet_lab"
SUMMARY = "summary.json"
STATUS_FAILED = 1
STATUS_BAD_VALUE = 2
# As of a program that SIGPIPE ends.
STATUS_UNREAD = 141
_HELP = ("-h", "--help")


def main() -> None:
    """Run the command line, and exit: 0 done, 1 failed, 2 wrong command line, 130 stopped."""
    # Until a study has handlers of its own.
    end_at_once_when_interrupted()
    sys.exit(status_of(PROGRAM, _dispatch, sys.argv[1:]))


def status_of(program: str, dispatch: Callable[[list[str]], int], words: list[str]) -> int:
    """Return the exit status of a command line; an error of the user is printed as one line."""
    try:
        status = dispatch(words)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # Nobody reads on, as in `| head`. Python would report it again when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return STATUS_UNREAD
    except LabError as error:
        print(f"{program}: {error}", file=sys.stderr)
        wrong = isinstance(error, (UsageError, ParameterError))
        return STATUS_BAD_VALUE if wrong else STATUS_FAILED


def read_command(
    program: str,
    jobs: dict[str, Job],
    words: list[str],
    defaults: Callable[[Job], dict[str, str]],
) -> tuple[Job, dict[str, str]] | None:
    """Return the job and its checked arguments, or print the list of jobs or the help of a job.

    `defaults` returns the resolved defaults of a job's arguments. Raises LabError for a wrong
    command line.
    """
    if not words or words[0] in _HELP:
        print(list_of_jobs(jobs, program))
        return None
    job = choose_job(jobs, words[0])
    if any(word in _HELP for word in words[1:]):
        # Relative to this folder, in which a run writes its results.
        print(help_on(job, {**defaults(job), "out": f"results/{job.name}"}))
        return None
    values = read_assignments(job, words[1:])
    out = Path.cwd() / values.get("out", f"results/{job.name}")
    return job, {**values, "out": os.path.normpath(out)}


class OutputFolder:
    """A folder for the results of one run, locked against a second run.

    The lock is on the folder itself and ends with the process, however that ends. Logs of the run
    are in the folder `log`.
    """

    def __init__(self, path: Path):
        self.path, self.log = path, path / "log"
        self._lock = contextlib.ExitStack()
        self._before: dict[Path, int] = {}

    def __enter__(self) -> OutputFolder:
        """Create and lock the folder, delete the summary of an earlier run; raise UsageError."""
        try:
            make_folder(self.path)
            self.log.mkdir(exist_ok=True)
            descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
            self._lock.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            (self.path / SUMMARY).unlink(missing_ok=True)
        except FileError as error:
            raise UsageError(str(error)) from error
        except OSError as error:
            self._lock.close()
            message = f"cannot write to {self.path}: {error.strerror}"
            if isinstance(error, BlockingIOError):
                message = f"another run is writing to {self.path}, choose another out:="
            raise UsageError(message) from error
        self._before = self._files()
        return self

    def __exit__(self, *_) -> None:
        """Delete partial files of killed programs, and log/ if it is empty; unlock the folder.

        Subfolders but log/ are left alone: another run may write to one of them.
        """
        for part in (*self.path.glob(f"{PART}*"), *self.log.glob(f"{PART}*")):
            if part.is_dir():
                shutil.rmtree(part, ignore_errors=True)
            else:
                part.unlink(missing_ok=True)
        # There are no logs without ROS.
        with contextlib.suppress(OSError):
            self.log.rmdir()
        self._lock.close()

    def has_summary(self) -> bool:
        """Return whether this run has written its summary."""
        return (self.path / SUMMARY).is_file()

    def is_finished(self) -> bool:
        """Return whether the summary of this run exists and does not have "finished": false."""
        try:
            summary = json.loads((self.path / SUMMARY).read_text())
        except (OSError, ValueError):
            return False
        return summary.get("finished", True)

    def written(self) -> list[Path]:
        """Return the files that this run has written, without logs."""
        return [path for path, time in self._files().items() if self._before.get(path) != time]

    def _files(self) -> dict[Path, int]:
        files = sorted(path for path in self.path.iterdir() if path.is_file())
        return {path: path.stat().st_mtime_ns for path in files}


def shown(path: Path) -> str:
    """Return a path for messages: relative if it is below the current folder."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


def print_end(job: str, how: str, started: float, out: OutputFolder) -> None:
    """Print how a job has ended that started at a `time.monotonic`, and what it has written."""
    print(f"{job}: {how} after {time.monotonic() - started:.1f} s")
    for path in out.written():
        print(f"  {shown(path)}")


def _dispatch(words: list[str]) -> int:
    every = find_jobs(package_share())
    jobs = {name: job.without_ros() for name, job in every.items() if job.program}
    if words and words[0] in every.keys() - jobs.keys():
        raise UsageError(f"{words[0]} needs ROS: clone bullet_lab, run scripts/run.sh {words[0]}")
    found = read_command(PROGRAM, jobs, words, _defaults)
    return 0 if found is None else _run(*found)


def _defaults(job: Job) -> dict[str, str]:
    return {name: job.resolve(one.default or "", {}) for name, one in job.arguments.items()}


def _run(job: Job, values: dict[str, str]) -> int:
    """Run a job in this process, print its results, and return the exit status."""
    started = time.monotonic()
    module, _, function = job.program.partition(":")
    study = getattr(importlib.import_module(module), function or "main")
    with OutputFolder(Path(values["out"])) as out:
        try:
            study(words=job.words(values))
            status = 0
        except SystemExit as end:
            status = end.code
        # A study that refuses a value prints why: that line shall stand alone.
        if status != STATUS_BAD_VALUE:
            ends = {0: "done", STATUS_INTERRUPTED: "stopped"}
            print_end(job.name, ends.get(status, "failed"), started, out)
    return status
