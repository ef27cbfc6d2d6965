"""Writing what others name into one folder or below it, and nowhere else."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from bullet_lab.core.files import FileError, make_folder

_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL


class ConfinedFolder:
    """A folder that others may have files written into.

    Links count as they are when it is asked for: those that lead out are refused, and one that
    comes into the way after that is not followed.

    Attributes:
        path: of the folder, without links.
    """

    def __init__(self, path: Path):
        self.path = path.expanduser().resolve()

    def place(self, name: str) -> Path:
        """Return where a file of that name will be: a path without links, below the folder.

        Raises:
            FileError: it would be elsewhere, or is or lacks a folder.
            OSError, RuntimeError: the name is too long, its links go in circles.
        """
        path = (self.path / name).resolve()
        if path != self.path and self.path not in path.parents:
            raise FileError(f"{path} is not in {self.path}")
        if path.is_dir() or path == self.path:
            raise FileError(f"{path} is a folder")
        make_folder(self.path)
        if not path.parent.is_dir():
            raise FileError(f"there is no folder {path.parent}")
        return path

    def write(self, path: Path, text: str) -> None:
        """Put a text where `place` has said, whole or not at all; raises FileError."""
        try:
            with contextlib.ExitStack() as opened:
                inner = self._open(opened, path.parent)
                _put(inner, path.name, text)
        except OSError as error:
            raise FileError(f"cannot write {path}: {error.strerror}") from error

    def _open(self, opened: contextlib.ExitStack, folder: Path) -> int:
        """Open a folder below this one step by step, through no link; return its descriptor."""
        inner = os.open(self.path, _FOLDER)
        opened.callback(os.close, inner)
        for part in folder.relative_to(self.path).parts:
            inner = os.open(part, _FOLDER, dir_fd=inner)
            opened.callback(os.close, inner)
        return inner


def _put(folder: int, name: str, text: str) -> None:
    part = f".part_{secrets.token_hex(8)}"
    try:
        with open(os.open(part, _NEW_FILE, 0o666, dir_fd=folder), "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(part, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(part, dir_fd=folder)
        raise
