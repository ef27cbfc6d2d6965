"""A screen without a display, for RViz on a machine that has none."""

from __future__ import annotations

import os
import select
import subprocess
from pathlib import Path

from PIL import ImageGrab

from bullet_lab.errors import LabError

_SIZE = "1600x1000x24"
_START_TIMEOUT = 20.0
_STOP_TIMEOUT = 5.0


class ScreenError(LabError):
    """There is no screen to show something on."""


class VirtualScreen:
    """An Xvfb on a free display, which DISPLAY names from then on."""

    def __init__(self, log: Path):
        self._log = log
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

    def grab(self, path: Path) -> bool:
        """Save what is on the screen, cut to the windows; False while there is nothing."""
        try:
            image = ImageGrab.grab(xdisplay=self._display).convert("RGB")
            box = image.getbbox()
            if box is None:
                return False
            unfinished = path.with_name(f".{path.name}")
            image.crop(box).save(unfinished, format="PNG")
            unfinished.replace(path)
        except OSError:
            return False
        return True
