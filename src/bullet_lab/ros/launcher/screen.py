"""A screen without a display, for RViz on a machine that has none."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import time
from pathlib import Path

from PIL import ImageGrab

from bullet_lab.errors import LabError

_SIZE = "1600x1000x24"
_START_TIMEOUT = 20.0
_STOP_TIMEOUT = 5.0
_PICTURE_PERIOD = 3.0


class ScreenError(LabError):
    """There is no screen to show something on."""


class VirtualScreen:
    """An Xvfb on a free display, which DISPLAY names from then on.

    Args:
        log: file for what Xvfb says.
        picture: file for a picture of the screen.
    """

    def __init__(self, log: Path, picture: Path):
        self._log = log
        self._picture = picture
        self._next = time.monotonic() + _PICTURE_PERIOD
        self._server: subprocess.Popen | None = None
        self._display = ""

    def __enter__(self) -> VirtualScreen:
        """Start the screen and let everything that is started later draw on it.

        Raises:
            ScreenError: Xvfb is missing or does not start.
        """
        reader, writer = os.pipe()
        try:
            self._start(writer)
        finally:
            os.close(writer)
        with os.fdopen(reader) as answer:
            ready, _, _ = select.select([answer], [], [], _START_TIMEOUT)
            number = answer.readline().strip() if ready else ""
        if not number:
            self.__exit__()
            raise ScreenError(f"Xvfb does not start, see {self._log}")
        self._display = f":{number}"
        os.environ["DISPLAY"] = self._display
        os.environ["LIBGL_ALWAYS_SOFTWARE"] = "1"
        # For launch files: nobody sits before this screen.
        os.environ["BULLET_LAB_VIRTUAL_SCREEN"] = self._display
        return self

    def _start(self, writer: int) -> None:
        # Xvfb looks for a free display itself and tells its number. In a session of its own
        # it gets no Ctrl-C from the terminal: it has to outlive RViz.
        command = ["Xvfb", "-displayfd", str(writer), "-screen", "0", _SIZE, "-nolisten", "tcp"]
        with self._log.open("w") as log:
            try:
                self._server = subprocess.Popen(
                    command, pass_fds=[writer], stdout=log, stderr=log, start_new_session=True
                )
            except OSError as error:
                raise ScreenError(f"cannot start Xvfb: {error.strerror}") from error

    def __exit__(self, *_) -> None:
        """Stop the screen."""
        if self._server is None:
            return
        self._server.terminate()
        try:
            self._server.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()

    def picture_now_and_then(self) -> None:
        """Save a picture if it is time for one, so that there is one however the run ends."""
        if time.monotonic() >= self._next:
            self.picture()

    def picture(self) -> None:
        """Save what is on the screen, cut to the windows; nothing while there are none."""
        self._next = time.monotonic() + _PICTURE_PERIOD
        with contextlib.suppress(OSError):
            image = ImageGrab.grab(xdisplay=self._display).convert("RGB")
            box = image.getbbox()
            if box is not None:
                unfinished = self._picture.with_name(f".{self._picture.name}")
                image.crop(box).save(unfinished, format="PNG")
                unfinished.replace(self._picture)
