"""Rows of numbers over time, written as they come, so that a crash loses nothing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Callable, Dict, Iterable, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.files import RowFile, make_folder
from bullet_lab.core.trajectory import Trajectory, tum_row
from bullet_lab.errors import LabError

NANOSECONDS = 1_000_000_000


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
