"""Expand xacro, the macro language of URDF.

A xacro file is a program: its `${…}` are Python expressions. The xacro package restricts the names
in them, but this is no protection. So a file is only expanded if the user names its path, never if
it came as text. A separate process expands it, which has limited time and memory and cannot write
files. It can read everything that the user can read, with the environment: do not expand xacro
files of strangers.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Mapping, Optional

from bullet_lab.simulation.world.xml import MAXIMUM_BYTES, XmlError

SUFFIX = ".xacro"
SECONDS = 30
MEMORY_BYTES = 1 << 30
LONGEST_MESSAGE = 300


class XacroError(XmlError):
    """A xacro file cannot be expanded."""


def is_xacro(path: Path) -> bool:
    """Return whether a file has the suffix of xacro."""
    return path.suffix.lower() == SUFFIX


def expand_xacro(path: Path, arguments: Optional[Mapping[str, str]] = None) -> str:
    """Return the URDF text of a xacro file, with values for its `<xacro:arg>`.

    Raises:
        XacroError: the xacro package or the file is missing, the file is invalid, or it takes too
            much time or memory; the message says which.
    """
    limits = {"seconds": SECONDS, "memory_bytes": MEMORY_BYTES}
    order = {"path": str(path), "arguments": dict(arguments or {}), **limits}
    child = Path(__file__).with_name("xacro_child.py")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(
            [sys.executable, "-B", str(child)],
            input=json.dumps(order).encode(),
            capture_output=True,
            timeout=2 * SECONDS,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise XacroError(f"{path}: xacro took longer than {2 * SECONDS} s") from error
    if done.returncode != 0:
        raise XacroError(f"{path}: {_reason(done)}")
    if len(done.stdout) > MAXIMUM_BYTES:
        raise XacroError(f"{path}: xacro makes more than {MAXIMUM_BYTES} bytes of it")
    return done.stdout.decode()


def _reason(done: subprocess.CompletedProcess) -> str:
    if done.returncode < 0:
        return f"xacro took more than {SECONDS} s"
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return lines[-1][:LONGEST_MESSAGE] if lines else "xacro failed without a message"
