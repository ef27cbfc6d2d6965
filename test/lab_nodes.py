"""Nodes of the package as processes, for the programs that measure and disturb them."""

import argparse
import contextlib
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path

import psutil
import rospy

PACKAGE = Path(__file__).resolve().parents[1]
# Wall seconds for a bridge to start, and for a node to end before it is killed.
START_SECONDS, STOP_SECONDS = 120.0, 20.0


def parser_of(prog, doc, **defaults):
    """Return a parser of options with defaults, which have the types of these."""
    shape = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog=prog, description=doc, formatter_class=shape)
    for name, default in defaults.items():
        if default is False:
            parser.add_argument(f"--{name}", action="store_true")
        else:
            parser.add_argument(f"--{name}", type=type(default), default=default)
    return parser


class Node:
    """A node in a process of its own, which ends with this one.

    Args:
        name: of its executable, such as "aruco".
        words: parameters and remappings.
        log: file that its output is appended to; without one, the output is lost.

    Attributes:
        process: what runs it.
        usage: what that takes of the machine.
    """

    def __init__(self, name, *words, log=None):
        self._log = log
        script = PACKAGE / "scripts" / f"{name}.py"
        with open(log or os.devnull, "a") as out:
            self.process = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", sys.executable, str(script), *words],
                stdout=out,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONFAULTHANDLER": "1"},
                # Ctrl-C is for the program that started it.
                start_new_session=True,
            )
        self.usage = psutil.Process(self.process.pid)

    def output(self):
        """Return what it has printed."""
        return self._log.read_text(errors="replace")

    def tracebacks(self):
        """Return the tracebacks that it has printed, each in a line."""
        parts = self.output().split("Traceback")[1:]
        return [" ".join(part.split("\n[")[0].split())[-2500:] for part in parts]

    def megabytes(self):
        """Return its resident memory."""
        return self.usage.memory_info().rss / 1e6

    def percent(self, seconds):
        """Return the processor time that it uses for so long, in percent of a core."""
        before, start = self._used(), time.monotonic()
        time.sleep(seconds)
        return 100.0 * (self._used() - before) / (time.monotonic() - start)

    def _used(self):
        return sum(self.usage.cpu_times()[:2])


def commands(text):
    """Return the words of nodes by their names, of a text with a line for each."""
    return {name: words for name, *words in map(shlex.split, text.strip().splitlines())}


class Lab:
    """A bridge and nodes around it, by their names; each has a log in a folder.

    Args:
        folder: of the logs.
        nodes: parameters and remappings by name.
    """

    def __init__(self, folder, nodes):
        self.nodes = {n: Node(n, *words, log=folder / f"{n}.log") for n, words in nodes.items()}
        rospy.wait_for_service("/bullet_lab/advance", START_SECONDS)

    def dead(self):
        """Return the nodes that have ended."""
        return [name for name, node in self.nodes.items() if node.process.poll() is not None]

    def tracebacks(self):
        """Return the tracebacks that nodes have printed."""
        found = {name: node.tracebacks() for name, node in self.nodes.items()}
        return [f"{name}: {text}" for name, texts in found.items() for text in texts]


def end_all(*nodes):
    """End nodes and wait for them."""
    for node in nodes:
        node.process.terminate()
    for node in nodes:
        with contextlib.suppress(subprocess.TimeoutExpired):
            node.process.wait(STOP_SECONDS)
        node.process.kill()
        node.process.wait()
