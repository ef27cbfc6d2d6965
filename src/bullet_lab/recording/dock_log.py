"""A campaign's log: a line for each docking, from which a stopped campaign goes on."""

from __future__ import annotations

import errno
import fcntl
import json
import os
from pathlib import Path
from typing import Any, Dict, List, Mapping

from bullet_lab.errors import LabError
from bullet_lab.recording.files import FileError, replace_file

Record = Mapping[str, Any]


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
