"""A campaign's log, from which a stopped one goes on, and what it comes down to."""

from __future__ import annotations

import csv
import errno
import fcntl
import json
import math
import os
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

import numpy as np

from bullet_lab.core.files import FileError, replace_file
from bullet_lab.errors import LabError

# Each halves the interval; after these a double has no digits left.
_HALVINGS = 1100


class BinomialError(LabError):
    """Counts that cannot be."""


def lower_bound(successes: int, trials: int, confidence: float = 0.95) -> float:
    """Return Clopper and Pearson's one-sided lower bound of a probability of success.

    It is the p for which so many successes or more have the probability 1 - confidence; the
    true probability lies above it in at least that share of all experiments, whatever it is.
    (C. J. Clopper and E. S. Pearson, Biometrika 26, 1934. Without a failure it is
    (1 - confidence)^(1 / trials), some 1 - 3 / trials at 95 %.)

    Raises:
        BinomialError: not 0 <= successes <= trials, no trials, or a confidence beyond (0, 1).
    """
    if not 0 <= successes <= trials or trials < 1:
        raise BinomialError(f"{successes} successes of {trials}")
    if not 0.0 < confidence < 1.0:
        raise BinomialError(f"a confidence of {confidence:g} is not between 0 and 1")
    if successes == 0:
        return 0.0
    low, high = 0.0, successes / trials
    tail = _Tail(successes, trials)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if tail.probability(middle) < 1.0 - confidence:
            low = middle
        else:
            high = middle
    return low


class _Tail:
    """The probability of so many successes or more."""

    def __init__(self, successes: int, trials: int):
        counts = range(successes, trials + 1)
        self._counts = np.array(counts, dtype=float)
        self._rest = trials - self._counts
        self._ways = np.array(
            [
                math.lgamma(trials + 1) - math.lgamma(k + 1) - math.lgamma(trials - k + 1)
                for k in counts
            ]
        )

    def probability(self, p: float) -> float:
        """Return it for a probability of success 0 < p < 1."""
        logs = self._ways + self._counts * math.log(p) + self._rest * math.log1p(-p)
        return float(np.exp(logs).sum())


Record = Mapping[str, Any]

DOCKED = "docked"
ERRORS = ("distance_error_m", "lateral_error_m", "yaw_error_deg")
CONFIDENCE = 0.95


def campaign_summary(records: Sequence[Record]) -> Dict[str, Any]:
    """Return the figures of a campaign for summary.json.

    Rates, errors and contacts; the errors are magnitudes, of the dockings that succeeded.

    Args:
        records: of at least one docking each, in the order of their indices.
    """
    docked = [record for record in records if record["result"] == DOCKED]
    failures = Counter(r["result"] for r in records if r["result"] != DOCKED)
    known = [record for record in records if record["sim_time_s"] is not None]
    return {
        "dockings": len(records),
        "docked": len(docked),
        "success_rate": len(docked) / len(records),
        "success_rate_lower_95": lower_bound(len(docked), len(records), CONFIDENCE),
        "failures": dict(sorted(failures.items())),
        "failed_indices": [r["index"] for r in records if r["result"] != DOCKED],
        **{name: error_figures([record[name] for record in docked]) for name in ERRORS},
        "wall_contacts": sum(record["wall_contacts"] for record in known),
        "dockings_with_contact": sum(record["wall_contacts"] > 0 for record in known),
        "retries": sum(record["retries"] for record in known),
        "sim_time_s": sum(record["sim_time_s"] for record in known),
        "longest_sim_time_s": max((record["sim_time_s"] for record in known), default=None),
        "by_world": _shares(records, "world"),
        "by_light": _shares(records, "light"),
        "by_odometry": _shares(records, "odometry"),
        "renderers": dict(sorted(Counter(record["renderer"] for record in known).items())),
    }


def error_figures(values: Sequence[float]) -> Dict[str, Any]:
    """Return median, 95 % quantile and maximum of the magnitudes; null without any."""
    if not values:
        return {"median": None, "p95": None, "max": None}
    sizes = np.abs(values)
    return {
        "median": float(np.median(sizes)),
        "p95": float(np.quantile(sizes, 0.95)),
        "max": float(sizes.max()),
    }


