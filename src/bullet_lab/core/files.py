"""Files of results: whole or not at all, and rows over time, written as they come."""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.trajectory import Trajectory, tum_row
from bullet_lab.errors import LabError

NANOSECONDS = 1_000_000_000
PART = ".part_"
"""How the name of what is not whole yet begins."""


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
    descriptor, name = tempfile.mkstemp(dir=path.parent, suffix=path.suffix, prefix=PART)
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


class SeriesError(LabError):
    """A row that cannot be recorded."""


class Series:
    """A CSV file of rows, each with a stamp in s before its numbers.

    Args:
        path: of the file; its folder is made if need be.
        columns: names of the numbers.
        in_order: whether stamps that do not increase are refused. Otherwise rows are put in
            order at the end, and one at the stamp of an earlier one takes its place.

    Raises:
        FileError: it cannot be written, here and in all that adds to it.
    """

    def __init__(self, path: Path, columns: Sequence[str], in_order: bool = True):
        make_folder(path.parent)
        self.columns = tuple(columns)
        self.last: Optional[int] = None
        """The last stamp in ns, None while there is none."""
        self._in_order = in_order
        self._rows: Dict[int, Tuple[float, ...]] = {}
        self._file = RowFile(path)
        for line in self._header():
            self._file.write(line)

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, stamp: int, values: Sequence[float]) -> None:
        """Record numbers at a stamp in ns; infinite ones are nothing seen, and allowed.

        Raises:
            SeriesError: NaN, another number of them, or a stamp that is not after the last one.
        """
        row = tuple(map(float, values))
        if len(row) != len(self.columns):
            raise SeriesError(f"{len(row)} numbers where there were {len(self.columns)}")
        self._check(row)
        last = stamp if self.last is None else max(self.last, stamp)
        if self._in_order and self.last is not None and stamp <= self.last:
            raise SeriesError(
                f"time goes back from {self.last / NANOSECONDS:.9f} s "
                f"to {stamp / NANOSECONDS:.9f} s"
            )
        self._rows[stamp], self.last = row, last
        self._file.write(self._line(stamp, row))

    def table(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the stamps in s, shape (n,), and the numbers, shape (n, columns)."""
        rows = self._sorted()
        stamps = np.array([stamp for stamp, _ in rows], dtype=float) / NANOSECONDS
        numbers = np.array([row for _, row in rows], dtype=float)
        return stamps, numbers.reshape(len(rows), len(self.columns))

    def path(self, first: int = 0) -> Optional[Trajectory]:
        """Return three columns, which are x (m), y (m) and yaw (rad); None while there is no row.

        Args:
            first: index of the column of x.
        """
        stamps, rows = self.table()
        return Trajectory(stamps, rows[:, first : first + 3]) if len(stamps) else None

    def finish(self, until: Optional[int] = None) -> None:
        """Close the file; leave out what came after a stamp in ns, if one is given."""
        self._rows = {s: row for s, row in self._sorted() if until is None or s <= until}
        lines = [self._line(stamp, row) for stamp, row in self._rows.items()]
        self._file.rewrite([*self._header(), *lines])

    def _header(self) -> Iterable[str]:
        return [",".join(("stamp", *self.columns))]

    def _line(self, stamp: int, row: Sequence[float]) -> str:
        return ",".join([f"{stamp / NANOSECONDS:.9f}", *map(repr, row)])

    def _check(self, row: Sequence[float]) -> None:
        if any(map(math.isnan, row)):
            raise SeriesError("a number that is NaN")

    def _sorted(self) -> List[Tuple[int, Tuple[float, ...]]]:
        return sorted(self._rows.items())


class PathSeries(Series):
    """A TUM file of planar poses (m, m, rad), which are finite."""

    def __init__(self, path: Path):
        super().__init__(path, ("x", "y", "yaw"))

    def _header(self) -> Iterable[str]:
        return ()

    def _line(self, stamp: int, row: Sequence[float]) -> str:
        return tum_row(stamp / NANOSECONDS, *row)

    def _check(self, row: Sequence[float]) -> None:
        if not all(map(math.isfinite, row)):
            raise SeriesError(f"a pose that is not finite: {row}")


Values = Sequence[float]


class Join:
    """Rows of several sources, brought together where their stamps agree to the nanosecond.

    Args:
        sources: names of all of them.
        complete: called with the stamp in ns and the values by source, once all are there.
    """

    def __init__(self, sources: Iterable[str], complete: Callable[[int, Dict[str, Values]], None]):
        self._sources = frozenset(sources)
        self._complete = complete
        self._waiting: Dict[int, Dict[str, Values]] = {}

    def add(self, source: str, stamp: int, values: Values) -> None:
        """Take the values of a source at a stamp in ns."""
        waiting = self._waiting.setdefault(stamp, {})
        waiting[source] = values
        if len(waiting) == len(self._sources):
            del self._waiting[stamp]
            self._complete(stamp, waiting)
