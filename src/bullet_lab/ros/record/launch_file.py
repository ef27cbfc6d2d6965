"""Runs the launch file of a user, and finds errors in the output of roslaunch."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shlex
import subprocess
from collections import Counter
from pathlib import Path
from typing import Callable

from bullet_lab.ros.node.node import NodeError

# Wall seconds for roslaunch to end its nodes; this node itself has six.
GOODBYE = 5.0
COLOURS = re.compile(r"\x1b(\[[\d;]*m|\][^\x07]*\x07)")
# A line of roslaunch that reports an error.
ERROR = re.compile(r"rror\b|Exception|not found|died")
NOT_LAUNCHED = re.compile(r"cannot launch node of type \[(.+?)/(.+?)\]: (.*)")
DIED = re.compile(r"\[([^][]+)\] process has died .*?(exit code -?\d+|without exit code)")
# Names of Debian packages with the nodes of a ROS package, the likeliest first.
DEBIAN = ("{}-tools", "lib{}lib-tools", "ros-{}", "ros-noetic-{}", "{}", "python3-{}")
INSTALLED = Path("/var/lib/dpkg/info")
ROS = re.compile(r"Robot OS|\bROS\b|ros\.org")


def assignments(words: str) -> list[str]:
    """Split words like name:=value or name=value, and return them as name:=value."""
    return [re.sub("^([^=:]+):?=", r"\1:=", word) for word in shlex.split(words)]


def reason_in(log: str) -> str:
    """Return the line of roslaunch's output that best explains why it has ended."""
    lines = [line.strip() for line in COLOURS.sub("", log).splitlines() if line]
    first = next((n for n, line in enumerate(lines) if ERROR.search(line)), 0)
    # After a colon, the message goes on in the next line.
    last = next((n for n in range(first, len(lines)) if not lines[n].endswith(":")), first)
    return " ".join(lines[first : last + 1]) or "no output"


def failures_in(log: str, package_of: Callable[[str], str]) -> list[str]:
    """Return a line for each node that could not start or died.

    Args:
        log: output of roslaunch.
        package_of: returns the Debian package with the nodes of a ROS package; empty for none.
    """
    log = COLOURS.sub("", log)
    found = []
    for package, name, why in NOT_LAUNCHED.findall(log):
        debian = package_of(package)
        if why == package:
            why = f"there is no ROS package '{package}'"
            debian_hint = "; Debian has none that is known"
        else:
            debian_hint = ""
        if debian:
            debian_hint = f"; Debian has it: {debian}"
        found.append(f"{package}/{name}: {why}{debian_hint}")
    found += [f"{name} has died ({why})" for name, why in DIED.findall(log)]
    counts = Counter(found)
    return [line if n == 1 else f"{line} ({n} times)" for line, n in counts.items()]


@functools.lru_cache(maxsize=None)
def debian_package(package: str) -> str:
    """Return the Debian package with a ROS package's nodes, by the lists of apt.

    The text is empty if there is none, or if it is installed.
    """
    full = package.replace("_", "-")
    names = [form.format(name) for form in DEBIAN for name in (full, full.replace("-ros", ""))]
    command = ["apt-cache", "show", *names]
    try:
        shown = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout
    except OSError:
        return ""
    parts = shown.decode(errors="replace").split("Package: ")
    # A name alone is not enough: Debian's package tf is a game.
    known = {part.split(None, 1)[0] for part in parts if ROS.search(part)}
    found = next((name for name in names if name in known), "")
    # Some file names have the architecture after a colon.
    return "" if any(INSTALLED.glob(f"{found}[.:]*list")) else found


class Launched:
    """A roslaunch process that runs a launch file until it is closed; none if `path` is empty."""

    def __init__(self, path: str, arguments: str):
        folder = Path(os.environ.get("ROS_LOG_DIR") or ".")
        self.path = path
        self._log = folder / "launch_file.log"
        words = ["roslaunch", "--sigint-timeout", "3", "--sigterm-timeout", "1", path]
        self._process: subprocess.Popen | None = None
        if path:
            with self._log.open("w") as log:
                self._process = subprocess.Popen(
                    words + assignments(arguments), stdout=log, stderr=subprocess.STDOUT
                )

    def check(self) -> None:
        """Raise NodeError if it has ended."""
        if self._process is not None and self._process.poll() is not None:
            reason = reason_in(self._output())
            raise NodeError(f"{self.path} has ended, see {self._log}: {reason}")

    def failures(self) -> list[str]:
        """Return a line for each node that could not start or has died."""
        return failures_in(self._output(), debian_package)

    def close(self) -> None:
        """End roslaunch and its nodes."""
        if self._process is not None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GOODBYE)

    def _output(self) -> str:
        return self._log.read_text(errors="replace") if self.path else ""
