"""Fingerprints: a result file as a hash and a few numbers, small enough for a repository."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Sequence, Tuple

import numpy as np
from PIL import Image

from bullet_lab.errors import LabError

WALL_CLOCK_KEYS = ("wall_time_s", "real_time_factor")
"""Keys of JSON files whose values depend on the speed of the run; they are left out."""

MOST_COLUMNS = 100
"""A table with more columns, such as a laser's, is summarized as one column."""

_DIGITS = 9
_HASH_DIGITS = 16
_TUM = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")


class FingerprintError(LabError):
    """A result cannot be read."""


@dataclass(frozen=True)
class Fingerprint:
    """A summary of a result file.

    Attributes:
        hash: hash of its bytes; for JSON, without the keys that are left out.
        numbers: numbers by their names, to nine digits. For tables: row count, mean and standard
            deviation of each column. For JSON: each number, and each list as a column. For
            pictures: width, height, mean and standard deviation of each channel. For other
            files: all their numbers as one column.
    """

    hash: str
    numbers: Mapping[str, float]

    @staticmethod
    def of(path: Path, left_out: Sequence[str] = WALL_CLOCK_KEYS) -> Fingerprint:
        """Read a file.

        Raises:
            FingerprintError: the file cannot be read, or its content does not fit its suffix.
        """
        try:
            content, columns = _content(path, left_out)
        except (OSError, ValueError, csv.Error) as error:
            raise FingerprintError(f"cannot read {path}: {error}") from error
        numbers = _summary(columns).items()
        rounded = {name: float(f"{value:.{_DIGITS}g}") for name, value in numbers}
        return Fingerprint(hashlib.sha256(content).hexdigest()[:_HASH_DIGITS], rounded)

    def difference(self, reference: Fingerprint) -> Tuple[float, str]:
        """Return the largest difference from the numbers of a reference, and that number's name.

        Differences are relative for numbers beyond 1, absolute below, and infinite for a number
        that only one of the two has.

        >>> a, b = Fingerprint("", {"x": 2.5, "y": 0.1}), Fingerprint("", {"x": 2.0, "y": 0.0})
        >>> a.difference(b)
        (0.25, 'x')
        >>> a.difference(Fingerprint("", {"x": 2.5}))
        (inf, 'y')
        """
        differences = [(0.0, "")]
        for name in {*self.numbers, *reference.numbers}:
            difference = math.inf
            if name in self.numbers and name in reference.numbers:
                theirs = reference.numbers[name]
                difference = abs(self.numbers[name] - theirs) / max(1.0, abs(theirs))
            differences.append((difference, name))
        return max(differences)


def _content(path: Path, left_out: Sequence[str]) -> Tuple[bytes, Dict[str, Iterable[Any]]]:
    """Return the bytes of a file that are hashed, and its columns by their names."""
    data = path.read_bytes()
    if path.suffix == ".png":
        return data, _channels(path)
    if path.suffix == ".csv":
        header, *rows = csv.reader(path.read_text().splitlines())
        return data, {name: [row[i] for row in rows] for i, name in enumerate(header)}
    if path.suffix == ".tum":
        return data, dict(zip(_TUM, zip(*(line.split() for line in path.read_text().splitlines()))))
    if path.suffix not in (".json", ".jsonl"):
        return data, {"numbers": _NUMBER.findall(data.decode(errors="replace"))}
    text = path.read_text()
    texts = text.splitlines() if path.suffix == ".jsonl" else [text]

    def without(value: Dict[str, Any]) -> Dict[str, Any]:
        return {key: entry for key, entry in value.items() if key not in left_out}

    values = [json.loads(entry, object_hook=without) for entry in texts]
    columns: Dict[str, List[float]] = {}
    for name, number in _leaves(values, ""):
        columns.setdefault(name, []).append(number)
    return json.dumps(values).encode(), columns


def _channels(path: Path) -> Dict[str, Iterable[Any]]:
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB"), dtype=float).reshape(-1, 3)
        size = {"width": [image.width], "height": [image.height]}
    return {**size, **dict(zip(("red", "green", "blue"), pixels.T))}


def _leaves(value: Any, name: str) -> Iterator[Tuple[str, Any]]:
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _leaves(entry, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for entry in value:
            yield from _leaves(entry, name)
    elif isinstance(value, (int, float)):
        yield name, float(value)


def _summary(columns: Mapping[str, Iterable[Any]]) -> Dict[str, float]:
    """Summarize columns by their names; ignore entries that are not finite numbers."""
    if len(columns) > MOST_COLUMNS:
        columns = {"all columns": [entry for column in columns.values() for entry in column]}
    numbers: Dict[str, float] = {}
    for name, column in columns.items():
        entries = [number for number in map(_number, column) if math.isfinite(number)]
        if len(entries) == 1:
            numbers[name] = entries[0]
        elif entries:
            numbers[f"{name} count"] = len(entries)
            numbers[f"{name} mean"] = float(np.mean(entries))
            numbers[f"{name} std"] = float(np.std(entries))
    return numbers


def _number(entry: Any) -> float:
    try:
        return float(entry)
    except ValueError:
        return math.nan