def _shares(records: Sequence[Record], name: str) -> Dict[str, Any]:
    """Return how many docked of how many, for each value that a column has."""
    total = Counter(record[name] for record in records)
    docked = Counter(record[name] for record in records if record["result"] == DOCKED)
    return {value: f"{docked[value]} of {total[value]}" for value in sorted(total)}


def write_campaign_csv(path: Path, records: Sequence[Record]) -> None:
    """Write a row for each docking, every number with all its digits; raises FileError."""

    def write(part: Path) -> None:
        with part.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(records[0])
            writer.writerows(_cells(record) for record in records)

    replace_file(path, write)


def _cells(record: Record) -> List[Any]:
    return ["" if value is None else value for value in record.values()]


class DockLogError(LabError):
    """A log that this campaign cannot go on with."""


class DockLog:
    """Lines of JSON: the campaign's parameters, then a docking each, in the order they came.

    A line is written at once and whole. The last one may still be a part, if the machine or the
    disk has failed: it is cut off, and its docking is missing.

    Args:
        path: of the file; made if need be.
        parameters: what decides the outcome of each docking.

    Raises:
        DockLogError: the file is that of a campaign with other parameters, is no log, or
            another campaign is writing to it.
        FileError: it cannot be read or written.
    """

    def __init__(self, path: Path, parameters: Mapping[str, Any]):
        self._path = path
        self._header = _line({"campaign": parameters})
        self.records: Dict[int, Record] = {}
        try:
            # Unbuffered, so that what is written is in the file whatever becomes of this process.
            self._file = path.open("a+b", buffering=0)
        except OSError as error:
            raise FileError(f"cannot write {path}: {error.strerror}") from error
        try:
            self._lock()
            self._read()
        except LabError:
            self._file.close()
            raise

    def append(self, record: Record) -> None:
        """Add the record of a docking, which has its "index"; raises FileError."""
        self._write(_line(record))
        self.records[record["index"]] = record

    def sort(self) -> None:
        """Put the lines in the order of their indices and close the file; raises FileError."""
        lines = [self._header, *(_line(self.records[index]) for index in sorted(self.records))]
        replace_file(self._path, lambda part: part.write_bytes(b"".join(lines)))
        self.close()

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise DockLogError(f"another campaign is writing to {self._path}") from None

    def _read(self) -> None:
        self._file.seek(0)
        data = self._file.readall()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            self._file.truncate(len(whole))
        lines = whole.splitlines(keepends=True)
        if not lines:
            self._write(self._header)
            return
        self._check_header(lines[0])
        for number, line in enumerate(lines[1:], start=2):
            record = self._parse(line, number)
            if not isinstance(record.get("index"), int):
                raise DockLogError(f"{self._path}, line {number}: this is no docking")
            self.records[record["index"]] = record

    def _check_header(self, line: bytes) -> None:
        if line == self._header:
            return
        found = self._parse(line, 1).get("campaign")
        if not isinstance(found, dict):
            raise DockLogError(f"{self._path} is no log of a campaign")
        wanted = json.loads(self._header)["campaign"]
        raise DockLogError(
            f"{self._path} is the log of a campaign with other parameters "
            f"({', '.join(_differences(found, wanted))}): choose another folder, or remove it"
        )

    def _parse(self, line: bytes, number: int) -> Dict[str, Any]:
        try:
            values = json.loads(line)
        except ValueError:
            values = None
        if not isinstance(values, dict):
            raise DockLogError(f"{self._path}, line {number}: this is no line of a campaign")
        return values

    def _write(self, line: bytes) -> None:
        try:
            written = self._file.write(line)
        except OSError as error:
            raise FileError(f"cannot write {self._path}: {error.strerror}") from error
        if written < len(line):
            raise FileError(f"cannot write {self._path}: {os.strerror(errno.ENOSPC)}")


def _line(values: Mapping[str, Any]) -> bytes:
    return (json.dumps(values, allow_nan=False) + "\n").encode()


def _differences(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> List[str]:
    names = [name for name in {**wanted, **found} if found.get(name) != wanted.get(name)]
    return [f"{name} {_shown(found.get(name))}, not {_shown(wanted.get(name))}" for name in names]


def _shown(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
