"""The output of a run with ROS: its logs, and a virtual screen if there is no screen."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import re
import select
import shutil
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import BinaryIO, Iterator

from bullet_lab.core.files import FileError, file_errors, replace_file
from bullet_lab.errors import LabError

_ROS_PACKAGES = ("ROS_PACKAGE_PATH", "ROS_ROOT", "ROS_ETC_DIR", "ROS_VERSION", "ROS_DISTRO")
_SIZE = "1600x1000x24"
_START_TIMEOUT = 20.0
_STOP_TIMEOUT = 5.0
_PICTURE_PERIOD = 3.0


def environment_without_ros() -> dict[str, str]:
    """Return the environment of a job that must not join this process's ROS master."""
    return {n: v for n, v in os.environ.items() if n[:4] != "ROS_" or n in _ROS_PACKAGES}


def tied(*command: str) -> list[str]:
    """Return a command that gets SIGTERM when the thread ends that starts it.

    So no process stays behind if the launcher is killed by SIGKILL, unless setpriv is missing.
    """
    return [*(("setpriv", "--pdeathsig", "TERM") if shutil.which("setpriv") else ()), *command]


@contextlib.contextmanager
def temporary_folder() -> Iterator[str]:
    """Yield a folder that is deleted afterwards, even if this process is killed by SIGKILL."""
    with tempfile.TemporaryDirectory(prefix="lab-") as name:
        # Its input ends when this process ends; the nodes in the folder need a while to end, too.
        command = ["sh", "-c", 'read -r _; sleep 2; rm -rf "$0"', name]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, start_new_session=True) as sweeper:
            try:
                yield name
            finally:
                sweeper.kill()


class PlainText(io.TextIOBase):
    """A text file without terminal colours; text is lost while the disk is full."""

    def __init__(self, file: BinaryIO):
        self._file = file

    def write(self, text: str) -> int:
        """Write text, if the disk has room."""
        plain = re.sub(r"\x1b(\[[\d;]*m|\][^\x07]*\x07)", "", text)
        with contextlib.suppress(OSError):
            self._file.write(plain.encode(errors="replace"))
        return len(text)


@contextlib.contextmanager
def words_to(path: Path):
    """Redirect output and log of this process, not of its nodes, to a file; raise FileError."""
    with file_errors(f"cannot write {path}"):
        file = path.open("wb", buffering=0)
    with file:
        plain = PlainText(file)
        # At the level of INFO, roslaunch would write the user's whole environment to it.
        logging.basicConfig(stream=plain, level=logging.WARNING, force=True)
        # The master logs a long error for each node that ends before it is notified of others.
        logging.getLogger("rosmaster.threadpool").setLevel(logging.CRITICAL)
        with contextlib.redirect_stdout(plain), contextlib.redirect_stderr(plain):
            yield


class VirtualScreen:
    """An Xvfb on a free display, which is set as DISPLAY; its output goes to a log file."""

    def __init__(self, log: Path, picture: Path):
        self._log, self._picture = log, picture
        self._next = time.monotonic() + _PICTURE_PERIOD

    def __enter__(self) -> VirtualScreen:
        """Start the screen, for all programs that are started later; raise LabError."""
        # Xvfb finds a free display and prints its number. A new session keeps Ctrl-C in the
        # terminal from it: it must outlive RViz.
        command = tied("Xvfb", "-displayfd", "1", "-screen", "0", _SIZE, "-nolisten", "tcp")
        streams = {"stdout": subprocess.PIPE, "text": True, "start_new_session": True}
        with file_errors("cannot start Xvfb"), self._log.open("w") as log:
            self._server = subprocess.Popen(command, stderr=log, **streams)
        answer = self._server.stdout
        ready, _, _ = select.select([answer], [], [], _START_TIMEOUT)
        number = answer.readline().strip() if ready else ""
        if not number:
            self.__exit__()
            raise LabError(f"Xvfb does not start, see {self._log}")
        self._display = f":{number}"
        os.environ["DISPLAY"] = self._display
        os.environ["LIBGL_ALWAYS_SOFTWARE"] = "1"
        # For launch files: nobody can see this screen.
        os.environ["BULLET_LAB_VIRTUAL_SCREEN"] = self._display
        return self

    def __exit__(self, *_) -> None:
        """Stop the screen."""
        self._server.terminate()
        try:
            self._server.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()

    def picture_now_and_then(self) -> None:
        """Save a picture every few seconds, so that there is one however the run ends."""
        if time.monotonic() >= self._next:
            self.picture()

    def picture(self) -> None:
        """Save a picture of the screen, cropped to the windows; none while it is empty."""
        # Imported late: few runs have a virtual screen.
        from PIL import ImageGrab

        self._next = time.monotonic() + _PICTURE_PERIOD
        with contextlib.suppress(OSError, FileError):
            image = ImageGrab.grab(xdisplay=self._display).convert("RGB")
            box = image.getbbox()
            if box is not None:
                replace_file(self._picture, partial(image.crop(box).save, format="PNG"))
