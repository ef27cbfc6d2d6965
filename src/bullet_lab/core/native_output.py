"""Keeping what C++ libraries print away from the user's terminal."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from typing import IO, Iterator


@contextlib.contextmanager
def hidden_native_output() -> Iterator[None]:
    """Discard what native code writes to the standard streams meanwhile.

    PyBullet prints its build time when it is imported and warnings while it loads; every
    failure is also raised, and reported once.
    """
    with open(os.devnull, "wb") as sink, native_output_to(sink):
        yield


@contextlib.contextmanager
def native_output_to(file: IO) -> Iterator[None]:
    """Have native code write to a file instead of the standard streams meanwhile."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = {stream: os.dup(stream) for stream in (1, 2)}
    try:
        for stream in saved:
            os.dup2(file.fileno(), stream)
        yield
    finally:
        # C keeps a buffer of its own, which would come out at exit.
        ctypes.CDLL(None).fflush(None)
        for stream, copy in saved.items():
            os.dup2(copy, stream)
            os.close(copy)
