"""Tries mutants, one after the other: python worker.py SEED FOLDER WAY:FIRST:COUNT …

Before each it prints its place in the list and its number, after each that fails why; whoever has
started it sees by that where it has died or hangs. What an exception does not tell is watched here:
files that are opened where nothing of the package has a reason to, numbers that are not finite,
memory.
"""

import contextlib
import logging
import os
import resource
import site
import sys
import sysconfig
import tempfile
import traceback
import warnings
from pathlib import Path

from mutations import generator, mutant
from ways import PACKAGE, WAYS, check_numbers

from bullet_lab.errors import LabError

# Address space of a worker, and how much it may grow from one mutant to the next, in bytes.
MOST_MEMORY, MOST_GROWTH = 6 << 30, 400 << 20
# A refusal is a line for people.
LONGEST_LINE = 4000
ALLOWED = (
    str(PACKAGE),
    os.path.realpath(PACKAGE / "build" / "ws"),
    sys.prefix,
    sys.base_prefix + "/lib",
    sys.base_prefix + "/share",
    "/opt/ros",
    "/etc/matplotlibrc",
    os.path.expanduser("~/.cache/matplotlib"),
    os.path.expanduser("~/.config/matplotlib"),
    # rosbag compiles the definitions of messages that a bag has.
    os.path.join(tempfile.gettempdir(), "genpy_"),
    # Older scipy makes and removes a file while it is imported.
    os.path.join(tempfile.gettempdir(), "scipy-"),
    "/dev/",
    "/proc/self",
    "/sys/devices",
    *sysconfig.get_paths().values(),
    *site.getsitepackages(),
)


class Watch:
    """Notes files that are opened outside of `ALLOWED` and a folder while a mutant is tried."""

    def __init__(self, folder):
        self._folder = os.path.realpath(folder)
        self.outside = []
        self._on = False
        sys.addaudithook(self._see)

    @contextlib.contextmanager
    def look(self):
        """Watch for as long as this lasts."""
        self.outside, self._on = [], True
        try:
            yield
        finally:
            self._on = False

    def _see(self, event, arguments):
        if not self._on or event not in ("open", "os.remove", "os.rename", "socket.connect"):
            return
        name = arguments[0]
        if event == "socket.connect":
            self.outside.append(f"a connection to {arguments[1]}")
        elif isinstance(name, (str, bytes)) and name:
            path = os.path.realpath(os.fsdecode(name))
            if not path.startswith((self._folder, *ALLOWED)):
                self.outside.append(path)


def try_mutant(way, path, watch):
    """Return why a mutant fails, or nothing."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        with watch.look():
            check_numbers(WAYS[way].enter(path))
    except LabError as error:
        line = str(error)
        if "\n" in line or not line or len(line) > LONGEST_LINE:
            return f"a refusal of {len(line)} characters: {line[:200]}"
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        said = " ".join(str(error).split())[:200]
        return f"{type(error).__name__}: {said} ({Path(where.filename).name}:{where.lineno})"
    if watch.outside:
        return f"it has opened {watch.outside[0]}"
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    return f"it took {grown >> 20} MB" if grown > MOST_GROWTH else ""


def main():
    """Try mutants."""
    seed, folder, *batches = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w")
    # Libraries in C print as they please.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    with tempfile.TemporaryDirectory(dir=folder) as here:
        watch = Watch(here)
        os.chdir(here)
        for place, batch in enumerate(batches):
            way, first, count = batch.split(":")
            seeds = list(WAYS[way].seeds())
            path = Path(here) / f"mutant{WAYS[way].suffix}"
            for number in range(int(first), int(first) + int(count)):
                path.write_bytes(mutant(seeds, generator(int(seed), way, number)))
                print(place, number, file=answers, flush=True)
                failure = try_mutant(way, path, watch)
                if failure:
                    print(f"! {failure}", file=answers, flush=True)


if __name__ == "__main__":
    main()
