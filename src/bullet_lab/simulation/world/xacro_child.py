"""Expand a xacro file in a process of its own: xacro_child.py FILE SECONDS MEMORY_BYTES.

It is a part of `urdf`. `xacro` as a command finds its packages with it as well.
"""

from __future__ import annotations

import contextlib
import os
import re
import resource
import sys
import types
from io import StringIO
from typing import Any

OLD_TAGS = re.compile(r"<(macro|property|include)\s[^>]*(?:params|value|filename)\s*=")


def main() -> int:
    """Write URDF, or one line of error."""
    path, seconds, memory_bytes = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    # Otherwise Python would import modules beside this file first.
    del sys.path[0]
    try:
        import xacro
    except ImportError:
        return _fail("the Python package xacro is not installed")
    find_packages_of_ros1()
    _limit(seconds, memory_bytes)
    try:
        # Messages of xacro are not URDF.
        with contextlib.redirect_stdout(StringIO()):
            document = xacro.process_file(path, mappings={}, verbosity=0)
        text = document.toxml()
    except (Exception, SystemExit) as error:
        if _is_memory_error(error):
            return _fail(f"xacro took more than {memory_bytes >> 20} MB of memory")
        hint = hint_of_old_tags(path)
        reason = f"xacro: {error or type(error).__name__}{hint and f' ({hint})'}"
        return _fail(" ".join(reason.split()))
    sys.stdout.write(text)
    return 0


def command() -> None:
    """Run xacro's command line; if it fails, report first what Noetic no longer reads in a file."""
    find_packages_of_ros1()
    from xacro import main

    said = StringIO()
    try:
        with contextlib.redirect_stderr(said):
            main()
    except SystemExit as end:
        for path in filter(os.path.isfile, sys.argv[1:] if end.code else ()):
            hint = hint_of_old_tags(path)
            sys.stderr.write(f"xacro: error in {path}: {hint}\n" if hint else "")
        raise
    finally:
        sys.stderr.write(said.getvalue())


def hint_of_old_tags(path: str) -> str:
    """Return a remark on tags without the prefix that xacro demands since Noetic, or nothing."""
    with open(path, errors="replace") as file:
        found = sorted(set(OLD_TAGS.findall(file.read())))
    names = ", ".join(f"<{name}> is <xacro:{name}>" for name in found)
    return f"since ROS Noetic, {names}" if names else ""


def find_packages_of_ros1() -> None:
    """Make xacro's $(find package) search like package://; PyPI's xacro would ask ROS 2."""
    from bullet_lab.simulation.world.resources import ros_package_folder

    def share_folder(name: str) -> str:
        folder = ros_package_folder(name)
        if folder is None:
            raise LookupError(f"no ROS package '{name}'")
        return str(folder)

    packages = types.ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = share_folder
    sys.modules["ament_index_python"] = types.ModuleType("ament_index_python")
    sys.modules["ament_index_python.packages"] = packages


def _is_memory_error(error: Any) -> bool:
    # xacro wraps an error that it catches in one with the attribute `exc`.
    while error is not None and not isinstance(error, MemoryError):
        error = getattr(error, "exc", None)
    return error is not None


def _limit(seconds: int, memory_bytes: int) -> None:
    for kind, most in (
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_AS, memory_bytes),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(kind, (most, most))


def _fail(message: str) -> int:
    sys.stderr.write(f"{message}\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())
