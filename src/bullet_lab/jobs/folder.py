"""The folder for the results of a run, with or without ROS."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
from pathlib import Path

from bullet_lab.core.files import PART, FileError, make_folder
from bullet_lab.jobs.declaration import UsageError

SUMMARY = "summary.json"


class OutputFolder:
    """A folder for the results of one run, locked against a second run.

    The lock is on the folder itself and ends with the process, however that ends.
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
        """Create and lock the folder, delete the summary of an earlier run; raise UsageError."""
        try:
            make_folder(self.path)
            self.log.mkdir(exist_ok=True)
            self._descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            (self.path / SUMMARY).unlink(missing_ok=True)
        except FileError as error:
            raise UsageError(str(error)) from error
        except OSError as error:
            self._close()
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
        self._close()

    def _close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

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
