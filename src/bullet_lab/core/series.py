"""Rows of numbers over time, written as they come, so that a crash loses nothing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.files import RowFile, make_folder
from bullet_lab.errors import LabError

NANOSECONDS = 1_000_000_000


class SeriesError(LabError):
    """A row that cannot be recorded."""


class Series:
    """A CSV file of rows, each with a stamp in s before its numbers.

    Args:
        path: of the file; its folder is made if need be.
        columns: names of the numbers.

    Raises:
        FileError: it cannot be written, here and in all that adds to it.
    """

    def __init__(self, path: Path, columns: Sequence[str]):
        make_folder(path.parent)
        self.columns = tuple(columns)
        self._file = RowFile(path)
        self._file.write(",".join(("stamp", *self.columns)))
        self._stamps: List[int] = []
        self._rows: List[Tuple[float, ...]] = []

    @property
    def last(self) -> Optional[int]:
        """The last stamp in ns, None while there is none."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp: int, values: Sequence[float]) -> None:
        """Record numbers at a stamp in ns; infinite ones are nothing seen, and allowed.

        Raises:
            SeriesError: NaN, another number of them, or a stamp that is not after the last one.
        """
        if len(values) != len(self.columns):
            raise SeriesError(f"{len(values)} numbers where there were {len(self.columns)}")
        if any(map(math.isnan, values)):
            raise SeriesError("a number that is NaN")
        if self._stamps and stamp <= self._stamps[-1]:
            raise SeriesError("time does not go on")
        row = tuple(map(float, values))
        self._stamps.append(stamp)
        self._rows.append(row)
        self._file.write(_line(stamp, row))

    def table(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the stamps in s, shape (n,), and the numbers, shape (n, columns)."""
        stamps = np.array(self._stamps, dtype=float) / NANOSECONDS
        return stamps, np.array(self._rows, dtype=float).reshape(len(stamps), len(self.columns))

    def finish(self, until: Optional[int] = None) -> None:
        """Close the file; leave out what came after a stamp in ns, if one is given."""
        kept = [k for k, stamp in enumerate(self._stamps) if until is None or stamp <= until]
        self._stamps = [self._stamps[k] for k in kept]
        self._rows = [self._rows[k] for k in kept]
        lines = [_line(stamp, row) for stamp, row in zip(self._stamps, self._rows)]
        self._file.rewrite([",".join(("stamp", *self.columns)), *lines])


def _line(stamp: int, row: Sequence[float]) -> str:
    return ",".join([f"{stamp / NANOSECONDS:.9f}", *(repr(value) for value in row)])
