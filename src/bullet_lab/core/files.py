"""Result files: written whole or not at all, or row by row."""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from functools import partial
from itertools import starmap
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Iterator, Mapping, Optional, Sequence, Tuple

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

    `write` is called with the path to write to. Raises FileError if the file cannot be written; one
    that existed before is unchanged.
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


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all; raises FileError."""
    replace_file(path, lambda part: part.write_text(text))


def write_json(path: Path, values: Summary) -> None:
    """Write values as indented JSON, keys in the given order.

    Raises FileError if JSON cannot represent a value, such as NaN, or the file cannot be written.
    """
    try:
        text = json.dumps(values, indent=2, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise FileError(f"cannot write {path}: {error}") from error
    write_text(path, text)


class Series:
    """A CSV file of rows, each a stamp in s and numbers, written as they are added.

    The folder of the file is made. Either stamps that do not increase are refused, or, not
    `in_order`, rows are sorted at the end, and a row replaces one with the same stamp. All methods
    raise FileError if the file cannot be written.

    Attributes:
        columns: names of the numbers.
        last: the last stamp in ns; None before the first row.
    """

    def __init__(self, path: Path, columns: Sequence[str], in_order: bool = True):
        make_folder(path.parent)
        self.columns = tuple(columns)
        self.last: Optional[int] = None
        self._path, self._in_order = path, in_order
        self._rows: Dict[int, Tuple[float, ...]] = {}
        self._errors = partial(file_errors, f"cannot write {path}")
        with self._errors():
            self._file = path.open("w", buffering=1)
            self._file.write(self._header())

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, stamp: int, values: Sequence[float]) -> None:
        """Record numbers at a stamp in ns; they may be infinite, which means that nothing was seen.

        Raises LabError for NaN, a wrong number of them, or an out-of-order stamp.
        """
        row = tuple(map(float, values))
        if len(row) != len(self.columns):
            raise LabError(f"{len(row)} numbers; {len(self.columns)} are needed")
        self._check(row)
        last = stamp if self.last is None else self.last
        if self._in_order and self._rows and stamp <= last:
            times = f"{last / NANOSECONDS:.9f} s to {stamp / NANOSECONDS:.9f} s"
            raise LabError(f"time goes back from {times}")
        self._rows[stamp] = row
        self.last = max(last, stamp)
        with self._errors():
            self._file.write(self._line(stamp, row))

    def table(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the stamps in s, shape (n,), and the numbers, shape (n, columns)."""
        rows = sorted(self._rows.items())
        stamps = np.array([stamp for stamp, _ in rows], dtype=float) / NANOSECONDS
        numbers = np.array([row for _, row in rows], dtype=float)
        return stamps, numbers.reshape(len(rows), len(self.columns))

    def path(self, first: int = 0) -> Optional[Trajectory]:
        """Return x (m), y (m) and yaw (rad), from the column `first` on; None without rows."""
        stamps, rows = self.table()
        return Trajectory(stamps, rows[:, first : first + 3]) if len(stamps) else None

    def finish(self, until: Optional[int] = None) -> None:
        """Sort and close the file; rows after the stamp `until` in ns, if given, are left out."""
        rows = sorted(self._rows.items())
        self._rows = {stamp: row for stamp, row in rows if until is None or stamp <= until}
        with self._errors():
            self._file.close()
        write_text(self._path, self._header() + "".join(starmap(self._line, self._rows.items())))

    def _header(self) -> str:
        return ",".join(("stamp", *self.columns)) + "\n"

    def _line(self, stamp: int, row: Sequence[float]) -> str:
        return ",".join([f"{stamp / NANOSECONDS:.9f}", *map(repr, row)]) + "\n"

    def _check(self, row: Sequence[float]) -> None:
        if any(map(math.isnan, row)):
            raise LabError("a number is NaN; it must be finite or infinite")


class PathSeries(Series):
    """A TUM file of finite planar poses (m, m, rad)."""

    def __init__(self, path: Path):
        super().__init__(path, ("x", "y", "yaw"))

    def _header(self) -> str:
        return ""

    def _line(self, stamp: int, row: Sequence[float]) -> str:
        return tum_row(stamp / NANOSECONDS, *row) + "\n"

    def _check(self, row: Sequence[float]) -> None:
        if not all(map(math.isfinite, row)):
            raise LabError(f"the pose is not finite: {row}")


Values = Sequence[float]


class Join:
    """Joins rows of several sources whose stamps are equal to the nanosecond.

    `complete` is called with the stamp in ns and the values by source, when all have come.
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
