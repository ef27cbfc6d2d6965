"""A process that has imported what all nodes need, and forks into each node of the package.

A node starts sooner that way, as it has most of its modules already. It is a process of its own
all the same, and a child of the launcher: with its name, log, signals and exit status.

    python -m bullet_lab.ros.launcher.node_server <file descriptor>
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import reduction
from multiprocessing.connection import Connection
from typing import NamedTuple

from bullet_lab.entry import adopt_orphans, end_at_once_when_interrupted, quick_imports

# They import rospy, NumPy and the messages.
SHARED = (
    "bullet_lab.ros.messages.gazebo_types",
    "bullet_lab.ros.messages.poses",
    "bullet_lab.ros.node.lock_step",
    "bullet_lab.ros.node.odometry",
)
# Bytes of the server's command line, which the nodes replace by their own.
ROOM = 4096
# Places of arg_start and arg_end in /proc/self/stat behind the name of the process.
ARGUMENTS = slice(45, 47)
# Option of Linux's prctl.h.
PR_SET_PDEATHSIG = 1


class Request(NamedTuple):
    """What a node is started with: command line, working folder and environment."""

    words: list[str]
    folder: str
    environment: dict[str, str]


class NodeProcess:
    """A node that the server has started; with what roslaunch uses of `subprocess.Popen`."""

    def __init__(self, pid: int):
        self.pid = pid
        self.returncode: int | None = None
        self._lock = threading.Lock()

    def poll(self) -> int | None:
        """Return the exit status, None while it runs, -n after a signal n."""
        with self._lock:
            if self.returncode is None:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
                if pid:
                    killed = os.WIFSIGNALED(status)
                    self.returncode = -os.WTERMSIG(status) if killed else os.WEXITSTATUS(status)
            return self.returncode


class NodeServer:
    """The server's process, for the launcher; leaving the context ends it, but not the nodes."""

    def __init__(self):
        # Nodes are orphans of the server's.
        adopt_orphans()
        self._connection, theirs = multiprocessing.Pipe()
        number = theirs.fileno()
        command = [sys.executable, "-m", __name__, str(number), " " * ROOM]
        self._process = subprocess.Popen(command, pass_fds=[number], start_new_session=True)
        theirs.close()

    def __enter__(self) -> NodeServer:
        return self

    def __exit__(self, *_) -> None:
        self._connection.close()
        self._process.kill()
        self._process.wait()

    def start(self, request: Request, output: int) -> NodeProcess:
        """Start a node whose standard output is a file descriptor; raise OSError or EOFError."""
        self._connection.send(request)
        reduction.send_handle(self._connection, output, self._process.pid)
        return NodeProcess(self._connection.recv())


def serve(connection: Connection) -> Request | None:
    """Answer requests; return one in the process of each node, and None when they end."""
    end_at_once_when_interrupted()
    # A module that cannot be imported is reported by the node that imports it.
    with contextlib.suppress(ImportError), quick_imports():
        for module in SHARED:
            importlib.import_module(module)
    launcher = os.getppid()
    while True:
        try:
            request = connection.recv()
            output = reduction.recv_handle(connection)
            pid = _fork_orphan(launcher)
            if pid:
                os.close(output)
                connection.send(pid)
        except (EOFError, BrokenPipeError):
            # The launcher has ended.
            return None
        if not pid:
            os.dup2(output, sys.stdout.fileno())
            os.close(output)
            connection.close()
            return request


def _fork_orphan(launcher: int) -> int:
    """Return the number of a new process, whose parent is the launcher; 0 in that process.

    Raises EOFError if the launcher has ended.
    """
    read, write = os.pipe()
    middle = os.fork()
    if middle:
        os.close(write)
        os.waitpid(middle, 0)
        with open(read) as answer:
            pid = answer.read()
        if not pid:
            raise EOFError
        return int(pid)
    middle = os.getpid()
    if os.fork():
        os._exit(0)
    os.setsid()
    while os.getppid() == middle:
        time.sleep(0.001)
    # As `output.tied`.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != launcher:
        os._exit(1)
    os.close(read)
    with open(write, "w") as answer:
        answer.write(str(os.getpid()))
    return 0


def become(request: Request) -> None:
    """Run a node's executable in this process."""
    import rosgraph.names
    import rospy.names

    show_command_line([sys.executable, *request.words])
    os.chdir(request.folder)
    os.environ.clear()
    os.environ.update(request.environment)
    sys.argv[:] = request.words
    sys.path[0] = os.path.dirname(request.words[0])
    # rospy has read the server's command line and namespace.
    rospy.names.reload_mappings(sys.argv)
    rospy.names._set_caller_id(f"{rosgraph.names.get_ros_namespace()}unnamed")
    runpy.run_path(request.words[0], run_name="__main__")


def show_command_line(words: list[str]) -> None:
    """Write a command line into this process's memory, where ps and pkill read it."""
    with open("/proc/self/stat") as stat:
        start, end = map(int, stat.read().rpartition(")")[2].split()[ARGUMENTS])
    line = "".join(f"{word}\0" for word in words).encode()
    ctypes.memmove(start, line[: end - start - 1].ljust(end - start, b"\0"), end - start)


if __name__ == "__main__":
    # As in `entry.run`.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    wanted = serve(Connection(int(sys.argv[1])))
    if wanted is not None:
        become(wanted)
