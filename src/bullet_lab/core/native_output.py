"""Redirection of what C++ libraries print to the terminal."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from typing import IO, Iterator


@contextlib.contextmanager
def hidden_native_output() -> Iterator[None]:
    """Discard what native code writes to the standard streams in this block.

    PyBullet prints its build time when it is imported, and warnings while it loads. It also raises
    each failure, which is reported once.
    """
    with open(os.devnull, "wb") as sink, native_output_to(sink):
        yield


@contextlib.contextmanager
def native_output_to(file: IO) -> Iterator[None]:
    """Redirect what native code writes to the standard streams in this block to a file."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = {stream: os.dup(stream) for stream in (1, 2)}
    try:
        for stream in saved:
            os.dup2(file.fileno(), stream)
        yield
    finally:
        # The C library has its own buffer, which it would write at exit.
        ctypes.CDLL(None).fflush(None)
        for stream, copy in saved.items():
            os.dup2(copy, stream)
            os.close(copy)
