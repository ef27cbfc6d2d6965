"""The process: start of the executables in scripts/, its memory, and output of C++ libraries.

Modules are imported late, so that a failure is one line, too.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import os
import signal
import sys
from typing import Iterator
from urllib.parse import urlsplit

from bullet_lab.errors import LabError

STATUS_CANNOT_START = 1
STATUS_INTERRUPTED = 130
# Options of GNU's malloc.h.
M_MMAP_THRESHOLD = -3
M_ARENA_MAX = -8
# Option of Linux's prctl.h.
PR_SET_CHILD_SUBREAPER = 36
# Larger than images of 640x480, for which memory from the system would be too slow.
LARGE_BYTES = 4 * 2**20
ARENAS = 1
JOB = "BULLET_LAB_JOB"
"""Set in the environment of a job's nodes."""


def run(target: str, *arguments: object) -> None:
    """Import "module" or "module:function", and call its `main` or the function with arguments.

    If a library is missing, print one line and exit.
    """
    module, _, function = target.partition(":")
    name = os.path.basename(sys.argv[0])
    # With several threads, the last bit of a sum depends on the number of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    end_at_once_when_interrupted()
    give_memory_back()
    import logging

    # No traceback if the disk is too full for the log.
    logging.raiseExceptions = False
    keep_to_this_machine()
    try:
        with quick_imports():
            main = getattr(importlib.import_module(module), function or "main")
    except LabError as error:
        _end(f"{name}: {error}")
    except ImportError as error:
        hint = "run scripts/setup.sh, or install what package.xml and requirements.txt name"
        _end(f"{name}: {error} (for {sys.executable}): {hint}")
    if signal.getsignal(signal.SIGINT) is _end_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    main(*arguments)


@contextlib.contextmanager
def quick_imports() -> Iterator[None]:
    """Import in this block without garbage collections.

    They would take a fifth of its time: each looks at all modules so far, which are never garbage.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def command() -> None:
    """Run the command of an installation by pip; see `bullet_lab.jobs.command`."""
    run("bullet_lab.jobs.command")


def give_memory_back() -> None:
    """Make the C library return freed memory to the system instead of keeping it.

    Otherwise it keeps freed shadow maps and images of many sizes between small blocks, and a
    process grows by hundreds of megabytes in an hour. It also has a heap of up to 64 MB for each of
    many threads, even after they have ended; rospy has a thread for each connection.
    """
    # Only GNU's C library has this function, and needs it.
    with contextlib.suppress(AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        mallopt(M_ARENA_MAX, ARENAS)


def adopt_orphans() -> None:
    """Make processes below this one its children, from now on, when their parents have ended."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)


def trim_memory() -> None:
    """Make the C library return free memory between used blocks to the system.

    By default it returns only large buffers and the end of its heap.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


@contextlib.contextmanager
def hidden_native_output() -> Iterator[None]:
    """Discard what native code writes to the standard streams in this block.

    PyBullet prints its build time when it is imported, and warnings while it loads. It also raises
    each failure, which is reported once.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    saved = {stream: os.dup(stream) for stream in (1, 2)}
    try:
        with open(os.devnull, "wb") as sink:
            for stream in saved:
                os.dup2(sink.fileno(), stream)
        yield
    finally:
        # The C library has its own buffer, which it would write at exit.
        ctypes.CDLL(None).fflush(None)
        for stream, copy in saved.items():
            os.dup2(copy, stream)
            os.close(copy)


def keep_to_this_machine() -> None:
    """Make rospy listen on the loopback, unless the environment names an address or a master.

    By default rospy listens on all interfaces, and all who reach a node can stop it.
    """
    if any(os.environ.get(name) for name in ("ROS_IP", "ROS_HOSTNAME")):
        return
    try:
        master = urlsplit(os.environ.get("ROS_MASTER_URI", "")).hostname or "localhost"
    except ValueError:
        # rospy reports the invalid URI.
        return
    if master in ("localhost", "::1") or master.startswith("127."):
        os.environ["ROS_HOSTNAME"] = "localhost"


def end_at_once_when_interrupted() -> None:
    """Exit at once on Ctrl-C, while there is nothing to clean up.

    A module may swallow a KeyboardInterrupt while it is imported. If it is raised within `exec`, as
    of dataclasses, Python ends by SIGINT whatever the exit status.
    """
    # A shell's background job ignores SIGINT.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end_at_once)
    # scripts/run.sh starts Python with SIGINT blocked.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))


def _end_at_once(*_) -> None:
    os._exit(STATUS_INTERRUPTED)


def _end(line: str) -> None:
    print(line, file=sys.stderr)
    sys.exit(STATUS_CANNOT_START)
