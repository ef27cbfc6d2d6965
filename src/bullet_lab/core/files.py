"""Writing results so that nothing half-written is ever found."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any, Callable, Iterable, Mapping

from bullet_lab.errors import LabError


class FileError(LabError):
    """A result cannot be written."""


def make_folder(folder: Path) -> Path:
    """Make a folder for results, if need be, and return it.

    Raises:
        FileError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot make the folder {folder}: {error.strerror}") from error
    if not os.access(folder, os.W_OK):
        raise FileError(f"cannot write to the folder {folder}")
    return folder


def replace_file(path: Path, write: Callable[[Path], None]) -> None:
    """Have a file written beside its place and put there only when it is whole.

    Args:
        path: where the file shall be.
        write: writes to the path that it is given.

    Raises:
        FileError: it cannot be written; what was there before still is.
    """
    try:
        _replace_file(path, write)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error


def _replace_file(path: Path, write: Callable[[Path], None]) -> None:
    descriptor, name = tempfile.mkstemp(dir=path.parent, suffix=path.suffix, prefix=".part_")
    os.close(descriptor)
    part = Path(name)
    try:
        write(part)
        # mkstemp's files are private; results are for everybody that may read the folder.
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o666 & ~umask)
        part.replace(path)
    finally:
        with contextlib.suppress(FileNotFoundError):
            part.unlink()


def move_file(path: Path, folder: Path) -> None:
    """Move a file to a folder, over what has its name there; raises FileError."""
    try:
        path.replace(folder / path.name)
    except OSError as error:
        raise FileError(f"cannot move {path} to {folder}: {error.strerror}") from error


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as indented JSON, keys in the given order.

    Raises:
        FileError: a value has no place in JSON, such as NaN, or the file cannot be written.
    """
    try:
        text = json.dumps(values, indent=2, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise FileError(f"cannot write {path}: {error}") from error
    replace_file(path, lambda part: part.write_text(text))


class RowFile:
    """A text file that is written row by row, each in the file as soon as it is known.

    Raises:
        FileError: the file cannot be written; so do its methods.
    """

    def __init__(self, path: Path):
        self.path = path
        self._file = self._try(lambda: path.open("w", buffering=1))

    def write(self, row: str) -> None:
        """Add a row, given without its line end."""
        self._try(lambda: self._file.write(f"{row}\n"))

    def rewrite(self, rows: Iterable[str]) -> None:
        """Close the file and put other rows in its place, at once or not at all."""
        self.close()
        text = "".join(f"{row}\n" for row in rows)
        replace_file(self.path, lambda part: part.write_text(text))

    def close(self) -> None:
        """Close the file as it is."""
        self._try(self._file.close)

    def _try(self, action: Callable[[], Any]) -> Any:
        try:
            return action()
        except OSError as error:
            raise FileError(f"cannot write {self.path}: {error.strerror}") from error
