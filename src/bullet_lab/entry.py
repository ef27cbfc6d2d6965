"""How the executables in scripts/ start: import late, so that failing to is one line too."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import signal
import sys
from urllib.parse import urlsplit

from bullet_lab.errors import LabError

STATUS_CANNOT_START = 1
STATUS_INTERRUPTED = 130
# Of GNU's malloc.h; pictures of 640x480 are smaller, for whom the system would take too long.
M_MMAP_THRESHOLD, LARGE_BYTES = -3, 4 * 2**20
M_ARENA_MAX, ARENAS = -8, 1
JOB = "BULLET_LAB_JOB"
"""Set in the environment of a job's nodes."""


def run(target: str) -> None:
    """Import "module" or "module:function" and call its `main` or function.

    Where a library is missing, that ends with one line.
    """
    module, _, function = target.partition(":")
    name = os.path.basename(sys.argv[0])
    # With several, the last bit of a sum depends on how many cores there are.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    end_at_once_when_interrupted()
    give_memory_back()
    import logging

    # A log that finds no room on the disk is no reason for tracebacks.
    logging.raiseExceptions = False
    keep_to_this_machine()
    try:
        main = getattr(importlib.import_module(module), function or "main")
    except LabError as error:
        _end(f"{name}: {error}")
    except ImportError as error:
        hint = "run scripts/setup.sh, or install what package.xml and requirements.txt name"
        _end(f"{name}: {error} (for {sys.executable}): {hint}")
    if signal.getsignal(signal.SIGINT) is _end_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    main()


def give_memory_back() -> None:
    """Have the C library give the system back what is freed, instead of keeping it.

    Where shadow maps and pictures of many sizes come and go, it comes to keep them among what is
    small, and a process grows by hundreds of megabytes in an hour. And it has a heap for each of
    many threads, which keeps up to 64 MB when they are gone: rospy has one for each connection.
    """
    # Other C libraries than GNU's have no such function, and no such habit.
    with contextlib.suppress(AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        mallopt(M_ARENA_MAX, ARENAS)


def trim_memory() -> None:
    """Have the C library give the system back what is free among what is in use.

    By itself it gives back large buffers and the end of its heap: what is free before a small
    thing that is in use stays resident.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def keep_to_this_machine() -> None:
    """Have rospy listen on the loopback, unless the environment names an address or a master.

    rospy itself listens on all interfaces, and whoever reaches a node may stop it.
    """
    if any(os.environ.get(name) for name in ("ROS_IP", "ROS_HOSTNAME")):
        return
    try:
        master = urlsplit(os.environ.get("ROS_MASTER_URI", "")).hostname or "localhost"
    except ValueError:
        # rospy will say so.
        return
    if master in ("localhost", "::1") or master.startswith("127."):
        os.environ["ROS_HOSTNAME"] = "localhost"


def end_at_once_when_interrupted() -> None:
    """Answer Ctrl-C by the end of this process, for as long as there is nothing to put in order.

    Modules that are being imported may swallow a KeyboardInterrupt, and where it has come through
    `exec`, as of dataclasses, Python kills itself by SIGINT whatever status it is told to end with.
    """
    # A shell's background job is not to be interrupted.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end_at_once)
    # scripts/run.sh has one wait that comes before this.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))


def _end_at_once(*_) -> None:
    os._exit(STATUS_INTERRUPTED)


def _end(line: str) -> None:
    print(line, file=sys.stderr)
    sys.exit(STATUS_CANNOT_START)
