"""What a run leaves behind: the folder of its results, and its log."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import re
from pathlib import Path
from typing import TextIO

from bullet_lab.ros.launcher.jobs import UsageError

SUMMARY = "summary.json"


class OutputFolder:
    """A folder for the results of one run, locked against a second one.

    The lock is on the folder itself and goes with the process, however that ends.
    """

    def __init__(self, path: Path):
        self.path = path
        self._descriptor = -1
        self._before: dict[Path, int] = {}

    @property
    def log(self) -> Path:
        """The folder for the logs of the run."""
        return self.path / "log"

    def __enter__(self) -> OutputFolder:
        """Create and lock the folder, forget the summary of an earlier run.

        Raises:
            UsageError: the folder cannot be written to, or another run uses it.
        """
        try:
            self.log.mkdir(parents=True, exist_ok=True)
            self._lock()
            (self.path / SUMMARY).unlink(missing_ok=True)
        except BlockingIOError:
            self._unlock()
            message = f"another run is writing to {self.path}, choose another out:="
            raise UsageError(message) from None
        except OSError as error:
            self._unlock()
            raise UsageError(f"cannot write to {self.path}: {error.strerror}") from error
        self._before = self._files()
        return self

    def __exit__(self, *_) -> None:
        """Let others use the folder."""
        self._unlock()

    def _lock(self) -> None:
        self._descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _unlock(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def has_summary(self) -> bool:
        """Whether this run has written its summary."""
        return (self.path / SUMMARY).is_file()

    def written(self) -> list[Path]:
        """The files that this run has written, logs left out."""
        return [path for path, time in self._files().items() if self._before.get(path) != time]

    def _files(self) -> dict[Path, int]:
        files = sorted(path for path in self.path.iterdir() if path.is_file())
        return {path: path.stat().st_mtime_ns for path in files}


def shown(path: Path) -> str:
    """A path as the user would write it: relative where it is below the current folder."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


class _PlainText:
    """A text file that gets no terminal colours."""

    def __init__(self, file: TextIO):
        self._file = file

    def write(self, text: str) -> int:
        return self._file.write(re.sub(r"\x1b(\[[\d;]*m|\][^\x07]*\x07)", "", text))

    def flush(self) -> None:
        self._file.flush()


@contextlib.contextmanager
def words_to(path: Path):
    """Send what this process (not its nodes) prints and logs to a file."""
    with path.open("w", buffering=1) as log:
        # At the level of INFO, roslaunch would write the user's whole environment to it.
        logging.basicConfig(stream=log, level=logging.WARNING, force=True)
        # The master complains at length about each node that leaves before it is told of others.
        logging.getLogger("rosmaster.threadpool").setLevel(logging.CRITICAL)
        plain = _PlainText(log)
        with contextlib.redirect_stdout(plain), contextlib.redirect_stderr(plain):
            yield
