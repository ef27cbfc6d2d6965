"""Result files: written whole or not at all, or row by row."""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.trajectory import Trajectory, tum_row
from bullet_lab.errors import LabError

NANOSECONDS = 1_000_000_000
Summary = Mapping[str, Any]
"""Content of summary.json, or of an entry in it, by name."""

PART = ".part_"
"""Prefix of the names of incomplete files."""


class FileError(LabError):
    """A file cannot be written."""


@contextlib.contextmanager
def file_errors(failure: str) -> Iterator[None]:
    """Raise FileError, which begins with a failure such as "cannot write x", for an OSError."""
    try:
        yield
    except OSError as error:
        raise FileError(f"{failure}: {error.strerror or error}") from error


def make_folder(folder: Path) -> Path:
    """Make a folder if it does not exist, and return it; raises FileError."""
    with file_errors(f"cannot make the folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        raise FileError(f"cannot write to the folder {folder}")
    return folder


def replace_file(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file under another name, and rename it when it is complete.

    Args:
        path: of the file.
        write: writes a file to the path that it is called with.

    Raises:
        FileError: it cannot be written; a file that existed before is unchanged.
    """
    with file_errors(f"cannot write {path}"):
        descriptor, name = tempfile.mkstemp(dir=path.parent, suffix=path.suffix, prefix=PART)
        os.close(descriptor)
        part = Path(name)
        try:
            write(part)
            # mkstemp's files are private; all who can read the folder may read results.
            umask = os.umask(0)
            os.umask(umask)
            part.chmod(0o666 & ~umask)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def write_json(path: Path, values: Summary) -> None:
    """Write values as indented JSON, keys in the given order.

    Raises:
        FileError: JSON cannot represent a value, such as NaN, or the file cannot be written.
    """
    try:
        text = json.dumps(values, indent=2, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise FileError(f"cannot write {path}: {error}") from error
    replace_file(path, lambda part: part.write_text(text))


class Series:
    """A CSV file of rows, each a stamp in s and numbers, written as they are added.

    Args:
        path: of the file; its folder is made if it does not exist.
        columns: names of the numbers.
        in_order: whether stamps that do not increase are refused. Otherwise rows are sorted at the
            end, and a row replaces an earlier one with the same stamp.

    Raises:
        FileError: the file cannot be written; its methods raise it, too.
    """

    def __init__(self, path: Path, columns: Sequence[str], in_order: bool = True):
        make_folder(path.parent)
        self.columns = tuple(columns)
        self.last: Optional[int] = None
        """The last stamp in ns; None before the first row."""
        self._path = path
        self._in_order = in_order
        self._rows: Dict[int, Tuple[float, ...]] = {}
        self._failure = f"cannot write {path}"
        with file_errors(self._failure):
            self._file = path.open("w", buffering=1)
            self._file.writelines(f"{line}\n" for line in self._header())

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, stamp: int, values: Sequence[float]) -> None:
        """Record numbers at a stamp in ns; they may be infinite, which means that nothing was seen.

        Raises:
            LabError: NaN, a wrong number of them, or an out-of-order stamp.
        """
        row = tuple(map(float, values))
        if len(row) != len(self.columns):
            raise LabError(f"{len(row)} numbers; {len(self.columns)} are needed")
        self._check(row)
        last = stamp if self.last is None else max(self.last, stamp)
        if self._in_order and self.last is not None and stamp <= self.last:
            raise LabError(
                f"time goes back from {self.last / NANOSECONDS:.9f} s "
                f"to {stamp / NANOSECONDS:.9f} s"
            )
        self._rows[stamp] = row
        self.last = last
        with file_errors(self._failure):
            self._file.write(f"{self._line(stamp, row)}\n")

    def table(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the stamps in s, shape (n,), and the numbers, shape (n, columns)."""
        rows = self._sorted()
        stamps = np.array([stamp for stamp, _ in rows], dtype=float) / NANOSECONDS
        numbers = np.array([row for _, row in rows], dtype=float)
        return stamps, numbers.reshape(len(rows), len(self.columns))

    def path(self, first: int = 0) -> Optional[Trajectory]:
        """Return three columns, x (m), y (m) and yaw (rad), as a trajectory; None without rows.

        Args:
            first: index of the column of x.
        """
        stamps, rows = self.table()
        return Trajectory(stamps, rows[:, first : first + 3]) if len(stamps) else None

    def finish(self, until: Optional[int] = None) -> None:
        """Sort and close the file; rows after the stamp `until` in ns, if given, are left out."""
        self._rows = {s: row for s, row in self._sorted() if until is None or s <= until}
        lines = [self._line(stamp, row) for stamp, row in self._rows.items()]
        text = "".join(f"{line}\n" for line in (*self._header(), *lines))
        with file_errors(self._failure):
            self._file.close()
        replace_file(self._path, lambda part: part.write_text(text))

    def _header(self) -> Iterable[str]:
        return [",".join(("stamp", *self.columns))]

    def _line(self, stamp: int, row: Sequence[float]) -> str:
        return ",".join([f"{stamp / NANOSECONDS:.9f}", *map(repr, row)])

    def _check(self, row: Sequence[float]) -> None:
        if any(map(math.isnan, row)):
            raise LabError("a number is NaN; it must be finite or infinite")

    def _sorted(self) -> List[Tuple[int, Tuple[float, ...]]]:
        return sorted(self._rows.items())


class PathSeries(Series):
    """A TUM file of finite planar poses (m, m, rad)."""

    def __init__(self, path: Path):
        super().__init__(path, ("x", "y", "yaw"))

    def _header(self) -> Iterable[str]:
        return ()

    def _line(self, stamp: int, row: Sequence[float]) -> str:
        return tum_row(stamp / NANOSECONDS, *row)

    def _check(self, row: Sequence[float]) -> None:
        if not all(map(math.isfinite, row)):
            raise LabError(f"the pose is not finite: {row}")


Values = Sequence[float]


class Join:
    """Joins rows of several sources whose stamps are equal to the nanosecond.

    Args:
        sources: names of all of them.
        complete: called with the stamp in ns and the values by source, when all have come.
    """

    def __init__(self, sources: Iterable[str], complete: Callable[[int, Dict[str, Values]], None]):
        self._sources = frozenset(sources)
        self._complete = complete
        self._waiting: Dict[int, Dict[str, Values]] = {}

    def add(self, source: str, stamp: int, values: Values) -> None:
        """Add the values of a source at a stamp in ns."""
        waiting = self._waiting.setdefault(stamp, {})
        waiting[source] = values
        if len(waiting) == len(self._sources):
            del self._waiting[stamp]
            self._complete(stamp, waiting)


def place_within(folder: Path, name: str) -> Path:
    """Return the path, without symbolic links, of a file of that name below a folder.

    Args:
        folder: that the file has to be in, without links; it is made if need be.
        name: of the file, from outside.

    Raises:
        FileError: the file is outside the folder, is a folder, or its folder does not exist.
        OSError, RuntimeError: the name is too long, or its links form a cycle.
    """
    path = (folder / name).resolve()
    if path != folder and folder not in path.parents:
        raise FileError(f"{path} is not in {folder}")
    if path.is_dir() or path == folder:
        raise FileError(f"{path} is a folder")
    make_folder(folder)
    if not path.parent.is_dir():
        raise FileError(f"there is no folder {path.parent}")
    return path
