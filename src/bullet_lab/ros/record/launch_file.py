"""A launch file that somebody else wrote: it is run, and what roslaunch says of it is read."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shlex
import subprocess
from collections import Counter
from pathlib import Path
from typing import Callable, List, Optional

from bullet_lab.ros.node.node import NodeError

# Wall seconds for what roslaunch has started to end, of the six that this node has itself.
GOODBYE = 5.0
COLOURS = re.compile(r"\x1b(\[[\d;]*m|\][^\x07]*\x07)")
# What is in a line of roslaunch's that tells what went wrong.
TELLING = re.compile(r"rror\b|Exception|not found|died")
NOT_LAUNCHED = re.compile(r"cannot launch node of type \[(.+?)/(.+?)\]: (.*)")
DIED = re.compile(r"\[([^][]+)\] process has died .*?(exit code -?\d+|without exit code)")
# How Debian names what has the nodes of a ROS package, the likeliest first.
DEBIAN = ("{}-tools", "lib{}lib-tools", "ros-{}", "ros-noetic-{}", "{}", "python3-{}")
INSTALLED = Path("/var/lib/dpkg/info")
ROS = re.compile(r"Robot OS|\bROS\b|ros\.org")


def assignments(words: str) -> List[str]:
    """Return words like name:=value or name=value, as roslaunch has them."""
    return [re.sub("^([^=:]+):?=", r"\1:=", word) for word in shlex.split(words)]


def reason_in(log: str) -> str:
    """Return the line in what roslaunch has printed that says most about why it has ended."""
    lines = [line for line in re.sub(COLOURS, "", log).splitlines() if line]
    telling = (n for n, line in enumerate(lines) if re.search(TELLING, line))
    first = next(telling, 0)
    # What ends with a colon is told in the line below.
    last = next((n for n in range(first, len(lines)) if not lines[n].endswith(":")), first)
    return " ".join(line.strip() for line in lines[first : last + 1]) or "without a word"


def failures_in(log: str, package_of: Callable[[str], str]) -> List[str]:
    """Return a line for each node that could not start or died, by what roslaunch has printed.

    `package_of` gives the Debian package with the nodes of a ROS package; empty for none.
    """
    log, found = re.sub(COLOURS, "", log), []
    for package, name, why in re.findall(NOT_LAUNCHED, log):
        debian, is_missing = package_of(package), why == package
        why = f"there is no ROS package '{package}'" if is_missing else why
        if debian or is_missing:
            why += f"; Debian has it: {debian}" if debian else "; Debian has none that is known"
        found.append(f"{package}/{name}: {why}")
    found += [f"{name} has died ({why})" for name, why in re.findall(DIED, log)]
    counts = Counter(found)
    return [line if n == 1 else f"{line} ({n} times)" for line, n in counts.items()]


@functools.lru_cache(maxsize=None)
def debian_package(package: str) -> str:
    """Return the Debian package that has a ROS package's nodes; empty for one that is here or none.

    It is looked for in what apt has listed, by the names that Debian gives such packages.
    """
    full = package.replace("_", "-")
    names = [form.format(name) for form in DEBIAN for name in (full, full.replace("-ros", ""))]
    command = ["apt-cache", "show", *names]
    try:
        shown = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout
    except OSError:
        return ""
    parts = shown.decode(errors="replace").split("Package: ")
    # Debian's tf is a game.
    known = {part.split(None, 1)[0] for part in parts if re.search(ROS, part)}
    found = next((name for name in names if name in known), "")
    # Some have their architecture after a colon.
    return "" if any(INSTALLED.glob(f"{found}[.:]*list")) else found


class Launched:
    """A launch file that runs as long as this is open, by a roslaunch of its own; none without."""

    def __init__(self, path: str, arguments: str):
        folder = Path(os.environ.get("ROS_LOG_DIR") or ".")
        self.path, self._log = path, folder / "launch_file.log"
        words = ["roslaunch", "--sigint-timeout", "3", "--sigterm-timeout", "1", path]
        self._process: Optional[subprocess.Popen] = None
        if path:
            with self._log.open("w") as log:
                self._process = subprocess.Popen(
                    words + assignments(arguments), stdout=log, stderr=subprocess.STDOUT
                )

    def check(self) -> None:
        """Raise NodeError if it has ended."""
        if self._process is not None and self._process.poll() is not None:
            reason = reason_in(self._printed())
            raise NodeError(f"{self.path} has ended, see {self._log}: {reason}")

    def failures(self) -> List[str]:
        """Return a line for each node that could not start or has died."""
        return failures_in(self._printed(), debian_package)

    def close(self) -> None:
        """End all that it has started."""
        if self._process is not None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GOODBYE)

    def _printed(self) -> str:
        return self._log.read_text(errors="replace") if self.path else ""
